"""Heading from motion: what the accelerometer felt is matched with the velocity changes that the receiver saw.

In a level frame of arbitrary heading the strapdown integrates specific force to dz. Between two fixes the receiver
shows dV, and as complex numbers, north + i east,

    exp(-i psi) dV = dz + x1 dt + x2 GG + x3 G,   G = integral of exp(i y), GG = integral of G,

with psi the heading sought, and of what the level frame does not know x1, a tilt (turned into force by gravity); x2, a
level gyro bias, which tilts it ever further; x3, an accelerometer bias. The biases turn with the body, whose heading in
the frame is y. All three have the filter's covariance as their prior, so that pairs from before a rest are worth as
much as it has told since. The filter corrects attitude and biases on the way; dz is kept as if it never had (`shift`),
and what has been corrected is the prior's mean. The vertical gyro bias makes psi drift: the sums are kept for a bank of
drift rates, whose likelihoods weigh the answer (`posterior`).

Source: Wu and Pan, Velocity/position integration formula, part I (2013), in the plane; Schweppe, Uncertain Dynamic
Systems (1973), ch. 6, for nuisance parameters with a prior; matched-filter bank.
"""

import math
from typing import Any

from ...kernels.earth import STANDARD_GRAVITY
from ...kernels.jit import kernel
from ...kernels.rotation import dcm_of_quat
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, RATES

Pair = tuple[float, float]  # a complex number

BENT = 0.1  # rad, of a tilt corrected afterwards: more is not of first order
LONGEST_S = 30.0  # a force felt longer ago shows in no innovation
FITTED = 3.0  # heading, and what the nuisance parameters take
RATE_STEP = math.radians(0.35)  # rad/s between hypotheses
ZETA, TIME, TILTING, SWAY, AGED = range(5)  # running integrals: of force, of 1, of G, G, and of force times age


@kernel
def times(a: Pair, b: Pair) -> Pair:
    """a b"""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


@kernel
def inner(a: Pair, b: Pair) -> Pair:
    """conj(a) b"""
    return a[0] * b[0] + a[1] * b[1], a[0] * b[1] - a[1] * b[0]


@kernel
def unit(angle: float) -> Pair:
    """exp(i angle)"""
    return math.cos(angle), math.sin(angle)


@kernel
def feel(c: Any, turn: float, dt: float) -> None:
    """Add the level specific force gathered in c.dv over `dt` s, in which the body turned at `turn` rad/s."""
    total, twice, d = c.running, c.twice, c.shifted
    y, sway = (c.swing[0], c.swing[1]), (total[SWAY, 0], total[SWAY, 1])
    force = times(unit(c.frame), (c.dv[0], c.dv[1]))
    tilted, biased = times((d[1, 0], d[1, 1]), sway), times((d[2, 0], d[2, 1]), y)
    after = times(unit(turn * dt), y)
    age = 1e-9 * (c.t_ns - c.ages_ns)
    zn, ze = force[0] - (d[0, 0] + tilted[0] + biased[0]) * dt, force[1] - (d[0, 1] + tilted[1] + biased[1]) * dt
    new = ((zn, ze), (dt, 0.0), (sway[0] * dt, sway[1] * dt), (y[0] * dt, y[1] * dt), (zn * age, ze * age))
    for k in range(5):
        for i in range(2):
            twice[k, i] += (total[k, i] + 0.5 * new[k][i]) * dt
            total[k, i] += new[k][i]
    c.swing[0], c.swing[1] = after
    c.drifted += c.frame_rate * dt


