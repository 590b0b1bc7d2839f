"""The states and constants of the reduced inertial estimator."""

import math

import numpy as np

from ...compile.jit import interpreted
from ...configuration.settings import Initial, Settings
from ...math.arrays import Records
from ...math.earth import STANDARD_GRAVITY, gravity
from ...math.rotation import UNKNOWN_ANGLE
from ...sensor_errors.profiles import profile_of
from ..tuning import Tunable, dtype_of, values_of

(
    NORTH,  # m, error of the position
    EAST,
    DOWN,
    SPEED,  # m/s, along the heading, negative in reverse
    SINK,  # m/s, down
    ACCEL,  # m/s^2, along the heading
    YAW,  # rad
    ROLL,
    PITCH,
    ACCEL_BIAS_X,  # m/s^2
    ACCEL_BIAS_Y,
    GYRO_BIAS,  # rad/s
    GYRO_SCALE,
    FIX_NORTH,  # m, error of the receiver that lasts from fix to fix
    FIX_EAST,
    FIX_DOWN,
    LEAN,  # rad/(m/s^2), roll per lateral acceleration
    SQUAT,  # rad/(m/s^2), pitch per longitudinal acceleration
    WHEEL_SCALE,
    TIME_OFFSET,  # s, by which a fix is older than its epoch says
    STATES,
) = range(21)
TRAVEL_NORTH, TRAVEL_EAST, TRAVEL_DOWN, TRAVEL_SPEED, TRAVEL_YAW, TRAVELS = range(6)  # places in `travel`
WHITE_HORIZONTAL, WHITE_VELOCITY, WHITE_VERTICAL = range(3)  # places in `white_var`
PACKED = STATES * (STATES + 1) // 2
RING = 64  # number of past steps that are stored
JACOBIAN_LENGTH = 7  # elements of a Jacobian

