"""The records of the aiding sources: what each keeps from one measurement to the next."""

import numpy as np

from ..state import AGES, STATES

GNSS = np.dtype(
    [
        ("last_used_ns", "<i8"),  # epoch of the last fix used
        ("fix_count", "<i8"),
        ("speed", "<f8"),  # m/s of the last fix, NaN unknown
        ("bias_sigma", "<f8", (2,)),  # m, horizontal and vertical
        ("reported_sigma", "<f8", (2,)),  # m, by the receiver, horizontal and vertical
        ("noise_var", "<f8", (2,)),  # m^2, learned white variance, horizontal and vertical
        ("velocity_noise_var", "<f8"),  # m^2/s^2, learned variance of a component of its velocity
        ("offset_velocity", "<f8", (3,)),  # m/s, NED, by which the time offset shifts a position
        ("given_lever_arm", "<f8", (3,)),  # m, body, by the user; NaN before the first fix
        ("given_lever_arm_sigma", "<f8"),  # m, of each component at first
        ("lever_arm_is_measured", "<i8", (3,)),  # 1: the component counts as measured with a ruler
        ("lever_arm_inflation", "<f8", (3,)),  # m^2, by which its variance may be larger
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
        ("waits_since_ns", "<i8"),  # after a gap it waits for the course of a fix
        ("direction", "<f8"),  # 1 or -1: the vehicle went along its forward axis or against it when it was fast last
    ],
    align=True,
)

LAND_EVIDENCE = np.dtype(  # that the vehicle rolls on the ground
    [
        ("level_axis", "<f8", (3,)),  # level body axis, body
        ("products", "<f8", (15,)),  # sums of products of velocities, turn rate and azimuth, weighted; packed
        ("weight", "<f8"),  # sum of their weights, s^2/m^2
        ("count", "<f8"),  # independent velocities in these
        ("turn_count", "<f8"),  # windows of turns; sums over these, of m/s^2:
        ("turn_sum", "<f8"),  # forward velocity times turn rate
        ("turn_force_sum", "<f8"),  # lateral specific force
        ("turn2_sum", "<f8"),  # their products
        ("turn_times_force_sum", "<f8"),
        ("turn_force2_sum", "<f8"),
        ("leaky_height", "<f8"),  # m, integral of the vertical velocity in the body that decays
        ("mean_height", "<f8"),  # m, its mean
        ("current_vector", "<f8", (2,)),  # s/m, information times current north and east
        ("current_information", "<f8", (3,)),  # s^2/m^2, of the current: nn, ne, ee
        ("log_likelihood", "<f8"),  # ratio, of a land vehicle against a body in a current; 0: not known
        ("heave_variance", "<f8"),  # mean square of its deviation, over the largest of a land vehicle
    ],
    align=True,
)

BAROMETER = np.dtype(  # at the last reading
    [
        ("last_ns", "<i8"),  # its epoch
        ("last_used_ns", "<i8"),  # epoch of the last reading that was used
        ("rejected_ns", "<i8"),  # epoch of the last one that was not
        ("height", "<f8"),  # m
        ("speed2", "<f8"),  # m^2/s^2, square of the speed
        ("reading", "<f8"),  # m, the last one
        ("changed_ns", "<i8"),  # the epoch since when it has been that
        ("ratio_ns", "<i8"),  # when the change that is compared began
        ("ratio_reading", "<f8"),  # m, the reading, and the height, then
        ("ratio_height", "<f8"),
        ("reading2", "<f8"),  # m^2, sum of the squares of changes of the reading
        ("reading_height", "<f8"),  # m^2, sum of these changes times those of the height
        ("fix_ns", "<i8"),  # epoch of the last fix with which it was compared
        ("mean_fix_height", "<f8"),  # m, smoothed height of the fixes
        ("mean_reading", "<f8"),  # m, smoothed reading at the fixes
        ("scale_error2_by_fixes", "<f8"),  # square of the scale error that the fixes have shown; 0: none
    ],
    align=True,
)

EXTERNAL_AID = np.dtype(  # an external pose, or velocity
    [
        ("last_ns", "<i8"),  # epoch of the last one
        ("last_used_ns", "<i8"),  # epoch of the last that was used
        ("rejected", "<i8"),  # 1: the last one was rejected
        ("distrusted", "<i8"),  # 1: the motion has contradicted a heading while the yaws of poses were used
        ("agreeing_ns", "<i8"),  # since when they have agreed again
        ("yaw_ns", "<i8"),  # epoch of the last pose with a yaw
        ("used_share", "<f8"),  # of the velocities that have agreed with the estimate lately
        ("shown", "<f8", (3,)),  # of a velocity: sum of the products of measured and predicted component, over variance
        ("expected", "<f8", (3,)),  # of the predicted one's square
        ("shown_noise", "<f8", (3,)),  # variance of `shown`
        ("offset_variance", "<f8", (3,)),  # m^2, of a pose: of a lasting error, NED, by its distance when it returned
        ("last_value", "<f8", (4,)),  # its values; NaN before the first
    ],
    align=True,
)

