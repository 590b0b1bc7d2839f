"""Does the receiver creep away? A constant velocity that its positions had, and the vehicle had not, since some moment.

A filter that is not told of the receiver's velocity follows such positions: each of them is within its gate. But what
creeping at 1 m/s would do to the estimate, and to every innovation, follows from the filter's own gains. So for some
moments at which it may have begun, that pull is carried along, and the creeping velocity is estimated from the
innovations by least squares. When it is certainly not nothing, the estimate is put back to where it had been without,
as unsure as that velocity is, and the positions are refused (see `admission`).

How far a receiver's positions wander is not what it reports: what this one has seemed to creep in earlier times
is the measure.

Source: Friedland, Treatment of bias in recursive filtering (1969); Willsky and Jones, A generalized likelihood ratio
approach to the detection and estimation of jumps in linear systems (1976).
"""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import packed_index
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, MOMENTS, NEVER_NS, POSITION, STATES, TURN_SCALE, VELOCITY, WANDER

EVERY_S = 12.0  # between the moments
LEAST_S, LEAST_FIXES = 5.0, 4
LEAST_CREEP = 0.05  # m/s, what a velocity may be wrong by without knowing it
CERTAIN = 30.0  # chi squared of two degrees of freedom: once in three million
RESTLESS = (1.25, 2.0, 10.0)  # least, first and most square of wander as it has seemed over wander as reported
FIRST_WEIGHT, RESTLESS_MEMORY = 5.0, 0.05  # windows; per window


@kernel
def forget_creep(c: Any) -> None:
    """Begin anew, with the receiver trusted."""
    c.creeping = 0
    c.seemed = 0.0
    for j in range(MOMENTS):
        c.since_ns[j] = NEVER_NS


@kernel
def proven(c: Any) -> bool:
    """Have estimate and receiver agreed for as long as it takes to let every moment begin?"""
    return bool(min(c.since_ns[0], c.since_ns[1], c.since_ns[2]) != NEVER_NS)


@kernel
def suppose(c: Any, j: int) -> None:
    """Let moment j be now."""
    c.since_ns[j] = c.t_ns
    c.supposed_n[j] = 0
    for i in range(2):
        c.evidence_creep[j, i] = 0.0
    for i in range(3):
        c.information[j, i] = 0.0
    for i in range(STATES):
        c.pull[i, 2 * j] = 0.0
        c.pull[i, 2 * j + 1] = 0.0


@kernel
def carry_pull(c: Any, m: Any, angle: float, dt: float, decay: float) -> None:
    """Propagate the pull as `predict` does errors: `m` is body to NED, `angle` the turn about the vertical."""
    u, f = c.pull, c.dv
    for i in range(3):
        for j in range(2 * MOMENTS):
            u[POSITION + i, j] += dt * u[VELOCITY + i, j]
    for j in range(2 * MOMENTS):
        x, y, z = u[ATTITUDE, j], u[ATTITUDE + 1, j], u[ATTITUDE + 2, j]
        u[VELOCITY, j] += f[2] * y - f[1] * z
        u[VELOCITY + 1, j] += f[0] * z - f[2] * x
        u[VELOCITY + 2, j] += f[1] * x - f[0] * y
    for i in range(3):
        for k in range(3):
            a = m[3 * i + k] * dt
            for j in range(2 * MOMENTS):
                u[VELOCITY + i, j] -= a * u[ACCEL_BIAS + k, j]
                u[ATTITUDE + i, j] -= a * u[GYRO_BIAS + k, j] + m[3 * i + k] * angle * u[TURN_SCALE + k, j]
        for j in range(2 * MOMENTS):
            u[WANDER + i, j] *= decay


