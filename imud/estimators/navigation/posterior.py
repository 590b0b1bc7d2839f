"""The heading that the pairs of `matching` tell, with tilt and biases marginalized out under their prior."""

import math
from typing import Any

from ...kernels.earth import STANDARD_GRAVITY
from ...kernels.jit import kernel
from ...kernels.rotation import dcm_of_quat
from .correction import predicted, row
from .matching import FITTED, RATE_STEP, SWAY, Pair, inner, rate_of, rebase, times, unit
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, RATES
from .strapdown import wrapped

EVENTS = 3.0, 2.0  # innovations with motion, at least; and so many more where the gyro's drift is not known at all
CORRELATED = 1.5  # what is left over of neighbouring innovations is not quite independent
ANY_TILT = 0.3  # m/s^2, where the filter's covariance is not to be believed


@kernel
def nuisance(c: Any, m: Any, i: int) -> int:
    """Row of component i (even: real) of tilt, level gyro bias and accelerometer bias, each as it acts on the force."""
    axis = i % 2
    if i < 2:
        return row(c, 0, ATTITUDE + 1 - axis, (2 * axis - 1) * STANDARD_GRAVITY)
    k = 0
    for j in range(3):
        if i < 4:
            k = row(c, k, GYRO_BIAS + j, (1 - 2 * axis) * STANDARD_GRAVITY * m[3 * (1 - axis) + j])
        else:
            k = row(c, k, ACCEL_BIAS + j, -m[3 * axis + j])
    return k