CONTRADICTED, NO_DIRECTION, OTHER_FIELD = 1, 2, 3  # why a reading was not used
MAGNETOMETER = np.dtype(
    [
        ("last_ns", "<i8"),  # epoch of the last reading
        ("since_ns", "<i8"),  # since when the field has been that of the earth, and steady
        ("contradicted_ns", "<i8"),  # when it last contradicted a heading
        ("strength", "<f8"),  # smoothed: the field's strength over that of the earth, less 1
        ("dip", "<f8"),  # rad, smoothed: its dip less that of the earth
        ("variation", "<f8"),  # smoothed squares of the differences of both from their smoothed values
        ("heading_variance", "<f8"),  # rad^2, of the heading after the last reading; 0 while it is not known
        ("unused", "<i8"),  # why the last reading was not used: CONTRADICTED, OTHER_FIELD; 0: it was
    ],
    align=True,
)

SOURCE_AGE = np.dtype(  # by how much the measurements of a source are older than their epochs
    [
        ("last_ns", "<i8"),  # epoch of the last one that it was learned from
        ("probability", "<f8", (AGES,)),
        ("mean", "<f8", (AGES, 3)),  # m/s or m, and rad, slow mean of the difference at each age
        ("known_s", "<f8", (AGES,)),  # s, for how long it has been known
        ("age", "<f8"),  # s, the estimate
        ("variance", "<f8"),  # s^2
    ],
    align=True,
)

HEADING_AID = np.dtype(
    [
        ("last_ns", "<i8"),  # epoch of the last heading
        ("last_used_ns", "<i8"),  # and of the last that was used
        ("distrusted", "<i8"),  # 1: the motion has contradicted a heading that was fused from it
        ("agreeing_ns", "<i8"),  # since when it has agreed again
        ("rejecting_ns", "<i8"),  # since when the headings of a compass that is trusted have been rejected
        ("boresight", "<f8"),  # rad, estimated, beyond that of the settings
        ("boresight_prior", "<f8"),  # rad^2, its variance before any motion
        ("yaw_corrections", "<f8"),  # rad, sum of all corrections of the yaw
        ("off_ns", "<i8"),  # epoch of the last heading that did not repeat the one before
        ("last_off", "<f8"),  # rad, that heading less the yaw by the gyros alone
        ("off_changed", "<f8"),  # rad, by how much that has changed lately
        ("gyros_turned", "<f8"),  # rad, by how much they have turned meanwhile
        ("expected_variance", "<f8"),  # rad^2, of off_changed without a deviation
        ("mean_excess", "<f8"),  # rad^2, mean square of off_changed beyond that
        ("deviation_variance", "<f8"),  # rad^2, of the headings' deviation, as near iron; 0: none has shown
        ("opened_variance", "<f8"),  # rad^2, as much of it as P has
        ("turn_ns", "<i8"),  # when the interval began whose turn is compared
        ("turn_count", "<i8"),  # intervals before it
        ("turn_heading", "<f8"),  # rad, the last heading
        ("turn_rate", "<f8"),  # rad/s, of the yaw, then
        ("turn", "<f8"),  # rad, of the gyros since turn_ns
        ("turn_shown", "<f8"),  # rad, of the headings
        ("last_turn", "<f8"),  # rad, of the gyros in the interval before
        ("last_turn_shown", "<f8"),  # rad, of the headings
        ("turn_xx", "<f8"),  # rad^2, sum of x^2; of x and y see `heading_turns`
        ("turn_xy", "<f8"),  # rad^2, of x y
        ("turn_noise", "<f8"),  # rad^4, of x^2 times the variance of y
    ],
    align=True,
)

ODOMETER = np.dtype(
    [
        ("last_ns", "<i8"),  # epoch of the last reading
        ("last_used_ns", "<i8"),  # epoch of the last that was used
        ("reverses", "<i8"),  # 1: there was a reading below zero
        ("direction", "<f8"),  # 1: readings above zero are along the forward axis, -1: against it; 0: not known
        ("residual", "<f8"),  # m/s, of the last that was used, after its correction
        ("corrections", "<f8", (3,)),  # m/s, NED, sum of all corrections of the velocity
        ("used_corrections", "<f8", (3,)),  # the same at the last reading that was used
        ("step", "<f8"),  # m/s, size of the innovation with which the readings became wrong at once; 0: they did not
        ("step_speed", "<f8"),  # m/s, the estimated speed then
        ("inflation", "<f8"),  # m^2/s^2, added to P since then
        ("used_share", "<f8"),  # of the readings lately
        ("unused", "<i8"),  # why the last reading was not used: CONTRADICTED, NO_DIRECTION; 0: it was
        ("reading", "<f8"),  # m/s, the last that differed from the one before
        ("reading_ns", "<i8"),  # its epoch
        ("predicted", "<f8"),  # m/s, what the estimate predicted for it
        ("reading_corrections", "<f8", (3,)),  # corrections at its epoch
        ("changed_ns", "<i8"),  # epoch of the first of the readings that are equal to the last one
        ("longest_repetition", "<f8"),  # s, for which readings other than 0 were equal, and then changed
        ("frozen", "<i8"),  # 1: the sensor has stopped, and repeats its last reading
        ("resolution", "<f8"),  # m/s, smallest difference of readings so far; infinite before the first
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
        ("cross_sum", "<f8"),  # m^2/s^2, of their cross products with the velocity, down
        ("v2", "<f8"),  # m^2/s^2, square of the velocity
        ("agreements", "<i8"),  # fixes that refute it, since the last that contradicts the wheels
        ("rejecting", "<i8"),  # 1: the sums are of fixes since a drift was detected
    ],
    align=True,
)
