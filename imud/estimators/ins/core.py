"""The core of the navigation filter, a record for each concern, and the rings around it; what a rewind restores.

The records of aiding sources, alignment, GLR tests and integrity monitoring are in `records` of their folders.
"""

import numpy as np

from ...math.lanes import LANES
from ..records import FIX, INNOVATION, MEASUREMENT, PENDING_INNOVATIONS, SOURCE_KINDS
from .aiding.records import (
    BAROMETER,
    EXTERNAL_AID,
    GNSS,
    HEADING_AID,
    LAND_EVIDENCE,
    MAGNETOMETER,
    NHC,
    ODOMETER,
    SOURCE_AGE,
    WHEEL_CHECK,
)
from .alignment.records import ALIGNMENT, FIX_AGE, HYPOTHESIS_BANK
from .glr_tests.records import (
    COMPASS_OFFSET,
    CURRENT,
    DRIFT,
    FAULT_SENSITIVITIES,
    GYRO_BIAS_STEP,
    IMU_BIAS_STEP,
    LEVER_ARM_ERROR,
    TIME_OFFSET_STEP,
    VELOCITY_DRIFT,
)
from .integrity.records import GRAVITY_MONITOR, INTEGRITY, VELOCITY_DISCREPANCY, VELOCITY_LAG
from .state import (
    AIDING_RING,
    BANKS,
    BORESIGHTS,
    EXPONENTIALS,
    FAULTS,
    IMU_RING,
    JACOBIAN_LENGTH,
    LEARNING_STATES,
    SNAPSHOTS,
    STATED,
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
        ("gnss_lever_arm", "<f8", (3,)),  # m, antenna from IMU, body
        ("velocity_mount", "<f8", (4,)),  # from the axes of the velocity sensor to the body's
    ],
    align=True,
)

EARTH = np.dtype(  # what depends on the position, evaluated at this one
    [
        ("lat", "<f8"),  # rad
        ("height", "<f8"),  # m
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
        ("held_s", "<f8"),  # s for which a good sample stands for damaged ones
        ("integration_time", "<f8"),  # s
        ("delta_v", "<f8", (3,)),  # m/s, integral of specific force in NED
        ("delta_theta", "<f8", (3,)),  # rad, integral of the body's rate
        ("deferred_rotation", "<f8", (3,)),  # rad, body, turned without gyro_scale, until it is notable
        ("accel_n", "<f8", (3,)),  # m/s^2, smoothed acceleration in NED
        ("level_force", "<f8", (2,)),  # m/s^2, averaged specific force, north and east
        ("rate_b", "<f8", (3,)),  # rad/s, smoothed rate of the body
        ("scale_error_rate", "<f8", (3,)),  # rad/s, gyro_scale times the smoothed rate: for the solution
    ],
    align=True,
)

