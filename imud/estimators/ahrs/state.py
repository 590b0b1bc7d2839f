"""The records of the attitude filter: its parameters, and its state by concern.

Error states are "true minus estimate", 28 of them, in the order of the table below. The attitude error is a small
rotation phi in NED: q_true = exp(phi) q_nb. The sensors follow true = (I - M)(measured - bias), M full for the gyro,
diagonal for the accelerometer.

| error state      | unit    | what it is |
|------------------|---------|------------|
| ATTITUDE (3)     | rad     | small rotation about north, east, down |
| GYRO_BIAS (3)    | rad/s   | body axes |
| VELOCITY (3)     | m/s     | north, east, down |
| ACCEL_BIAS (3)   | m/s^2   | body axes |
| GYRO_MATRIX (9)  | 1       | scale factors and misalignments of the gyro, by rows |
| ACCEL_SCALE (3)  | 1       | scale factors of the accelerometer |
| ACCEL_DELAY      | s       | of the accelerometer behind the gyro |
| POSITION (3)     | m       | north, east, down, from a slowly following origin |
"""

import numpy as np

from ..tuning import dtype_of
from .parameters import TUNABLES

ATTITUDE, GYRO_BIAS, VELOCITY, ACCEL_BIAS, GYRO_MATRIX, ACCEL_SCALE, ACCEL_DELAY, POSITION = 0, 3, 6, 9, 12, 21, 24, 25
STATES = 28
JACOBIAN_LENGTH = 8  # most nonzero elements of a row of H
FUSED = 9  # most scalar measurements of an interval
HYPOTHESES = 17  # of how the body moves, before the first rest
HYPOTHESIS_STATES = 11
REGRESSION = 5  # columns of the regression that shows the drag
WINDOW = 32  # codes on either side of the reading next to zero, among which zero itself is sought
BINS = 2 * WINDOW + 1  # of a histogram of readings about zero

# From the sensor's profile: variances, power spectral densities, the nominal sample period.
PARAMETERS = np.dtype(
    [
        ("period_s", "<f8"),  # nominal, of samples
        ("gyro_psd", "<f8"),  # rad^2/s
        ("gyro_bias_var", "<f8"),  # (rad/s)^2 at switch-on
        ("gyro_bias_inflation", "<f8"),  # (rad/s)^2, added to that if the bias contradicts it
        ("gyro_bias_psd", "<f8"),  # (rad/s)^2/s: one bias instability per root second
        ("gyro_matrix_var", "<f8"),
        ("accel_psd", "<f8"),  # (m/s)^2/s
        ("accel_bias_var", "<f8"),  # (m/s^2)^2 at switch-on
        ("accel_bias_psd", "<f8"),  # (m/s^2)^2/s
        ("accel_scale_var", "<f8"),
        # what is added to these variances if the magnitude of the force at the first rest contradicts them
        ("gyro_matrix_inflation", "<f8"),
        ("accel_bias_inflation", "<f8"),
        ("accel_scale_inflation", "<f8"),
        ("mean_rate_psd", "<f8"),  # (rad/s)^2 s: noise of the mean rate at rest
        ("sensor_axes", "<f8", (9,)),  # rotation matrix from the sensor's to body axes: flags are about the sensor's
        ("tuning", dtype_of(TUNABLES)),
    ],
    align=True,
)

NAV = np.dtype(  # the nominal state
    [
        ("q_nb", "<f8", (4,)),
        ("v_n", "<f8", (3,)),  # m/s, NED, from the beginning of the motion
        ("p_n", "<f8", (3,)),  # m, NED, from a slowly following origin
        ("bg", "<f8", (3,)),  # rad/s
        ("ba", "<f8", (3,)),  # m/s^2
        ("gyro_matrix", "<f8", (9,)),
        ("accel_scale", "<f8", (3,)),
        ("accel_delay", "<f8"),  # s
        ("gravity", "<f8"),  # m/s^2
    ],
    align=True,
)

