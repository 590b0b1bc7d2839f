"""The position of a fix, at its epoch: its innovation, its Jacobian, its gate.

z = p_fix - p - C_nb lever_arm - gnss_bias + v time_offset, axis by axis; the height has a gate of its own.
"""

import math
from typing import Any

from ....compile.jit import kernel
from ....math.earth import radii
from ...records import POSITION_N
from ..ekf import innovation, innovation_variance, set_jacobian, variance
from ..fusion import correct_state, fuse
from ..mechanization import body_to_ned, bounded_cosine, wrap_angle
from ..observers.gnss_drift import detect_drift
from ..state import ATTITUDE, GNSS_BIAS, NAVIGATING, POSITION, TIME_OFFSET
from .gnss_gate import POSITION_GATE, gate_height, gate_position, set_rejecting
from .gnss_noise import (
    learn_position_noise,
    lever_arm_rate_variance,
    limit_position_confidence,
    mark_used,
    second_order_error,
)
from .gnss_time import confirm_survey_epochs

BIAS_FREE_GATE = 20.0  # of fix against position, whatever the GNSS bias says: it never has jumped, only drifted
LATE_FIX_ACCEL = 1.0  # m/s^2, where a fix is too late for rewinding
TURN_BETWEEN_FIXES_S = 1.0


@kernel
def position_offset(c: Any, fix: Any, out: Any) -> None:
    """out <- the way in m (NED) from the estimate to the fix; down is NaN without a height."""
    meridian, prime_vertical = radii(c.nav.lat)
    out[0] = (fix.lat - c.nav.lat) * (meridian + c.nav.height)
    out[1] = wrap_angle(fix.lon - c.nav.lon) * (prime_vertical + c.nav.height) * bounded_cosine(c.nav.lat)
    out[2] = -(fix.height - c.nav.height)


@kernel
def position_jacobian(c: Any, lever: Any, i: int) -> int:
    """Jacobian of the antenna's position along axis i: IMU position, attitude, GNSS bias and time offset."""
    k = set_jacobian(c, 0, POSITION + i, 1.0)
    j, m = (i + 1) % 3, (i + 2) % 3
    k = set_jacobian(c, k, ATTITUDE + j, lever[m])
    k = set_jacobian(c, k, ATTITUDE + m, -lever[j])
    k = set_jacobian(c, k, GNSS_BIAS + i, 1.0)
    return set_jacobian(c, k, TIME_OFFSET, -c.nav.v_n[i] if c.alignment.mode == NAVIGATING else 0.0)


@kernel
def write_innovation(innovations: Any, n: int, t_ns: int, kind: int, z: float, s: float, used: bool) -> int:
    """Write one row, if there is room; returns the rows written so far."""
    if n < len(innovations):
        r = innovations[n]
        r.t_ns, r.kind, r.value, r.variance, r.used = t_ns, kind, z, s, 1 if used else 0
        n += 1
    return n


@kernel
def lever_arm_n(p: Any, c: Any, body: Any) -> tuple[float, float, float]:
    """A vector of the lever arm (`body`) in NED; none during coarse alignment, where the antenna itself is followed."""
    if c.alignment.mode != NAVIGATING:
        return 0.0, 0.0, 0.0
    return body_to_ned(c, body)


@kernel
def max_nis(c: Any, lever: Any, extra: float, first: int, last: int) -> float:
    """The largest normalised innovation squared of axes first to last - 1, to be held against POSITION_GATE."""
    largest, z = 0.0, c.scratch.position_innovation
    for i in range(first, last):
        r = c.gnss.noise_var[i // 2] + extra
        s = innovation_variance(c, position_jacobian(c, lever, i)) + r
        without_bias = variance(c, POSITION + i) + c.gnss.reported_sigma[i // 2] ** 2 + r
        nis = (z[i] + c.nav.gnss_bias[i]) ** 2 / without_bias  # a bias state that has run away is no excuse
        largest = max(largest, z[i] ** 2 / s, nis * (POSITION_GATE / BIAS_FREE_GATE))
    return largest


@kernel
def fuse_gnss_position(p: Any, c: Any, fix: Any, late: float, innovations: Any, n: int) -> int:
    """Gate and fuse the position; the fix was true `late` s before the core's time. Height has no veto."""
    z = c.scratch.position_innovation
    position_offset(c, fix, z)
    lever = lever_arm_n(p, c, (p.gnss_lever_arm[0], p.gnss_lever_arm[1], p.gnss_lever_arm[2]))
    extra = second_order_error(c) ** 2 + (0.5 * LATE_FIX_ACCEL * late * late) ** 2
    extra += lever_arm_rate_variance(c) * TURN_BETWEEN_FIXES_S**2
    for i in range(3):
        z[i] += late * c.nav.v_n[i] - lever[i] - c.nav.gnss_bias[i]
    level = gate_position(c, fix, max_nis(c, lever, extra, 0, 2))
    height = level and gate_height(c, max_nis(c, lever, extra, 2, 3))
    for i in range(3):
        if not math.isfinite(z[i]):
            continue
        accepted = level if i < 2 else height
        r = c.gnss.noise_var[i // 2] + extra
        m = position_jacobian(c, lever, i)
        s = innovation_variance(c, m) + r
        left = innovation(c, m, z[i])
        n = write_innovation(innovations, n, fix.t_ns, POSITION_N + i, left, s, accepted)
        if accepted:
            fuse(c, m, left, s, i if i < 2 else -1)
            if c.alignment.mode == NAVIGATING or c.stationarity.at_rest:  # otherwise they show accelerations
                learn_position_noise(c, i, left * left / s, s)
    if level:
        correct_state(c)
        mark_used(c)
        confirm_survey_epochs(c)
        if c.alignment.mode == NAVIGATING and detect_drift(c):
            correct_state(c)
        limit_position_confidence(p, c)
    set_rejecting(c)
    return n