@kernel
def shift(c: Any) -> None:
    """Before the corrections in c.x are applied: keep the running integrals as if they were not."""
    x, d = c.x, c.shifted
    m = dcm_of_quat((c.q[0], c.q[1], c.q[2], c.q[3]))
    gyro = (x[GYRO_BIAS], x[GYRO_BIAS + 1], x[GYRO_BIAS + 2])
    accel = (x[ACCEL_BIAS], x[ACCEL_BIAS + 1], x[ACCEL_BIAS + 2])
    frame = unit(c.frame)
    body = times(frame, (c.swing[0], -c.swing[1]))
    tilt = times(frame, (-STANDARD_GRAVITY * x[ATTITUDE + 1], STANDARD_GRAVITY * x[ATTITUDE]))
    drift = times(body, (STANDARD_GRAVITY * along(m, 1, gyro), -STANDARD_GRAVITY * along(m, 0, gyro)))
    bias = times(body, (-along(m, 0, accel), -along(m, 1, accel)))
    since = times(drift, (c.running[SWAY, 0], c.running[SWAY, 1]))
    for i in range(2):
        d[0, i] += tilt[i] - since[i]
        d[1, i] += drift[i]
        d[2, i] += bias[i]
    c.frame -= x[ATTITUDE + 2]
    c.frame_rate += along(m, 2, gyro)


@kernel
def along(m: Any, axis: int, v: Any) -> float:
    """Component of the body vector v along an axis of the level frame, by the direction cosines m."""
    return float(m[3 * axis] * v[0] + m[3 * axis + 1] * v[1] + m[3 * axis + 2] * v[2])


@kernel
def clear_matching(c: Any) -> None:
    """Forget all pairs, and begin with the level frame as it is."""
    c.weight = c.squares = c.aged = 0.0
    c.frame = c.frame_rate = c.drifted = 0.0
    c.running[:] = 0.0
    c.twice[:] = 0.0
    c.shifted[:] = 0.0
    c.swing[0], c.swing[1] = 1.0, 0.0
    c.energy[:] = 0.0
    c.smear[:] = 0.0
    c.normal[:] = 0.0
    c.felt[:] = 0.0
    c.smeared[:] = 0.0
    c.match[:] = 0.0
    c.seen[:] = 0.0
    c.origin_ns = c.ages_ns = c.t_ns


@kernel
def add_shifted(c: Any, a: Any, first: int) -> None:
    """Element `first` of a += what was corrected, times the three elements after it."""
    for j in range(3):
        p = times((c.shifted[j, 0], c.shifted[j, 1]), (a[first + 1 + j, 0], a[first + 1 + j, 1]))
        a[first, 0] += p[0]
        a[first, 1] += p[1]


@kernel
def count_ages_from_now(c: Any) -> None:
    """Shift the integral of force times its age, so that it stays small: what was felt long ago tells nothing now."""
    dt = 1e-9 * (c.t_ns - c.ages_ns)
    c.ages_ns = c.t_ns
    for i in range(2):
        c.running[AGED, i] -= dt * c.running[ZETA, i]
        c.twice[AGED, i] -= dt * c.twice[ZETA, i]
        for state in range(3):
            c.followed[state, 1 + AGED, i] -= dt * c.followed[state, 1 + ZETA, i]


@kernel
def rebase(c: Any) -> None:
    """Take the corrections as made in all that was matched, and in the integrals.

    That is of first order, so that what was matched before counts the less the more its level frame was tilted. A frame
    that never had the corrections would tilt ever further.
    """
    count_ages_from_now(c)
    d, mixed = c.shifted, (0.0, 0.0)
    drifted = times((d[1, 0], d[1, 1]), (c.running[SWAY, 0], c.running[SWAY, 1]))
    then, now = d[0, 0] ** 2 + d[0, 1] ** 2, (d[0, 0] + drifted[0]) ** 2 + (d[0, 1] + drifted[1]) ** 2
    fade(c, math.exp(-max(then, now) / (STANDARD_GRAVITY * BENT) ** 2))
    for j in range(3):
        dj, before = (d[j, 0], d[j, 1]), inner((d[j, 0], d[j, 1]), (c.felt[j, 0], c.felt[j, 1]))
        for k in range(3):
            p = times((c.normal[j, k, 0], c.normal[j, k, 1]), (d[k, 0], d[k, 1]))
            c.felt[j, 0] += p[0]
            c.felt[j, 1] += p[1]
        after = inner(dj, (c.felt[j, 0], c.felt[j, 1]))
        mixed = (mixed[0] + before[0], mixed[1] + after[0])
        c.smear[0] += 2.0 * inner(dj, (c.smeared[j, 0], c.smeared[j, 1]))[0]
        for k in range(RATES):
            p = inner(dj, (c.seen[k, j, 0], c.seen[k, j, 1]))
            c.match[k, 0] += p[0]
            c.match[k, 1] += p[1]
    c.energy[0] += mixed[0] + mixed[1]  # |z + d u|^2 = |z|^2 + d' (u' z) + d' (u' z + u' u d)
    add_shifted(c, c.running, ZETA)
    add_shifted(c, c.twice, ZETA)
    add_shifted(c, c.marked, ZETA)
    add_shifted(c, c.marked_twice, ZETA)
    add_shifted(c, c.means, ZETA)
    for state in range(3):
        add_shifted(c, c.followed[state], 1 + ZETA)
    d[:] = 0.0


