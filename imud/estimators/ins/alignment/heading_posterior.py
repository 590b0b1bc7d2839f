"""The heading that the pairs of `matching` tell, with tilt and biases marginalized out under their prior."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ....compile.jit import kernel
from ....math.earth import STANDARD_GRAVITY
from ...tuning import Tunable
from ..ekf import innovation_variance, set_jacobian
from ..mechanization import rotation_matrix, wrap_angle
from ..observers.heading_integrals import (
    HEADING_INTEGRAL,
    Complex,
    add_scaled,
    conjugate_product,
    element,
    multiply,
    phasor,
)
from ..state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, HYPOTHESES
from .drift_hypotheses import (
    GNSS_COLUMN,
    INERTIAL_COLUMN,
    REGRESSOR_COLUMN,
    apply_corrections,
    drift_rate,
)

if TYPE_CHECKING:
    from ..types import Core, HypothesisBank, Parameters


TUNABLES = (
    Tunable("min_events", 3.0, "", "Least number of innovations with motion.", "Simulated starts."),
    Tunable(
        "min_events_unknown_drift",
        2.0,
        "",
        "So many more where the gyro's drift is not known at all.",
        "Simulated starts.",
    ),
    Tunable(
        "correlation_factor",
        1.5,
        "",
        "Variance of neighbouring innovations, not quite independent.",
        "Simulated starts.",
    ),
    Tunable(
        "unknown_tilt_accel",
        0.3,
        "m/s^2",
        "Sigma of gravity's level part where the covariance is not believed.",
        "1.75 deg of tilt.",
    ),
)
FITTED_PARAMETERS = 3.0  # heading, and what the nuisance parameters take


@kernel
def nuisance_jacobian(c: Core, m: Any, i: int) -> int:
    """Row of component i (even: real) of tilt, level gyro bias and accelerometer bias, each as it acts on the force."""
    axis = i % 2
    if i < 2:
        return set_jacobian(c, 0, ATTITUDE + 1 - axis, (2 * axis - 1) * STANDARD_GRAVITY)
    k = 0
    for j in range(3):
        if i < 4:
            k = set_jacobian(c, k, GYRO_BIAS + j, (1 - 2 * axis) * STANDARD_GRAVITY * m[3 * (1 - axis) + j])
        else:
            k = set_jacobian(c, k, ACCEL_BIAS + j, -m[3 * axis + j])
    return k


@kernel
def set_prior(c: Core, b: HypothesisBank) -> None:
    """b.prior <- their covariance (3 x 3, complex) as the filter has it, taken as equal in all directions."""
    m = rotation_matrix(c)
    b.prior[:] = 0.0
    for j in range(6):
        innovation_variance(c, nuisance_jacobian(c, m, j))
        for i in range(6):
            n = nuisance_jacobian(c, m, i)
            s = 0.0
            for k in range(n):
                s += c.scratch.values[k] * c.scratch.d[c.scratch.columns[k]]
            if i % 2 == j % 2:
                b.prior[i // 2, j // 2, 0] += 0.5 * s
            else:
                b.prior[i // 2, j // 2, 1] += 0.5 * s if i % 2 == 1 else -0.5 * s


@kernel
def set_wide_prior(p: Parameters, c: Core, b: HypothesisBank, accel_initial: float) -> None:
    """b.prior <- what is known of tilt and accelerometer bias before anything was learned."""
    set_prior(c, b)
    gyro = b.prior[1, 1, 0]
    b.prior[:] = 0.0
    b.prior[0, 0, 0], b.prior[1, 1, 0], b.prior[2, 2, 0] = p.tuning.unknown_tilt_accel**2, gyro, accel_initial**2


@kernel
def move_prior_to_origin(c: Core, b: HypothesisBank) -> None:
    """Carry b.prior from tilt and biases now, in level axes, over to those at the origin of the running integrals."""
    frame, sway, s = phasor(c.alignment.wander_azimuth), element(c.alignment.integrals, HEADING_INTEGRAL), b.prior
    body = multiply(frame, (c.alignment.heading_phasor[0], -c.alignment.heading_phasor[1]))
    for k in range(3):  # rows
        for j in range(3):
            p = multiply(frame if j == 0 else body, element(s[j], k))
            s[j, k, 0], s[j, k, 1] = p[0], p[1]
        add_scaled(s[0, k], multiply(sway, element(s[1], k)), -1.0)
    for j in range(3):  # columns, conjugated
        for k in range(3):
            p = conjugate_product(frame if k == 0 else body, element(s[j], k))
            s[j, k, 0], s[j, k, 1] = p[0], p[1]
        add_scaled(s[j, 0], conjugate_product(sway, element(s[j], 1)), -1.0)


@kernel
def invert(a: Any) -> None:
    """a <- its inverse (3 x 3, complex, Gauss-Jordan; for what has a dominant diagonal by construction)."""
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
def eliminate_nuisance(b: HypothesisBank, products: Any) -> None:
    """b.gain <- (N + S^-1)^-1 = S (N S + 1)^-1, with N the regressors' products, and S b.prior."""
    s, g = b.prior, b.inverse
    for j in range(3):
        for k in range(3):
            g[j, k, 0], g[j, k, 1] = 1.0 if j == k else 0.0, 0.0
            for i in range(3):
                add_scaled(
                    g[j, k],
                    multiply(element(products[REGRESSOR_COLUMN + j], REGRESSOR_COLUMN + i), element(s[i], k)),
                    1.0,
                )
    invert(g)
    for j in range(3):
        for k in range(3):
            b.gain[j, k, 0], b.gain[j, k, 1] = 0.0, 0.0
            for i in range(3):
                add_scaled(b.gain[j, k], multiply(element(s[j], i), element(g[i], k)), 1.0)


