"""A fix while the heading is not known: its innovations are matched with what was felt, pairs of them level the frame.

How they are matched, is in `matching`; here is what of a fix is taken for it, and how long it can be compared.
"""

import math
from typing import Any

from ...kernels.earth import STANDARD_GRAVITY
from ...kernels.jit import kernel
from ...kernels.rotation import dcm_of_quat
from ..records import AT_REST
from .correction import predicted, row
from .covariance import WANDER_S, variance
from .hypotheses import carry_on, clear_bank, fade, likely, match, rebase
from .levelling import level_between
from .matching import TIME, ZETA, Pair, clear_matching, times, unit
from .state import ATTITUDE, GYRO_BIAS, LATENCY, LEVELLING, NAVIGATING, NEVER_NS
from .strapdown import way
from .whitening import ANY_SPEED, expected, innovate, let_pass, restart

SHORTEST_S, LONGEST_S = 0.9, 6.0  # between two fixes of a pair
VAGUENESS = 0.4  # m/s, of a velocity change seen in positions
GATE = 25.0
OLDEST_S, OLDEST_TURN = (100.0, 400.0), math.radians(20.0)  # of pairs: tilt and biases are taken as constant
OUTAGE = 0.2  # of that time, without fixes, after which to begin anew
LEVELLED = math.radians(6.0)


@kernel
def mark(c: Any, lat: float, lon: float, vn: float, ve: float) -> None:
    """Remember this fix as the first of the next pair."""
    c.mark_ns = c.t_ns
    for k in range(4):
        for i in range(2):
            c.marked[k, i], c.marked_twice[k, i] = c.running[k, i], c.twice[k, i]
    m = c.mark
    m[0], m[1], m[2], m[3], m[4], m[5] = vn, ve, lat, lon, c.accel[0], c.accel[1]


@kernel
def levelled(c: Any) -> bool:
    """Whether roll and pitch are known well enough to navigate."""
    return max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1)) < LEVELLED**2


@kernel
def level_by(c: Any, vn: float, ve: float, dt: float) -> None:
    """Level by the force in c.pair, felt over `dt` s while the velocity was seen to change by (vn, ve)."""
    zn, ze = times(unit(-c.frame), (c.pair[ZETA, 0], c.pair[ZETA, 1]))
    if c.phase == LEVELLING:
        level_between(c, zn / dt, ze / dt, dt, math.hypot(vn, ve) / dt)


@kernel
def jerked2(c: Any) -> float:
    """Variance, m^2/s^2, of a velocity change since the mark by what is not known of the fixes' latency."""
    return float(variance(c, LATENCY) * ((c.accel[0] - c.mark[4]) ** 2 + (c.accel[1] - c.mark[5]) ** 2))


@kernel
def displaced2(c: Any, b: Any) -> float:
    """Variance, m^2, of a way since the last fix matched by the same: what it has sped up goes on for so long."""
    north, east = c.running[ZETA, 0] - b.before[ZETA, 0], c.running[ZETA, 1] - b.before[ZETA, 1]
    return float(variance(c, LATENCY) * (north * north + east * east))


@kernel
def patience(c: Any) -> float:
    """Seconds between positions that show a velocity change with a sigma of VAGUENESS.

    It is their second difference, of three times white noise and of two increments of a random walk.
    """
    walk = 4.0 * c.reported[0] ** 2 / WANDER_S
    root = math.sqrt(walk * walk + 24.0 * c.white[0] * VAGUENESS**2)
    seconds: float = (walk + root) / (2.0 * VAGUENESS**2)
    return min(max(seconds, SHORTEST_S), LONGEST_S)


@kernel
def memory(c: Any) -> float:
    """Seconds for which pairs can be compared: drift hypotheses lie some way apart, unless the drift is known.

    While navigating the estimate of the gyro's scale factor changes, too.
    """
    if c.phase == NAVIGATING:
        return OLDEST_S[0]
    drift = math.sqrt(predicted(c, vertical_bias(c)))
    return min(max(OLDEST_TURN / drift, OLDEST_S[0]), OLDEST_S[1])


@kernel
def pair(c: Any, b: Any, lat: float, lon: float, vn: float, ve: float, noise2: float) -> None:
    """A fix at the core's time, with its velocity (NaN when it has none), of a variance beyond the usual."""
    matching = 1e-9 * (c.t_ns - c.matched_ns) >= SHORTEST_S
    if matching:
        rebase(c, b)
        match_fix(c, b, lat, lon, vn, ve, noise2)
    dt = 1e-9 * (c.t_ns - c.mark_ns)
    m = c.mark
    known = math.isfinite(vn) and math.isfinite(m[0])
    if dt < SHORTEST_S or (not known and dt < patience(c)):
        return
    if not matching:
        rebase(c, b)
    if dt > max(LONGEST_S, 2.0 * patience(c)):
        c.slope[2] = 0.0
    elif known:
        for k in range(4):
            for i in range(2):
                c.pair[k, i] = c.running[k, i] - c.marked[k, i]
        level_by(c, vn - m[0], ve - m[1], dt)
    else:
        north, east = way(c, m[2], m[3], lat, lon)
        pair_of_means(c, north / dt, east / dt, dt)
    mark(c, lat, lon, vn, ve)


