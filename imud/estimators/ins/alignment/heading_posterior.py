"""The posterior of the heading: the products of the hypothesis bank, with tilt and biases marginalized under a prior.

For each frame rate the nuisance parameters are eliminated by least squares with the prior's information. The argument
of the remaining cross product of GNSS and inertial innovations is the heading; the residual energy is minus twice the
log likelihood. The hypotheses are averaged with their likelihoods (a Gaussian sum).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.earth import STANDARD_GRAVITY
from ....math.rotation import wrap_angle
from ...tuning import Tunable
from ..ekf import cross_covariance, set_jacobian
from ..mechanization import rotation_matrix
from ..state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, HYPOTHESES
from .force_integrals import (
    HEADING_INTEGRAL,
    Complex,
    add_scaled,
    conjugate_product,
    element,
    multiply,
    phasor,
)
from .hypothesis_bank import (
    GNSS_COLUMN,
    INERTIAL_COLUMN,
    REGRESSOR_COLUMN,
    apply_corrections,
    frame_rate,
)

if TYPE_CHECKING:
    from ....math.arrays import Tensor
    from ....math.rotation import Matrix
    from ..types import Core, HypothesisBank, Parameters


TUNABLES = (
    Tunable(
        "min_events",
        3.0,
        "",
        "Least number of innovations with motion from which a heading is accepted.",
        "Simulated starts.",
    ),
    Tunable(
        "min_events_unknown_rate",
        2.0,
        "",
        "Additional innovations with motion where the vertical gyro bias is not known.",
        "Simulated starts.",
    ),
    Tunable(
        "correlation_factor",
        1.5,
        "",
        "Factor of the variance of innovations whose neighbours are not quite independent.",
        "Simulated starts.",
    ),
    Tunable(
        "max_edge_weight",
        0.01,
        "",
        "Largest probability of an outermost frame rate with which a heading is accepted.",
        "Choice: of a posterior that lies within the hypotheses it is far smaller.",
        high=0.5,
    ),
    Tunable(
        "unknown_tilt_accel",
        0.3,
        "m/s^2",
        "Sigma of gravity's level component where the covariance of the tilt is not used.",
        "1.75 deg of tilt.",
    ),
)
FITTED_PARAMETERS = 3.0  # the heading, and the degrees of freedom that the nuisance parameters take


@kernel
def nuisance_jacobian(c: Core, C_nb: Matrix, i: int) -> int:
    """Jacobian of component i of the nuisance parameters; 0, 1: tilt; 2, 3: gyro; 4, 5: accelerometer; even: north.

    Each acts as a level specific force, m/s^2 (the gyro bias: m/s^3). C_nb: row by row. Returns the row's length.
    """
    axis = i % 2
    if i < 2:
        return set_jacobian(c, 0, ATTITUDE + 1 - axis, (2 * axis - 1) * STANDARD_GRAVITY)
    length = 0
    for j in range(3):
        if i < 4:
            length = set_jacobian(
                c, length, GYRO_BIAS + j, (1 - 2 * axis) * STANDARD_GRAVITY * C_nb[3 * (1 - axis) + j]
            )
        else:
            length = set_jacobian(c, length, ACCEL_BIAS + j, -C_nb[3 * axis + j])
    return length


@kernel
def set_prior(c: Core, prior: Tensor) -> None:
    """Set `prior` to the nuisance parameters' covariance (3 x 3, complex) from P, averaged over the two level axes."""
    C_nb = rotation_matrix(c)
    prior[:] = 0.0
    for j in range(6):
        cross_covariance(c, nuisance_jacobian(c, C_nb, j))
        for i in range(6):
            length = nuisance_jacobian(c, C_nb, i)
            s = 0.0
            for k in range(length):
                s += c.scratch.values[k] * c.scratch.d[c.scratch.columns[k]]
            if i % 2 == j % 2:
                prior[i // 2, j // 2, 0] += 0.5 * s
            else:
                prior[i // 2, j // 2, 1] += 0.5 * s if i % 2 == 1 else -0.5 * s


@kernel
def set_wide_prior(p: Parameters, c: Core, prior: Tensor, accel_initial: float) -> None:
    """Set wide variances of tilt and accelerometer bias (sigma `accel_initial`, m/s^2); the gyro bias from P."""
    set_prior(c, prior)
    gyro = prior[1, 1, 0]
    prior[:] = 0.0
    prior[0, 0, 0], prior[1, 1, 0], prior[2, 2, 0] = p.tuning.unknown_tilt_accel**2, gyro, accel_initial**2


@kernel
def move_prior_to_origin(c: Core, s: Tensor) -> None:
    """Transform the prior `s` from tilt and biases now, in level axes, to those at the origin of the integrals."""
    a = c.alignment
    frame, heading_integral = phasor(a.frame_azimuth), element(a.integrals, HEADING_INTEGRAL)
    body = multiply(frame, (a.heading_phasor[0], -a.heading_phasor[1]))
    for k in range(3):  # rows
        for j in range(3):
            p = multiply(frame if j == 0 else body, element(s[j], k))
            s[j, k, 0], s[j, k, 1] = p[0], p[1]
        add_scaled(s[0, k], multiply(heading_integral, element(s[1], k)), -1.0)
    for j in range(3):  # columns, conjugated
        for k in range(3):
            p = conjugate_product(frame if k == 0 else body, element(s[j], k))
            s[j, k, 0], s[j, k, 1] = p[0], p[1]
        add_scaled(s[j, 0], conjugate_product(heading_integral, element(s[j], 1)), -1.0)


@kernel
def invert(a: Tensor) -> None:
    """a <- its inverse (3 x 3, complex; Gauss-Jordan without pivoting, the diagonal is dominant by construction)."""
    for i in range(3):
        size = a[i, i, 0] ** 2 + a[i, i, 1] ** 2
        pivot = (a[i, i, 0] / size, -a[i, i, 1] / size)
        a[i, i, 0], a[i, i, 1] = 1.0, 0.0
        for k in range(3):
            p = multiply(pivot, (a[i, k, 0], a[i, k, 1]))
            a[i, k, 0], a[i, k, 1] = p[0], p[1]
        for j in range(3):
            if j != i:
                f = (a[j, i, 0], a[j, i, 1])
                a[j, i, 0], a[j, i, 1] = 0.0, 0.0
                for k in range(3):
                    p = multiply(f, (a[i, k, 0], a[i, k, 1]))
                    a[j, k, 0] -= p[0]
                    a[j, k, 1] -= p[1]


@kernel
def eliminate_nuisance(gain: Tensor, g: Tensor, prior: Tensor, products: Tensor) -> None:
    """`gain` <- (N + S^-1)^-1 = S (N S + 1)^-1; N: products of the regressors, S: the prior, g: scratch."""
    for j in range(3):
        for k in range(3):
            g[j, k, 0], g[j, k, 1] = 1.0 if j == k else 0.0, 0.0
            for i in range(3):
                add_scaled(
                    g[j, k],
                    multiply(element(products[REGRESSOR_COLUMN + j], REGRESSOR_COLUMN + i), element(prior[i], k)),
                    1.0,
                )
    invert(g)
    for j in range(3):
        for k in range(3):
            gain[j, k, 0], gain[j, k, 1] = 0.0, 0.0
            for i in range(3):
                add_scaled(gain[j, k], multiply(element(prior[j], i), element(g[i], k)), 1.0)


@kernel
def residual_product(gain: Tensor, products: Tensor, one: int, other: int) -> Complex:
    """products[one, other] less the part that the regressors explain: a Schur complement by `gain`."""
    re, im = element(products[one], other)
    for j in range(3):
        for k in range(3):
            right = multiply(element(gain[j], k), element(products[REGRESSOR_COLUMN + k], other))
            p = multiply(element(products[one], REGRESSOR_COLUMN + j), right)
            re -= p[0]
            im -= p[1]
    return re, im


@kernel
def evaluate_hypothesis(b: HypothesisBank, k: int) -> tuple[float, float]:
    """b.headings[k] <- heading of the level frame (rad) and residual energy; returns residual and explained energy."""
    eliminate_nuisance(b.gain, b.inverse, b.prior, b.products[k])
    re, im = residual_product(b.gain, b.products[k], INERTIAL_COLUMN, GNSS_COLUMN)
    z2 = residual_product(b.gain, b.products[k], INERTIAL_COLUMN, INERTIAL_COLUMN)[0]
    v2 = residual_product(b.gain, b.products[k], GNSS_COLUMN, GNSS_COLUMN)[0]
    both = elementary.hypot(re, im)
    b.headings[k, 0], b.headings[k, 1] = elementary.atan2(im, re), z2 + v2 - 2.0 * both
    return z2 + v2 - 2.0 * both, min(z2, both)


@kernel
def average_hypotheses(b: HypothesisBank, weight: float) -> tuple[float, float, float, float, float]:
    """Moments of the hypotheses in b.headings (heading, weight, rate); weight: the sum of their weights.

    Returns mean heading, its variance, mean rate, its variance, covariance of heading and rate.
    """
    re, im, rate, rate2, covariance = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(HYPOTHESES):
        psi, w = b.headings[k, 0], b.headings[k, 1]
        re += w * elementary.cos(psi)
        im += w * elementary.sin(psi)
        rate += w * b.headings[k, 2]
        rate2 += w * b.headings[k, 2] ** 2
    rate /= weight
    mean = elementary.atan2(im, re)
    for k in range(HYPOTHESES):
        covariance += b.headings[k, 1] * wrap_angle(b.headings[k, 0] - mean) * (b.headings[k, 2] - rate)
    length = min(elementary.hypot(re, im) / weight, 1.0)
    variance = -2.0 * elementary.log(max(length, 1e-9))  # of a wrapped normal distribution
    return mean, variance, rate, rate2 / weight - rate * rate, covariance / weight


@kernel
def solve_heading(
    p: Parameters, c: Core, b: HypothesisBank, bias_variance: float
) -> tuple[float, float, float, float, float]:
    """Posterior mean of the level frame's heading now (rad), and of its rate that the filter does not predict.

    bias_variance: of the vertical gyro bias, rad^2/s^2. Call with the nuisance parameters' prior in b.prior. Returns
    heading, its sigma (pi: not observable yet), frame rate, its variance, covariance of heading and frame rate. Where
    the rate is beyond all hypotheses, the sigma is pi and the rate that of the nearest, with variance 0.
    """
    unknown = (0.0, math.pi, 0.0, 0.0, 0.0)
    age = 1e-9 * (c.nav.t_ns - c.alignment.origin_ns)
    events = p.tuning.min_events + p.tuning.min_events_unknown_rate * min(bias_variance * age * age, 1.0)
    energy = b.products[0, GNSS_COLUMN, GNSS_COLUMN, 0]
    if b.weight <= FITTED_PARAMETERS or energy**2 < events * b.energy2:
        return unknown
    apply_corrections(p, c, b)
    move_prior_to_origin(c, b.prior)
    least, power = math.inf, 0.0
    for k in range(HYPOTHESES):
        residual_energy, explained_energy = evaluate_hypothesis(b, k)
        if residual_energy < least:
            least, power = residual_energy, explained_energy
    if power < 1.0:
        return unknown
    r = p.tuning.correlation_factor * max(least / (2.0 * b.weight - FITTED_PARAMETERS), 1.0)
    frame = c.alignment.frame_azimuth + c.alignment.corrected_rotation
    mean = b.energy_age / energy  # time of the velocity changes, s after the origin: there the heading is known best
    between = p.tuning.frame_rate_step**2 / 12.0  # variance of a rate uniform between two hypotheses
    inside = bias_variance * between / (bias_variance + between)  # of the rate within one hypothesis, with its prior
    weight = 0.0
    for k in range(HYPOTHESES):
        frame_rate_k, energy_difference = frame_rate(p, k), b.headings[k, 1] - least
        apart = frame_rate_k + c.alignment.bias_correction
        w = elementary.exp(-0.5 * energy_difference / r - 0.5 * apart**2 / (bias_variance + between))
        unpredicted_rate = apart * inside / between
        psi = (
            b.headings[k, 0]
            + frame_rate_k * mean
            + (unpredicted_rate - c.alignment.bias_correction) * (age - mean)
            + frame
        )
        b.headings[k, 0], b.headings[k, 1], b.headings[k, 2] = psi, w, unpredicted_rate
        weight += w
    if not weight > 0.0:
        return unknown
    edge = max(b.headings[0, 1], b.headings[HYPOTHESES - 1, 1])
    if edge > p.tuning.max_edge_weight * weight:  # the rate may well be beyond all hypotheses
        if edge < 0.5 * weight:
            return unknown
        outermost = frame_rate(p, 0 if b.headings[0, 1] == edge else HYPOTHESES - 1)
        return 0.0, math.pi, outermost + c.alignment.bias_correction, 0.0, 0.0
    psi, spread2, rate, rate_variance, covariance = average_hypotheses(b, weight)
    spread2 += (age - mean) ** 2 * inside
    variance = max(rate_variance, 0.0) + inside
    return psi, math.sqrt(r / power + spread2), rate, variance, covariance + (age - mean) * inside
