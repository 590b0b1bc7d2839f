"""Heading from motion: velocity changes felt in a level frame of arbitrary heading are matched with the receiver's.

Between fixes k-1 and k the receiver shows dV (from its velocity, or as a difference of mean velocities between three
positions), the integrated level specific force shows dz, both as complex numbers north + i east; dV = exp(i psi) dz.
The least-squares heading of the level frame is psi = arg sum(conj(dz) dV), whatever way the sensor is mounted; means
are removed, because a tilt error adds a constant to dz. A gyro
bias not yet known makes psi drift, so the sum is kept for a bank of drift rates; their likelihoods weigh the answer.

Source: Wu and Pan, Velocity/position integration formula, part I (2013), in the plane; matched-filter bank.
"""

import math
from typing import Any

from ...kernels.earth import radii
from ...kernels.jit import kernel
from ...kernels.kalman import reset
from ...kernels.rotation import dcm_of_quat, quat_exp, quat_of_gravity
from .correction import correct, predicted, row, take, turn_tilt
from .covariance import grow, predict, variance
from .levelling import level_between
from .non_holonomic import stop
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, LEVELLING, NAVIGATING, NEVER_NS, RATES, STATES, TURN_SCALE, WANDER
from .strapdown import cosine, rotate, wrapped

SHORTEST_S, LONGEST_S = 0.9, 3.0  # between two fixes of a pair
MOVED = 0.3  # m/s, a velocity change worth matching
FORGET = 0.97  # per pair
NOISE = 0.15  # m/s, least residual of a pair
CORRELATED = 1.5**2  # residuals of neighbouring pairs are not independent
FITTED = 3.0  # north and east mean, heading
READY = math.radians(11.0)
HORIZON_S = 8.0  # for which the heading has to stay known
PAIRS = 5.0
COHERENCE = 0.6
UNEQUAL = 0.25  # least ratio of the squares of felt and received changes
RATE_STEP = math.radians(0.35)  # rad/s between hypotheses
LEAST_HEADING = math.radians(3.0)
START_TILT = math.radians(1.0)
LOST_TILT = math.radians(20.0)
LEVELLED = math.radians(6.0)


@kernel
def feel(c: Any, dvn: float, dve: float, dt: float) -> None:
    """Add the level specific force of one interval, in the frame of arbitrary heading."""
    c.path[0] += (c.zeta[0] + 0.5 * dvn) * dt
    c.path[1] += (c.zeta[1] + 0.5 * dve) * dt
    c.zeta[0] += dvn
    c.zeta[1] += dve


@kernel
def mark(c: Any, lat: float, lon: float, vn: float, ve: float) -> None:
    """Remember this fix as the first of the next pair."""
    c.mark_ns = c.t_ns
    m = c.mark
    m[0], m[1], m[2], m[3], m[4], m[5] = c.zeta[0], c.zeta[1], c.path[0], c.path[1], vn, ve
    m[6], m[7] = lat, lon


@kernel
def levelled(c: Any) -> bool:
    """Whether roll and pitch are known well enough to navigate."""
    return max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1)) < LEVELLED**2


