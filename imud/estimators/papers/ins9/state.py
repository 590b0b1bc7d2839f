"""The parameters and the state of `ins9`, and how both begin."""

import math

import numpy as np

from ....configuration.settings import Initial, Settings
from ....math.arrays import Records
from ....sensor_errors.profiles import profile_of

REST_S = 5.0
IN_RUN_S = 300.0  # time in which a bias wanders by its in-run stability
DISTANCE, SPEED, ACCELERATION, STATES = 0, 1, 2, 3
RATE_ERROR, SCALE_ERROR, EARTH, DEVICE, SOURCES = range(5)  # what tilts the reckoning

PARAMETERS = np.dtype(
    [
        ("acceleration_walk", "<f8"),  # (m/s^2)^2/s, Q
        ("distance_var", "<f8"),  # m^2, R
        ("gyro_psd", "<f8"),  # rad^2/s
        ("accel_psd", "<f8"),  # (m/s)^2/s
        ("accel_bias_var", "<f8"),  # (m/s^2)^2
        ("accel_bias_psd", "<f8"),  # (m/s^2)^2/s, of the bias since the rest
        ("gyro_bias_psd", "<f8"),  # (rad/s)^2/s
        ("gyro_scale_var", "<f8"),
        ("accel_scale_var", "<f8"),
    ],
    align=True,
)

STATE = np.dtype(
    [
        ("t_ns", "<i8"),
        ("samples", "<i8"),
        ("first_sample_ns", "<i8"),  # of the first sample
        ("rest_s", "<f8"),  # how long the rest at the start was
        ("moving_s", "<f8"),  # since the rest at the start
        ("w_sum", "<f8", (3,)),  # over that rest
        ("f_sum", "<f8", (3,)),
        ("initial_yaw", "<f8"),  # rad, NaN: unknown
        ("q", "<f8", (4,)),
        ("bg", "<f8", (3,)),
        ("gravity", "<f8"),
        ("w", "<f8", (3,)),  # the newest good sample
        ("f", "<f8", (3,)),
        ("C_rest", "<f8", (9,)),  # q then, as a matrix by rows
        ("rotation_from_rest", "<f8"),  # rad, from the attitude at rest
        ("tilt_by", "<f8", (SOURCES,)),  # rad of tilt, m/s and m level per unit of each source of tilt error
        ("velocity_by", "<f8", (SOURCES,)),
        ("distance_by", "<f8", (SOURCES,)),
        ("velocity_by_bias", "<f8", (9,)),  # s and s^2: per m/s^2 of accelerometer bias, by rows
        ("distance_by_bias", "<f8", (9,)),
        ("reckoned_v", "<f8", (3,)),  # m/s, NED: dead reckoning
        ("reckoned_p", "<f8", (3,)),
        ("p", "<f8", (3,)),  # the nine states, NED
        ("v", "<f8", (3,)),
        ("a", "<f8", (3,)),
        ("predicted", "<f8", (3,)),  # p before the update
        ("P", "<f8", (6,)),
        ("x", "<f8", (STATES,)),
        ("d", "<f8", (STATES,)),
        ("column", "<i8", (1,)),
        ("one", "<f8", (1,)),
        ("innovation", "<f8", (3,)),
        ("variance", "<f8"),
        ("origin", "<f8", (3,)),  # rad, rad, m; NaN: none
        ("origin_var", "<f8", (3,)),
    ],
    align=True,
)


def configure(settings: Settings, rate_hz: float) -> Records:
    """Parameters (PARAMETERS): Q and R, and the sensor's noise for the sigmas of dead reckoning."""
    profile = profile_of(settings)
    p = np.zeros(1, PARAMETERS)
    p["acceleration_walk"] = settings.ins9.acceleration_walk
    p["distance_var"] = settings.ins9.distance_var
    p["gyro_psd"], p["accel_psd"] = profile.gyro_noise**2, profile.accel_noise**2
    p["accel_bias_var"] = profile.accel_bias_initial**2
    p["accel_bias_psd"] = profile.accel_bias_instability**2 / IN_RUN_S
    p["gyro_bias_psd"] = profile.gyro_bias_instability**2 / IN_RUN_S
    p["gyro_scale_var"], p["accel_scale_var"] = profile.gyro_scale**2, profile.accel_scale**2
    return p


def start(parameters: Records, initial: Initial) -> Records:
    """A state (STATE) at rest at its origin, P = 0."""
    s = np.zeros(1, STATE)
    s["origin"], s["one"] = math.nan, 1.0
    s["initial_yaw"] = math.nan if initial.yaw_deg is None else math.radians(initial.yaw_deg)
    if initial.lat_deg is not None and initial.lon_deg is not None:
        s["origin"] = math.radians(initial.lat_deg), math.radians(initial.lon_deg), initial.height_m or 0.0
        s["origin_var"][0, 2] = math.nan if initial.height_m is None else 0.0
    return s
