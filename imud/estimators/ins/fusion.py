"""One step of the Kalman filter, and what has to follow every one: drift test, process noise, integrals of force.

The test for a drifting receiver and the learned process noise need every gain, the alignment every correction. `ekf`
and `error_model` know none of them; aiding sources and propagation call the functions of this file.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ...compile.jit import kernel
from .alignment.force_integrals import accumulate_integrals, retain_integrals
from .ekf import inject_error, innovation, innovation_variance, kalman_update
from .error_model import linearize, propagate_covariance
from .integrity.gnss_drift import BY_WHEELS, propagate_sensitivity, update_sensitivity
from .integrity.reset_inflation import fade_inflation
from .mechanization import start_integration
from .process_noise import learn_process_noise, propagate_learning, update_learning
from .state import NAVIGATING

if TYPE_CHECKING:
    from ..types import Innovation
    from .types import Core, Parameters


NEVER = 1e-12  # a gate that nothing passes


@kernel
def propagate_errors(p: Parameters, c: Core) -> None:
    """Propagate P, and what follows it, over the covariance interval, and start a new interval."""
    if c.imu.integration_time <= 0.0:
        return
    transition = c.scratch.transition
    linearize(p, c, transition)
    accumulate_integrals(c, transition.turn, transition.interval)
    propagate_covariance(p, c, transition)
    propagate_sensitivity(c, transition)
    propagate_learning(p, c, transition)
    fade_inflation(c, transition.gnss_bias)
    start_integration(c)


@kernel
def fuse(c: Core, m: int, z: float, s: float, axis: int) -> None:
    """Scalar Kalman update with innovation z of variance s; the Jacobian has `m` elements and P h is in scratch.d.

    axis: 0 for a GNSS position north, 1 east; -1: any other measurement.
    """
    update_sensitivity(c, m, s, z, axis)
    update_learning(c, m, z, s)
    kalman_update(c, z, s)


@kernel
def gated_update(c: Core, m: int, z: float, r: float, gate: float) -> tuple[float, float, float]:
    """Fuse a measurement with residual z (against the nominal state) and variance r, unless NIS > gate; gate 0: none,
    gate NEVER: it is rejected.

    The Jacobian has `m` elements. Returns the innovation, its variance, and its normalised square (NIS), negative when
    rejected.
    """
    s = innovation_variance(c, m) + r
    z = innovation(c, m, z)
    nis = z * z / s
    if 0.0 < gate < nis or not nis < math.inf:
        return z, s, -nis
    fuse(c, m, z, s, -1)
    return z, s, nis


@kernel
def learn_from(p: Parameters, c: Core, m: int, z: float, s: float) -> None:
    """While navigating, learn the process noise from a fix's innovation z of variance s, before it is fused.

    From a receiver that contradicts the wheels nothing is learned.
    """
    if c.alignment.mode == NAVIGATING and c.drift.detected != BY_WHEELS:
        learn_process_noise(p, c, m, z, s)


@kernel
def gated_fix_update(p: Parameters, c: Core, m: int, z: float, r: float, gate: float) -> tuple[float, float, float]:
    """`gated_update` with a measurement of a receiver, from which the process noise is learned first."""
    s = innovation_variance(c, m) + r
    learn_from(p, c, m, innovation(c, m, z), s)
    return gated_update(c, m, z, r, gate)


@kernel
def write_innovation(
    innovations: list[Innovation], n: int, t_ns: int, kind: int, z: float, s: float, used: bool
) -> int:
    """Write row n of the innovations (value z, variance s), if there is room; returns the rows written so far."""
    if n < len(innovations):
        r = innovations[n]
        r.t_ns, r.kind, r.value, r.variance, r.used = t_ns, kind, z, s, 1 if used else 0
        n += 1
    return n


@kernel
def pseudo_measurement(c: Core, kind: int, m: int, z: float, r: float, gate: float) -> tuple[float, float, float]:
    """Fuse a pseudo-measurement as `gated_update` does, and write its innovation."""
    value, s, nis = gated_update(c, m, z, r, gate)
    x = c.scratch
    x.innovation_count = write_innovation(x.innovations, x.innovation_count, c.nav.t_ns, kind, value, s, nis >= 0.0)
    return value, s, nis


@kernel
def clear_innovations(c: Core) -> None:
    """The innovations of the last sample have been read."""
    c.scratch.innovation_count = 0


@kernel
def correct_state(p: Parameters, c: Core) -> None:
    """Inject the error estimate into the nominal state; the alignment notes it, so that its integrals do not jump."""
    retain_integrals(c)
    inject_error(p, c)
