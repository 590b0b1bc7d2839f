"""Zero-velocity update (ZUPT) and zero-angular-rate update (ZARU), once per stationarity window at rest.

ZUPT: z = -v, while navigating. ZARU: z = mean rate - earth rate in the body - bg. In coarse alignment, and where the
receiver confirms the rest, the velocity is then reset to zero.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...records import REST_N, REST_X
from ...tuning import Tunable
from ..ekf import decorrelate, set_jacobian, variance
from ..fusion import correct_state, pseudo_measurement
from ..glr_tests.fault_sensitivity import clear_velocity_sensitivity
from ..mechanization import set_velocity
from ..rest import gnss_confirms_rest
from ..state import GYRO_BIAS, NAVIGATING, OTHER_AXIS, VELOCITY
from .contradicted_bias import contradicts_bias, excess_rate, rate_variance

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
    Tunable(
        "rest_gate",
        25.0,
        "NIS",
        "Gate of zero rates at rest; that of zero velocity is four times as large.",
        "Five sigma.",
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
    shows yet: it is fused once it has stayed long enough.
    """
    confirmed, navigating = gnss_confirms_rest(p, c), c.alignment.mode == NAVIGATING
    sigma = p.tuning.zupt_sigma if confirmed else p.tuning.zupt_sigma_unconfirmed
    if navigating:
        for i in range(3):
            length = set_jacobian(c, 0, VELOCITY + i, 1.0)
            pseudo_measurement(
                c, REST_N + i, length, -c.nav.v_n[i], sigma * sigma, 4.0 * p.tuning.rest_gate, OTHER_AXIS
            )
    order, r = least_known_first(c), rate_variance(p, c)
    for k in range(3):
        i = order[k]
        if not contradicts_bias(p, c, i):
            length = set_jacobian(c, 0, GYRO_BIAS + i, 1.0)
            pseudo_measurement(c, REST_X + i, length, excess_rate(c, i), r, p.tuning.rest_gate, OTHER_AXIS)
    correct_state(p, c)
    if confirmed or not navigating:
        reset_velocity(c, p.tuning.standstill_sigma if confirmed else sigma)
