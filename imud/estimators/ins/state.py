"""The records of the navigation filter: one for each concern, and what a rewind restores.

Error states are "true minus estimate", 37 of them, in the order of the table below. The attitude error is a small
rotation phi in navigation axes, C_true = exp(phi) C.

| error state            | unit    | what it is |
|------------------------|---------|------------|
| POSITION (3)           | m       | north, east, down |
| VELOCITY (3)           | m/s     | north, east, down |
| ATTITUDE (3)           | rad     | small rotation about north, east, down |
| GYRO_BIAS (3)          | rad/s   | body axes |
| ACCEL_BIAS (3)         | m/s^2   | body axes |
| GNSS_BIAS (3)          | m       | correlated error of the receiver's position, first-order Gauss-Markov, NED |
| MOUNT_PITCH, MOUNT_YAW | rad     | of the vehicle's forward axis in the body |
| TIME_OFFSET            | s       | by which a fix is older than its epoch says |
| GYRO_SCALE (9)         | rad/rad | scale factors and misalignments of the gyros: error about each body axis per rate about x, then y, then z |
| NHC_LEVER_ARM          | m       | of the sensor ahead of the point about which the vehicle turns |
| VELOCITY_TIME_OFFSET   | s       | by which the receiver's velocity is older than its position |
| ODOMETER_SCALE         |         | by which the odometer's reading is too large, as a share of the speed |
| BARO_OFFSET            | m       | by which the barometer's height is too large |
| GNSS_VELOCITY_BIAS (3) | m/s     | correlated error of the receiver's velocity, first-order Gauss-Markov, NED |
"""  # noqa: E501 a table's row is one line

import numpy as np

from ..records import FIX, INNOVATION, MEASUREMENT

STATES = 37
POSITION, VELOCITY, ATTITUDE, GYRO_BIAS, ACCEL_BIAS, GNSS_BIAS = 0, 3, 6, 9, 12, 15
MOUNT_PITCH, MOUNT_YAW, TIME_OFFSET, GYRO_SCALE, NHC_LEVER_ARM, VELOCITY_TIME_OFFSET = 18, 19, 20, 21, 30, 31
ODOMETER_SCALE, BARO_OFFSET, GNSS_VELOCITY_BIAS = 32, 33, 34

COARSE_ALIGNMENT, NAVIGATING = 0, 1  # modes: roll and pitch only, position from GNSS; everything
FREE, AUTO, LAND = 0, 1, 2  # vehicle

HYPOTHESES = 33  # of the rate at which the level frame rotates during alignment
NEVER_NS = -(1 << 62)  # a time before all others
IMU_RING = 4096  # samples kept: 2 s at the highest rate
SNAPSHOTS = 64
SNAPSHOT_NS = 50_000_000
ONSETS = 3  # times at which the receiver may have begun to drift
AIDING_RING = 256  # measurements kept: 2 s of sources of 100 Hz
BANKS = 32  # fixes of which the hypothesis bank is kept
LEARNING_STATES = 9  # of which the sensitivity to the process noise is known: position, velocity, attitude
JACOBIAN_LENGTH = 10  # most nonzero elements of a row of H
STEP_INNOVATIONS = 8  # of one sample: a window of rest and a constraint
PENDING_INNOVATIONS = 1024  # kept until they are asked for

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
        ("frozen_position", "<f8", (2,)),  # latitude and longitude of the last fix
        ("frozen_since_ns", "<i8"),  # and since when they are the same
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

BAROMETER = np.dtype(  # at the last reading
    [
        ("last_ns", "<i8"),  # its epoch
        ("last_used_ns", "<i8"),  # that of the last that was used
        ("height", "<f8"),  # m
        ("speed2", "<f8"),  # m^2/s^2, square of the speed
    ],
    align=True,
)

HEADING_AID = np.dtype([("last_ns", "<i8")], align=True)  # epoch of the last heading

ODOMETER = np.dtype(
    [
        ("last_ns", "<i8"),  # epoch of the last reading
        ("last_used_ns", "<i8"),  # and of the last that was used
        ("reverses", "<i8"),  # 1: there was a reading below zero
        ("direction", "<f8"),  # 1: readings above zero are along the forward axis, -1: against it; 0: not known
    ],
    align=True,
)

WHEEL_CHECK = np.dtype(  # the receiver's velocity against the wheels: sums over the fixes that contradict them
    [
        ("onset_ns", "<i8"),  # the first of these fixes
        ("count", "<f8"),
        ("z_n", "<f8"),  # m/s, velocity of the fix less that of the estimate
        ("z_e", "<f8"),
        ("z2", "<f8"),  # m^2/s^2, its square
        ("turned", "<f8"),  # m^2/s^2, its product with the velocity, turned to the right
        ("v2", "<f8"),  # m^2/s^2, square of the velocity
        ("agreements", "<i8"),  # fixes in a row that agree, after a drift was detected
    ],
    align=True,
)

