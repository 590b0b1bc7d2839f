"""The records of integrity monitoring: rejected fixes, the gravity monitor, velocity discrepancies."""

import numpy as np

from ..state import CHORD_POINTS

INTEGRITY = np.dtype(  # rejected fixes, and what they imply for the heading
    [
        ("rejecting", "<i8"),  # 1: the last fix was rejected
        ("reject_count", "<i8", (2,)),  # positions in a row, and heights
        ("reject_start_ns", "<i8", (2,)),  # the first of them, or of those that are consistent with the velocity
        ("inconsistent_count", "<i8"),  # rejected positions in a row that are far from those before: outliers?
        ("outage_at_reject_s", "<f8"),  # since the last fix used, when the first was rejected
        ("first_offset", "<f8", (2,)),  # m, north and east: innovation of the first position rejected in a row
        ("reject_offset", "<f8", (2,)),  # m, how far north and east of the estimate that was
        ("reject_velocity", "<f8", (2,)),  # m/s, north and east, estimated then
        ("rejected_velocity", "<f8", (2,)),  # m/s, error of the velocity that explains the last rejected position
        ("rejected_position2", "<f8", (3,)),  # m^2, of the position, if it is wrong instead of rejected ones
        ("rejected_inflation", "<f8"),  # NIS of positions rejected after an outage, less 1
        ("divergence_count", "<i8"),  # rejected positions that accelerated away, the last ones
        ("divergence_ns", "<i8"),  # the last one that was compared
        ("diverging_offset", "<f8", (2,)),  # m, how far north and east of the estimate that was
        ("diverging_velocity", "<f8", (2,)),  # m/s, velocity with which it moved away
        ("last_lat", "<f8"),  # rad, position of the last fix
        ("last_lon", "<f8"),
        ("last_velocity", "<f8", (2,)),  # m/s, its velocity north and east
        ("last_speed", "<f8"),  # m/s, and its speed
        ("last_course", "<f8"),  # rad
        ("unchanged_since_ns", "<i8"),  # when a fix first had that position, or the receiver was found to be frozen
        ("unchanged_lat", "<f8"),  # rad, position of the estimate then
        ("unchanged_lon", "<f8"),
        ("may_stand", "<i8"),  # 1: that position contradicts the estimate, and the vehicle may stand
        ("frozen", "<i8"),  # 1: the vehicle has moved since, so that the receiver is frozen
        ("epochs", "<i8"),  # REPORTED_EPOCHS, UNCONFIRMED_EPOCHS or EXACT_EPOCHS
        ("velocity_reject_count", "<i8"),  # fixes in a row whose velocity was rejected
        ("velocity_reject_ns", "<i8"),  # the first of them
        ("position_inflation", "<f8", (3,)),  # m^2, beyond P: how far off fixes were that were used, fading
        ("velocity_inflation", "<f8", (2,)),  # m^2/s^2, how fast they drifted away before, fading
        ("reset_score", "<f8"),  # resets to contradicting fixes, fading
        ("position_ns", "<i8"),  # when a position was last used or rejected
        ("position_uses", "<f8"),  # positions that were used, fading
        ("position_rejects", "<f8"),  # positions that were rejected, fading
        ("position_returns", "<f8"),  # positions that were used after rejected ones, fading
        ("height_ns", "<i8"),  # when a height was last used or rejected
        ("height_uses", "<f8"),  # heights that were used, fading
        ("height_rejects", "<f8"),  # heights that were rejected, fading
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

CHORD_POINT = np.dtype(
    [
        ("t_ns", "<i8"),  # epoch of the fix
        ("sum", "<f8", (2,)),  # m, north and east: way of the positions less integral of the velocity
        ("median", "<f8", (2,)),  # m, of that and the points before and after; of the newest point the sum
        ("velocity", "<f8", (2,)),  # m/s
        ("variance", "<f8"),  # m^2, of the integral
    ],
    align=True,
)

VELOCITY_DISCREPANCY = np.dtype(  # a receiver's velocity against its own positions
    [
        ("last_ns", "<i8"),  # epoch of the last fix
        ("last_lat", "<f8"),  # rad, its position
        ("last_lon", "<f8"),
        ("last_velocity", "<f8", (2,)),  # m/s, north and east
        ("repeated", "<i8"),  # 1: its position is that of the fix before to the last digit
        ("sum", "<f8", (2,)),  # as in CHORD_POINT
        ("sum_variance", "<f8"),
        ("points", CHORD_POINT, (CHORD_POINTS,)),
        ("count", "<i8"),  # points since the comparison began
        ("rate", "<f8", (2,)),  # m/s, the discrepancy: rate of the sum
        ("onset_ns", "<i8"),  # since when there is a discrepancy
        ("verdict", "<i8"),  # AGREES, UNDECIDED, UNUSED, VELOCITY_WRONG
    ],
    align=True,
)

VELOCITY_LAG = np.dtype(  # of a receiver's velocity behind its own positions; sums over pairs, fading
    [
        ("last_ns", "<i8"),  # epoch of the last point
        ("repeated", "<i8"),  # 1: its position was that of the fix before to the last digit
        ("pairs", "<f8"),
        ("change2", "<f8"),  # of the changes of the velocity, squared, over the variance of the noise; and so on
        ("cross", "<f8"),  # change times distance
        ("travel2", "<f8"),  # distance by the velocity, squared
        ("change_sum", "<f8"),  # change times what the positions have moved more
        ("travel_sum", "<f8"),
        ("energy", "<f8"),
        ("lag", "<f8"),  # s, found from them
        ("variance", "<f8"),  # s^2; 0: nothing is known
        ("late", "<i8"),  # USED, FOUND_LATE, LATE
    ],
    align=True,
)
