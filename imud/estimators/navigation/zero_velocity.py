"""What rest tells: the velocity is zero, and the gyro shows its bias and the earth's rotation (ZUPT and ZARU)."""

import math
from typing import Any

from ...kernels.earth import EARTH_RATE_RADPS
from ...kernels.jit import kernel
from ...kernels.kalman import reset
from ...kernels.rotation import quat_rotate_back
from ..records import REST_N, REST_X
from .correction import assume, correct, row
from .motion import confirmed, rest_rate
from .state import ASTRAY, GYRO_BIAS, MOMENTS, NAVIGATING, STATES, VELOCITY

# m/s, for what a window tells of all but the velocity. Weak on purpose: windows at rest all show the same tilt and
# bias, and a filter that counts them as independent comes to know, from its own linearization errors, what rest
# cannot show; weaker still where no receiver's speed confirms it: a start out of rest may be so smooth that only
# positions tell of it
REST_VELOCITY = (0.06, 0.2)
SWAY = 0.01  # m/s, of a vehicle that stands, its engine running: for the velocity itself
REST_TURN = 1e-4  # rad/s
GATE = 25.0


@kernel
def stand_still(c: Any, sigma: float) -> None:
    """The velocity is zero, whatever it was thought to be, and its error independent of all others."""
    for i in range(3):
        reset(c.P, STATES, VELOCITY + i, sigma * sigma)
        c.v[i] = 0.0
        for j in range(2 * MOMENTS):
            c.pull[VELOCITY + i, j] = 0.0


@kernel
def rest(p: Any, c: Any) -> None:
    """Fuse one window of rest (call at its end, before it is cleared)."""
    certain, navigating = confirmed(c), c.phase == NAVIGATING
    sigma = REST_VELOCITY[0] if certain else REST_VELOCITY[1]
    if navigating:
        for i in range(3):
            assume(c, REST_N + i, row(c, 0, VELOCITY + i, 1.0), -c.v[i], sigma * sigma, 4.0 * GATE)
    earth = quat_rotate_back(
        (c.q[0], c.q[1], c.q[2], c.q[3]),
        (EARTH_RATE_RADPS * math.cos(c.lat), 0.0, -EARTH_RATE_RADPS * math.sin(c.lat)),
    )
    r = p.gyro_psd / c.elapsed + c.floor**2 / c.n + REST_TURN**2
    for i in range(3):
        z = c.mean_w[i] - earth[i] - c.bg[i]
        if abs(z) > rest_rate(c, i):  # certain rest, or it would not have come to this
            reset(c.P, STATES, GYRO_BIAS + i, z * z)
            c.astray = ASTRAY  # and so is what was navigated with such a bias
        assume(c, REST_X + i, row(c, 0, GYRO_BIAS + i, 1.0), z, r, GATE)
    correct(c)
    if certain or not navigating:
        stand_still(c, SWAY if certain else sigma)