@kernel
def believe(c: Any) -> None:
    """c.prior <- their covariance (3 x 3, complex) as the filter has it, taken as equal in all directions."""
    m = dcm_of_quat((c.q[0], c.q[1], c.q[2], c.q[3]))
    c.prior[:] = 0.0
    for j in range(6):
        predicted(c, nuisance(c, m, j))
        for i in range(6):
            n = nuisance(c, m, i)
            s = 0.0
            for k in range(n):
                s += c.values[k] * c.d[c.columns[k]]
            if i % 2 == j % 2:
                c.prior[i // 2, j // 2, 0] += 0.5 * s
            else:
                c.prior[i // 2, j // 2, 1] += 0.5 * s if i % 2 == 1 else -0.5 * s


@kernel
def disbelieve(c: Any, accel_initial: float) -> None:
    """c.prior <- what is known of tilt and accelerometer bias before anything was learned."""
    believe(c)
    gyro = c.prior[1, 1, 0]
    c.prior[:] = 0.0
    c.prior[0, 0, 0], c.prior[1, 1, 0], c.prior[2, 2, 0] = ANY_TILT**2, gyro, accel_initial**2


@kernel
def bring_back(c: Any) -> None:
    """Carry c.prior from tilt and biases now, in level axes, over to those at the origin of the running integrals."""
    frame = unit(c.frame)
    body = times(frame, (c.swing[0], -c.swing[1]))
    sway = (c.running[SWAY, 0], c.running[SWAY, 1])
    s = c.prior
    for k in range(3):  # rows
        for j in range(3):
            p = times(frame if j == 0 else body, (s[j, k, 0], s[j, k, 1]))
            s[j, k, 0], s[j, k, 1] = p[0], p[1]
        p = times(sway, (s[1, k, 0], s[1, k, 1]))
        s[0, k, 0] -= p[0]
        s[0, k, 1] -= p[1]
    for j in range(3):  # columns, conjugated
        for k in range(3):
            p = inner(frame if k == 0 else body, (s[j, k, 0], s[j, k, 1]))
            s[j, k, 0], s[j, k, 1] = p[0], p[1]
        p = inner(sway, (s[j, 1, 0], s[j, 1, 1]))
        s[j, 0, 0] -= p[0]
        s[j, 0, 1] -= p[1]


@kernel
def invert(a: Any) -> None:
    """a <- its inverse (3 x 3, complex, Gauss-Jordan; for what has a dominant diagonal by construction)."""
    for i in range(3):
        size = a[i, i, 0] ** 2 + a[i, i, 1] ** 2
        pivot = (a[i, i, 0] / size, -a[i, i, 1] / size)
        a[i, i, 0], a[i, i, 1] = 1.0, 0.0
        for k in range(3):
            p = times(pivot, (a[i, k, 0], a[i, k, 1]))
            a[i, k, 0], a[i, k, 1] = p[0], p[1]
        for j in range(3):
            if j != i:
                f = (a[j, i, 0], a[j, i, 1])
                a[j, i, 0], a[j, i, 1] = 0.0, 0.0
                for k in range(3):
                    p = times(f, (a[i, k, 0], a[i, k, 1]))
                    a[j, k, 0] -= p[0]
                    a[j, k, 1] -= p[1]


@kernel
def eliminate(c: Any) -> None:
    """c.gain <- (N + S^-1)^-1 = S (N S + 1)^-1, with N the normal matrix of the nuisance parameters and S c.prior."""
    bring_back(c)
    s, n, g = c.prior, c.normal, c.inverse
    for j in range(3):
        for k in range(3):
            g[j, k, 0], g[j, k, 1] = 1.0 if j == k else 0.0, 0.0
            for i in range(3):
                p = times((n[j, i, 0], n[j, i, 1]), (s[i, k, 0], s[i, k, 1]))
                g[j, k, 0] += p[0]
                g[j, k, 1] += p[1]
    invert(g)
    for j in range(3):
        for k in range(3):
            c.gain[j, k, 0], c.gain[j, k, 1] = 0.0, 0.0
            for i in range(3):
                p = times((s[j, i, 0], s[j, i, 1]), (g[i, k, 0], g[i, k, 1]))
                c.gain[j, k, 0] += p[0]
                c.gain[j, k, 1] += p[1]


@kernel
def form(a: Any, matrix: Any, b: Any) -> Pair:
    """a' M b, a conjugated."""
    re, im = 0.0, 0.0
    for j in range(3):
        for k in range(3):
            p = inner((a[j, 0], a[j, 1]), times((matrix[j, k, 0], matrix[j, k, 1]), (b[k, 0], b[k, 1])))
            re += p[0]
            im += p[1]
    return re, im


@kernel
def correlation(c: Any, k: int) -> tuple[float, float, float, float]:
    """Of drift hypothesis k: sum conj(dz) dV, energies of both, all without what the nuisance parameters explain."""
    drift = rate_of(k)
    for j in range(3):
        for i in range(2):
            c.drifting[j, i] = c.felt[j, i] + drift * c.smeared[j, i]
    explained = form(c.drifting, c.gain, c.seen[k])
    z2 = c.energy[0] + drift * (c.smear[0] + drift * c.smear[1]) - form(c.drifting, c.gain, c.drifting)[0]
    v2 = c.energy[1] - form(c.seen[k], c.gain, c.seen[k])[0]
    return c.match[k, 0] - explained[0], c.match[k, 1] - explained[1], float(z2), float(v2)


@kernel
def solve(c: Any, bias_variance: float) -> tuple[float, float, float, float, float]:
    """Heading of the level frame now, its sigma (pi when not ready), its drift rate, that one's variance, covariance.

    Call with the prior in c.prior. The rate is that which the filter does not know of.
    """
    unknown = (0.0, math.pi, 0.0, 0.0, 0.0)
    age = 1e-9 * (c.t_ns - c.origin_ns)
    events = EVENTS[0] + EVENTS[1] * min(bias_variance * age * age, 1.0)
    if c.weight <= FITTED or c.energy[1] ** 2 < events * c.squares:
        return unknown
    rebase(c)
    eliminate(c)
    least, power = math.inf, 0.0
    for k in range(RATES):
        re, im, z2, v2 = correlation(c, k)
        misfit = z2 + v2 - 2.0 * math.hypot(re, im)
        if misfit < least:
            least, power = misfit, min(z2, math.hypot(re, im))
    if power < 1.0:
        return unknown
    r = CORRELATED * max(least / (2.0 * c.weight - FITTED), 1.0)
    frame = c.frame + c.drifted
    mean = c.aged / c.energy[1]  # age of what tells most: the heading of then is known best
    between = RATE_STEP**2 / 12.0  # hypotheses
    inside = bias_variance * between / (bias_variance + between)
    weight, sr, si, rate, rate2 = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(RATES):
        drift = rate_of(k)
        re, im, z2, v2 = correlation(c, k)
        misfit = z2 + v2 - 2.0 * math.hypot(re, im) - least
        apart = drift + c.frame_rate
        w = math.exp(-0.5 * misfit / r - 0.5 * apart**2 / (bias_variance + between))
        unforeseen = apart * inside / between
        psi = math.atan2(im, re) + drift * mean + (unforeseen - c.frame_rate) * (age - mean) + frame
        c.headings[k, 0], c.headings[k, 1], c.headings[k, 2] = psi, w, unforeseen
        weight += w
        sr += w * math.cos(psi)
        si += w * math.sin(psi)
        rate += w * unforeseen
        rate2 += w * unforeseen**2
    if not weight > 0.0:
        return unknown
    rate /= weight
    length = min(math.hypot(sr, si) / weight, 1.0)
    spread2 = -2.0 * math.log(max(length, 1e-9)) + (age - mean) ** 2 * inside
    psi, together = math.atan2(si, sr), 0.0
    for k in range(RATES):
        together += c.headings[k, 1] * wrapped(c.headings[k, 0] - psi) * (c.headings[k, 2] - rate)
    variance = max(rate2 / weight - rate * rate, 0.0) + inside
    return psi, math.sqrt(r / power + spread2), rate, variance, together / weight + (age - mean) * inside