COVARIANCE = np.dtype(
    [
        ("P", "<f8", (STATES * (STATES + 1) // 2,)),  # packed upper triangle
        ("boresight", "<f8", (STATES, BORESIGHTS)),  # of the error states with the boresights
        ("boresight_covariance", "<f8", (BORESIGHTS, BORESIGHTS)),  # of these; 0 of what is not estimated
    ],
    align=True,
)

MOTION_CLASS = np.dtype(  # of windows at rest, or in slow motion: their log gyro deviations
    [("count", "<f8"), ("mean", "<f8"), ("variance", "<f8")],
    align=True,
)

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
        ("sum_rate_difference2", "<f8"),  # of differences between successive rates
        ("sum_force_difference2", "<f8"),  # and specific forces
        # of complete windows
        ("mean_w", "<f8", (3,)),
        ("mean_f", "<f8", (3,)),
        ("steady_f", "<f8", (3,)),  # m/s^2, the mean of the window before the first of those of low motion in a row
        # most that the means have changed lately, squared, per s
        ("level_rate_change2", "<f8"),  # rad^2/s^3
        ("vertical_rate_change2", "<f8"),  # rad^2/s^3
        ("force_change2", "<f8"),  # m^2/s^5
        ("mean_down", "<f8", (3,)),  # unit vector, body: the vertical, averaged
        ("tilt_range2", "<f8"),  # rad^2, most by which the vertical has differed from it lately, squared
        ("level_accel2", "<f8"),  # m^2/s^4, largest level acceleration lately, squared
        ("turn_rate_var", "<f8"),  # rad^2/s^2, of the mean rate at rest, as the direction of the force has changed
        ("at_rest", "<i8"),
        ("low_motion_count", "<i8"),  # windows of low motion in a row
        ("stationary_count", "<i8"),  # and of none
        ("contradiction_count", "<i8"),  # windows of standing in a row whose mean rate contradicts the gyro bias
        ("contradicting_w", "<f8", (3,)),  # rad/s, mean rate of the first of them
        ("changed_rate_count", "<i8"),  # windows since, of standing in a row, with another rate
        ("contradicting_turn2", "<f8"),  # rad^2, square of what it has turned the heading by
        ("rest_class", MOTION_CLASS),
        ("slow_motion_class", MOTION_CLASS),
        ("log_likelihood_ratio", "<f8"),  # of rest against slow motion, summed over windows
        ("gyro_noise_floor", "<f8"),  # rad/s, smallest gyro deviation measured
        ("vibration_level", "<f8"),  # 0 to 1, how much of a vehicle's vibration there is
        ("vibration_accel_psd", "<f8"),  # m^2/s^3, noise density added by vibration
        ("vibration_gyro_psd", "<f8"),  # rad^2/s
        ("mean_vibration_gyro_psd", "<f8"),  # of windows under way
        ("vibration_time", "<f8"),  # s, how long those were, up to that of the mean
        ("attitude_noise_level", "<f8"),  # by how much the learned noise of the attitude is multiplied
    ],
    align=True,
)

REST_GAP = np.dtype(  # a gap that began at rest
    [
        ("turn2", "<f8"),  # rad^2, variance of a turn in it, until that is judged; 0: there is none
        ("window_count", "<i8"),  # since
        ("force", "<f8", (3,)),  # m/s^2, body, mean specific force before
        ("force2", "<f8"),  # m^2/s^4, variance of its change in each axis, if the body was not moved
        ("lat", "<f8"),  # rad, where the body was
        ("lon", "<f8"),
        ("place2", "<f8"),  # m^2, variance of that, of both axes together; 0: it was compared, or is not known
    ],
    align=True,
)

TIME_EVIDENCE = np.dtype(  # what changes of the acceleration show of the time offset
    [
        ("velocity_change", "<f8", (3,)),  # m/s, NED, by specific force, in the window
        ("velocity_variance", "<f8"),  # m^2/s^2, that noise adds to each component of it
        ("duration", "<f8"),  # s, of the window until now
        ("accel", "<f8", (3,)),  # m/s^2, NED, mean specific force of the window before
        ("accel_noise", "<f8"),  # m^2/s^4, variance of each component of it; 0: there was none
        ("information", "<f8"),  # 1/s^2, about the time offset, by P at the end of the window before
        ("error_variance", "<f8"),  # s^2, of the time offset then; more than that of P
        ("shown", "<f8"),  # 1/s^2, information that a window has shown; below 0: what those that follow make up for
        ("largest_variance", "<f8"),  # s^2, error_variance at its largest since the alignment
        ("missing_variance", "<f8"),  # s^2, by which P states less now
    ],
    align=True,
)

BIAS_CHANGES = np.dtype(
    [
        ("averaged_force", "<f8", (3,)),  # m/s^2, body
        ("earlier_force", "<f8", (3,)),  # the average of it
        ("warm_up_variance", "<f8"),  # (rad/s)^2: of what warming up may still change
    ],
    align=True,
)

