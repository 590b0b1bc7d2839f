"""Roll and pitch in motion from pairs of vectors, for a vehicle whose mean force is not vertical.

One that turns or accelerates for long, an aircraft above all, is not levelled by a mean force. The attitude C of the
frame of `vector_pairs` follows from Wahba's problem, whatever it is (Davenport's q method); weighted least squares with
the prior of the gyro bias refine it. The covariance says whether roll and pitch are known: after some seconds, in
straight flight or in a turn. The heading that comes with them is not accepted: the hypothesis bank has a better model
of the receiver's errors, and finds what is left of it.

Source: Markley and Crassidis, Fundamentals of Spacecraft Attitude Determination and Control (2014), sec. 5.3.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ....compile.jit import kernel
from ....math.rotation import cross, dcm_of_quat, dot, quat_exp, quat_normalised, quat_product, quat_rotate_back
from ...tuning import Tunable
from ..aiding.forward_axis_search import clear_scatter
from ..ekf import add_correction, combine, decorrelate, variance
from ..fusion import correct_state
from ..mechanization import ned_to_body, set_attitude
from ..state import ATTITUDE, GYRO_BIAS
from .vector_pairs import (
    vector_quaternion,
)
from .velocity_pairs import restart_in_motion_alignment

if TYPE_CHECKING:
    from ....math.rotation import Matrix, Quaternion, Vector
    from ..types import Core, HypothesisBank, Parameters


TUNABLES = (
    Tunable("min_vectors", 5, "pairs", "Least number of pairs of vectors that level the frame.", "Choice."),
    Tunable(
        "max_vector_tilt",
        math.radians(3.0),
        "rad",
        "Largest tilt sigma that pairs of vectors level the frame with.",
        "Half of levelled_sigma.",
    ),
    Tunable(
        "max_vector_chi2",
        4.0,
        "",
        "Largest mean square of the residuals of pairs of vectors, over their variance.",
        "Two sigma.",
    ),
    Tunable(
        "vector_tilt_floor",
        math.radians(1.0),
        "rad",
        "Sigma of the tilt found from pairs of vectors, in addition to that of the least squares.",
        "An accelerometer bias of 0.2 m/s^2.",
    ),
    Tunable(
        "vector_tilt_gate",
        9.0,
        "NIS",
        "Gate of a tilt that is known already against that of pairs of vectors.",
        "Three sigma.",
    ),
)
Solved = tuple[float, float, float, float, float, float, float, float]
SQUARINGS = 7  # of the matrix whose dominant eigenvector is sought
ITERATIONS = 3  # of the least squares


@kernel
def davenport_attitude(b: HypothesisBank) -> Quaternion:
    """The rotation from the vectors' frame to navigation axes that fits the pairs best, without the gyro bias."""
    K, square = b.vector_product[0], b.vector_product[1]
    K[:] = 0.0
    size = 0.0
    for k in range(b.vector_count):
        r, w = b.vectors[k], 1.0 / b.vectors[k].level_variance
        n, f = (r.gnss[0], r.gnss[1], r.gnss[2]), (r.force[0], r.force[1], r.force[2])
        z = cross(f, n)
        K[0, 0] += w * dot(n, f)
        for i in range(3):
            K[0, 1 + i] += w * z[i]
            K[1 + i, 0] += w * z[i]
            K[1 + i, 1 + i] -= w * dot(n, f)
            for j in range(3):
                K[1 + i, 1 + j] += w * (n[i] * f[j] + n[j] * f[i])
        size += w * math.sqrt(dot(n, n) * dot(f, f))
    for i in range(4):
        K[i, i] += size
    for _ in range(SQUARINGS):
        largest = 1e-300
        for i in range(4):
            largest = max(largest, K[i, i])
        for i in range(4):
            for j in range(4):
                square[i, j] = 0.0
                for m in range(4):
                    square[i, j] += K[i, m] * K[m, j] / (largest * largest)
        for i in range(4):
            for j in range(4):
                K[i, j] = square[i, j]
    column = 0
    for i in range(4):
        if K[i, i] > K[column, column]:
            column = i
    return quat_normalised((K[0, column], K[1, column], K[2, column], K[3, column]))


