"""The core of the navigation filter, a record for each concern, and the rings around it; what a rewind restores."""

import numpy as np

from ..records import FIX, INNOVATION, MEASUREMENT
from .aiding.records import BAROMETER, EXTERNAL_AID, HEADING_AID, MAGNETOMETER, ODOMETER, WHEEL_CHECK
from .alignment.records import ALIGNMENT, HYPOTHESIS_BANK
from .state import (
    AIDING_RING,
    BANKS,
    GYRO_BIAS_ONSETS,
    IMU_RING,
    JACOBIAN_LENGTH,
    LEARNING_STATES,
    ONSETS,
    PENDING_INNOVATIONS,
    SNAPSHOTS,
    STATES,
    STEP_INNOVATIONS,
)

NAV = np.dtype(  # the nominal state: time, and one value for each error state
    [
        ("t_ns", "<i8"),
        ("fused_count", "<i8"),  # measurements fused since the start, in the order of their times
        ("lat", "<f8"),  # rad
        ("lon", "<f8"),  # rad
        ("height", "<f8"),  # m above the ellipsoid
        ("v_n", "<f8", (3,)),  # m/s, NED
        ("q_nb", "<f8", (4,)),  # during coarse alignment the heading has an arbitrary origin
        ("bg", "<f8", (3,)),  # rad/s
        ("ba", "<f8", (3,)),  # m/s^2
        ("gnss_bias", "<f8", (3,)),  # m, NED, fix minus truth: the correlated error of the receiver
        ("forward", "<f8", (3,)),  # unit vector of the vehicle's motion in the body
        ("lateral", "<f8", (3,)),  # unit vector across it, level
        ("time_offset", "<f8"),  # s, a fix is older than its epoch says by this
        ("gyro_scale", "<f8", (9,)),  # gyro error about each body axis per rate about x, then y, then z
        ("nhc_lever_arm", "<f8"),  # m, by which the sensor is ahead of the axle without sideslip
        ("velocity_time_offset", "<f8"),  # s, the receiver's velocity is older than its position by this
        ("odometer_scale", "<f8"),  # the odometer's reading is too large by this share of the speed
        ("baro_offset", "<f8"),  # m, the barometer's height is too large by this
        ("gnss_velocity_bias", "<f8", (3,)),  # m/s, NED, fix minus truth: the correlated error of its velocity
    ],
    align=True,
)

EARTH = np.dtype(  # what depends on the position, evaluated where `position` says
    [
        ("position", "<f8", (2,)),  # latitude rad, height m
        ("sin_lat", "<f8"),
        ("cos_lat", "<f8"),
        ("tan_lat", "<f8"),
        ("lat_per_m", "<f8"),  # rad of latitude per metre north
        ("transverse_per_m", "<f8"),  # rad in the prime vertical per metre east
        ("lon_per_m", "<f8"),  # rad of longitude per metre east
        ("gravity", "<f8"),  # m/s^2
    ],
    align=True,
)

IMU = np.dtype(  # the last sample, and what was integrated since the covariance was propagated
    [
        ("sample_count", "<i8"),  # samples integrated since the start
        ("sample_ns", "<i8"),  # time of the last of them; fixes are fused between samples, too
        ("w", "<f8", (3,)),  # rad/s, body
        ("f", "<f8", (3,)),  # m/s^2, body
        ("saturated", "<i8"),  # 1: the last sample is at the end of the sensor's range
        ("outage_s", "<f8", (2,)),  # s for which rates, and forces, are missing or clipped
        ("integration_time", "<f8"),  # s
        ("delta_v", "<f8", (3,)),  # m/s, integral of specific force in NED
        ("delta_theta", "<f8", (3,)),  # rad, integral of the body's rate
        ("deferred_rotation", "<f8", (3,)),  # rad, body, turned without gyro_scale, until it is notable
        ("accel_n", "<f8", (3,)),  # m/s^2, smoothed acceleration in NED
        ("rate_b", "<f8", (3,)),  # rad/s, smoothed rate of the body
        ("scale_error_rate", "<f8", (3,)),  # rad/s, gyro_scale times the smoothed rate: for the solution
    ],
    align=True,
)

