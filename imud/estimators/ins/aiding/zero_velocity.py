"""What rest tells: the velocity is zero, and the gyro shows its bias and the earth's rotation (ZUPT and ZARU)."""

import math
from typing import Any

from ....kernels.earth import EARTH_RATE_RADPS
from ....kernels.jit import kernel
from ....kernels.kalman import reset
from ....kernels.rotation import quat_rotate_back
from ...records import REST_N, REST_X
from ..ekf import inject_error, pseudo_measurement, set_jacobian
from ..state import GYRO_BIAS, HEADING_FAULTS, NAVIGATING, ONSETS, STATES, VELOCITY
from ..stationarity import gnss_confirms_rest, max_rest_rate

# m/s, for what a window tells of all but the velocity. Weak on purpose: windows at rest all show the same tilt and
# bias, and a filter that counts them as independent comes to know, from its own linearization errors, what rest
# cannot show; weaker still where no receiver's speed confirms it: a start out of rest may be so smooth that only
# positions tell of it
ZUPT_SIGMA = (0.06, 0.2)
STANDSTILL_SIGMA = 0.01  # m/s, of a vehicle that stands, its engine running: for the velocity itself
ZARU_SIGMA = 1e-4  # rad/s
REST_GATE = 25.0


@kernel
def reset_velocity(c: Any, sigma: float) -> None:
    """The velocity is zero, whatever it was thought to be, and its error independent of all others."""
    for i in range(3):
        reset(c.cov.P, STATES, VELOCITY + i, sigma * sigma)
        c.nav.v_n[i] = 0.0
        for j in range(2 * ONSETS):
            c.drift.bias_sensitivity[VELOCITY + i, j] = 0.0


@kernel
def fuse_rest(p: Any, c: Any) -> None:
    """Fuse one window of rest (call at its end, before it is cleared)."""
    certain, navigating = gnss_confirms_rest(c), c.alignment.mode == NAVIGATING
    sigma = ZUPT_SIGMA[0] if certain else ZUPT_SIGMA[1]
    if navigating:
        for i in range(3):
            pseudo_measurement(
                c, REST_N + i, set_jacobian(c, 0, VELOCITY + i, 1.0), -c.nav.v_n[i], sigma * sigma, 4.0 * REST_GATE
            )
    earth = quat_rotate_back(
        (c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3]),
        (EARTH_RATE_RADPS * math.cos(c.nav.lat), 0.0, -EARTH_RATE_RADPS * math.sin(c.nav.lat)),
    )
    r = (
        p.gyro_psd / c.stationarity.duration
        + c.stationarity.gyro_noise_floor**2 / c.stationarity.sample_count
        + ZARU_SIGMA**2
    )
    for i in range(3):
        z = c.stationarity.mean_w[i] - earth[i] - c.nav.bg[i]
        if abs(z) > max_rest_rate(c, i):  # certain rest, or it would not have come to this
            reset(c.cov.P, STATES, GYRO_BIAS + i, z * z)
            c.integrity.heading_fault_count = HEADING_FAULTS  # and so is what was navigated with such a bias
        pseudo_measurement(c, REST_X + i, set_jacobian(c, 0, GYRO_BIAS + i, 1.0), z, r, REST_GATE)
    inject_error(c)
    if certain or not navigating:
        reset_velocity(c, STANDSTILL_SIGMA if certain else sigma)