@kernel
def rotation_row(axis: int, u: Vector) -> Vector:
    """Component `axis` of theta x u per theta."""
    if axis == 0:
        return (0.0, u[2], -u[1])
    if axis == 1:
        return (-u[2], 0.0, u[0])
    return (u[1], -u[0], 0.0)


@kernel
def add_equations(b: HypothesisBank, k: int, C: Matrix, db: Vector) -> float:
    """Add the three equations of pair k to the normal equations of rotation and gyro bias; returns their chi2."""
    N, r, chi2 = b.vector_normal, b.vectors[k], 0.0
    f = np.empty(3)
    h = np.empty(6)
    u = np.empty(3)
    for i in range(3):
        g = r.sensitivity
        f[i] = r.force[i] + g[i, 0] * db[0] + g[i, 1] * db[1] + g[i, 2] * db[2]
    for i in range(3):
        u[i] = C[3 * i] * f[0] + C[3 * i + 1] * f[1] + C[3 * i + 2] * f[2]
    for axis in range(3):
        w = 1.0 / (r.down_variance if axis == 2 else r.level_variance)
        z = r.gnss[axis] - u[axis]
        h[0], h[1], h[2] = rotation_row(axis, (u[0], u[1], u[2]))
        for j in range(3):
            h[3 + j] = 0.0
            for i in range(3):
                h[3 + j] += C[3 * axis + i] * r.sensitivity[i, j]
        for i in range(6):
            for j in range(6):
                N[i, j] += w * h[i] * h[j]
            N[i, 12] += w * h[i] * z
        chi2 += w * z * z
    return chi2


@kernel
def solve_normal(b: HypothesisBank) -> None:
    """Columns 6 to 11 of the normal equations <- their inverse, column 12 <- the solution (Gauss-Jordan, no pivots)."""
    N = b.vector_normal
    for i in range(6):
        for j in range(6):
            N[i, 6 + j] = 1.0 if i == j else 0.0
    for i in range(6):
        pivot = 1.0 / N[i, i]
        for j in range(13):
            N[i, j] *= pivot
        for k in range(6):
            factor = N[k, i]
            if k != i:
                for j in range(13):
                    N[k, j] -= factor * N[i, j]


@kernel
def refine_attitude(c: Core, b: HypothesisBank, q: Quaternion) -> Solved:
    """Least squares from q: attitude of the vectors' frame, error of the gyro bias (rad/s), chi2 of the residuals."""
    N, a = b.vector_normal, c.alignment
    prior = (
        c.nav.bg[0] - a.vector_bias[0],
        c.nav.bg[1] - a.vector_bias[1],
        c.nav.bg[2] - a.vector_bias[2],
    )
    db, chi2 = prior, 0.0
    for _ in range(ITERATIONS):
        N[:] = 0.0
        C, chi2 = dcm_of_quat(q), 0.0
        for k in range(b.vector_count):
            chi2 += add_equations(b, k, C, db)
        for i in range(3):
            w = 1.0 / variance(c, GYRO_BIAS + i)
            N[i, i] += 1.0 / math.pi**2
            N[3 + i, 3 + i] += w
            N[3 + i, 12] += w * (prior[i] - db[i])
            chi2 += w * (prior[i] - db[i]) ** 2
        solve_normal(b)
        q = quat_normalised(quat_product(quat_exp(N[0, 12], N[1, 12], N[2, 12]), q))
        db = (db[0] + N[3, 12], db[1] + N[4, 12], db[2] + N[5, 12])
    return q[0], q[1], q[2], q[3], db[0], db[1], db[2], chi2


