"""Rest as a measurement: the velocity is zero (ZUPT), and the gyro shows its bias and the earth's rotation (ZARU)."""

import math
from typing import Any

from ....compile.jit import kernel
from ....math.earth import EARTH_RATE_RADPS
from ...records import REST_N, REST_X
from ..ekf import decorrelate, set_jacobian
from ..fusion import correct_state, pseudo_measurement
from ..mechanization import ned_to_body, set_velocity
from ..observers.gnss_drift import clear_velocity_sensitivity
from ..state import GYRO_BIAS, NAVIGATING, VELOCITY
from ..stationarity import gnss_confirms_rest, max_rest_rate

# m/s, where a receiver's speed confirms the rest, and where none does. Large on purpose: windows of one rest all show
# the same tilt and bias, and a filter that counts them as independent comes to know, from its own linearization
# errors, what rest cannot show; and a start out of rest may be so smooth that only positions show it
ZUPT_SIGMA = (0.06, 0.2)
STANDSTILL_SIGMA = 0.01  # m/s, of a vehicle that stands, its engine running: for the velocity itself
ZARU_SIGMA = 1e-4  # rad/s
REST_GATE = 25.0


@kernel
def reset_velocity(c: Any, sigma: float) -> None:
    """The velocity is zero, whatever it was thought to be, and its error independent of all others."""
    for i in range(3):
        decorrelate(c, VELOCITY + i, sigma * sigma)
        set_velocity(c, i, 0.0)
    clear_velocity_sensitivity(c)


@kernel
def fuse_rest(p: Any, c: Any) -> bool:
    """Fuse one window of rest (call at its end, before it is cleared). True: it contradicts the gyro bias."""
    certain, navigating = gnss_confirms_rest(c), c.alignment.mode == NAVIGATING
    sigma = ZUPT_SIGMA[0] if certain else ZUPT_SIGMA[1]
    if navigating:
        for i in range(3):
            m = set_jacobian(c, 0, VELOCITY + i, 1.0)
            pseudo_measurement(c, REST_N + i, m, -c.nav.v_n[i], sigma * sigma, 4.0 * REST_GATE)
    north, down = EARTH_RATE_RADPS * math.cos(c.nav.lat), -EARTH_RATE_RADPS * math.sin(c.nav.lat)
    earth = ned_to_body(c, (north, 0.0, down))
    s, contradicted = c.stationarity, False
    r = p.gyro_psd / s.duration + s.gyro_noise_floor**2 / s.sample_count + ZARU_SIGMA**2
    for i in range(3):
        z = s.mean_w[i] - earth[i] - c.nav.bg[i]
        if abs(z) > max_rest_rate(c, i):  # the rest is certain, or it would not have been detected
            decorrelate(c, GYRO_BIAS + i, z * z)
            contradicted = True
        pseudo_measurement(c, REST_X + i, set_jacobian(c, 0, GYRO_BIAS + i, 1.0), z, r, REST_GATE)
    correct_state(c)
    if certain or not navigating:
        reset_velocity(c, STANDSTILL_SIGMA if certain else sigma)
    return contradicted
