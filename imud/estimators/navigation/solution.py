"""What the outside sees of the filter's core: one solution row."""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import packed_index
from ...kernels.rotation import euler_variances
from ..records import ATTITUDE_VALID, COASTING, HEADING_VALID, POSITION_VALID
from .covariance import deviation, variance
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, NAVIGATING, POSITION, STATES, VELOCITY

COASTING_S = 5.0  # a slow line may bring a 1 Hz receiver's fixes two seconds apart
TILT_VALID = math.radians(10.0)
HEADING_LIMIT = math.radians(30.0)


@kernel
def status(c: Any, sigma_rpy: Any) -> int:
    """The status bits of the solution."""
    bits: int = c.flags
    if max(sigma_rpy[0], sigma_rpy[1]) < TILT_VALID:
        bits |= ATTITUDE_VALID
    if (c.phase == NAVIGATING or c.heading_sigma > 0.0) and sigma_rpy[2] < HEADING_LIMIT:
        bits |= HEADING_VALID
    if c.fixes > 0:
        bits |= POSITION_VALID
        if c.t_ns - c.fix_ns > 1e9 * COASTING_S:
            bits |= COASTING
    return bits


@kernel
def write(c: Any, o: Any) -> None:
    """Fill the row `o`."""
    o.t_ns = c.t_ns
    known = c.fixes > 0
    o.lat = c.lat if known else math.nan
    o.lon = c.lon if known else math.nan
    o.height = c.height if known else math.nan
    for i in range(4):
        o.q_nb[i] = c.q[i]
    for i in range(3):
        o.v[i] = c.v[i] if known else math.nan
        o.w[i] = c.w[i] - c.bg[i] - c.excess[i]
        o.f[i] = c.f[i] - c.ba[i]
        o.bg[i] = c.bg[i]
        o.ba[i] = c.ba[i]
        o.sigma_p[i] = math.sqrt(max(variance(c, POSITION + i), 0.0) + c.doubt[i]) if known else math.nan
        o.sigma_v[i] = deviation(c, VELOCITY + i) if known else math.nan
        o.sigma_bg[i] = deviation(c, GYRO_BIAS + i)
        o.sigma_ba[i] = deviation(c, ACCEL_BIAS + i)
    a = ATTITUDE
    rpy = euler_variances(
        (c.q[0], c.q[1], c.q[2], c.q[3]),
        c.P[packed_index(STATES, a, a)],
        c.P[packed_index(STATES, a, a + 1)],
        c.P[packed_index(STATES, a, a + 2)],
        c.P[packed_index(STATES, a + 1, a + 1)],
        c.P[packed_index(STATES, a + 1, a + 2)],
        c.P[packed_index(STATES, a + 2, a + 2)],
    )
    for i in range(3):
        o.sigma_rpy[i] = math.sqrt(max(rpy[i], 0.0))
    o.status = status(c, o.sigma_rpy)