@kernel
def residual_product(b: HypothesisBank, products: Any, one: int, other: int) -> Complex:
    """A product without what the regressors explain, by the gain."""
    re, im = element(products[one], other)
    for j in range(3):
        for k in range(3):
            right = multiply(element(b.gain[j], k), element(products[REGRESSOR_COLUMN + k], other))
            p = multiply(element(products[one], REGRESSOR_COLUMN + j), right)
            re -= p[0]
            im -= p[1]
    return re, im


@kernel
def evaluate_hypothesis(b: HypothesisBank, k: int) -> tuple[float, float]:
    """Of hypothesis k: b.headings <- the frame's heading and the misfit; returns this, and the energy that agrees."""
    eliminate_nuisance(b, b.products[k])
    re, im = residual_product(b, b.products[k], INERTIAL_COLUMN, GNSS_COLUMN)
    z2, v2 = (
        residual_product(b, b.products[k], INERTIAL_COLUMN, INERTIAL_COLUMN)[0],
        residual_product(b, b.products[k], GNSS_COLUMN, GNSS_COLUMN)[0],
    )
    both = math.hypot(re, im)
    b.headings[k, 0], b.headings[k, 1] = math.atan2(im, re), z2 + v2 - 2.0 * both
    return z2 + v2 - 2.0 * both, min(z2, both)


@kernel
def solve_heading(
    p: Parameters, c: Core, b: HypothesisBank, bias_variance: float
) -> tuple[float, float, float, float, float]:
    """Heading of the level frame now, its sigma (pi when not ready), its drift rate, that one's variance, covariance.

    Call with the prior in b.prior. The rate is that which the filter does not know of.
    """
    unknown = (0.0, math.pi, 0.0, 0.0, 0.0)
    age = 1e-9 * (c.nav.t_ns - c.alignment.origin_ns)
    events = p.tuning.min_events + p.tuning.min_events_unknown_drift * min(bias_variance * age * age, 1.0)
    energy = b.products[0, GNSS_COLUMN, GNSS_COLUMN, 0]
    if b.weight <= FITTED_PARAMETERS or energy**2 < events * b.energy2:
        return unknown
    apply_corrections(p, c, b)
    move_prior_to_origin(c, b)
    least, power = math.inf, 0.0
    for k in range(HYPOTHESES):
        misfit, agreed = evaluate_hypothesis(b, k)
        if misfit < least:
            least, power = misfit, agreed
    if power < 1.0:
        return unknown
    r = p.tuning.correlation_factor * max(least / (2.0 * b.weight - FITTED_PARAMETERS), 1.0)
    frame = c.alignment.wander_azimuth + c.alignment.wander_azimuth_drift
    mean = b.energy_age / energy  # age of what tells most: the heading of then is known best
    between = p.tuning.drift_rate_step**2 / 12.0  # hypotheses
    inside = bias_variance * between / (bias_variance + between)
    weight, sr, si, rate, rate2 = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(HYPOTHESES):
        drift, misfit = drift_rate(p, k), b.headings[k, 1] - least
        apart = drift + c.alignment.vertical_bias
        w = math.exp(-0.5 * misfit / r - 0.5 * apart**2 / (bias_variance + between))
        unforeseen = apart * inside / between
        psi = b.headings[k, 0] + drift * mean + (unforeseen - c.alignment.vertical_bias) * (age - mean) + frame
        b.headings[k, 0], b.headings[k, 1], b.headings[k, 2] = psi, w, unforeseen
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
    for k in range(HYPOTHESES):
        together += b.headings[k, 1] * wrap_angle(b.headings[k, 0] - psi) * (b.headings[k, 2] - rate)
    variance = max(rate2 / weight - rate * rate, 0.0) + inside
    return psi, math.sqrt(r / power + spread2), rate, variance, together / weight + (age - mean) * inside