COVARIANCE = np.dtype([("P", "<f8", (STATES * (STATES + 1) // 2,))], align=True)  # packed upper triangle

STATIONARITY = np.dtype(
    [
        # the present window
        ("sample_count", "<i8"),
        ("duration", "<f8"),  # s
        ("sum_w", "<f8", (3,)),
        ("sum_f", "<f8", (3,)),
        ("delta_v", "<f8", (3,)),  # m/s, integral of specific force in NED
        ("sum_w2", "<f8"),
        ("sum_f2", "<f8"),
        ("sum_difference2", "<f8", (2,)),  # of differences between successive rates, and specific forces
        # of complete windows
        ("mean_w", "<f8", (3,)),
        ("mean_f", "<f8", (3,)),
        (
            "max_rate_of_change",
            "<f8",
            (2,),
        ),  # rad^2/s^3, m^2/s^5: most that the means have changed lately, squared, per s
        ("at_rest", "<i8"),
        ("low_motion_count", "<i8"),  # windows of low motion in a row
        ("stationary_count", "<i8"),  # and of none
        (
            "motion_class",
            "<f8",
            (2, 3),
        ),  # at rest and in slow motion: count, mean and variance of the log gyro deviation
        ("log_likelihood_ratio", "<f8"),  # of rest against slow motion, summed over windows
        ("gyro_noise_floor", "<f8"),  # rad/s, smallest gyro deviation measured
        ("vibration_level", "<f8"),  # 0 to 1, how much of a vehicle's vibration there is
        ("vibration_accel_psd", "<f8"),  # m^2/s^3, noise density added by vibration
        ("vibration_gyro_psd", "<f8"),  # rad^2/s
    ],
    align=True,
)

GRAVITY_MONITOR = np.dtype(
    [
        ("time", "<f8"),  # s, since the first window
        ("angle", "<f8", (3,)),  # rad, the measured rate integrated since then
        ("mean_w", "<f8", (3,)),  # of the last window, rad/s
        ("first_f", "<f8", (3,)),  # mean force of the first window, m/s^2
        ("variance", "<f8"),  # m^2/s^4, largest of a mean force since then
        ("last_rest_ns", "<i8"),  # when the body was last at rest
    ],
    align=True,
)

NHC = np.dtype(  # the non-holonomic constraint of a land vehicle
    [
        ("since_update", "<f8"),  # s
        ("enabled", "<i8"),
        ("velocity_scatter", "<f8", (6,)),  # sum of products of the normalised velocity in the body, upper triangle
        ("principal_axis", "<f8", (3,)),  # unit vector of its main direction
        ("ground_scatter", "<f8", (3,)),  # the same over ground
        ("down_sum", "<f8", (3,)),  # sum of the vertical in the body
        ("scatter_weight", "<f8"),
        ("mean_nis", "<f8"),  # smoothed normalised innovation squared
        ("noise_scale", "<f8", (2,)),  # lateral and vertical velocity variance over the assumed one
        ("innovation_sum", "<f8", (2, 2)),  # lateral and vertical: sums of innovations, and of their variances
        ("innovation_count", "<i8"),  # innovations in these
        ("sum_count", "<i8"),  # complete sums since the noise scale was reset
        ("start_variance", "<f8", (STATES,)),  # variances when the constraint was enabled
        ("disable_count", "<i8"),  # times that it was disabled by a contradiction
        ("disabled_ns", "<i8"),  # and the last of them
    ],
    align=True,
)

GNSS = np.dtype(
    [
        ("last_used_ns", "<i8"),  # epoch of the last fix used
        ("fix_count", "<i8"),
        ("speed", "<f8"),  # m/s of the last fix, NaN unknown
        ("bias_sigma", "<f8", (2,)),  # m, horizontal and vertical
        ("reported_sigma", "<f8", (2,)),  # m, by the receiver, horizontal and vertical
        ("noise_var", "<f8", (2,)),  # m^2, learned white variance, horizontal and vertical
        ("velocity_noise_var", "<f8"),  # m^2/s^2, learned variance of a component of its velocity
    ],
    align=True,
)

INTEGRITY = np.dtype(  # rejected fixes, and what they imply for the heading
    [
        ("rejecting", "<i8"),  # 1: the last fix was rejected
        ("reject_count", "<i8", (2,)),  # positions in a row, and heights
        ("reject_start_ns", "<i8", (2,)),  # the first of them, or of those that are consistent with the velocity
        ("outage_at_reject_s", "<f8"),  # since the last fix used, when the first was rejected
        ("reject_offset", "<f8", (2,)),  # m, how far north and east of the estimate that was
        ("last_position", "<f8", (2,)),  # latitude and longitude of the last fix
        ("last_velocity", "<f8", (4,)),  # its velocity north and east, speed and course
        ("unchanged_since_ns", "<i8"),  # when a fix first had that position
        ("unchanged_estimate", "<f8", (2,)),  # latitude and longitude of the estimate then
        ("frozen", "<i8"),  # 1: the vehicle has moved since, so that the receiver is frozen
        ("survey_epochs", "<i8"),  # 1: its epochs are a survey's, not confirmed yet
        ("velocity_reject_count", "<i8"),  # fixes in a row whose velocity was rejected
        (
            "position_inflation",
            "<f8",
            (3,),
        ),  # m^2, beyond P: how far the fixes were that the filter was reset to, fading
        ("reset_score", "<f8"),  # resets to contradicting fixes, fading
    ],
    align=True,
)

PROCESS_NOISE = np.dtype(  # of velocity and attitude, learned
    [
        ("psd", "<f8", (2,)),  # m^2/s^3, rad^2/s
        ("log_psd", "<f8", (2,)),  # their logarithms, and the covariance of these, packed
        ("log_psd_covariance", "<f8", (3,)),
        # derivatives by the logarithms of P, packed, and of the estimate
        ("covariance_sensitivity", "<f8", (2, LEARNING_STATES * (LEARNING_STATES + 1) // 2)),
        ("estimate_sensitivity", "<f8", (2, LEARNING_STATES)),
    ],
    align=True,
)

DRIFT = np.dtype(  # the test for a receiver that drifts (GLR)
    [
        ("detected", "<i8"),  # by what: BY_POSITIONS, BY_WHEELS; 0: none is detected
        ("noise_scale", "<f8"),  # variance of the receiver's bias over the reported one
        ("noise_scale_count", "<i8"),  # onsets from which it was learned
        ("pending_noise_scale", "<f8"),  # that of the last closed onset, learned at the next
        ("onset_ns", "<i8", (ONSETS,)),  # start of a hypothetical drift
        ("innovation_count", "<i8", (ONSETS,)),  # since
        ("information_vector", "<f8", (ONSETS, 2)),  # s/m, of the drift velocity north and east
        ("information_matrix", "<f8", (ONSETS, 3)),  # s^2/m^2, upper triangle
        (
            "bias_sensitivity",
            "<f8",
            (STATES, 2 * ONSETS),
        ),  # error states per m/s of drift, north and east for each onset
    ],
    align=True,
)

TIME_OFFSET_STEP = np.dtype(  # the test for a step of the receiver's stamps (GLR)
    [
        ("onset_ns", "<i8"),  # the last fix that was as expected
        ("information", "<f8"),  # 1/s^2, of the step
        ("vector", "<f8"),  # 1/s, information times step
        ("energy", "<f8"),  # sum of the normalised innovations squared
        ("count", "<i8"),  # number of these
        ("sensitivity", "<f8", (STATES, 1)),  # error states per second of the step
        ("jump", "<f8", (2, 3)),  # of positions north, east: sums of 1 / s, of mean / s, of innovation / s
    ],
    align=True,
)

GYRO_BIAS_STEP = np.dtype(  # the test for a step of the gyro bias about the vertical (GLR)
    [
        ("last_ns", "<i8"),  # the last fix
        ("heading_variance", "<f8"),  # rad^2, beyond P: of a step that is likely but not detected
        ("onset_ns", "<i8", (GYRO_BIAS_ONSETS,)),
        ("information", "<f8", (GYRO_BIAS_ONSETS,)),  # s^2/rad^2, of the step
        ("vector", "<f8", (GYRO_BIAS_ONSETS,)),  # s/rad, information times step
        ("energy", "<f8", (GYRO_BIAS_ONSETS,)),  # sum of the normalised innovations squared
        ("count", "<f8", (GYRO_BIAS_ONSETS,)),  # number of these
        ("sensitivity", "<f8", (STATES, GYRO_BIAS_ONSETS)),  # error states per rad/s of the step
    ],
    align=True,
)

TRANSITION = np.dtype(  # F over one interval of the covariance: the blocks that differ from the identity
    [
        ("interval", "<f8"),  # s; position from velocity
        ("delta_v", "<f8", (3,)),  # m/s, integral of specific force, NED: its cross product is velocity from attitude
        ("C_nb", "<f8", (9,)),  # body to navigation axes: velocity from accelerometer bias, attitude from gyro bias
        ("turn_angle", "<f8"),  # rad, about the vertical
        ("scaled_angle", "<f8", (3,)),  # rad, body, the rotation that is applied now: attitude from gyro_scale
        ("gnss_bias_decay", "<f8"),  # factor of the GNSS position bias
        ("gnss_velocity_bias_decay", "<f8"),  # factor of the GNSS velocity bias
    ],
    align=True,
)

SCRATCH = np.dtype(  # used within one call of the filter's entries only: no snapshot has it
    [
        ("x", "<f8", (STATES,)),  # error estimate that is not injected yet
        ("d", "<f8", (STATES,)),  # P h
        ("columns", "<i8", (JACOBIAN_LENGTH,)),  # h
        ("values", "<f8", (JACOBIAN_LENGTH,)),
        ("transition", TRANSITION),
        ("learning_columns", "<i8", (JACOBIAN_LENGTH,)),  # the part of h, and D h, that learns process noise
        ("learning_values", "<f8", (JACOBIAN_LENGTH,)),
        ("learning_d", "<f8", (LEARNING_STATES,)),
        ("position_innovation", "<f8", (3,)),
        ("accel_fit", "<f8", (3,)),  # m/s^2, acceleration over the uncertain part of the time offset
        ("accel_fit_error", "<f8", (3,)),  # m/s, second-order term of the velocity there
        ("integral_change", "<f8", (4, 2)),
        ("innovations", INNOVATION, (STEP_INNOVATIONS,)),  # of the last sample
        ("innovation_count", "<i8"),
    ],
    align=True,
)

REWOUND = [  # what a rewind restores
    ("nav", NAV),
    ("earth", EARTH),
    ("imu", IMU),
    ("cov", COVARIANCE),
    ("stationarity", STATIONARITY),
    ("gravity_monitor", GRAVITY_MONITOR),
    ("nhc", NHC),
    ("gnss", GNSS),
    ("integrity", INTEGRITY),
    ("process_noise", PROCESS_NOISE),
    ("drift", DRIFT),
    ("time_offset_step", TIME_OFFSET_STEP),
    ("gyro_bias_step", GYRO_BIAS_STEP),
    ("alignment", ALIGNMENT),
    ("barometer", BAROMETER),
    ("heading_aid", HEADING_AID),
    ("magnetometer", MAGNETOMETER),
    ("pose", EXTERNAL_AID),
    ("external_velocity", EXTERNAL_AID),
    ("odometer", ODOMETER),
    ("wheel_check", WHEEL_CHECK),
]
SNAPSHOT = np.dtype(REWOUND, align=True)
CORE = np.dtype([*REWOUND, ("scratch", SCRATCH)], align=True)

STORED_SAMPLE = np.dtype(
    [("t_ns", "<i8"), ("w", "<f8", (3,)), ("f", "<f8", (3,)), ("flags", "<i8"), ("outage_s", "<f8")], align=True
)

STORED_MEASUREMENT = np.dtype(
    [
        ("t_ns", "<i8"),  # of the core when it is fused
        ("kind", "<i8"),
        ("fix", FIX),  # if it is a GNSS fix
        ("measurement", MEASUREMENT),  # if it is from another source
        ("bank", "<i8"),  # number of the hypothesis bank before a fix
        ("too_late", "<i8"),  # 1: its epoch is before the horizon, so that it is fused later
        ("last_epoch_ns", "<i8"),  # these three as in STATE, before a fix
        ("last_time_offset", "<f8"),
        ("last_fusion_ns", "<i8"),
    ],
    align=True,
)

STATE = np.dtype(
    [
        ("core", CORE, (1,)),
        ("bank", HYPOTHESIS_BANK, (1,)),  # changes with fixes only, so that no snapshot needs it
        ("banks", HYPOTHESIS_BANK, (BANKS,)),  # before each of the last fixes
        ("bank_count", "<i8"),  # fixes ever stored
        ("snapshots", SNAPSHOT, (SNAPSHOTS,)),
        ("imu_ring", STORED_SAMPLE, (IMU_RING,)),
        ("aiding_ring", STORED_MEASUREMENT, (AIDING_RING,)),  # in the order of their times
        ("aiding_start", "<i8"),  # measurements no longer kept: the number of the oldest that is
        ("aiding_count", "<i8"),  # measurements kept
        ("snapshot_count", "<i8"),  # snapshots ever taken, less those withdrawn
        ("sample_count", "<i8"),  # samples ever put into the ring
        ("last_epoch_ns", "<i8"),  # epoch of the last fix fused
        ("last_time_offset", "<f8"),  # s, as found at that fix
        ("last_fusion_ns", "<i8"),  # and the time of the core at which it was fused
        ("initial_rpy", "<f8", (3,)),  # rad, NaN where not given by the user
        ("last_w", "<f8", (3,)),  # last good sample, body axes
        ("last_f", "<f8", (3,)),
        ("pending_innovations", INNOVATION, (PENDING_INNOVATIONS,)),
        ("pending_count", "<i8"),  # rows of it
        ("interpolated_w", "<f8", (3,)),  # scratch: the sample interpolated at a fix
        ("interpolated_f", "<f8", (3,)),
    ],
    align=True,
)