@kernel
def felt_less(c: Any, b: Any, s: float) -> bool:
    """Do the innovations in b.left, of variance s, differ by more than any heading and the tilt's doubt explain?"""
    felt = math.hypot(b.left[1 + ZETA, 0], b.left[1 + ZETA, 1])
    tilt2 = STANDARD_GRAVITY**2 * max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1))
    doubt = s + tilt2 * (b.left[1 + TIME, 0] ** 2 + b.left[1 + TIME, 1] ** 2)
    return bool((felt - math.hypot(b.left[0, 0], b.left[0, 1])) ** 2 > GATE * doubt)


@kernel
def match_fix(c: Any, b: Any, lat: float, lon: float, vn: float, ve: float, noise2: float) -> None:
    """Match what this fix tells with what was felt."""
    dt = 1e-9 * (c.t_ns - c.matched_ns)
    if 1e-9 * (c.t_ns - c.origin_ns) > memory(c) or dt > OUTAGE * memory(c):
        forget_pairs(c)
        dt = math.inf
    c.matched_ns = c.t_ns
    late2 = displaced2(c, b)
    if dt == math.inf:
        c.base[0], c.base[1] = lat, lon
        clear_matching(c)
        clear_bank(b)
        begin_anew(c, b)
    else:
        carry_on(c, b, dt)
        let_pass(b, c.reported[0], dt)
        fade(b, math.exp(-2.0 * dt / memory(c)))
    if math.isfinite(vn) and math.isfinite(ve):
        consider(c, b, False, (vn, ve), c.white_speed + jerked2(c) + noise2)
    else:
        consider(c, b, True, way(c, c.base[0], c.base[1], lat, lon), c.white[0] + late2)


@kernel
def begin_anew(c: Any, b: Any) -> None:
    """Place and velocity are taken from the next fix."""
    restart(b, c.reported[0])
    c.refusals = 0


@kernel
def consider(c: Any, b: Any, place: bool, told: Pair, r: float) -> None:
    """Match a place (m) or a velocity of variance r, if it tells something; not one that was not felt.

    When there are three such fixes in a row, place and velocity are taken anew from the next.
    """
    s = expected(b, place, r)
    certain = levelled(c) and s < 0.5 * ANY_SPEED**2
    innovate(b, likely(c), place, told)
    if certain and felt_less(c, b, s):
        c.refusals += 1
        if c.refusals > 2:
            begin_anew(c, b)
        return
    c.refusals = 0
    match(c, b, place, told, s, certain and not c.flags & AT_REST)


@kernel
def pair_of_means(c: Any, vn: float, ve: float, dt: float) -> None:
    """From positions alone: the mean velocity since the last fix, against the mean before it."""
    s = c.slope
    for k in range(4):
        for i in range(2):
            mean = (c.twice[k, i] - c.marked_twice[k, i]) / dt
            c.pair[k, i] = mean - c.means[k, i]
            c.means[k, i] = mean
    if s[2] > 0.0 and unfelt(c, vn - s[0], ve - s[1], dt):
        s[2] = 0.0
        return
    if s[2] > 0.0:
        level_by(c, vn - s[0], ve - s[1], c.pair[TIME, 0])
    s[0], s[1], s[2] = vn, ve, dt


@kernel
def unfelt(c: Any, vn: float, ve: float, dt: float) -> bool:
    """Is this change of mean velocities over `dt` s more than force (c.pair), doubt of the tilt and noise explain?"""
    felt = math.hypot(c.pair[ZETA, 0], c.pair[ZETA, 1])
    tilt2 = STANDARD_GRAVITY**2 * max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1))
    doubt = 6.0 * (c.white[0] + c.reported[0] ** 2) / dt**2 + tilt2 * c.pair[TIME, 0] ** 2
    return bool(max(math.hypot(vn, ve) - felt, 0.0) ** 2 > GATE * doubt)


@kernel
def vertical_bias(c: Any) -> int:
    """Put the gyro bias about the vertical into the measurement row; returns its length."""
    m = dcm_of_quat((c.q[0], c.q[1], c.q[2], c.q[3]))
    k = 0
    for i in range(3):
        k = row(c, k, GYRO_BIAS + i, m[6 + i])
    return k


@kernel
def forget_pairs(c: Any) -> None:
    """Begin to match anew."""
    clear_matching(c)
    c.mark_ns = c.matched_ns = NEVER_NS
    c.slope[2] = 0.0
    c.astray = 0
