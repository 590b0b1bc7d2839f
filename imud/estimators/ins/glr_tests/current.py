"""GLR test for a body in a current that passes for a land vehicle, while the non-holonomic constraint is enabled.

The constraint says that there is no velocity across the forward axis. In a current d, north and east, that holds of the
velocity through the water: with every update the heading turns towards the course, and the mounting, which was found
on one course, is wrong on the next. So a current is a fault of `fault_sensitivity` from the time on at which the
constraint was enabled, and all innovations since, its own and those of the fixes, give its size. What
`aiding.land_evidence` knew of it by then is where the sums begin.

The ratio of two likelihoods decides, as there: d of a land vehicle is slip, that of a boat has the sigma
`current_share` of its speed. If a boat is the more likely by `land_log_likelihood`, the constraint is disabled, and
what it has done is removed. Until then the stated variance of the heading has what a current would have done, times the
probability of a boat.

Source: as `fault_sensitivity`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ..state import ATTITUDE, AUTO, CURRENT_FAULT, EE, NE, NN
from .fault_sensitivity import open_column, remove_drift
from .gyro_bias_step import weight_of

if TYPE_CHECKING:
    from typing import Any

    from ..types import Core, Parameters


@kernel
def open_current(c: Core) -> None:
    """The constraint is enabled: from now on a current does something to the estimate."""
    g, e = c.current, c.land_evidence
    for i in range(2):
        open_column(c, CURRENT_FAULT + i)
        g.vector[i] = e.current_vector[i]
    for i in range(3):
        g.information[i] = e.current_information[i]
    g.energy = g.count = g.heading_variance = 0.0


@kernel
def add_to_sums(g: Any, x: float, y: float, z: float, s: float, weight: float) -> None:
    """Add an innovation z of variance s, of this weight, to the sums g of a fault of two components.

    x, y: mean of the innovation per unit of each.
    """
    g.vector[0] += weight * x * z / s
    g.vector[1] += weight * y * z / s
    g.information[NN] += weight * x * x / s
    g.information[NE] += weight * x * y / s
    g.information[EE] += weight * y * y / s
    g.energy += weight * z * z / s
    g.count += weight


@kernel
def add_to_current(c: Core, z: float, s: float, weight: float) -> None:
    """Add an innovation z of variance s, of this weight, to the sums."""
    mean = c.scratch.fault_innovation
    add_to_sums(c.current, mean[CURRENT_FAULT], mean[CURRENT_FAULT + 1], z, s, weight)


@kernel
def add_fix_to_current(p: Parameters, c: Core, z: float, s: float, r: float, axis: int) -> None:
    """Add an innovation z of variance s of a fix while the constraint is enabled; r, axis: see `weight_of`."""
    if c.nhc.enabled and p.vehicle == AUTO:
        weight = weight_of(p, c, s, r, axis)
        if weight > 0.0:
            add_to_current(c, z, s, weight)


@kernel
def current_posterior(c: Core, prior: float) -> Any:
    """Current north and east, m/s, its covariance nn, ne, ee, and its log likelihood relative to none.

    prior: variance of a component, m^2/s^2.
    """
    g, k = c.current, 1.0 / prior
    scale = 1.0 / max(g.energy / max(g.count, 1.0), 1.0)
    a, b, ab = scale * g.information[NN] + k, scale * g.information[EE] + k, scale * g.information[NE]
    det = a * b - ab * ab
    nn, ne, ee = b / det, -ab / det, a / det
    y0, y1 = scale * g.vector[0], scale * g.vector[1]
    north, east = nn * y0 + ne * y1, ne * y0 + ee * y1
    return north, east, nn, ne, ee, 0.5 * (north * y0 + east * y1) - 0.5 * elementary.log(det / (k * k))


@kernel
def judge_current(c: Core, slip2: float, current2: float) -> float:
    """Log likelihood ratio of a land vehicle against a body in a current; states what a likely current has done.

    slip2, current2: variances of a component of the apparent current of both, m^2/s^2.
    """
    g, V = c.current, c.faults.sensitivity
    north, east, nn, ne, ee, log_likelihood = current_posterior(c, current2)
    _, _, _, _, _, of_slip = current_posterior(c, slip2)
    ratio = of_slip - log_likelihood
    vn, ve = V[ATTITUDE + 2, CURRENT_FAULT], V[ATTITUDE + 2, CURRENT_FAULT + 1]
    turned = vn * north + ve * east
    variance = vn * vn * nn + 2.0 * vn * ve * ne + ve * ve * ee
    g.heading_variance = (turned * turned + variance) / (1.0 + elementary.exp(min(max(ratio, -30.0), 30.0)))
    return float(ratio)


@kernel
def remove_current(c: Core, current2: float) -> None:
    """Gather in scratch.x what the most likely current has done, and add its covariance to P."""
    north, east, nn, ne, ee, _ = current_posterior(c, current2)
    remove_drift(c, CURRENT_FAULT, (north, east), nn, ne, ee)
    close_current(c)


@kernel
def close_current(c: Core) -> None:
    """The constraint is disabled: a current does nothing to the estimate from now on."""
    c.current.heading_variance = 0.0