TUNABLES = (
    Tunable("step_s", 0.05, "s", "Samples are averaged over this time.", "Well below what a vehicle's motion takes."),
    Tunable("lean", 0.008, "rad/(m/s^2)", "Roll outwards in a curve.", "Cars: 2 to 7 deg/g."),
    Tunable("lean_sigma", 0.004, "rad/(m/s^2)", "Sigma of lean.", "As above."),
    Tunable("squat", 0.006, "rad/(m/s^2)", "Pitch up when gaining speed.", "Cars: 1.5 to 5 deg/g."),
    Tunable("squat_sigma", 0.003, "rad/(m/s^2)", "Sigma of squat.", "As above."),
    Tunable("accel_sigma", 1.5, "m/s^2", "Sigma of the acceleration along the heading.", "City traffic: 1 to 2."),
    Tunable("accel_time_s", 3.0, "s", "Correlation time of the acceleration.", "City traffic: 2 to 5."),
    Tunable("tilt_walk", 0.006, "rad/sqrt(s)", "Random walk of roll and pitch.", "Grades change by 1 deg in 10 s."),
    Tunable("lateral_sigma", 0.1, "m/s", "Sigma of the lateral velocity of a vehicle on wheels.", "Tyres, antenna."),
    Tunable("force_sigma", 0.1, "m/s^2", "Sigma of a force that no state explains, per step.", "Unevenness of roads."),
    Tunable("sink_walk", 0.1, "m/s^2/sqrt(Hz)", "Random walk of the vertical velocity.", "tilt_walk at 15 m/s."),
    Tunable(
        "fix_sigma", 1.5, "m", "Sigma of the lasting error of a fix at HDOP 1 that reports none.", "GPS: 1 to 2.5."
    ),
    Tunable(
        "fix_time_s",
        60.0,
        "s",
        "Correlation time of the lasting error of a fix.",
        "Atmosphere, multipath: 30 s to minutes.",
    ),
    Tunable("fix_white_sigma", 0.5, "m", "First sigma of the white error of a fix.", "Is learned."),
    Tunable(
        "velocity_sigma", 0.1, "m/s", "First sigma of the white error of a fix's velocity.", "Doppler; is learned."
    ),
    Tunable("time_offset_sigma", 0.2, "s", "Sigma of the age of a fix beyond its epoch.", "As navigation."),
    Tunable(
        "time_offset_walk",
        0.003,
        "s/sqrt(s)",
        "Random walk of the age of a fix beyond its epoch.",
        "Sentences that wait in a slow line.",
    ),
    Tunable(
        "velocity_time_sigma",
        0.03,
        "s",
        "Sigma of the age of a receiver's velocity beyond that of its position.",
        "Receivers filter their velocity: 0.02 to 0.05.",
    ),
    Tunable("learning_fixes", 50.0, "", "Fixes over which white errors are learned.", "A minute at 1 Hz."),
    Tunable(
        "align_speed",
        3.0,
        "m/s",
        "Speed from which the course is taken as the heading at the start.",
        "Nobody reverses as fast.",
    ),
    Tunable("course_speed", 1.0, "m/s", "Speed from which the lateral velocity corrects the heading.", "Receivers."),
    Tunable("rest_speed", 0.3, "m/s", "Receiver's speed below which the vehicle may rest.", "Receivers at rest: 0.1."),
    Tunable("rest_rate", 0.02, "rad/s", "Yaw rate below which the vehicle may rest.", "1 deg/s."),
    Tunable(
        "rest_force",
        0.05,
        "m/s^2",
        "Change of the specific force below which the vehicle may rest.",
        "Half a percent of g.",
    ),
    Tunable("rest_s", 3.0, "s", "Time for which all signs of rest must last.", "Longer than a turning point."),
    Tunable("min_white_position", 0.05, "m", "Least white sigma that is learned of a position.", "RTK."),
    Tunable("min_white_velocity", 0.03, "m/s", "Least white sigma that is learned of a velocity.", "Real receivers."),
    Tunable("min_white_height", 0.1, "m", "Least white sigma that is learned of a height.", "RTK."),
    Tunable("initial_yaw_sigma", math.radians(2.0), "rad", "Sigma of a heading that the user gives.", "Choice."),
    Tunable("fault_rate", 0.3, "rad/s", "Error of the yaw rate while the gyro fails.", "A vehicle's turn."),
    Tunable(
        "rejected_sink_variance",
        0.1,
        "m^2/s^2",
        "Variance added to that of the vertical velocity with each rejected height.",
        "Choice.",
    ),
    Tunable(
        "rejected_height_share",
        0.1,
        "",
        "Variance added to that of the height then, over that of the innovation.",
        "Choice.",
    ),
    Tunable("gate", 30.0, "NIS", "Gate of two measurements.", "Chi-square, 3e-7."),
    Tunable(
        "rejected_limit",
        10,
        "",
        "Number of rejected fixes in a row after which the filter is reset to them.",
        "10 s at 1 Hz.",
    ),
    Tunable("wheel_sigma", 0.05, "m/s", "Sigma of a wheel speed that reports none.", "Pulses of an ABS ring at 10 Hz."),
    Tunable(
        "wheel_scale_sigma", 0.05, "", "Sigma of the wheels' scale factor at the start.", "Worn or other tyres: 3 %."
    ),
    Tunable("wheel_scale_walk", 5e-5, "1/sqrt(s)", "Random walk of the wheels' scale factor.", "0.3 % in an hour."),
    Tunable(
        "wheel_slip",
        0.004,
        "",
        "Sigma of the slip at a constant speed, as a share of the speed.",
        "Rolling resistance.",
    ),
    Tunable(
        "wheel_slip_per_accel",
        0.004,
        "1/(m/s^2)",
        "Sigma of the slip per acceleration.",
        "10 % at 1 g: Wong (2008), ch. 1.",
    ),
    Tunable("wheel_slip_time_s", 1.0, "s", "Correlation time of the slip.", "As navigation."),
    Tunable("wheel_sign_sigmas", 3.0, "sigma", "Speed, in sigmas, whose sign a reading takes.", "Three sigma."),
    Tunable(
        "wheel_dead_speed", 0.3, "m/s", "Speed below which wheels are reported as standing.", "Pulses of an ABS ring."
    ),
    Tunable("wheel_gate", 12.0, "NIS", "Gate of a wheel speed.", "3.5 sigma: slip is common."),
    Tunable("max_late_s", 2.5, "s", "Age beyond which fixes are rejected.", "Shorter than the past that is kept."),
    Tunable(
        "max_heading_sigma",
        math.radians(20.0),
        "rad",
        "Heading sigma up to which HEADING_VALID is set.",
        "As navigation.",
    ),
    Tunable("max_tilt_sigma", math.radians(10.0), "rad", "Tilt sigma up to which ATTITUDE_VALID is set.", "As tilt."),
    Tunable("coasting_s", 2.5, "s", "Time without a fix after which COASTING is set.", "Two fixes of a 1 Hz receiver."),
)

