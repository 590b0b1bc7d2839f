"""Zero-velocity update (ZUPT) and zero-angular-rate update (ZARU), once per stationarity window at rest.

ZUPT: z = -v, while navigating. ZARU: z = mean rate - earth rate in the body - bg. In coarse alignment, and where the
receiver confirms the rest, the velocity is then reset to zero.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.earth import EARTH_RATE_RADPS
from ...records import REST_N, REST_X
from ...tuning import Tunable
from ..ekf import add_variance, decorrelate, set_jacobian, variance
from ..fusion import correct_state, pseudo_measurement
from ..glr_tests.gnss_drift import clear_velocity_sensitivity
from ..mechanization import ned_to_body, set_velocity
from ..rest import gnss_confirms_rest, max_rest_rate
from ..state import ATTITUDE, GYRO_BIAS, NAVIGATING, OTHER_AXIS, VELOCITY

if TYPE_CHECKING:
    from ..types import Core, Parameters


TUNABLES = (
    Tunable(
        "zupt_sigma",
        0.06,
        "m/s",
        "Sigma of zero velocity at rest if the receiver confirms it; large, as windows are not independent.",
        "Recorded drives.",
    ),
    Tunable(
        "zupt_sigma_unconfirmed",
        0.2,
        "m/s",
        "Sigma of zero velocity at rest if nothing confirms the rest.",
        "Simulated smooth starts.",
    ),
    Tunable(
        "standstill_sigma",
        0.01,
        "m/s",
        "Sigma of the velocity of a vehicle that stands, its engine running.",
        "Recorded drives.",
    ),
    Tunable("zaru_sigma", 1e-4, "rad/s", "Sigma of the rate of a vehicle that stands.", "Choice."),
    Tunable(
        "rest_gate",
        25.0,
        "NIS",
        "Gate of zero rates at rest; that of zero velocity is four times as large.",
        "Five sigma.",
    ),
    Tunable(
        "bias_contradiction_windows",
        10,
        "windows",
        "Windows at rest in a row that contradict the gyro bias, all by the same rate, before it is replaced.",
        "Five seconds: of a body that turns on the spot the rate seldom is the same for so long.",
        low=1,
    ),
)


@kernel
def reset_velocity(c: Core, sigma: float) -> None:
    """Set the velocity to zero with `sigma` (m/s), uncorrelated with all other error states."""
    for i in range(3):
        decorrelate(c, VELOCITY + i, sigma * sigma)
        set_velocity(c, i, 0.0)
    clear_velocity_sensitivity(c)


@kernel
def least_known_first(c: Core) -> tuple[int, int, int]:
    """The gyro biases in order of falling variance."""
    i, j, k = 0, 1, 2
    if variance(c, GYRO_BIAS + i) < variance(c, GYRO_BIAS + j):
        i, j = j, i
    if variance(c, GYRO_BIAS + j) < variance(c, GYRO_BIAS + k):
        j, k = k, j
    if variance(c, GYRO_BIAS + i) < variance(c, GYRO_BIAS + j):
        i, j = j, i
    return i, j, k


@kernel
def fuse_rest(p: Parameters, c: Core) -> None:
    """Fuse one window of rest (call at its end, before it is cleared).

    A rate that contradicts the bias is either another bias, which stays, or the beginning of a motion that nothing else
    shows yet.
    """
    confirmed, navigating = gnss_confirms_rest(p, c), c.alignment.mode == NAVIGATING
    sigma = p.tuning.zupt_sigma if confirmed else p.tuning.zupt_sigma_unconfirmed
    if navigating:
        for i in range(3):
            length = set_jacobian(c, 0, VELOCITY + i, 1.0)
            pseudo_measurement(
                c, REST_N + i, length, -c.nav.v_n[i], sigma * sigma, 4.0 * p.tuning.rest_gate, OTHER_AXIS
            )
    north, down = EARTH_RATE_RADPS * elementary.cos(c.nav.lat), -EARTH_RATE_RADPS * elementary.sin(c.nav.lat)
    earth = ned_to_body(c, (north, 0.0, down))
    s, contradicted, turn2, yaw_turn2 = c.stationarity, False, 0.0, 0.0
    r = p.gyro_psd / s.duration + s.gyro_noise_floor**2 / s.sample_count + p.tuning.zaru_sigma**2 + s.turn_rate_var
    for i in range(3):
        if abs(s.mean_w[i] - s.contradicting_w[i]) > p.tuning.limit_sigmas * math.sqrt(2.0 * r):
            s.contradiction_count = 0  # a bias would have stayed the same
    replaces = s.contradiction_count + 1 >= p.tuning.bias_contradiction_windows
    contradicting_s = p.tuning.bias_contradiction_windows * s.duration
    low_motion_s = min(s.low_motion_count * s.duration, 1e-9 * (c.nav.t_ns - s.agreed_ns))
    order = least_known_first(c)
    for k in range(3):
        i = order[k]
        z = s.mean_w[i] - earth[i] - c.nav.bg[i]
        # only a confirmed rest is detected with such a rate; a window's mean may have it by noise, too
        if abs(z) > max(max_rest_rate(p, c, i), p.tuning.limit_sigmas * math.sqrt(variance(c, GYRO_BIAS + i) + r)):
            contradicted = True
            if not replaces:
                continue
            decorrelate(c, GYRO_BIAS + i, z * z)
            turn2 += (z * contradicting_s) ** 2
            yaw_turn2 += (z * max(low_motion_s, contradicting_s)) ** 2
        pseudo_measurement(c, REST_X + i, set_jacobian(c, 0, GYRO_BIAS + i, 1.0), z, r, p.tuning.rest_gate, OTHER_AXIS)
    correct_state(p, c)
    if turn2 > 0.0:  # by the wrong bias; gravity shows the tilt, nothing the yaw since the first window of low motion
        for i in range(2):
            add_variance(c, ATTITUDE + i, turn2)
        add_variance(c, ATTITUDE + 2, yaw_turn2)
    if confirmed or not navigating:
        reset_velocity(c, p.tuning.standstill_sigma if confirmed else sigma)
    if s.contradiction_count == 0:
        for i in range(3):
            s.contradicting_w[i] = s.mean_w[i]
    s.contradiction_count = s.contradiction_count + 1 if contradicted and not replaces else 0
    s.agreed_ns = s.agreed_ns if contradicted and not replaces else c.nav.t_ns
