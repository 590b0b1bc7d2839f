"""One step of the Kalman filter, and what has to follow every one: drift test, process noise, integrals of force.

The test for a drifting receiver and the learned process noise need every gain, the alignment every correction. `ekf`
and `error_model` know none of them; aiding sources and propagation call the functions of this file:

| update               | of what                                                              | used by |
|----------------------|----------------------------------------------------------------------|---------|
| `gated_update`       | white noise, with a gate or without                                  | levelling, alignment, gravity monitor |
| `correlated_update`  | one of many that share an error: the gate has the variance of one, the update that of what all know | all sources in `sources` |
| `fix_update`         | a receiver's position or velocity: process noise is learned from it  | GNSS    |
| `pseudo_measurement` | what is assumed, not measured; its innovation is stored              | ZUPT, ZARU, NHC |

All end in `fuse`, and `correct_state` injects what they found.
"""  # noqa: E501 a table's row is one line

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ...compile.jit import kernel
from .alignment.force_integrals import accumulate_integrals, record_corrections
from .alignment.velocity_change import add_velocity_change
from .boresights import add_boresights, compute_boresight_gain, propagate_boresights, update_boresights
from .ekf import apply_gain, compute_gain, cross_covariance, inject_error, innovation
from .error_model import linearize, propagate_covariance
from .glr_tests.compass_offset import add_to_compass_offset
from .glr_tests.current import add_fix_to_current, add_to_current
from .glr_tests.fault_sensitivity import predict_innovations, propagate_sensitivities, update_sensitivities
from .glr_tests.gnss_drift import BY_WHEELS, add_to_drift
from .glr_tests.gyro_bias_step import add_to_gyro_bias_step
from .glr_tests.imu_bias_step import add_to_imu_bias_step
from .glr_tests.lever_arm_error import add_to_lever_arm_error
from .glr_tests.time_offset_step import add_to_time_offset_step
from .glr_tests.velocity_drift import add_to_velocity_drift
from .integrity.reset_inflation import propagate_inflation
from .mechanization import start_integration
from .process_noise import learn_process_noise, propagate_learning, update_learning
from .state import ATTITUDE, CONSTRAINT_AXIS, HORIZONTAL, NAVIGATING, OTHER_AXIS, VELOCITY, VERTICAL
from .time_evidence import measure_time_evidence

if TYPE_CHECKING:
    from ..types import Innovation
    from .types import Core, Parameters


NO_GATE, REJECT = 0.0, -1.0  # gates: everything passes, nothing does


@kernel
def propagate_errors(p: Parameters, c: Core) -> None:
    """Propagate P, and what follows it, over the covariance interval, and start a new interval."""
    if c.imu.integration_time <= 0.0:
        return
    transition = c.scratch.transition
    linearize(p, c, transition)
    accumulate_integrals(c, transition.turn_angle, transition.interval)
    propagate_covariance(p, c, transition)
    add_velocity_change(c, transition)
    propagate_sensitivities(c, transition)
    propagate_boresights(p, c, transition)
    propagate_learning(p, c, transition)
    measure_time_evidence(p, c, transition)
    propagate_inflation(c, transition.interval, transition.gnss_bias_decay)
    start_integration(c)


@kernel
def fuse(c: Core, length: int, z: float, s: float, axis: int) -> None:
    """Scalar Kalman update with innovation z of variance s; the Jacobian has `length` elements, P h is in scratch.d.

    What faults add to the innovation is in scratch, too (`predict_innovations`).
    axis: what is measured, for the GLR tests: POSITION_AXIS or one of the other codes of `state`.
    """
    compute_gain(c, s)
    compute_boresight_gain(c, length, s, axis)
    add_to_drift(c, z, s, axis)
    if axis == CONSTRAINT_AXIS:
        add_to_current(c, z, s, 1.0)
    update_sensitivities(c)
    update_boresights(c, z, s)
    update_learning(c, length, z, s)
    apply_gain(c, z)