PARAMETERS = np.dtype(
    [
        ("tuning", dtype_of(TUNABLES)),
        ("gyro_psd", "<f8"),  # rad^2/s
        ("gyro_bias_var", "<f8"),  # (rad/s)^2
        ("gyro_bias_psd", "<f8"),  # rad^2/s^3
        ("gyro_scale_var", "<f8"),
        ("accel_psd", "<f8"),  # (m/s^2)^2/Hz
        ("accel_bias_var", "<f8"),  # (m/s^2)^2
        ("accel_bias_psd", "<f8"),
        ("gnss_lever_arm", "<f8", (3,)),  # m, antenna from the sensor, body
        ("odometer_lever_arm", "<f8", (3,)),  # m, wheel from the sensor, body
    ],
    align=True,
)

STATE = np.dtype(
    [
        ("t_ns", "<i8"),  # of the newest sample
        ("step_ns", "<i8"),  # time of the newest step, and of the fields that follow
        ("started", "<i8"),  # 1: there was a sample
        ("levelled", "<i8"),  # 1: roll and pitch are initialized
        ("aligned", "<i8"),  # 1: the heading is known, and the position is the vehicle's
        ("fix_count", "<i8"),  # fixes processed
        ("fix_ns", "<i8"),  # epoch of the newest fix
        ("reject_count", "<i8"),  # rejected fixes in a row
        ("resting", "<i8"),
        ("rest_since_ns", "<i8"),  # since when all signs are those of rest; 0: they are not
        ("rest_f", "<f8", (2,)),  # m/s^2, mean longitudinal and lateral specific force
        ("last_slow_ns", "<i8"),  # when the receiver was last slow
        ("gravity", "<f8"),  # m/s^2
        ("lat", "<f8"),  # rad
        ("lon", "<f8"),
        ("height", "<f8"),
        ("has_height", "<i8"),
        ("v", "<f8", (2,)),  # m/s, north and east, before the heading is known
        ("yaw_rate", "<f8"),  # rad/s, about the vertical, corrected
        ("initial_yaw", "<f8"),  # rad, the user's; NaN: none
        ("count", "<i8"),  # samples since the step
        ("w_sum", "<f8"),
        ("f_sum", "<f8", (3,)),
        ("down_sum", "<f8", (3,)),
        ("force_count", "<i8"),  # samples in f_sum
        ("rate_count", "<i8"),  # samples in w_sum
        ("outage_s", "<f8"),  # s without a rate
        ("f_last", "<f8", (3,)),  # m/s^2, of the sample before
        ("force_scatter", "<f8"),  # (m/s^2)^2, variance of a force between successive samples
        ("white_var", "<f8", (3,)),  # white variances: horizontal position m^2, velocity (m/s)^2, height m^2
        ("fix_var", "<f8", (3,)),  # m^2, of the receiver's correlated error
        ("x", "<f8", (STATES,)),
        ("P", "<f8", (PACKED,)),
        ("dx", "<f8", (STATES,)),
        ("d", "<f8", (STATES,)),
        ("columns", "<i8", (JACOBIAN_LENGTH,)),
        ("row", "<f8", (JACOBIAN_LENGTH,)),
        ("travel", "<f8", (TRAVELS,)),  # integrals: north, east, down m, speed m/s, yaw rad
        ("ring", "<f8", (RING, TRAVELS)),  # travel at past steps
        ("ring_ns", "<i8", (RING,)),
        ("ring_at", "<i8"),  # index of the newest
        ("wheel_ns", "<i8"),  # epoch of the newest reading of the wheels; 0: none
    ],
    align=True,
)
UNKNOWN_SPEED = 20.0  # m/s, 1 sigma
BIAS_WALK_S = 100.0  # time in which a bias walks by its instability


