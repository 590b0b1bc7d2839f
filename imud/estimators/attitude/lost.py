"""When roll and pitch are lost, and must be found as at a start.

They are when they have become so uncertain that what corrects them, which counts with small errors, would only turn
round for long: after values that were held, beyond the range, or missing. And they are when the body seems to gain a
speed that none has. Then it does not: the attitude is wrong, for a reason that nobody has told, as when the sensor
slipped, or its gyro was blind for a moment; weight counts as acceleration, and biases have been learnt from it.
"""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import reset
from .covariance import grow
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, STATES

FOUND, LOST = math.radians(15.0), math.radians(30.0)
LEVEL_SPEED = 50.0  # m/s gained in SPEED_S, which cars and light aircraft do not
VERTICAL_SPEED = 15.0  # m/s
SPEED_S = 30.0
WRONG_BIAS = 0.005  # rad/s, that may have been learnt meanwhile


@kernel
def loses(p: Any, s: Any) -> bool:
    """Is the vertical lost? To be asked once per covariance interval; then it is to be found anew."""
    if gains_speed(s):
        grow(s, ATTITUDE + 2, LOST**2)
        for i in range(3):
            grow(s, GYRO_BIAS + i, min(WRONG_BIAS**2, p.gyro_bias_var))
            reset(s.P, STATES, ACCEL_BIAS + i, p.accel_bias_var)
    else:
        if s.sigma_tilt < FOUND:
            s.found = 1
        if s.found == 0 or s.sigma_tilt < LOST:
            return False
    s.levelled = s.found = 0
    return True


@kernel
def gains_speed(s: Any) -> bool:
    """Does the body seem to gain more speed than any does?"""
    fade = s.span / (SPEED_S + s.span)
    for i in range(3):
        weight = s.gravity * s.span if i == 2 else 0.0
        s.gain[i] += s.push[i] + weight - fade * s.gain[i]
    level2 = s.gain[0] * s.gain[0] + s.gain[1] * s.gain[1]
    return bool(level2 > LEVEL_SPEED**2 or s.gain[2] * s.gain[2] > VERTICAL_SPEED**2)