@kernel
def add(c: Any, zn: float, ze: float, vn: float, ve: float, dt: float) -> None:
    """Take one pair of changes over `dt` s: felt (zn, ze), received (vn, ve)."""
    if c.phase == LEVELLING:
        level_between(c, zn / dt, ze / dt, dt, math.hypot(vn, ve) / dt)
    z2 = zn * zn + ze * ze
    v2 = vn * vn + ve * ve
    if max(z2, v2) < MOVED**2 or not levelled(c):
        return
    if c.phase != LEVELLING and not UNEQUAL * v2 < z2 < v2 / UNEQUAL:  # a bad fix, whatever the heading
        return
    if c.pairs == 0.0:
        c.origin_ns = c.t_ns
    age = 1e-9 * (c.t_ns - c.origin_ns)
    for k in range(RATES):
        drift = (k - RATES // 2) * RATE_STEP * age
        si, co = math.sin(drift), math.cos(drift)
        a, b = co * vn + si * ve, co * ve - si * vn  # the velocity change, turned back
        c.match[k, 0] = FORGET * c.match[k, 0] + zn * a + ze * b
        c.match[k, 1] = FORGET * c.match[k, 1] + zn * b - ze * a
        c.seen[k, 0] = FORGET * c.seen[k, 0] + a
        c.seen[k, 1] = FORGET * c.seen[k, 1] + b
    c.felt[0] = FORGET * c.felt[0] + zn
    c.felt[1] = FORGET * c.felt[1] + ze
    c.pairs = FORGET * c.pairs + 1.0
    c.energy[0] = FORGET * c.energy[0] + z2
    c.energy[1] = FORGET * c.energy[1] + v2


@kernel
def correlation(c: Any, k: int) -> tuple[float, float, float]:
    """Of drift hypothesis k: sum conj(dz) dV without the means (a tilt adds a constant to dz), and energy of dV so."""
    n = c.pairs
    re = c.match[k, 0] - (c.felt[0] * c.seen[k, 0] + c.felt[1] * c.seen[k, 1]) / n
    im = c.match[k, 1] - (c.felt[0] * c.seen[k, 1] - c.felt[1] * c.seen[k, 0]) / n
    return re, im, c.energy[1] - (c.seen[k, 0] ** 2 + c.seen[k, 1] ** 2) / n


@kernel
def pair(c: Any, lat: float, lon: float, vn: float, ve: float) -> None:
    """A fix at the core's time, with its velocity (NaN when it has none)."""
    dt = 1e-9 * (c.t_ns - c.mark_ns)
    if dt < SHORTEST_S:
        return
    m = c.mark
    meridian, prime_vertical = radii(c.lat)
    north = (lat - m[6]) * (meridian + c.height)
    east = wrapped(lon - m[7]) * (prime_vertical + c.height) * cosine(c.lat)
    if dt > LONGEST_S:
        c.slope[4] = 0.0
    elif math.isfinite(vn) and math.isfinite(m[4]):
        add(c, c.zeta[0] - m[0], c.zeta[1] - m[1], vn - m[4], ve - m[5], dt)
    else:
        zn, ze = (c.path[0] - m[2]) / dt, (c.path[1] - m[3]) / dt
        s = c.slope
        if s[4] > 0.0:
            add(c, zn - s[2], ze - s[3], north / dt - s[0], east / dt - s[1], dt)
        s[0], s[1], s[2], s[3], s[4] = north / dt, east / dt, zn, ze, 1.0
    mark(c, lat, lon, vn, ve)


@kernel
def vertical_bias(c: Any) -> int:
    """Put the gyro bias about the vertical into the measurement row; returns its length."""
    m = dcm_of_quat((c.q[0], c.q[1], c.q[2], c.q[3]))
    k = 0
    for i in range(3):
        k = row(c, k, GYRO_BIAS + i, m[6 + i])
    return k


@kernel
def solve(c: Any, bias_variance: float) -> tuple[float, float, float, float]:
    """Heading of the level frame now, its sigma (pi when not ready), and its drift rate with its variance."""
    unknown = (0.0, math.pi, 0.0, 0.0)
    if c.pairs < PAIRS * 0.9:
        return unknown
    z2 = c.energy[0] - (c.felt[0] ** 2 + c.felt[1] ** 2) / c.pairs
    least, coherent = math.inf, 0.0
    for k in range(RATES):
        re, im, v2 = correlation(c, k)
        size = math.hypot(re, im)
        coherent = max(coherent, size * size / max(z2 * v2, 1e-9))
        least = min(least, z2 + v2 - 2.0 * size)
    if coherent < COHERENCE or z2 < PAIRS * MOVED**2:
        return unknown
    r = CORRELATED * max(least / (2.0 * c.pairs - FITTED), NOISE**2)
    age = 1e-9 * (c.t_ns - c.origin_ns)
    weight, sr, si, rate, rate2 = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(RATES):
        drift = (k - RATES // 2) * RATE_STEP
        re, im, v2 = correlation(c, k)
        misfit = z2 + v2 - 2.0 * math.hypot(re, im) - least
        w = math.exp(-0.5 * misfit / r - 0.5 * drift * drift / (bias_variance + RATE_STEP**2 / 12.0))
        psi = math.atan2(im, re) + drift * age
        weight += w
        sr += w * math.cos(psi)
        si += w * math.sin(psi)
        rate += w * drift
        rate2 += w * drift * drift
    rate /= weight
    length = min(math.hypot(sr, si) / weight, 1.0)
    spread = math.sqrt(-2.0 * math.log(max(length, 1e-9)))
    sigma = math.sqrt(r / z2 + spread * spread)
    return math.atan2(si, sr), sigma, rate, max(rate2 / weight - rate * rate, 0.0) + RATE_STEP**2 / 12.0


@kernel
def turn_north(c: Any, psi: float) -> None:
    """Turn the level frame by psi about down, and the roll and pitch errors, given in it, with it."""
    rotate(c, quat_exp(0.0, 0.0, 0.0), 0.0, 0.0, psi)
    turn_tilt(c, psi)


@kernel
def find_heading(c: Any) -> bool:
    """Turn the level frame to north when the pairs tell how; its sigma goes to c.heading_sigma."""
    k = vertical_bias(c)
    psi, sigma, rate, rate_variance = solve(c, predicted(c, k))
    if sigma * sigma + rate_variance * HORIZON_S**2 > READY**2:
        return False
    take(c, vertical_bias(c), -rate, rate_variance, 0.0)
    c.x[ATTITUDE + 2] = 0.0
    correct(c)
    turn_north(c, psi)
    c.heading_sigma = max(sigma, LEAST_HEADING)
    return True


@kernel
def forget_pairs(c: Any) -> None:
    """Begin to match anew."""
    c.pairs = 0.0
    c.turned = 0.0
    c.astray = 0
    c.energy[:] = 0.0
    c.felt[:] = 0.0
    c.seen[:] = 0.0
    c.match[:] = 0.0


@kernel
def engage(p: Any, c: Any) -> None:
    """Begin to navigate, at the position and velocity in hand, with the heading in hand and its sigma."""
    predict(p, c)
    reset(c.P, STATES, ATTITUDE + 2, c.heading_sigma**2)
    grow(c, ATTITUDE, START_TILT**2)
    grow(c, ATTITUDE + 1, START_TILT**2)
    c.phase = NAVIGATING
    forget_pairs(c)


@kernel
def forget_attitude(c: Any) -> None:
    """Back to levelling: nothing is known of roll, pitch and heading."""
    c.phase = LEVELLING
    c.heading_sigma = 0.0
    stop(c)
    c.mark_ns = NEVER_NS
    c.slope[4] = 0.0
    forget_pairs(c)
    q = quat_of_gravity(c.f[0], c.f[1], c.f[2] - 1e-3)
    c.q[0], c.q[1], c.q[2], c.q[3] = q
    for i in range(3):
        reset(c.P, STATES, ATTITUDE + i, LOST_TILT**2 if i < 2 else math.pi**2)


@kernel
def forget_heading(p: Any, c: Any) -> None:
    """Back to levelling: the heading was wrong, and what was learned with it."""
    forget_attitude(c)
    for i in range(3):
        c.bg[i] = 0.0
        c.ba[i] = 0.0
        c.wander[i] = 0.0
        c.turn_scale[i] = 0.0
        reset(c.P, STATES, GYRO_BIAS + i, p.gyro_initial**2)
        reset(c.P, STATES, ACCEL_BIAS + i, p.accel_initial**2)
        reset(c.P, STATES, TURN_SCALE + i, p.gyro_scale**2)
        reset(c.P, STATES, WANDER + i, c.reported[0 if i < 2 else 1] ** 2)