@kernel
def fade(c: Any, share: float) -> None:
    """Keep a share of what was matched."""
    c.weight *= share
    c.squares *= share
    c.aged *= share
    c.energy *= share
    c.smear *= share
    c.normal *= share
    c.felt *= share
    c.smeared *= share
    c.match *= share
    c.seen *= share


@kernel
def blend(sums: Any, new: Pair, share: float) -> None:
    """Add to a sum."""
    sums[0] += share * new[0]
    sums[1] += share * new[1]


@kernel
def mean_age(c: Any) -> float:
    """Seconds from the origin to when the force was felt that the innovations in c.left tell of, in the mean."""
    z, aged, now = c.left[1 + ZETA], c.left[1 + AGED], 1e-9 * (c.t_ns - c.origin_ns)
    z2 = z[0] ** 2 + z[1] ** 2
    ago = (z[0] * aged[0] + z[1] * aged[1]) / z2 if z2 > 0.0 else 0.0
    return float(now + min(max(ago, -LONGEST_S), 0.0))


@kernel
def innovation(c: Any, k: int) -> Pair:
    """One of those in c.left."""
    return c.left[k, 0], c.left[k, 1]


@kernel
def rate_of(k: int) -> float:
    """Drift rate of hypothesis k, rad/s."""
    return (k - RATES // 2) * RATE_STEP


@kernel
def accumulate(c: Any, s: float, age: float) -> None:
    """Match the innovations in c.left (received, felt, three regressors), of variance s, `age` s from the origin.

    What was felt around then was turned by the drift from then on: of first order, dz changes by the drift rate times
    `late`.
    """
    seen, z, share = innovation(c, 0), innovation(c, 1), 1.0 / s
    ago, aged = 1e-9 * (c.t_ns - c.origin_ns) - age, innovation(c, 1 + AGED)
    late = -aged[1] - ago * z[1], aged[0] + ago * z[0]
    z = z[0] + c.frame_rate * late[0], z[1] + c.frame_rate * late[1]
    for j in range(3):
        blend(c.felt[j], inner(innovation(c, 2 + j), z), share)
        blend(c.smeared[j], inner(innovation(c, 2 + j), late), share)
        for k in range(3):
            blend(c.normal[j, k], inner(innovation(c, 2 + j), innovation(c, 2 + k)), share)
    turned = c.drifted - c.frame_rate * ago
    for k in range(RATES):
        drift = rate_of(k)
        v = times(unit(-drift * age - turned), seen)  # turned back
        blend(c.match[k], inner((z[0] + drift * late[0], z[1] + drift * late[1]), v), share)
        for j in range(3):
            blend(c.seen[k, j], inner(innovation(c, 2 + j), v), share)
    v2 = seen[0] ** 2 + seen[1] ** 2
    blend(c.energy, (z[0] ** 2 + z[1] ** 2, v2), share)
    blend(c.smear, (2.0 * inner(z, late)[0], inner(late, late)[0]), share)
    c.squares += (share * v2) ** 2
    c.aged += share * v2 * age
    c.weight += 1.0