@kernel
def follow_pull(c: Any, m: int, s: float, z: float, axis: int) -> None:
    """A row of length m with innovation z, variance s and P h in c.d is about to be taken: of position `axis`, or -1.

    Call before the covariance is changed.
    """
    for j in range(MOMENTS):
        if c.since_ns[j] == NEVER_NS:
            continue
        first = 2 * j
        north, east = 0.0, 0.0
        for k in range(m):
            north -= c.values[k] * c.pull[c.columns[k], first]
            east -= c.values[k] * c.pull[c.columns[k], first + 1]
        if axis >= 0:
            since = 1e-9 * (c.t_ns - c.since_ns[j])
            if axis == 0:
                north += since
            else:
                east += since
            c.evidence_creep[j, 0] += north * z / s
            c.evidence_creep[j, 1] += east * z / s
            c.information[j, 0] += north * north / s
            c.information[j, 1] += north * east / s
            c.information[j, 2] += east * east / s
            c.supposed_n[j] += 1
        for i in range(STATES):
            gain = c.d[i] / s
            c.pull[i, first] += gain * north
            c.pull[i, first + 1] += gain * east


@kernel
def estimate(c: Any, j: int, restless: float) -> Any:
    """Velocity north and east that the receiver has crept with since moment j, its covariance, and chi squared."""
    nn, ne, ee = c.information[j, 0], c.information[j, 1], c.information[j, 2]
    determinant = nn * ee - ne * ne
    if not determinant > 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    pnn, pne, pee = ee / determinant, -ne / determinant, nn / determinant
    vn = pnn * c.evidence_creep[j, 0] + pne * c.evidence_creep[j, 1]
    ve = pne * c.evidence_creep[j, 0] + pee * c.evidence_creep[j, 1]
    pnn, pne, pee = restless * pnn + LEAST_CREEP**2, restless * pne, restless * pee + LEAST_CREEP**2
    determinant = pnn * pee - pne * pne
    chi2 = (pee * vn * vn - 2.0 * pne * vn * ve + pnn * ve * ve) / determinant
    return vn, ve, pnn, pne, pee, chi2


@kernel
def put_back(c: Any, j: int, found: Any) -> None:
    """Take out of the estimate (gather in c.x) what creeping as found since moment j has done to it."""
    vn, ve, pnn, pne, pee = found[0], found[1], found[2], found[3], found[4]
    u, first = c.pull, 2 * j
    for i in range(STATES):
        c.x[i] -= u[i, first] * vn + u[i, first + 1] * ve
        a = pnn * u[i, first] + pne * u[i, first + 1]
        b = pne * u[i, first] + pee * u[i, first + 1]
        for k in range(i, STATES):
            c.P[packed_index(STATES, i, k)] += a * u[k, first] + b * u[k, first + 1]


@kernel
def learn_restlessness(c: Any, seen: float) -> None:
    """A receiver that has not been found to creep has seemed to, by `seen` times the variance expected.

    What was seen the time before is learned: what is seen now may yet be found to be creeping.
    """
    seen, c.seemed = c.seemed, seen
    if not seen > 0.0:
        return
    c.supposed += 1
    share = max(RESTLESS_MEMORY, 1.0 / (FIRST_WEIGHT + c.supposed))
    c.restless = max(c.restless + share * (min(seen, RESTLESS[2]) - c.restless), RESTLESS[0])


@kernel
def look_for_creep(c: Any) -> bool:
    """After a position was taken: does the receiver creep? Then the correction to put back is in c.x."""
    best, worst, oldest, youngest_s = 0, 0.0, 0, math.inf
    for j in range(MOMENTS):
        age = math.inf if c.since_ns[j] == NEVER_NS else 1e-9 * (c.t_ns - c.since_ns[j])
        if c.since_ns[j] < c.since_ns[oldest]:
            oldest = j
        youngest_s = min(youngest_s, age)
        if LEAST_S < age < math.inf and c.supposed_n[j] >= 2 * LEAST_FIXES:
            chi2 = estimate(c, j, c.restless)[5]
            if chi2 > worst:
                best, worst = j, chi2
    if worst > CERTAIN and proven(c):
        put_back(c, best, estimate(c, best, c.restless))
        forget_creep(c)
        c.creeping = 1
        return True
    if youngest_s >= EVERY_S:
        if c.since_ns[oldest] != NEVER_NS:
            learn_restlessness(c, 0.5 * estimate(c, oldest, 1.0)[5])
        suppose(c, oldest)
    return False
