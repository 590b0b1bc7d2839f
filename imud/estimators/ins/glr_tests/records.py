"""The records of the GLR tests, and of the sensitivities that they share."""

import numpy as np

from ..state import BORESIGHTS, FAULTS, GYRO_BIAS_ONSETS, IMU_BIAS_HYPOTHESES, IMU_BIAS_ONSETS, ONSETS, STATES

FAULT_SENSITIVITIES = np.dtype(
    [
        ("sensitivity", "<f8", (STATES, FAULTS)),  # error of the estimate per unit of each fault
        ("boresight_sensitivity", "<f8", (BORESIGHTS, FAULTS)),  # the same of the boresights
    ],
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
        ("gap_s", "<f8", (ONSETS,)),  # s, from the onset to the first fix after it
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
        ("epoch_ns", "<i8"),  # of the last fix
        ("epoch_energy", "<f8"),  # its part of the energy
        ("largest_energy", "<f8"),  # the largest part that one fix has
        ("jump", "<f8", (2, 3)),  # of positions north, east: sums of 1 / s, of mean / s, of innovation / s
    ],
    align=True,
)

LEVER_ARM_ERROR = np.dtype(  # the test for a lever arm that is given wrong (GLR)
    [
        ("onset_ns", "<i8"),
        ("vector", "<f8", (2,)),  # 1/m, information times error ahead and to the right
        ("information", "<f8", (3,)),  # 1/m^2, of the error: xx, xy, yy
        ("energy", "<f8"),  # sum of the normalised innovations squared
        ("count", "<f8"),  # number of these
        ("epoch_ns", "<i8"),  # of the last fix
        ("epoch_energy", "<f8"),  # its part of the energy
        ("largest_energy", "<f8"),  # the largest part that one fix has
    ],
    align=True,
)

COMPASS_OFFSET = np.dtype(  # the test for a compass that shows a wrong heading (GLR)
    [
        ("onset_ns", "<i8"),  # when its headings were used first
        ("last_ns", "<i8"),  # the last fix
        ("turn_variance", "<f8"),  # rad^2, of a turn of the sensor while it was not connected
        ("unconfirmed", "<i8"),  # 1: it gave the heading, and motion has not confirmed that
        ("information", "<f8"),  # 1/rad^2, of the offset
        ("vector", "<f8"),  # 1/rad, information times offset
        ("energy", "<f8"),  # sum of the normalised innovations squared
        ("count", "<f8"),  # number of these
        ("heading_variance", "<f8"),  # rad^2, beyond P: of an offset that is likely but not detected
    ],
    align=True,
)

CURRENT = np.dtype(  # the test for a body in a current that passes for a land vehicle (GLR)
    [
        ("vector", "<f8", (2,)),  # s/m, information times current north and east
        ("information", "<f8", (3,)),  # s^2/m^2, of the current: nn, ne, ee
        ("energy", "<f8"),  # sum of the normalised innovations squared
        ("count", "<f8"),  # number of these
        ("heading_variance", "<f8"),  # rad^2, beyond P: of a current that is not excluded
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

IMU_BIAS_STEP = np.dtype(  # the test for a step of the biases of accelerometers or gyros (GLR)
    [
        ("attitude_variance", "<f8", (3,)),  # rad^2, beyond P: of a step that is likely but not detected
        ("proofs", "<i8"),  # fixes in a row after which a step was proven
        ("onset_ns", "<i8", (IMU_BIAS_ONSETS,)),
        ("energy", "<f8", (IMU_BIAS_ONSETS,)),  # sum of the normalised innovations squared
        ("count", "<f8", (IMU_BIAS_ONSETS,)),  # number of these
        ("information", "<f8", (IMU_BIAS_HYPOTHESES, 6)),  # of the step: xx, xy, xz, yy, yz, zz
        ("vector", "<f8", (IMU_BIAS_HYPOTHESES, 3)),  # information times step
    ],
    align=True,
)
