"""The records of the alignment: in the core, and the hypothesis bank, which only fixes change."""

import numpy as np

from ..state import AGES, HYPOTHESES, VECTORS

ALIGNMENT = np.dtype(  # in a level frame of arbitrary heading; complex numbers are north + i east
    [
        ("mode", "<i8"),
        ("heading_sigma", "<f8"),  # rad, of a heading that was found, measured or given; 0: none
        ("heading_bias_gain", "<f8"),  # s, heading error per frame rate: minus that per vertical gyro bias
        ("integrals", "<f8", (4, 2)),  # since the origin, of: level specific force, 1, G, exp(i y)
        ("double_integrals", "<f8", (4, 2)),  # integrals of these
        ("heading_phasor", "<f8", (2,)),  # exp(i y), y: heading of the body in the integrals' frame, rad
        ("frame_azimuth", "<f8"),  # rad, azimuth of the level frame of q_nb in that of the integrals
        ("corrected_rotation", "<f8"),  # rad, integral of bias_correction: the frame would have rotated by it
        ("bias_correction", "<f8"),  # rad/s, corrections of the vertical gyro bias since the origin
        ("applied_corrections", "<f8", (3, 2)),  # the sum of those that the integrals have had
        ("corrections", "<f8", (3, 2)),  # m/s^2, m/s^3, m/s^2: of tilt, level gyro bias, accelerometer bias, since then
        ("velocity_known_ns", "<i8"),  # last fix used, or the origin if that is later
        ("known_integral", "<f8", (2,)),  # m/s, of the level specific force then
        ("added_velocity_variance", "<f8"),  # m^2/s^2, to each level component since then
        ("level_accel_ns", "<i8"),  # last time that the force levelled in motion
        ("pair_start_ns", "<i8"),  # last fix used for alignment
        ("pair_velocity", "<f8", (2,)),  # m/s, its velocity north and east; NaN: it reported none
        ("pair_lat", "<f8"),  # rad, its position
        ("pair_lon", "<f8"),
        ("pair_accel", "<f8", (2,)),  # m/s^2, smoothed acceleration north and east then
        ("pair_integrals", "<f8", (4, 2)),  # integrals then
        ("pair_double_integrals", "<f8", (4, 2)),
        ("mean_velocity", "<f8", (2,)),  # m/s, north and east, of the last pair of positions
        ("mean_velocity_s", "<f8"),  # s, time between them; 0: there was none
        ("mean_integrals", "<f8", (4, 2)),
        ("low_motion_lat", "<f8"),  # rad, position of the first fix since motion is low
        ("low_motion_lon", "<f8"),
        ("low_motion_ns", "<i8"),
        ("origin_ns", "<i8"),
        ("origin_lat", "<f8"),  # rad, from where the positions of fixes are counted
        ("origin_lon", "<f8"),
        ("last_match_ns", "<i8"),  # last fix matched
        ("vector_start_ns", "<i8"),  # last fix at which a pair of vectors ended
        ("vector_velocity", "<f8", (3,)),  # m/s, its velocity, NED
        ("vector_arm_velocity", "<f8", (3,)),  # m/s, that of the antenna to the IMU, vectors' frame
        ("vector_q", "<f8", (4,)),  # body axes to the vectors' frame, which is fixed: the body's at the first fix
        ("vector_bias", "<f8", (3,)),  # rad/s, gyro bias with which they are integrated
        ("vector_force", "<f8", (3,)),  # m/s, integral of specific force since that fix, in the vectors' frame
        ("vector_rotation", "<f8", (3, 3)),  # s, integral of their axes since the first fix: rotation per gyro bias
        ("vector_sensitivity", "<f8", (3, 3)),  # m, vector_force per gyro bias
        ("reject_count", "<i8"),  # fixes in a row that contradict the specific force
        ("heading_fault_count", "<i8"),  # pairs in a row that contradict the heading
    ],
    align=True,
)

VECTOR_PAIR = np.dtype(  # the change of velocity between two fixes, as both sensors have it
    [
        ("gnss", "<f8", (3,)),  # m/s, of the receiver less gravity, NED
        ("force", "<f8", (3,)),  # m/s, of the IMU and the lever arm, in the vectors' frame
        ("sensitivity", "<f8", (3, 3)),  # m, of that per gyro bias
        ("level_variance", "<f8"),  # m^2/s^2, of each level component
        ("down_variance", "<f8"),
    ],
    align=True,
)

HYPOTHESIS_BANK = np.dtype(
    [
        ("integrals", "<f8", (HYPOTHESES, 4, 2)),  # as the core's, to the last matched fix, turned back
        ("double_integrals", "<f8", (HYPOTHESES, 4, 2)),
        ("whitening_state", "<f8", (HYPOTHESES, 3, 5, 2)),  # position, velocity, GNSS bias of fixes and each integral
        ("whitening_P", "<f8", (3, 3)),  # and their covariance, m, s
        ("products", "<f8", (HYPOTHESES, 5, 5, 2)),  # of the innovations of GNSS, force and three regressors
        ("weight", "<f8"),  # number of matched innovations
        ("energy2", "<f8"),  # sum of squares of the single energies of the velocity changes
        ("energy_age", "<f8"),  # s, their energy times its age
        ("last_integrals", "<f8", (4, 2)),  # the core's then
        ("last_double_integrals", "<f8", (4, 2)),
        ("vector_count", "<i8"),
        ("vectors", VECTOR_PAIR, (VECTORS,)),
        # scratch
        ("vector_normal", "<f8", (6, 13)),
        ("vector_product", "<f8", (2, 4, 4)),
        ("innovations", "<f8", (5, 2)),
        ("prior", "<f8", (3, 3, 2)),
        ("inverse", "<f8", (3, 3, 2)),
        ("gain", "<f8", (3, 3, 2)),
        ("headings", "<f8", (HYPOTHESES, 3)),
    ],
    align=True,
)

FIX_AGE = np.dtype(  # by how much the fixes are older than their epochs, while the heading is sought; see fix_age
    [
        ("last_ns", "<i8"),  # epoch of the last fix that was compared
        ("origin_ns", "<i8"),  # of the integrals then
        ("lat", "<f8"),  # rad, its position
        ("lon", "<f8"),
        ("velocity", "<f8", (2,)),  # m/s, north and east, its velocity, or the mean since the one before
        ("integrals", "<f8", (AGES, 2, 4, 2)),  # at its epoch less each age: integrals, double integrals; NaN: unknown
        ("products", "<f8", (AGES, 5, 5, 2)),  # sums over pairs of fixes, in units of their noise: see hypothesis_bank
        ("counts", "<f8", (AGES, 2)),  # of pairs, and of those in motion
        ("corrections", "<f8", (3, 2)),  # in the accelerations: those of before the first pair in motion
        ("prior", "<f8", (3, 3, 2)),  # of the nuisance parameters, after these
        ("probability", "<f8"),  # that the time offset is wrong by more than the alignment bears
        ("age", "<f8"),  # s, mean of the posterior
        ("variance", "<f8"),  # s^2, of the posterior
        ("around", "<f8", (2, 2, 4, 2)),  # scratch: the integrals of the states before and after a time
        ("pair", "<f8", (5, 2)),  # scratch, m/s^2: acceleration of the receiver, and changes of the integrals by time
        ("inverse", "<f8", (3, 3, 2)),  # scratch
        ("gain", "<f8", (3, 3, 2)),  # scratch
        ("undone", "<f8", (3, 2)),  # scratch: minus the corrections that the integrals of a state have had
    ],
    align=True,
)