@kernel
def rotation_per_bias(c: Core, C: Matrix, axis: int, j: int) -> float:
    """Rotation of the body now about a navigation axis per gyro bias error along axis j of the body, s."""
    G = c.alignment.vector_rotation
    return float(-(C[3 * axis] * G[0, j] + C[3 * axis + 1] * G[1, j] + C[3 * axis + 2] * G[2, j]))


@kernel
def tilt_variance(c: Core, b: HypothesisBank, C: Matrix) -> float:
    """Larger variance, rad^2, of the two tilts of the body now: of the frame, and of its rotation by the bias since."""
    N, most = b.vector_normal, 0.0
    h = np.empty(6)
    for axis in range(2):
        for j in range(3):
            h[j] = 1.0 if j == axis else 0.0
            h[3 + j] = rotation_per_bias(c, C, axis, j)
        s = 0.0
        for i in range(6):
            for j in range(6):
                s += h[i] * N[i, 6 + j] * h[j]
        most = max(most, s)
    return most


@kernel
def set_levelled(
    p: Parameters, c: Core, b: HypothesisBank, attitude: Quaternion, C: Matrix, x: Solved, r: float
) -> None:
    """Set attitude and gyro bias with their covariance; r: factor of that of the least squares, which gave x."""
    N = b.vector_normal
    set_attitude(c, quat_normalised(attitude))
    for j in range(3):
        decorrelate(c, GYRO_BIAS + j, min(r * N[3 + j, 9 + j], variance(c, GYRO_BIAS + j)))
    for axis in range(2):
        own = r * N[axis, 6 + axis]
        for j in range(3):
            own -= r * N[axis, 9 + j] ** 2 / N[3 + j, 9 + j]
        decorrelate(c, ATTITUDE + axis, max(own, 0.0) + p.tuning.vector_tilt_floor**2)
        for j in range(3):
            gain = N[axis, 9 + j] / N[3 + j, 9 + j] + rotation_per_bias(c, C, axis, j)
            combine(c, ATTITUDE + axis, GYRO_BIAS + j, gain)
    for j in range(3):
        add_correction(c, GYRO_BIAS + j, c.alignment.vector_bias[j] + x[4 + j] - c.nav.bg[j])
    correct_state(p, c)


@kernel
def level_with_vectors(p: Parameters, c: Core, b: HypothesisBank) -> bool:
    """Level with the pairs of vectors, if they know roll and pitch better, or contradict them; True if they did."""
    n = b.vector_count
    if n < p.tuning.min_vectors:
        return False
    x = refine_attitude(c, b, davenport_attitude(b))
    q = (x[0], x[1], x[2], x[3])
    ratio = max(x[7] / (3.0 * n - 3.0), 1.0)
    variance_now = ratio * tilt_variance(c, b, dcm_of_quat(q)) + p.tuning.vector_tilt_floor**2
    if ratio > p.tuning.max_vector_chi2 or variance_now > p.tuning.max_vector_tilt**2:
        return False
    G = c.alignment.vector_rotation
    turned = np.empty(3)
    for i in range(3):
        turned[i] = -(G[i, 0] * x[4] + G[i, 1] * x[5] + G[i, 2] * x[6])
    attitude = quat_product(quat_product(q, quat_exp(turned[0], turned[1], turned[2])), vector_quaternion(c))
    down, known = quat_rotate_back(attitude, (0.0, 0.0, 1.0)), ned_to_body(c, (0.0, 0.0, 1.0))
    apart = cross(down, known)
    apart2 = dot(apart, apart) if dot(down, known) > 0.0 else 1.0
    tilt2 = max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1))
    if tilt2 < p.tuning.levelled_sigma**2 and apart2 < p.tuning.vector_tilt_gate * (tilt2 + variance_now):
        return False
    set_levelled(p, c, b, attitude, dcm_of_quat(q), x, ratio)
    clear_scatter(c)
    restart_in_motion_alignment(c)
    return True