ALIGNMENT = np.dtype(  # in a level frame of arbitrary heading; complex numbers are north + i east
    [
        ("mode", "<i8"),
        ("heading_sigma", "<f8"),  # rad, of a heading given by the user; 0: none
        (
            "heading_bias_gain",
            "<f8",
        ),  # s, heading error per error of the vertical gyro bias
        ("integrals", "<f8", (4, 2)),  # since the origin, of: level specific force, 1, G, exp(i y)
        ("double_integrals", "<f8", (4, 2)),  # integrals of these
        ("heading_phasor", "<f8", (2,)),  # exp(i y), y: heading of the body in the integrals' frame, rad
        ("frame_azimuth", "<f8"),  # rad, azimuth of the level frame of q_nb in that of the integrals
        ("corrected_rotation", "<f8"),  # rad, integral of bias_correction: the frame would have rotated by it
        ("bias_correction", "<f8"),  # rad/s, corrections of the vertical gyro bias since the origin
        (
            "corrections",
            "<f8",
            (3, 2),
        ),  # m/s^2, m/s^3, m/s^2: of tilt, level gyro bias, accelerometer bias, since then
        ("pair_start_ns", "<i8"),  # last fix used for alignment
        ("pair_start", "<f8", (6,)),  # its velocity, latitude and longitude, and the acceleration
        ("pair_integrals", "<f8", (4, 2)),  # integrals then
        ("pair_double_integrals", "<f8", (4, 2)),
        ("mean_velocity", "<f8", (3,)),  # m/s north, east, of the last pair of positions; its s, 0: none
        ("mean_integrals", "<f8", (4, 2)),
        ("low_motion_position", "<f8", (2,)),  # latitude and longitude of the first fix since motion is low
        ("low_motion_ns", "<i8"),
        ("origin_ns", "<i8"),
        ("position_origin", "<f8", (2,)),  # latitude and longitude from which the positions of fixes are counted
        ("last_match_ns", "<i8"),  # last fix matched
        ("reject_count", "<i8"),  # fixes in a row that contradict the specific force
        ("heading_fault_count", "<i8"),  # pairs in a row that contradict the heading
    ],
    align=True,
)

TRANSITION = np.dtype(  # F over one interval of the covariance: the blocks that differ from the identity
    [
        ("interval", "<f8"),  # s; position from velocity
        ("force", "<f8", (3,)),  # m/s, integral of specific force, NED: its cross product is velocity from attitude
        ("rotation", "<f8", (9,)),  # C_nb: velocity from accelerometer bias, attitude from gyro bias
        ("turn_angle", "<f8"),  # rad, about the vertical
        ("scaled_angle", "<f8", (3,)),  # rad, body, the rotation that is applied now: attitude from gyro_scale
        ("gnss_bias", "<f8"),  # decay of the GNSS bias
        ("gnss_velocity_bias", "<f8"),  # and of that of the velocity
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
    ("alignment", ALIGNMENT),
    ("barometer", BAROMETER),
    ("heading_aid", HEADING_AID),
    ("odometer", ODOMETER),
    ("wheel_check", WHEEL_CHECK),
]
SNAPSHOT = np.dtype(REWOUND, align=True)
CORE = np.dtype([*REWOUND, ("scratch", SCRATCH)], align=True)

HYPOTHESIS_BANK = np.dtype(
    [
        ("integrals", "<f8", (HYPOTHESES, 4, 2)),  # as the core's, to the last matched fix, turned back
        ("double_integrals", "<f8", (HYPOTHESES, 4, 2)),
        (
            "whitening_state",
            "<f8",
            (HYPOTHESES, 3, 5, 2),
        ),  # position, velocity, GNSS bias of the fixes and of each integral
        ("whitening_P", "<f8", (3, 3)),  # and their covariance, m, s
        (
            "products",
            "<f8",
            (HYPOTHESES, 5, 5, 2),
        ),  # of the innovations of GNSS, force and three regressors
        ("weight", "<f8"),  # number of matched innovations
        ("energy2", "<f8"),  # sum of squares of the single energies of the velocity changes
        ("energy_age", "<f8"),  # s, their energy times its age
        ("last_integrals", "<f8", (4, 2)),  # the core's then
        ("last_double_integrals", "<f8", (4, 2)),
        # scratch
        ("innovations", "<f8", (5, 2)),
        ("prior", "<f8", (3, 3, 2)),
        ("inverse", "<f8", (3, 3, 2)),
        ("gain", "<f8", (3, 3, 2)),
        ("headings", "<f8", (HYPOTHESES, 3)),
    ],
    align=True,
)

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