def configure(settings: Settings, rate_hz: float) -> Records:
    """Parameters (PARAMETERS) from the sensor's noise profile."""
    profile = profile_of(settings)
    p = np.zeros(1, PARAMETERS)
    p["tuning"] = values_of(TUNABLES, settings.riss.tuning)
    p["gyro_psd"], p["gyro_bias_var"] = profile.gyro_noise**2, profile.gyro_bias_initial**2
    p["gyro_bias_psd"] = profile.gyro_bias_instability**2 / BIAS_WALK_S
    p["gyro_scale_var"] = profile.gyro_scale**2
    p["accel_psd"], p["accel_bias_var"] = profile.accel_noise**2, profile.accel_bias_initial**2
    p["accel_bias_psd"] = profile.accel_bias_instability**2 / BIAS_WALK_S
    p["gnss_lever_arm"] = settings.navigation.lever_arm
    p["odometer_lever_arm"] = settings.aiding.odometer_lever_arm_m
    return p


def start(parameters: Records, initial: Initial) -> Records:
    """A state (STATE) that waits for its first sample."""
    s, tuning = np.zeros(1, STATE), parameters["tuning"][0]
    s["gravity"] = STANDARD_GRAVITY
    if initial.lat_deg is not None:
        s["gravity"] = interpreted(gravity)(math.radians(initial.lat_deg), initial.height_m or 0.0)
    s["initial_yaw"] = math.nan if initial.yaw_deg is None else math.radians(initial.yaw_deg)
    s["white_var"][0, WHITE_HORIZONTAL] = tuning["fix_white_sigma"] ** 2
    s["white_var"][0, WHITE_VERTICAL] = 4.0 * tuning["fix_white_sigma"] ** 2
    s["white_var"][0, WHITE_VELOCITY] = tuning["velocity_sigma"] ** 2
    diagonal = np.zeros(STATES)
    diagonal[[SPEED, YAW]] = UNKNOWN_SPEED**2, UNKNOWN_ANGLE**2
    diagonal[[ROLL, PITCH]] = UNKNOWN_ANGLE**2
    diagonal[ACCEL] = tuning["accel_sigma"] ** 2
    diagonal[[ACCEL_BIAS_X, ACCEL_BIAS_Y]] = parameters["accel_bias_var"][0]
    diagonal[[GYRO_BIAS, GYRO_SCALE]] = parameters["gyro_bias_var"][0], parameters["gyro_scale_var"][0]
    diagonal[[LEAN, SQUAT]] = tuning["lean_sigma"] ** 2, tuning["squat_sigma"] ** 2
    diagonal[WHEEL_SCALE] = tuning["wheel_scale_sigma"] ** 2
    diagonal[TIME_OFFSET] = tuning["time_offset_sigma"] ** 2
    s["x"][0, LEAN], s["x"][0, SQUAT] = tuning["lean"], tuning["squat"]
    s["P"][0] = np.diag(diagonal)[np.triu_indices(STATES)]
    return s


def checkpoint(state: Records) -> Records:
    """The whole state: a restart of the program is like a gap in the samples."""
    return state


def resume(state: Records, saved: Records) -> None:
    """Continue from a checkpoint in a state before its first sample; one from a recording may hold any numbers."""
    state[:] = saved
    state["ring_at"] %= RING