PROCESS_NOISE = np.dtype(  # of velocity and attitude, learned
    [
        ("psd", "<f8", (2,)),  # m^2/s^3, rad^2/s
        ("log_psd", "<f8", (2,)),  # their logarithms, and the covariance of these, packed
        ("log_psd_covariance", "<f8", (3,)),
        ("first_log_psd", "<f8"),  # the velocity's when navigation began; infinite once the noise is known
        # covariance of the filter of nine states, and its derivatives by the logarithms, packed; one lane is empty
        ("covariances", "<f8", (LEARNING_STATES * (LEARNING_STATES + 1) // 2, LANES)),
        # derivatives of the estimate by the logarithms
        ("estimate_sensitivity", "<f8", (2, LEARNING_STATES)),
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
        ("velocity_psd", "<f8"),  # m^2/s^3, process noise
        ("attitude_psd", "<f8"),  # rad^2/s
    ],
    align=True,
)

VELOCITY_EPOCH = np.dtype(  # the antenna at the time at which its velocity was that of a fix
    [
        ("acceleration", "<f8", (3,)),  # m/s^2, NED
        ("second_order", "<f8", (3,)),  # m/s, second-order term of the velocity's time offset
        ("change", "<f8", (3,)),  # m/s, of the antenna's velocity since then
        ("by_lever_arm", "<f8", (3, 3)),  # rad/s, how the lever arm changes the antenna's velocity: C_nb [w x]
    ],
    align=True,
)

SCRATCH = np.dtype(  # used within one call of the filter's entries only: no snapshot has it
    [
        ("x", "<f8", (STATES,)),  # error estimate that is not injected yet
        ("d", "<f8", (STATES,)),  # P h
        ("gain", "<f8", (STATES,)),  # d over the variance of the innovation
        ("columns", "<i8", (JACOBIAN_LENGTH,)),  # h
        ("values", "<f8", (JACOBIAN_LENGTH,)),
        ("transition", TRANSITION),
        ("boresight_row", "<f8", (BORESIGHTS,)),  # B, of the boresights
        ("boresight_e", "<f8", (BORESIGHTS,)),  # their covariances with the innovation
        ("boresight_gain", "<f8", (BORESIGHTS,)),  # these over its variance
        ("fault_innovation", "<f8", (FAULTS,)),  # mean of the innovation per unit of each fault
        ("learning_columns", "<i8", (JACOBIAN_LENGTH,)),  # of the nine states that learn process noise: h
        ("learning_values", "<f8", (JACOBIAN_LENGTH,)),
        ("learning_d", "<f8", (LEARNING_STATES + 1, LANES)),  # their covariances S times h; behind them h S h'
        ("learning_gain", "<f8", (LEARNING_STATES, LANES)),  # the same in all lanes
        ("position_innovation", "<f8", (3,)),
        ("velocity_epoch", VELOCITY_EPOCH),  # of the fix that is fused
        ("integral_change", "<f8", (4, 2)),
        ("innovations", INNOVATION, (STEP_INNOVATIONS,)),  # of the last sample
        ("innovation_count", "<i8"),
        ("age_variance", "<f8"),  # s^2, of the measurement that is fused
        ("fix_age_probability", "<f8"),  # that the time offset is wrong; this and the next change with new fixes
        ("fix_age_error2", "<f8"),  # s^2, mean square of the time offset's error; 0: no ages have been compared
        ("drift", "<f8", (2,)),  # m, what the positions may have drifted until the fix that is fused
        ("discrepancy2", "<f8", (2,)),  # m^2/s^2, of velocity and positions of the receiver, squared, where open
        ("discrepancy_onset_ns", "<i8"),
        ("stated_variances", "<f8", (STATED,)),  # of the last solution: with what P does not have
        ("exp_arguments", "<f8", (EXPONENTIALS,)),  # of the last exponentials, most of which are needed again
        ("exponentials", "<f8", (EXPONENTIALS,)),
        ("stated_sigmas", "<f8", (STATED,)),  # and their square roots, which most samples need again
    ],
    align=True,
)

REWOUND = [  # what a rewind restores
    ("nav", NAV),
    ("earth", EARTH),
    ("imu", IMU),
    ("cov", COVARIANCE),
    ("stationarity", STATIONARITY),
    ("bias_changes", BIAS_CHANGES),
    ("rest_gap", REST_GAP),
    ("gravity_monitor", GRAVITY_MONITOR),
    ("nhc", NHC),
    ("land_evidence", LAND_EVIDENCE),
    ("gnss", GNSS),
    ("time_evidence", TIME_EVIDENCE),
    ("integrity", INTEGRITY),
    ("process_noise", PROCESS_NOISE),
    ("faults", FAULT_SENSITIVITIES),
    ("drift", DRIFT),
    ("time_offset_step", TIME_OFFSET_STEP),
    ("gyro_bias_step", GYRO_BIAS_STEP),
    ("imu_bias_step", IMU_BIAS_STEP),
    ("velocity_drift", VELOCITY_DRIFT),
    ("compass_offset", COMPASS_OFFSET),
    ("current", CURRENT),
    ("lever_arm_error", LEVER_ARM_ERROR),
    ("alignment", ALIGNMENT),
    ("barometer", BAROMETER),
    ("heading_aid", HEADING_AID),
    ("magnetometer", MAGNETOMETER),
    ("pose", EXTERNAL_AID),
    ("external_velocity", EXTERNAL_AID),
    ("body_velocity", EXTERNAL_AID),
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
        ("age_variance", "<f8"),  # s^2, of its epoch less the age of its source
        ("velocity_epoch", VELOCITY_EPOCH),  # of a fix, when it was fused first
        ("restarts", "<i8"),  # 1: at this fix the filter begins anew, without the receiver's velocity
        ("discrepancy", "<f8", (2,)),  # m/s, of its velocity against its positions, where there is one
        ("discrepancy_s", "<f8"),  # time for which there has been one; 0: there is none
        ("discrepancy_open", "<i8"),  # 1: either of the two may be wrong, the positions for no longer than they drift
        ("velocity_lost", "<i8"),  # 1: from this fix on the velocity is not used
        ("discrepancy_lasts", "<i8"),  # 1: from this fix on it is longer than positions drift
        ("bank", "<i8"),  # number of the hypothesis bank before a fix
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
        ("source_ages", SOURCE_AGE, (SOURCE_KINDS,)),  # by kind; change with new measurements only
        ("fix_age", FIX_AGE),  # changes with new fixes only
        ("velocity_discrepancy", VELOCITY_DISCREPANCY),  # the same
        ("velocity_lag", VELOCITY_LAG),  # the same
        ("imu_ring", STORED_SAMPLE, (IMU_RING,)),
        ("aiding_ring", STORED_MEASUREMENT, (AIDING_RING,)),  # in the order of their times
        ("aiding_start", "<i8"),  # measurements no longer kept: the number of the oldest that is
        ("aiding_count", "<i8"),  # measurements kept
        ("snapshot_count", "<i8"),  # snapshots ever taken, less those withdrawn
        ("sample_count", "<i8"),  # samples ever put into the ring
        ("fix", FIX),  # the last one given, as it is used
        ("last_course", "<f8"),  # rad, of that, as it was reported
        ("course_repeats", "<i8"),  # fixes in a row that have repeated a course to the last digit
        ("usual_ahead", "<f8"),  # s, mean time by which fixes are newer than the newest sample
        ("last_epoch_ns", "<i8"),  # epoch of the last fix fused
        ("last_time_offset", "<f8"),  # s, as found at that fix
        ("last_fusion_ns", "<i8"),  # and the time of the core at which it was fused
        ("initial_rpy", "<f8", (3,)),  # rad, NaN where not given by the user
        ("last_w", "<f8", (3,)),  # last good sample, body axes
        ("last_f", "<f8", (3,)),
        ("pending", PENDING_INNOVATIONS),
        ("interpolated_w", "<f8", (3,)),  # scratch: the sample interpolated at a fix
        ("interpolated_f", "<f8", (3,)),
    ],
    align=True,
)
