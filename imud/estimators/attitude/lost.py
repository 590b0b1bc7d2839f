"""When roll and pitch are wrong although nobody has told, and when they are so unknown that they must be found anew.

A body seems to gain a speed that none has. Then it does not: the attitude is wrong, as when the sensor slipped, its
gyro was blind for a moment, or the user gave a false attitude; weight counts as acceleration, and biases have been
learnt from it. All of these become as uncertain as that acceleration says they are wrong. A vehicle that did gain so
much speed loses little by it: over the time that it took, its acceleration is a small tilt.

Where roll and pitch have become very uncertain, what corrects them, which counts with small errors, would only turn
round for long; they are then sought as at a start.
"""

import math
from typing import Any

from ...kernels.jit import kernel
from .covariance import grow, variance
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS
from .staying import forget_motion

FOUND, LOST = math.radians(15.0), math.radians(30.0)
FASTEST = 50.0  # m/s gained in SPEED_S, which cars and light aircraft do not
SOME = 0.25  # of it, which many do: from there on the time counts in which the rest was gained
SPEED_S = 300.0


@kernel
def loses(p: Any, s: Any) -> bool:
    """Is the vertical lost? To be asked once per covariance interval; then it is to be found anew."""
    speed = gained(s)
    if speed > FASTEST:
        disbelieve(p, s, speed * (1.0 - SOME) / s.gain_s)
    if s.sigma_tilt < FOUND:
        s.found = 1
    if s.found == 0 or s.sigma_tilt < LOST:
        return False
    s.levelled = s.found = 0
    return True


@kernel
def gained(s: Any) -> float:
    """The speed lately gained, m/s, whatever corrected it, and the time that it took in `gain_s`."""
    fade = s.span / (SPEED_S + s.span)
    speed2 = 0.0
    for i in range(3):
        weight = s.gravity * s.span if i == 2 else 0.0
        s.gain[i] += s.push[i] + weight - fade * s.gain[i]
        speed2 += s.gain[i] * s.gain[i]
    s.gain_s = s.gain_s + s.span if speed2 > (SOME * FASTEST) ** 2 else s.span
    return math.sqrt(speed2)


@kernel
def disbelieve(p: Any, s: Any, acceleration: float) -> None:
    """Take an acceleration, m/s^2, as weight that was seen in a false attitude."""
    tilt = acceleration / s.gravity
    for i in range(3):
        grow(s, ATTITUDE + i, tilt * tilt)
        unlearn(s, GYRO_BIAS + i, tilt / SPEED_S, p.gyro_bias_var)
        unlearn(s, ACCEL_BIAS + i, acceleration, p.accel_bias_var)
        forget_motion(s, i)
        s.gain[i] = 0.0
    s.sigma_tilt += tilt
    s.gain_s = 0.0


@kernel
def unlearn(s: Any, i: int, wrong: float, most: float) -> None:
    """Let error i be as large as `wrong`, but its variance no larger than `most`."""
    grow(s, i, max(min(wrong * wrong, most - variance(s, i)), 0.0))
