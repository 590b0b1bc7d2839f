"""Parameters from the sensor's noise profile, and the state before the first sample."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...configuration.settings import Initial, Settings
from ...kernels.earth import STANDARD_GRAVITY, gravity
from ...sensor_errors.profiles import PROFILES, Profile, profile_of
from .. import Record
from ..tuning import values_of
from .counts import COARSEST
from .levelling import UNIFORM
from .parameters import TUNABLES
from .state import ACCEL_BIAS, ACCEL_SCALE, ATTITUDE, GYRO_BIAS, GYRO_MATRIX, LAG, PARAMETERS, STATE, STATES
from .truncation import UNLIKELY

GRAVITY_SPREAD = 0.0015  # of standard gravity over the earth's surface, 1 sigma
ACCEL_BIAS_S = 100.0  # in which the accelerometer's bias may change by its instability
LAG_SPREAD = 0.003  # s, of the accelerometer behind the gyro, 1 sigma


def configure(settings: Settings, rate_hz: float) -> Record:
    """Parameters (PARAMETERS) from the sensor's profile; rate_hz is nominal, a step of more than 2.5 periods is a gap.

    Raises KeyError when there is no such profile.
    """
    profile = profile_of(settings)
    assumed = _well_calibrated(profile) if settings.imu.profile == "auto" else profile
    p = np.zeros(1, PARAMETERS)
    p["gap_s"] = 2.5 / rate_hz
    p["gyro_psd"] = profile.gyro_noise**2
    p["gyro_bias_var"] = profile.gyro_bias_initial**2
    p["gyro_bias_psd"] = profile.gyro_bias_instability**2
    p["gyro_matrix_var"] = assumed.gyro_scale**2
    p["accel_psd"] = profile.accel_noise**2
    p["accel_bias_var"] = assumed.accel_bias_initial**2
    p["accel_bias_psd"] = profile.accel_bias_instability**2 / ACCEL_BIAS_S
    p["accel_scale_var"] = assumed.accel_scale**2
    p["gyro_matrix_doubt"] = profile.gyro_scale**2 - p["gyro_matrix_var"]
    p["accel_bias_doubt"] = profile.accel_bias_initial**2 - p["accel_bias_var"]
    p["accel_scale_doubt"] = profile.accel_scale**2 - p["accel_scale_var"]
    p["rest_rate_psd"] = (3.0 * profile.gyro_noise) ** 2
    p["tuning"] = values_of(TUNABLES, settings.attitude.tuning)
    return p


def _well_calibrated(profile: Profile) -> Profile:
    """The profile of a sensor that nobody named, as good as boards that their makers calibrated (M-G350 data sheet).

    Bare parts are several times worse; the filter returns to their figures when the weight at rest says so.
    """
    board = PROFILES["m-g350"]
    return replace(
        profile,
        gyro_scale=min(profile.gyro_scale, board.gyro_scale),
        accel_bias_initial=min(profile.accel_bias_initial, board.accel_bias_initial),
        accel_scale=min(profile.accel_scale, board.accel_scale),
    )


def start(parameters: Record, initial: Initial) -> Record:
    """A state (STATE) that waits for its first sample. A latitude makes gravity known; given angles are kept."""
    s = np.zeros(1, STATE)
    known = initial.lat_deg is not None
    lat = math.radians(initial.lat_deg or 0.0)
    s["gravity"] = gravity(lat, initial.height_m or 0.0) if known else STANDARD_GRAVITY
    s["read"], s["count"], s["truncation"] = math.nan, COARSEST, UNLIKELY
    s["q"] = (1.0, 0.0, 0.0, 0.0)
    angles = (initial.roll_deg, initial.pitch_deg, initial.yaw_deg)
    s["given"] = [math.nan if angle is None else math.radians(angle) for angle in angles]
    s["heading"] = initial.yaw_deg is not None
    s["sigma_tilt"] = s["sigma_rpy"] = UNIFORM
    s["P"][0] = _covariance(parameters, known)[np.triu_indices(STATES)]
    return s


def _covariance(parameters: Record, gravity_known: bool) -> NDArray[np.float64]:
    P = np.zeros((STATES, STATES))
    for first, count, name in (
        (GYRO_BIAS, 3, "gyro_bias_var"),
        (ACCEL_BIAS, 3, "accel_bias_var"),
        (GYRO_MATRIX, 9, "gyro_matrix_var"),
        (ACCEL_SCALE, 3, "accel_scale_var"),
    ):
        each = range(first, first + count)
        P[each, each] = parameters[name][0]
    P[[ATTITUDE, ATTITUDE + 1], [ATTITUDE, ATTITUDE + 1]] = UNIFORM**2  # yaw counts from the start
    P[LAG, LAG] = LAG_SPREAD**2
    if not gravity_known:  # looks like the same scale error on every axis
        P[ACCEL_SCALE : ACCEL_SCALE + 3, ACCEL_SCALE : ACCEL_SCALE + 3] += GRAVITY_SPREAD**2
    return P
