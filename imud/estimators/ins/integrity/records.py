"""The records of integrity monitoring: rejected fixes, and the tests for faults of receiver and sensor."""

import numpy as np

from ..state import CHORD_POINTS, FAULTS, GYRO_BIAS_ONSETS, ONSETS, STATES

INTEGRITY = np.dtype(  # rejected fixes, and what they imply for the heading
    [
        ("rejecting", "<i8"),  # 1: the last fix was rejected
        ("reject_count", "<i8", (2,)),  # positions in a row, and heights
        ("reject_start_ns", "<i8", (2,)),  # the first of them, or of those that are consistent with the velocity
        ("outage_at_reject_s", "<f8"),  # since the last fix used, when the first was rejected
        ("reject_offset", "<f8", (2,)),  # m, how far north and east of the estimate that was
        ("rejected_velocity", "<f8", (2,)),  # m/s, error of the velocity that explains the last rejected position
        ("last_position", "<f8", (2,)),  # latitude and longitude of the last fix
        ("last_velocity", "<f8", (4,)),  # its velocity north and east, speed and course
        ("unchanged_since_ns", "<i8"),  # when a fix first had that position
        ("unchanged_estimate", "<f8", (2,)),  # latitude and longitude of the estimate then
        ("frozen", "<i8"),  # 1: the vehicle has moved since, so that the receiver is frozen
        ("epochs", "<i8"),  # REPORTED_EPOCHS, UNCONFIRMED_EPOCHS or EXACT_EPOCHS
        ("velocity_reject_count", "<i8"),  # fixes in a row whose velocity was rejected
        ("velocity_reject_ns", "<i8"),  # the first of them
        (
            "position_inflation",
            "<f8",
            (3,),
        ),  # m^2, beyond P: how far the fixes were that the filter was reset to, fading
        ("velocity_inflation", "<f8", (2,)),  # m^2/s^2, how fast they drifted away before, fading
        ("reset_score", "<f8"),  # resets to contradicting fixes, fading
        ("position_uses", "<f8"),  # positions that were used, fading
        ("position_rejects", "<f8"),  # positions that were rejected, fading
        ("position_returns", "<f8"),  # positions that were used after rejected ones, fading
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

FAULT_SENSITIVITIES = np.dtype(
    [("sensitivity", "<f8", (STATES, FAULTS))],  # error of the estimate per unit of each fault
    align=True,
)

DRIFT = np.dtype(  # the test for a receiver that drifts (GLR)
    [
        ("detected", "<i8"),  # by what: BY_POSITIONS, BY_WHEELS; 0: none is detected
        ("velocity", "<f8", (2,)),  # m/s, north and east, of the one that was detected, and since when it is
        ("since_ns", "<i8"),
        ("noise_scale", "<f8"),  # variance of the receiver's bias over the reported one
        ("noise_scale_count", "<i8"),  # onsets from which it was learned
        ("pending_noise_scale", "<f8"),  # that of the last closed onset, learned at the next
        ("onset_ns", "<i8", (ONSETS,)),  # start of a hypothetical drift
        ("innovation_count", "<i8", (ONSETS,)),  # since
        ("information_vector", "<f8", (ONSETS, 2)),  # s/m, of the drift velocity north and east
        ("information_matrix", "<f8", (ONSETS, 3)),  # s^2/m^2, upper triangle
        ("position_variance", "<f8", (2,)),  # m^2, what a likely drift adds to the stated variances
        ("velocity_variance", "<f8", (2,)),  # m^2/s^2
    ],
    align=True,
)

VELOCITY_DRIFT = np.dtype(  # the test for a receiver that drifts and says so in its velocity (GLR)
    [
        ("onset_ns", "<i8", (ONSETS,)),
        ("last_ns", "<i8"),  # the last fix
        ("confirmations", "<i8"),  # fixes under way that agreed with the heading since it was found
        ("count", "<f8", (ONSETS,)),  # velocities
        ("energy", "<f8", (ONSETS,)),  # sum of their normalised innovations squared
        ("vector", "<f8", (ONSETS, 3)),  # information times drift north and east, m/s, and heading step, rad
        ("information", "<f8", (ONSETS, 6)),  # their information: nn, ne, ee, nh, eh, hh
        ("drift", "<f8", (2,)),  # m/s, north and east, of the drift that was detected
        ("position_variance", "<f8", (2,)),  # m^2, what a likely drift adds to the stated variances
        ("velocity_variance", "<f8", (2,)),  # m^2/s^2
        ("heading_variance", "<f8"),  # rad^2
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
        ("jump", "<f8", (2, 3)),  # of positions north, east: sums of 1 / s, of mean / s, of innovation / s
    ],
    align=True,
)

COMPASS_OFFSET = np.dtype(  # the test for a compass that shows a wrong heading (GLR)
    [
        ("onset_ns", "<i8"),  # when its headings were used first
        ("last_ns", "<i8"),  # the last fix
        (
            "turn_variance",
            "<f8",
        ),  # rad^2, of a turn of the sensor while it was not connected
        ("unconfirmed", "<i8"),  # 1: it gave the heading, and motion has not confirmed that
        ("information", "<f8"),  # 1/rad^2, of the offset
        ("vector", "<f8"),  # 1/rad, information times offset
        ("energy", "<f8"),  # sum of the normalised innovations squared
        ("count", "<f8"),  # number of these
        ("boresight_sensitivity", "<f8"),  # error of the boresight, rad per rad
        ("heading_variance", "<f8"),  # rad^2, beyond P: of an offset that is likely but not detected
    ],
    align=True,
)

GYRO_BIAS_STEP = np.dtype(  # the test for a step of the gyro bias about the vertical (GLR)
    [
        ("last_ns", "<i8"),  # the last fix
        ("velocity_ns", "<i8"),  # the last one with a velocity
        ("heading_variance", "<f8"),  # rad^2, beyond P: of a step that is likely but not detected
        ("onset_ns", "<i8", (GYRO_BIAS_ONSETS,)),
        ("information", "<f8", (GYRO_BIAS_ONSETS,)),  # s^2/rad^2, of the step
        ("vector", "<f8", (GYRO_BIAS_ONSETS,)),  # s/rad, information times step
        ("energy", "<f8", (GYRO_BIAS_ONSETS,)),  # sum of the normalised innovations squared
        ("count", "<f8", (GYRO_BIAS_ONSETS,)),  # number of these
    ],
    align=True,
)

CHORD_POINT = np.dtype(
    [
        ("t_ns", "<i8"),  # epoch of the fix
        ("sum", "<f8", (2,)),  # m, north and east: way of the positions less integral of the velocity
        ("velocity", "<f8", (2,)),  # m/s
        ("variance", "<f8"),  # m^2, of the integral
    ],
    align=True,
)

VELOCITY_DISCREPANCY = np.dtype(  # a receiver's velocity against its own positions
    [
        ("last_ns", "<i8"),  # epoch of the last fix
        ("last_place", "<f8", (2,)),  # its latitude and longitude, rad
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
