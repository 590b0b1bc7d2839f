"""The records of the attitude filter: its 28 error states, its parameters and what it remembers.

Errors are "true minus estimate". The attitude error is a small rotation in NED (q_true = exp(phi) q_nb); velocity
and place are NED; gyro and accelerometer follow true = (I - M)(measured - bias), M full for the gyro
(scale factors and misalignments, row-major), diagonal for the accelerometer.
"""

import numpy as np

from ..tuning import dtype_of
from .parameters import TUNABLES
from .truncation import CELLS

ATTITUDE, GYRO_BIAS, VELOCITY, ACCEL_BIAS, GYRO_MATRIX, ACCEL_SCALE, LAG, PLACE = 0, 3, 6, 9, 12, 21, 24, 25
STATES = 28
PACKED = STATES * (STATES + 1) // 2

# What a sensor's profile gives, in variances and power spectral densities, and the nominal sample period.
PARAMETERS = np.dtype(
    [
        ("gap_s", "<f8"),  # a longer step between samples is a gap
        ("gyro_psd", "<f8"),  # rad^2/s
        ("gyro_bias_var", "<f8"),  # (rad/s)^2 at switch-on
        ("gyro_bias_psd", "<f8"),  # (rad/s)^2/s, a walk of one bias instability per root second
        ("gyro_matrix_var", "<f8"),
        ("accel_psd", "<f8"),  # (m/s)^2/s
        ("accel_bias_var", "<f8"),  # (m/s^2)^2 at switch-on
        ("accel_bias_psd", "<f8"),  # (m/s^2)^2/s
        ("accel_scale_var", "<f8"),
        ("gyro_matrix_doubt", "<f8"),  # by how much larger these variances are should the weight at rest be false
        ("accel_bias_doubt", "<f8"),
        ("accel_scale_doubt", "<f8"),
        ("rest_rate_psd", "<f8"),  # (rad/s)^2 s: noise of the mean rate at rest
        ("tuning", dtype_of(TUNABLES)),
    ],
    align=True,
)

STATE = np.dtype(
    [
        ("t_ns", "<i8"),  # of the newest sample
        ("samples", "<i8"),
        ("levelled", "<i8"),  # 1 when roll and pitch have been found
        ("found", "<i8"),  # 1 when they have been known well since
        ("seeking", "<i8"),  # 1 while they follow the mean force since the beginning
        ("pull", "<f8", (3,)),  # m/s, the integral of that force, NED
        ("pull2", "<f8"),  # m^2/s^3, and of its square
        ("pull_s", "<f8"),
        ("heading", "<i8"),  # 1 while yaw refers to true north
        ("given", "<f8", (3,)),  # roll, pitch, yaw that the user knows, NaN: unknown
        ("gravity", "<f8"),  # m/s^2
        ("q", "<f8", (4,)),
        ("v", "<f8", (3,)),
        ("bg", "<f8", (3,)),
        ("ba", "<f8", (3,)),
        ("gm", "<f8", (9,)),
        ("sa", "<f8", (3,)),
        ("lag", "<f8"),  # s
        ("P", "<f8", (PACKED,)),
        ("x", "<f8", (STATES,)),
        ("d", "<f8", (STATES,)),
        ("columns", "<i8", (8,)),  # a measurement row
        ("values", "<f8", (8,)),
        ("sigma_tilt", "<f8"),
        ("sigma_rpy", "<f8", (3,)),
        ("sigma_bg", "<f8", (3,)),
        ("sigma_ba", "<f8", (3,)),
        # the newest good sample as measured, and for how long it has been held
        ("w", "<f8", (3,)),
        ("f", "<f8", (3,)),
        ("held_s", "<f8"),
        ("f_change", "<f8", (3,)),  # of the force as measured, from the sample before
        # gathered since the covariance was last propagated; C is q_nb as a matrix
        ("span", "<f8"),  # s
        ("turn", "<f8", (9,)),  # integral of C
        ("push", "<f8", (3,)),  # of C f
        ("turn_rate", "<f8", (27,)),  # of C[i, j] w[k]
        ("turn_force", "<f8", (9,)),  # of C[i, j] f[j]
        ("sweep", "<f8", (3,)),  # of C (f x w)
        ("motion", "<f8", (6,)),  # of a a', a the acceleration: upper triangle
        ("spin", "<f8"),  # of |w|^2
        ("attitude_extra", "<f8"),  # rad^2, from gaps and saturation
        ("velocity_extra", "<f8"),  # (m/s)^2
        ("a", "<f8", (3,)),  # m/s^2, acceleration in NED
        # how lively the velocity is, and where the body is
        ("v_mean", "<f8", (3,)),
        ("v_energy", "<f8", (3,)),
        ("travel", "<f8", (3,)),  # (m/s)^2, lately, of velocities as only vehicles keep them up
        ("mean_force", "<f8", (3,)),  # m/s^2, NED, over the interval before
        ("mean_change", "<f8", (3,)),  # by which it differed from the one before that
        ("shaking", "<f8"),  # m/s^2, how unevenly it changes lately
        ("way_shaking", "<f8"),  # and while the body travelled
        ("p", "<f8", (3,)),  # m from where it was at home, NED
        ("p_energy", "<f8", (3,)),
        ("gain", "<f8", (3,)),  # m/s, speed lately gained, NED, whatever corrected it
        ("gain_s", "<f8"),  # and the time that it took
        # counts of the gyro, rad/s
        ("read", "<f8", (3,)),  # the newest rates as read, NaN: none yet
        ("count", "<f8", (3,)),  # the smallest step between readings
        ("phase", "<f8", (3,)),  # counts by which all readings differ from whole ones
        ("truncation", "<f8"),  # log odds that they are cut off toward zero
        ("cut_most", "<f8", (3,)),  # rad/s believed to be cut off far from zero, and of each count about it
        ("cut", "<f8", (3 * CELLS,)),
        ("cut_var", "<f8", (3,)),  # (rad/s)^2, of what is believed to be cut off at rest
        ("evidence", "<f8", (3 * CELLS,)),  # log likelihood ratio: that this count is the wide one, or none is
        ("side", "<f8", (3,)),  # of zero where the rate was, -1 or 1, 0: unknown
        ("seen", "<f8", (3,)),  # readings since, and of each count
        ("passed", "<f8", (3 * CELLS,)),
        ("still", "<f8", (3 * CELLS,)),  # readings of each count at rest
        ("still_step2", "<f8", (3,)),  # sum of the squares of the steps between them
        ("still_samples", "<i8"),
        ("still_blocks", "<i8"),
        # rest
        ("w_mean", "<f8", (3,)),
        ("f_mean", "<f8", (3,)),
        ("w_anchor", "<f8", (3,)),  # these means when the quiet began
        ("f_anchor", "<f8", (3,)),
        ("f_rest", "<f8", (3,)),  # when the gyro bias was last learnt at rest
        ("quiet_s", "<f8"),
        ("contradicted_s", "<f8"),  # for how long a quiet body has shown a rate that is not the known bias
        ("resting", "<i8"),
        ("weighed", "<i8"),
    ],
    align=True,
)