@kernel
def gated_update(c: Core, length: int, z: float, r: float, gate: float) -> tuple[float, float, float]:
    """Fuse a measurement of white noise: innovation z against the nominal state, variance r; rejected if NIS > gate.

    gate 0: none, REJECT: rejected. The Jacobian has `length` elements. Returns the innovation against the error
    estimate as well, its variance, and its normalised square (NIS), negative when rejected.
    """
    return correlated_update(c, length, z, r, 0.0, gate, OTHER_AXIS)


@kernel
def correlated_update(
    c: Core, length: int, z: float, r: float, shared: float, gate: float, axis: int
) -> tuple[float, float, float]:
    """`gated_update` of one of many measurements that share an error: the gate has r, the update r + shared.

    n measurements that share an error of variance e know together what one of them does: shared = (n - 1) e. axis: see
    `fuse`.
    """
    z, s = innovation(c, length, z), cross_covariance(c, length) + r + add_boresights(c, length, axis)
    predict_innovations(c, length, axis)
    return test_and_fuse(c, length, z, s, shared, gate, axis)


@kernel
def fix_update(
    p: Parameters, c: Core, length: int, z: float, r: float, gate: float, axis: int
) -> tuple[float, float, float]:
    """`gated_update` of a receiver's measurement; while navigating, process noise is learned from it first.

    Also from the first rejected one, since no update separates the errors of those that follow, but not from a receiver
    that contradicts the wheels. axis: see `fuse`.
    """
    z, s = innovation(c, length, z), cross_covariance(c, length) + r
    predict_innovations(c, length, axis)
    if c.alignment.mode == NAVIGATING and c.drift.detected != BY_WHEELS:
        if gate != REJECT or max(c.integrity.reject_count[HORIZONTAL], c.integrity.reject_count[VERTICAL]) <= 1:
            learn_process_noise(p, c, length, z, s)
        add_to_time_offset_step(c, z, s, axis)
        add_to_lever_arm_error(p, c, z, s, r, axis)
        if gate != REJECT:
            add_to_gyro_bias_step(p, c, z, s, r, axis)
            add_to_imu_bias_step(p, c, z, s, r, axis)
            add_fix_to_current(p, c, z, s, r, axis)
        add_to_velocity_drift(p, c, z, s, axis)
        add_to_compass_offset(p, c, z, s, axis)
    return test_and_fuse(c, length, z, s, 0.0, gate, axis)


@kernel
def test_and_fuse(
    c: Core, length: int, z: float, s: float, shared: float, gate: float, axis: int
) -> tuple[float, float, float]:
    """Fuse an innovation z of variance s + shared unless z^2 / s > gate; arguments and result as above."""
    nis = z * z / s
    if (gate != NO_GATE and nis > gate) or not nis < math.inf:
        return z, s, -nis
    fuse(c, length, z, s + shared, axis)
    return z, s, nis


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
def pseudo_measurement(
    c: Core, kind: int, length: int, z: float, r: float, gate: float, axis: int
) -> tuple[float, float, float]:
    """`gated_update` of what is assumed instead of measured; its innovation is stored until it is asked for."""
    z, s, nis = correlated_update(c, length, z, r, 0.0, gate, axis)
    scratch, n = c.scratch, c.scratch.innovation_count
    scratch.innovation_count = write_innovation(scratch.innovations, n, c.nav.t_ns, kind, z, s, nis >= 0.0)
    return z, s, nis


@kernel
def clear_innovations(c: Core) -> None:
    """The innovations of the last sample have been read."""
    c.scratch.innovation_count = 0


@kernel
def correct_state(p: Parameters, c: Core) -> None:
    """Inject the error estimate into the nominal state; the alignment notes it, so that its integrals do not jump."""
    record_corrections(c)
    for i in range(3):
        c.odometer.corrections[i] += c.scratch.x[VELOCITY + i]
    c.heading_aid.yaw_corrections += c.scratch.x[ATTITUDE + 2]
    inject_error(p, c)
