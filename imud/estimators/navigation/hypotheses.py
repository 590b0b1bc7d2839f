"""A bank of drift rates of the level frame: for each, the integrals of `matching` turned back, matched with the fixes.

If a hypothesis is right, its frame does not turn over ground, and the equation of `matching` holds in it for as long as
one likes. A tilt turns with the level frame, too, which drifts about the axis of the body that it takes for vertical.
The drift within the interval between two fixes matters little: each interval is turned as a whole.
"""

import math
from typing import Any

from ...kernels.earth import STANDARD_GRAVITY
from ...kernels.jit import kernel
from .matching import SWAY, ZETA, Pair, add_shifted, blend, inner, pick, times, unit
from .state import RATES
from .whitening import follow, innovate, update

RATE_STEP = math.radians(0.35)  # rad/s between hypotheses
SEEN, FELT, FIRST = 0, 1, 2  # products: of what the receiver saw, what was felt, and the first regressor
BENT = 0.1  # rad, of a tilt corrected afterwards: more is not of first order


@kernel
def rate_of(k: int) -> float:
    """Drift rate of hypothesis k, rad/s."""
    return (k - RATES // 2) * RATE_STEP


@kernel
def likely(c: Any) -> int:
    """The hypothesis nearest to what the filter knows of the drift."""
    return int(min(max(RATES // 2 + 0.5 - c.frame_rate / RATE_STEP, 0.0), RATES - 0.5))


@kernel
def turned(c: Any, k: int, ago: float) -> float:
    """Angle, rad, by which the level frame had turned since the origin `ago` s before now, if hypothesis k is right."""
    return float(rate_of(k) * (1e-9 * (c.t_ns - c.origin_ns) - ago) + c.drifted - c.frame_rate * ago)


@kernel
def clear_bank(b: Any) -> None:
    """Forget all that was matched, at the origin of the core's integrals."""
    b.running[:] = 0.0
    b.twice[:] = 0.0
    b.before[:] = 0.0
    b.before_twice[:] = 0.0
    fade(b, 0.0)


@kernel
def fade(b: Any, share: float) -> None:
    """Keep a share of what was matched."""
    b.weight *= share
    b.squares *= share
    b.aged *= share
    b.products *= share


@kernel
def carry_on(c: Any, b: Any, dt: float) -> None:
    """Add the core's integrals over the last `dt` s to those of each hypothesis, turned back."""
    for k in range(RATES):
        turn = unit(turned(c, k, 0.5 * dt))
        for j in range(4):
            old, new = pick(b.before, j), pick(c.running, j)
            once = times(turn, (new[0] - old[0], new[1] - old[1]))
            twice, again = pick(b.before_twice, j), pick(c.twice, j)
            again = times(turn, (again[0] - twice[0] - old[0] * dt, again[1] - twice[1] - old[1] * dt))
            blend(b.twice[k, j], pick(b.running[k], j), dt)
            blend(b.twice[k, j], again, 1.0)
            blend(b.running[k, j], once, 1.0)
    for j in range(4):
        for i in range(2):
            b.before[j, i], b.before_twice[j, i] = c.running[j, i], c.twice[j, i]


@kernel
def rebase(c: Any, b: Any) -> None:
    """Take the corrections as made in all that was matched, and in the integrals.

    That is of first order, so that what was matched before counts the less the more its level frame was tilted. A frame
    that never had the corrections would tilt ever further.
    """
    d = c.shifted
    drifted = times(pick(d, 1), pick(c.running, SWAY))
    then, now = d[0, 0] ** 2 + d[0, 1] ** 2, (d[0, 0] + drifted[0]) ** 2 + (d[0, 1] + drifted[1]) ** 2
    fade(b, math.exp(-max(then, now) / (STANDARD_GRAVITY * BENT) ** 2))
    for k in range(RATES):
        correct_products(b.products[k], d)
        add_shifted(d, b.running[k], ZETA)
        add_shifted(d, b.twice[k], ZETA)
        for state in range(3):
            add_shifted(d, b.followed[k, state], 1 + ZETA)
    add_shifted(d, c.running, ZETA)
    add_shifted(d, c.twice, ZETA)
    add_shifted(d, c.marked, ZETA)
    add_shifted(d, c.marked_twice, ZETA)
    add_shifted(d, c.means, ZETA)
    add_shifted(d, b.before, ZETA)
    add_shifted(d, b.before_twice, ZETA)
    d[:] = 0.0


@kernel
def correct_products(products: Any, d: Any) -> None:
    """As if d times the regressors had been part of what was felt."""
    for i in range(5):
        for j in range(3):
            blend(products[i, FELT], times(pick(d, j), pick(products[i], FIRST + j)), 1.0)
    for i in range(5):
        for j in range(3):
            blend(products[FELT, i], inner(pick(d, j), pick(products[FIRST + j], i)), 1.0)


@kernel
def accumulate(b: Any, k: int, share: float) -> None:
    """Add the products of the innovations in b.left to those of hypothesis k."""
    left = b.left
    for i in range(5):
        for j in range(5):
            blend(b.products[k, i, j], inner(pick(left, i), pick(left, j)), share)


@kernel
def count(b: Any, share: float, age: float) -> None:
    """Count the innovations in b.left, of variance 1 / share, `age` s from the origin."""
    v2 = share * (b.left[SEEN, 0] ** 2 + b.left[SEEN, 1] ** 2)
    b.squares += v2 * v2
    b.aged += v2 * age
    b.weight += 1.0


@kernel
def match(c: Any, b: Any, place: bool, told: Pair, s: float, telling: bool) -> None:
    """Take a place or a velocity, whose innovation has the variance s; match it if it is telling."""
    for k in range(RATES):
        innovate(b, k, place, told)
        if telling:
            accumulate(b, k, 1.0 / s)
        follow(b, k, place, s)
    if telling:
        count(b, 1.0 / s, 1e-9 * (c.t_ns - c.origin_ns))
    update(b, place, s)
