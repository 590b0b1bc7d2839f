"""One step of the Kalman filter, and those who observe it: the drift test and the integrals of the alignment.

The drift test has to know each gain, the alignment each correction. The filter itself (`ekf`, `error_model`) knows
neither of them; whoever fuses a measurement or propagates the errors calls the functions here.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ...compile.jit import kernel
from .ekf import inject_error, innovation, innovation_variance, kalman_update
from .error_model import linearize, propagate_covariance
from .mechanization import start_integration
from .observers.gnss_drift import propagate_sensitivity, update_sensitivity
from .observers.heading_integrals import accumulate_integrals, retain_integrals
from .observers.reset_inflation import fade_inflation

if TYPE_CHECKING:
    from .types import Core, Parameters


@kernel
def propagate_errors(p: Parameters, c: Core) -> None:
    """Propagate P, and what observes it, over the interval since the last time; start a new one."""
    if c.imu.integration_time <= 0.0:
        return
    phi = c.scratch.phi
    linearize(p, c, phi)
    accumulate_integrals(c, phi.turn, phi.interval)
    propagate_covariance(p, c, phi)
    propagate_sensitivity(c, phi)
    fade_inflation(c, phi.gnss_bias)
    start_integration(c)


@kernel
def fuse(c: Core, m: int, z: float, s: float, axis: int) -> None:
    """Fuse the Jacobian's `m` elements, whose P h is in scratch, with innovation z of variance s.

    axis: of the GNSS position that it is, 0 north, 1 east; -1: it is none.
    """
    update_sensitivity(c, m, s, z, axis)
    kalman_update(c, z, s)


@kernel
def gated_update(c: Core, m: int, z: float, r: float, gate: float) -> float:
    """Fuse the Jacobian with residual z (against the nominal state) and variance r, unless z^2/s > gate > 0.

    Returns the normalised innovation squared (NIS), negative when rejected.
    """
    s = innovation_variance(c, m) + r
    z = innovation(c, m, z)
    nis = z * z / s
    if 0.0 < gate < nis or not nis < math.inf:
        return -nis
    fuse(c, m, z, s, -1)
    return nis


@kernel
def pseudo_measurement(c: Core, kind: int, m: int, z: float, r: float, gate: float) -> tuple[float, float, float]:
    """Fuse what is assumed, not measured, and write its innovation; returns it, its variance, and as `gated_update`."""
    left = innovation(c, m, z)
    s = innovation_variance(c, m) + r
    nis = gated_update(c, m, z, r, gate)
    if c.scratch.innovation_count < len(c.scratch.innovations):
        o = c.scratch.innovations[c.scratch.innovation_count]
        o.t_ns, o.kind, o.value, o.variance, o.used = c.nav.t_ns, kind, left, s, 1 if nis >= 0.0 else 0
        c.scratch.innovation_count += 1
    return left, s, nis


@kernel
def clear_innovations(c: Core) -> None:
    """The innovations of the last sample have been read."""
    c.scratch.innovation_count = 0


@kernel
def correct_state(p: Parameters, c: Core) -> None:
    """Add the gathered correction to the nominal state; the integrals of the alignment are kept as if it were not."""
    retain_integrals(c)
    inject_error(p, c)
