"""What a small velocity and a place not left tell of tilt, biases and the gyro's matrix.

No sensor sees velocity; that a body does not run away is the knowledge that levels it. Its velocity is taken to be zero
with a noise as large as the motion is lively, and its place to be where it was, with a noise that grows with how far it
has lately been: a hand or a robot comes back, and over the time that it takes this is the stronger knowledge; a vehicle
soon is so far that its place tells nothing. The noise densities were found on hand-held recordings with optical truth
(BROAD), and on simulated vehicles such that their tilt errors are no larger than without a place.
"""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import reset
from .covariance import observe, variance
from .state import GYRO_BIAS, PLACE, STATES, VELOCITY

VELOCITY_NOISE = 0.023  # m/s sqrt(s), of zero velocity in slow motion
VELOCITY_LIVELY = 3.0  # sqrt(s), of it in proportion to the liveliness
REST_VELOCITY_NOISE = 0.09  # m/s sqrt(s)
UNIFORM_MOTION = 4.0  # sigma
KNOWN = 2.0  # sigma
FAST = 5.0  # m/s: a hand does not move faster; a vehicle does, and for long
PLACE_NOISE = 0.5  # m sqrt(s)
PLACE_LIVELY = 6.0  # sqrt(s), in proportion to the distance
START_VELOCITY_VAR = 0.1
START_PLACE_VAR = 0.1


@kernel
def hold(s: Any, i: int, psd: float) -> None:
    """Take velocity along axis i as zero with noise of this density.

    What is beyond it is real: uniform motion, which feels like rest and is forgotten. A speed on the way there is one
    of a vehicle, which lasts; it is fast in what exceeds the velocity's own uncertainty.
    """
    if s.v[i] * s.v[i] > UNIFORM_MOTION**2 * (variance(s, VELOCITY + i) + psd):
        forget_motion(s, i)
    fast2 = max(s.v[i] * s.v[i] - KNOWN**2 * variance(s, VELOCITY + i), 0.0)
    psd += VELOCITY_LIVELY**2 * fast2 * (fast2 / FAST**2) ** 2
    observe(s, VELOCITY + i, -s.v[i], psd / s.span)


@kernel
def hold_still(p: Any, s: Any) -> None:
    """At rest the mean rate is the gyro bias, and velocity zero."""
    for i in range(3):
        s.rest_sign[i] = math.copysign(1.0, s.w_mean[i])
        observe(s, GYRO_BIAS + i, s.w_mean[i] - s.bg[i], p.rest_rate_psd / s.span)
        hold(s, i, REST_VELOCITY_NOISE**2)


@kernel
def hold_near(s: Any) -> None:
    """In motion velocity is about zero, the livelier the less surely."""
    for i in range(3):
        hold(s, i, VELOCITY_NOISE**2 + VELOCITY_LIVELY**2 * s.v_energy[i])


@kernel
def hold_place(s: Any) -> None:
    """Take the place as the old one, the farther it has lately been the less surely."""
    for i in range(3):
        psd = PLACE_NOISE**2 + PLACE_LIVELY**2 * s.p_energy[i]
        observe(s, PLACE + i, -s.p[i], psd / s.span)


@kernel
def forget_motion(s: Any, i: int) -> None:
    """Count velocity and place along axis i from zero anew, and learn nothing from what they were."""
    s.v[i] = s.v_mean[i] = s.v_energy[i] = s.p[i] = s.p_energy[i] = 0.0
    reset(s.P, STATES, VELOCITY + i, START_VELOCITY_VAR)
    reset(s.P, STATES, PLACE + i, START_PLACE_VAR)