COVARIANCE = np.dtype(
    [
        ("P", "<f8", (STATES * (STATES + 1) // 2,)),  # packed upper triangle
        ("sigma_tilt", "<f8"),  # rad, the larger of roll's and pitch's
        ("sigma_rpy", "<f8", (3,)),
        ("sigma_bg", "<f8", (3,)),
        ("sigma_ba", "<f8", (3,)),
        ("unseen_tilt", "<f8"),  # rad, what the stated sigmas of roll and pitch have beyond those
        ("unseen_yaw", "<f8"),  # rad, the same of yaw
    ],
    align=True,
)

IMU = np.dtype(  # the newest good sample as measured
    [
        ("w", "<f8", (3,)),  # rad/s
        ("f", "<f8", (3,)),  # m/s^2
        ("f_change", "<f8", (3,)),  # m/s^2, from the sample before
        ("gap_w", "<f8", (3,)),  # rad/s, of the newest sample, of the one before what may be a gap, or of what is lost
        ("gap_f", "<f8", (3,)),  # m/s^2, the same
        ("outage_s", "<f8"),  # for how long the rate has been held
        ("fault_s", "<f8"),  # for how long the sensor has been at fault then; 0: its samples are damaged on the line
        ("rate2", "<f8"),  # (rad/s)^2, mean square of the rate lately, per axis
    ],
    align=True,
)

STAMPS = np.dtype(
    [
        ("period", "<f8"),  # s, of even samples
        ("ahead", "<f8"),  # s, by how much the newest sample is later than its stamp
        ("waiting", "<i8"),  # 1: whether samples were lost, or this one came late, is still open
        ("late", "<i8"),  # 1: the newest sample came late, or after lost ones
        ("losses_to_settle", "<i8"),  # so many more lost ones in a row show that none is late any more; 0: none is
        ("misfits", "<i8"),  # two for each sample off the line, less one for each on it
        ("unobserved", "<f8"),  # samples since one was on the line
        ("queued", "<i8"),  # so many samples that were taken for lost may yet come at once
        ("block_samples", "<i8"),  # whose mean period is taken
        ("block_s", "<f8"),  # the time that they took
        ("last_dt", "<f8"),  # s, between the stamps of the newest two samples; 0: not known
        ("rate_change", "<f8", (3,)),  # rad/s, from the sample before
        ("count", "<f8"),  # of the samples in the sum of squares, which fades
        ("squares", "<f8"),  # s^2, of the stamps about those of even samples
        ("taught", "<f8"),  # of the samples in the next three sums, which fade
        ("offset_offset", "<f8"),  # of a reading from its neighbours' mean by its stamp, over the changes; squared
        ("offset_reading", "<f8"),  # the same times that of the reading
        ("reading_reading", "<f8"),  # that of the reading, squared
        ("scatter", "<f8"),  # s, of the stamps about those of even samples
        ("gain", "<f8"),  # with which the line follows the stamps
        ("slope", "<f8"),  # of readings' offsets over those of stamps: 1 where these are right, 0: samples are even
        ("slope_variance", "<f8"),
    ],
    align=True,
)

# of samples that come at once; an interval is from one to the next, and the first ends with the first
QUEUE = np.dtype(
    [
        ("intervals", "<i8"),  # in a row
        ("change", "<f8", (3,)),  # rad/s, of the rate in the newest one
        ("change_before", "<f8", (3,)),  # in the one before
        ("newest_rate", "<f8", (3,)),  # rad/s, NED, mean rate of the newest one
        ("newest_force", "<f8", (3,)),  # m/s^2, NED
        ("weight", "<f8"),  # sum of the probabilities that samples are lost in intervals but the newest
        ("rate", "<f8", (3,)),  # the same times their rates
        ("force", "<f8", (3,)),
        ("square", "<f8"),  # (rad/s)^2
        ("unexplained", "<f8"),  # changes less what their neighbours explain, over these; squared, sum, which fades
        ("count", "<f8"),  # of changes in it
    ],
    align=True,
)

INTEGRALS = np.dtype(  # since the covariance was last propagated; C is q_nb as a matrix
    [
        ("time", "<f8"),  # s
        ("c", "<f8", (9,)),  # of C
        ("delta_v", "<f8", (3,)),  # m/s, of C f
        ("c_outer_w", "<f8", (27,)),  # of C[i, j] w[k]
        ("c_diag_f", "<f8", (9,)),  # of C[i, j] f[j]
        ("c_f_cross_w", "<f8", (3,)),  # of C (f x w)
        ("a_outer_a", "<f8", (6,)),  # of a a', a the acceleration: upper triangle
        ("w2", "<f8"),  # of |w|^2
        ("attitude_noise", "<f8"),  # rad^2, from gaps, faults, saturation and shocks
        ("velocity_noise", "<f8"),  # (m/s)^2
    ],
    align=True,
)

LEVELLING = np.dtype(
    [
        ("initialised", "<i8"),  # 1: roll and pitch are known
        ("coarse", "<i8"),  # 1: they follow the mean force since the beginning
        ("true_heading", "<i8"),  # 1: yaw refers to true north
        ("initial_rpy", "<f8", (3,)),  # rad, given by the user; NaN: unknown
        ("duration", "<f8"),  # s, of coarse levelling
        ("delta_v", "<f8", (3,)),  # m/s, NED, integral of the specific force since it began
        ("force2", "<f8"),  # m^2/s^3, integral of its square
    ],
    align=True,
)

MOTION = np.dtype(
    [
        ("v_mean", "<f8", (3,)),  # m/s, NED, over velocity_scatter_time_s
        ("v_scatter", "<f8", (3,)),  # (m/s)^2, about that mean
        ("p_scatter", "<f8", (3,)),  # m^2, mean square of the position
        ("travel_speed2", "<f8", (3,)),  # (m/s)^2, NED, of velocities that only vehicles sustain
        ("mean_force", "<f8", (3,)),  # m/s^2, NED, over the interval before
        ("mean_force_change", "<f8", (3,)),  # from the interval before that
        ("moving_s", "<f8"),  # in motion, before the first rest
        ("turn_rate", "<f8"),  # rad/s about the vertical, mean over steady_turn_time_s
        ("turn_rate2", "<f8"),  # (rad/s)^2, mean of its square
        ("hidden_tilt", "<f8"),  # rad, by which the tilt may be wrong before the first rest in a steady turn
        ("vibration_level", "<f8"),  # m/s^2, change of that change, averaged
        ("travel_vibration_level", "<f8"),  # the same while the body travelled
    ],
    align=True,
)

STATIONARITY = np.dtype(
    [
        ("w_mean", "<f8", (3,)),  # rad/s, running mean
        ("f_mean", "<f8", (3,)),  # m/s^2
        ("w_start", "<f8", (3,)),  # these means when the low motion began
        ("f_start", "<f8", (3,)),
        ("force_psd", "<f8"),  # (m/s)^2/s, of the force about its mean: noise and vibration, per axis
        ("f_at_rest", "<f8", (3,)),  # mean force when the gyro bias was last measured
        ("low_motion_s", "<f8"),
        ("bias_mismatch_s", "<f8"),  # for how long the mean rate at low motion has contradicted the known bias
        ("stationary", "<i8"),
        ("since_first_s", "<f8"),  # since the first rest began
        ("bg_before", "<f8", (3,)),  # rad/s, the gyro bias before it
        ("since_rest_s", "<f8"),  # since the last moment of rest
        ("possible_tilt", "<f8"),  # rad, sigma of a tilt error: what seems to accelerate may rest
        ("least_force_psd", "<f8"),  # (m/s)^2/s, the least force_psd at this rest: that of the quietest moment
        # of an even motion that the rest may have been, with its probability: the standard deviations
        ("hidden_tilt", "<f8"),  # rad, of roll and pitch
        ("hidden_turn", "<f8", (3,)),  # rad/s, of the gyro bias while it is measured
        ("hidden_angle", "<f8"),  # rad, of yaw, that this has made
        ("unmeasured_s", "<f8"),  # until the first rest
        ("gravity_checked", "<i8"),  # 1: the magnitude of the force at the first rest was compared with gravity
    ],
    align=True,
)

DIVERGENCE = np.dtype(
    [
        ("velocity_gain", "<f8", (3,)),  # m/s, NED, lately, not corrected by any measurement
        ("gain_duration", "<f8"),  # s that it took
        ("converged", "<i8"),  # 1: roll and pitch have been known well since the start
    ],
    align=True,
)

ATTITUDE_STEP = np.dtype(  # what is gained of velocity, and since it began to grow (the window)
    [
        ("delta_v", "<f8", (3,)),  # m/s, NED, integral of the specific force over gain_time_s, fading
        ("span", "<f8"),  # s, the same integral of 1
        ("mean_gain", "<f8", (3,)),  # m/s, the gain's mean over velocity_scatter_time_s
        ("mean_force", "<f8", (3,)),  # m/s^2, NED, over the same time
        ("usual_s", "<f8"),  # of motion in which the next two were learned
        ("usual_gain2", "<f8"),  # (m/s)^2
        ("usual_mean2", "<f8"),  # (m/s)^2, of that mean
        ("window_delta_v", "<f8", (3,)),  # m/s, integral of the specific force
        ("window_mean_v", "<f8", (3,)),  # m/s, and of the mean force
        ("window_body_v", "<f8", (3,)),  # m/s, of the specific force in body axes
        ("window_s", "<f8"),
        ("body_force", "<f8", (3,)),  # m/s^2, body, mean over lean_time_s
        ("body_s", "<f8"),  # for which the next two were learned
        ("usual_body_force", "<f8", (3,)),  # m/s^2, body, mean over hand_time_s
        ("body_scatter2", "<f8"),  # (m/s^2)^2, of body_force about it
        ("rise_delta_v", "<f8", (3,)),  # m/s, integral of the specific force since the gain is beyond its usual
        ("rise_s", "<f8"),
        ("clipping_variance", "<f8"),  # rad^2, that rates beyond the range have added to the attitude since then
        ("hand_held_s", "<f8"),  # of lively motion that is no vehicle's
        ("travel_s", "<f8"),  # of travel, fading
        ("levelled_angle", "<f8"),  # rad, by which the tilt was turned, and wrongly so if this was a vehicle; fading
        ("likely_hand_s", "<f8"),  # for which a hand, as the hypotheses last found it, still counts
        ("possible_tilt_error", "<f8"),  # rad, by which the tilt may be wrong while the gain grows
    ],
    align=True,
)

VELOCITY_HYPOTHESES = np.dtype(  # the first index is the hypothesis
    [
        ("x", "<f8", (HYPOTHESES, HYPOTHESIS_STATES)),
        ("P", "<f8", (HYPOTHESES, HYPOTHESIS_STATES, HYPOTHESIS_STATES)),
        ("log_likelihood", "<f8", (HYPOTHESES,)),  # less that of the likeliest
        ("log_weight", "<f8", (HYPOTHESES,)),  # of those without hands, less the largest
        ("v", "<f8", (2,)),  # m/s, north and east, integrated without corrections
        ("displacement", "<f8", (2,)),  # m, the integral of that since the last comparison
        ("time", "<f8"),  # s, of the transition so far
        ("tilt_by_bias", "<f8", (2, 3)),  # elements of the transition
        ("velocity_by_bias", "<f8", (2, 3)),
        ("force", "<f8"),  # m/s, integral of the vertical force
        ("turn", "<f8"),  # rad, about the vertical
        ("turn_by_bias", "<f8", (3,)),  # s, how a gyro bias turns north and east
        ("shift", "<f8", (7,)),  # what the filter's own corrections have added to the states
        ("attitude_noise", "<f8"),  # rad^2
        ("velocity_noise", "<f8", (2,)),  # (m/s)^2, north and east
        ("ph", "<f8", (HYPOTHESIS_STATES,)),
        ("hand", "<f8"),  # probability that the body is in a hand
        ("mean", "<f8", (HYPOTHESIS_STATES,)),  # of the others
        ("covariance", "<f8", (HYPOTHESIS_STATES, HYPOTHESIS_STATES)),
        ("yaw_correction", "<f8"),  # rad, that is due at the first rest
        ("leading", "<i8"),  # 1: the filter follows the others
        ("due", "<i8"),  # 1: it has not yet, to what they newly say
        ("possible_tilt_error", "<f8"),  # rad, of roll and of pitch
    ],
    align=True,
)

VARIANCE_FACTOR = np.dtype(  # the corrections of tilt, north and east, over what the covariance expects
    [
        ("correction", "<f8", (2,)),  # rad, their sum over correction_time_s, fading
        ("expected2", "<f8", (2,)),  # rad^2, its variance as the covariance has it
        ("squares", "<f8"),  # rad^2, of the sums, over correction_memory_s
        ("expectations", "<f8"),  # rad^2, of these squares
        ("tilt_scale", "<f8", (2,)),  # stated standard deviation of tilt over that of the covariance
    ],
    align=True,
)

DRAG = np.dtype(  # of the air, by the force across the thrust, and a block of it
    [
        ("mean_force", "<f8", (3,)),  # m/s^2, body, over drag_mean_s
        ("mean_s", "<f8"),  # that it has taken
        ("force", "<f8", (3,)),  # m/s^2, NED, across it, over the newest interval
        ("block_s", "<f8"),
        ("block_c", "<f8", (9,)),  # s, integral of C over the block
        ("block_force", "<f8", (3,)),  # m/s, of that force
        ("gained", "<f8", (3,)),  # m/s, of velocity since the block began
        ("displacement", "<f8", (3,)),  # m, the integral of that
        ("last_c", "<f8", (9,)),  # mean of the block before
        ("last_force", "<f8", (3,)),  # m/s^2, the same
        ("last_gained", "<f8", (3,)),  # m/s, from that block's mean velocity to its end
        ("has_last", "<i8"),  # 1: these are known
        # of changes between blocks: a constant force in the body (3), velocity and force across the thrust
        ("products", "<f8", (REGRESSION * REGRESSION,)),  # their sums, which fade
        ("blocks", "<f8"),
        ("per_mass", "<f8"),  # 1/s, drag per velocity and mass; 0: none is known
        ("constant", "<f8", (3,)),  # m/s^2, body, of the force across the thrust
        ("psd", "<f8"),  # (m/s)^2 s, of the velocity that it shows
    ],
    align=True,
)

CLIPPING = np.dtype(  # of the gyro, by its own axes
    [
        ("time", "<f8", (3,)),  # s, at the end of the range
        ("slope", "<f8", (3,)),  # rad/s^2, with which the rate came there
        ("last_slope", "<f8", (3,)),  # rad/s^2, of the newest step that was not flat
        ("flat", "<f8", (3,)),  # s, of flat steps since
        ("w", "<f8", (3,)),  # rad/s, the newest rates, compensated
        ("last_w", "<f8", (3,)),  # rad/s, those before
        ("missing_angle", "<f8"),  # rad, that the attitude may lack while a rate is at the end of the range
    ],
    align=True,
)

QUANTIZATION = np.dtype(
    [
        ("last_reading", "<f8", (3,)),  # rad/s; NaN: none yet
        ("lsb", "<f8", (3,)),  # rad/s, the smallest step between readings
        ("offset", "<f8", (3,)),  # LSB, of all readings from whole numbers
        ("truncation_log_odds", "<f8"),  # that readings are truncated toward zero
        ("max_error", "<f8", (3,)),  # rad/s, expected truncation error far from zero
        ("error", "<f8", (3 * BINS,)),  # rad/s, and of each code about zero
        ("error_var", "<f8", (3,)),  # (rad/s)^2, of that expected at rest
        ("log_likelihood_ratio", "<f8", (3 * BINS,)),  # that this code is the wide one, against that none is
        ("last_side", "<f8", (3,)),  # of zero on which the rate last left the window: -1 or 1, 0: unknown
        ("crossing_count", "<f8", (3,)),  # readings in the window since
        ("crossing_histogram", "<f8", (3 * BINS,)),
        ("rest_histogram", "<f8", (3 * BINS,)),
        ("rest_step2", "<f8", (3,)),  # LSB^2, sum of the squared steps between readings at rest
        ("rest_samples", "<i8"),
        ("rest_blocks", "<i8"),
    ],
    align=True,
)

HISTORY = np.dtype(  # what became of the errors in one covariance interval, for the smoother; see `history`
    [
        ("enabled", "<i8"),
        ("intervals", "<i8"),  # that have ended
        ("coarse", "<i8"),  # 1: roll and pitch were levelled, as at any time since coarse levelling began
        ("restart_ns", "<i8"),  # when roll and pitch were initialised anew; 0: they were not
        ("possible_tilt_var", "<f8"),  # rad^2, by which the tilt may be wrong before the first rest
        ("wrong_tilt_s", "<f8"),  # for how long the tilt that has been levelled was wrong; 0: it was not
        ("left_yaw", "<f8"),  # rad, correction of the yaw that was left for the first rest until this interval
        ("yaw_corrected", "<i8"),  # 1: and was made in it
        ("q_before", "<f8", (4,)),  # the attitude before the interval's corrections
        ("time", "<f8"),  # the integrals that make the transition
        ("c", "<f8", (9,)),
        ("delta_v", "<f8", (3,)),
        ("c_outer_w", "<f8", (27,)),
        ("c_diag_f", "<f8", (9,)),
        ("c_f_cross_w", "<f8", (3,)),
        ("count", "<i8"),  # scalar measurements; -1: the interval has not ended
        ("reset_states", "<i8", (FUSED + 2,)),  # bits: made independent before the transition, before each measurement
        ("state", "<i8", (FUSED,)),  # which one was measured
        ("innovation", "<f8", (FUSED,)),
        ("innovation_var", "<f8", (FUSED,)),
        ("ph", "<f8", (FUSED * STATES,)),  # P h' of each
        ("age", "<f8", (6,)),  # elements of the transition from gyro bias to roll and pitch at the end
    ],
    align=True,
)

SCRATCH = np.dtype(  # holds nothing from one call to the next
    [
        ("x", "<f8", (STATES,)),  # the error estimate until it is injected
        ("ph", "<f8", (STATES,)),  # P h'
        ("columns", "<i8", (JACOBIAN_LENGTH,)),  # a row h of H: its nonzero elements
        ("values", "<f8", (JACOBIAN_LENGTH,)),
        ("dv_n", "<f8", (3,)),  # m/s, change of velocity in NED over one sample
        ("a_n", "<f8", (3,)),  # m/s^2, the acceleration that it takes
        ("row", "<f8", (REGRESSION,)),
        ("products", "<f8", (REGRESSION * REGRESSION,)),
    ],
    align=True,
)

STATE = np.dtype(
    [
        ("t_ns", "<i8"),  # of the newest sample
        ("sample_count", "<i8"),
        ("nav", NAV),
        ("cov", COVARIANCE),
        ("imu", IMU),
        ("stamps", STAMPS),
        ("queue", QUEUE),
        ("integrals", INTEGRALS),
        ("levelling", LEVELLING),
        ("motion", MOTION),
        ("stationarity", STATIONARITY),
        ("divergence", DIVERGENCE),
        ("attitude_step", ATTITUDE_STEP),
        ("hypotheses", VELOCITY_HYPOTHESES),
        ("variance_factor", VARIANCE_FACTOR),
        ("drag", DRAG),
        ("clipping", CLIPPING),
        ("quantization", QUANTIZATION),
        ("history", HISTORY),
        ("scratch", SCRATCH),
    ],
    align=True,
)
