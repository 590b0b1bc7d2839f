"""Heading from true north: dual-antenna receivers, gyro compasses (HDT, THS).

z = heading - boresight - yaw, with yaw = atan2(y, x) of the body's x axis in NED, extrapolated where the epoch is after
the newest sample. The errors of a compass last, those of two antennas as long as reflections do: the gate has the
variance of a single heading, the update that of what all those know that share an error. A measurement has value[0]:
heading, rad, and sigma[0]: rad, NaN where it is not reported. A compass that the motion contradicts is left out until
it has agreed for `heading_trust_s`. During coarse alignment `alignment.external_heading` takes the heading.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.rotation import wrap_angle
from ...aiding_source import DEGREE, AidingSource, Column
from ...innovation_kinds import KINDS
from ...records import HEADING, HEADING_SOURCE
from ...tuning import Tunable
from ..boresights import (
    begin_boresight,
    forget_boresight,
    prior_variance,
    reopen_boresight,
    set_heading_row,
    widen_unused_boresight,
)
from ..ekf import innovation_variance, set_jacobian
from ..fusion import REJECT, correct_state, correlated_update, write_innovation
from ..glr_tests.compass_offset import close_compass_offset, is_unconfirmed, open_compass_offset
from ..mechanization import body_to_ned
from ..state import ATTITUDE, COMPASS_AXIS, NEVER_NS
from .heading_deviation import learn_deviation
from .heading_turns import add_heading_turn, forget_turns, turns_differently

if TYPE_CHECKING:
    from ...types import Innovation, Measurement
    from ..types import Core, Parameters

SOURCE = AidingSource(
    "heading",
    HEADING_SOURCE,
    "HDG",
    {"heading_deg": Column(DEGREE, -360.0, 360.0)},
    {"sigma_deg": Column(DEGREE, 0.01, 180.0)},
    {HEADING: KINDS[HEADING]},
)
TUNABLES = (
    Tunable("heading_sigma", math.radians(1.0), "rad", "Sigma of a heading that reports none.", "Choice."),
    Tunable(
        "heading_correlation_s", 10.0, "s", "Correlation time of the error of a heading.", "Multipath of a baseline."
    ),
    Tunable("heading_time_sigma", 0.03, "s", "Unknown age of a heading.", "Choice: half a period of 20 Hz."),
    Tunable("heading_gate", 25.0, "NIS", "Gate of a heading.", "Five sigma."),
    Tunable(
        "heading_reject_s",
        15.0,
        "s",
        "Time of rejections after which a heading that a compass gave and motion has not confirmed is given up; of a "
        "confirmed one the compass's boresight.",
        "Choice: reflections are mostly shorter.",
    ),
    Tunable("heading_agreement", 4.0, "NIS", "Gate of a compass that was wrong.", "Two sigma."),
    Tunable(
        "heading_trust_s",
        30.0,
        "s",
        "Time for which a compass that was wrong must agree before it is used again.",
        "A turn or two.",
    ),
    Tunable(
        "heading_min_level",
        0.2,
        "",
        "Least level component of the body's x axis for which it has a heading.",
        "Choice.",
    ),
)


@kernel
def sigma_of(p: Parameters, m: Measurement) -> float:
    """Sigma of a heading, rad: the reported one, else the tunable heading_sigma."""
    return m.sigma[0] if m.sigma[0] > 0.0 else p.tuning.heading_sigma


@kernel
def heading_of(p: Parameters, c: Core, m: Measurement) -> float:
    """The heading of the vehicle, rad, with the boresight of the settings and what is estimated beyond it."""
    return float(m.value[0] - p.heading_boresight - c.heading_aid.boresight)


@kernel
def headings_per_error(p: Parameters, c: Core, m: Measurement) -> float:
    """How many headings, as often as they come, share one error; 1 where they come seldom."""
    g = c.heading_aid
    dt = 1e-9 * (m.t_ns - g.last_ns) if g.last_ns != NEVER_NS else 2.0 * p.tuning.heading_correlation_s
    g.last_ns = m.t_ns
    return max(2.0 * p.tuning.heading_correlation_s / max(dt, 1e-3), 1.0)


@kernel
def distrust_compass(p: Parameters, c: Core) -> None:
    """The way the vehicle moves contradicts the heading, and a compass gave it: it is not used until it agrees."""
    if c.heading_aid.last_ns != NEVER_NS:
        c.heading_aid.distrusted = 1
        c.heading_aid.agreeing_ns = NEVER_NS
    close_compass_offset(c)
    forget_boresight(p, c)
    forget_turns(c)


@kernel
def has_compass(p: Parameters, c: Core) -> bool:
    """Whether headings come, used or not."""
    last_ns = c.heading_aid.last_ns
    return bool(last_ns != NEVER_NS and 1e-9 * (c.nav.t_ns - last_ns) < p.tuning.heading_trust_s)


@kernel
def contradicts_itself(p: Parameters, c: Core, m: Measurement) -> bool:
    """Whether a compass gave the heading, motion has not confirmed it, and its headings have been rejected for long."""
    rejected_s = 1e-9 * (m.t_ns - max(c.heading_aid.last_used_ns, c.compass_offset.onset_ns))
    return bool(is_unconfirmed(c) and rejected_s > p.tuning.heading_reject_s)


@kernel
def has_turned(p: Parameters, c: Core, t_ns: int, used: bool) -> bool:
    """Whether a compass has been rejected for `heading_reject_s` while fixes have shown the heading: it is off anew."""
    g = c.heading_aid
    no_fix_s = 1e-9 * (t_ns - c.gnss.last_used_ns)
    otherwise = used or g.distrusted != 0 or is_unconfirmed(c) or no_fix_s > p.tuning.coasting_s
    g.rejecting_ns = agreeing_since(g.rejecting_ns, t_ns, not otherwise)
    if otherwise or 1e-9 * (t_ns - g.rejecting_ns) < p.tuning.heading_reject_s:
        return False
    g.rejecting_ns = NEVER_NS
    return True


@kernel
def check_turns(p: Parameters, c: Core) -> bool:
    """Whether headings that do not turn with the gyros gave the heading; they are not used any more."""
    if c.heading_aid.distrusted or not turns_differently(p, c):
        return False
    gave_heading = is_unconfirmed(c)
    distrust_compass(p, c)
    return gave_heading


@kernel
def agreeing_since(since_ns: int, t_ns: int, agrees: bool) -> int:
    """Since when a source has agreed, ns, with what it says at t_ns; NEVER_NS: it does not. since_ns: before that."""
    if not agrees:
        return NEVER_NS
    return t_ns if since_ns == NEVER_NS else since_ns


@kernel
def check_trust(p: Parameters, c: Core, t_ns: int, agrees: bool) -> None:
    """Trust a compass again after a time of agreement."""
    g = c.heading_aid
    g.agreeing_ns = agreeing_since(g.agreeing_ns, t_ns, agrees)
    if agrees and 1e-9 * (t_ns - g.agreeing_ns) > p.tuning.heading_trust_s:
        g.distrusted = 0


@kernel
def yaw_jacobian(c: Core, x: float, y: float, z: float) -> int:
    """Jacobian of the yaw of d = (x, y, z), the body's x axis in NED; returns its length.

    It changes by (d x (phi x d))_down / (x^2 + y^2).
    """
    level2 = x * x + y * y
    length = set_jacobian(c, 0, ATTITUDE, -x * z / level2)
    length = set_jacobian(c, length, ATTITUDE + 1, -y * z / level2)
    return set_jacobian(c, length, ATTITUDE + 2, 1.0)


@kernel
def fuse_heading(p: Parameters, c: Core, m: Measurement, innovations: list[Innovation]) -> int:
    """Gate and fuse a heading while navigating; returns the rows of innovations. Before: see `external_heading`."""
    x, y, z = body_to_ned(c, (1.0, 0.0, 0.0))
    if x * x + y * y < p.tuning.heading_min_level**2:
        return 0
    rate = body_to_ned(c, (c.imu.rate_b[0], c.imu.rate_b[1], c.imu.rate_b[2]))[2]
    ahead_s = 1e-9 * (m.t_ns - c.nav.t_ns)  # 0 but for an epoch after the newest sample
    off = wrap_angle(heading_of(p, c, m) - elementary.atan2(y, x) - rate * ahead_s)
    r = sigma_of(p, m) ** 2
    timing = rate * rate * (p.tuning.heading_time_sigma**2 + c.scratch.age_variance)
    learn_deviation(p, c, m, off + c.heading_aid.boresight, r, rate, timing)
    length = yaw_jacobian(c, x, y, z)
    add_heading_turn(p, c, m.t_ns, m.value[0], rate, r)
    others = headings_per_error(p, c, m) - 1.0
    gate = p.tuning.heading_gate
    if c.heading_aid.distrusted:
        s = innovation_variance(c, length) + r + timing + prior_variance(p, c)
        check_trust(p, c, m.t_ns, off * off < p.tuning.heading_agreement * s)
        gate = REJECT
    elif c.compass_offset.onset_ns == NEVER_NS:
        open_compass_offset(c, False)
    if not c.heading_aid.distrusted:
        begin_boresight(p, c)
    deviation = c.heading_aid.deviation_variance
    shared = others * (r + deviation + rate * rate * c.scratch.age_variance)
    set_heading_row(c)
    z, s, nis = correlated_update(c, length, off, r + timing + deviation, shared, gate, COMPASS_AXIS)
    used = nis >= 0.0
    if used:
        correct_state(p, c)
        c.heading_aid.last_used_ns = m.t_ns
    elif c.heading_aid.last_used_ns == NEVER_NS and not c.heading_aid.distrusted and not is_unconfirmed(c):
        widen_unused_boresight(p, c)  # the heading was known before the compass came
    if has_turned(p, c, m.t_ns, used):
        reopen_boresight(c, off)
    return write_innovation(innovations, 0, m.t_ns, HEADING, z, s, used)
