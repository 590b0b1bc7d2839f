"""Faults of an odometer: which of the two is wrong where it contradicts the velocity, and a sensor that has stopped.

A rejected reading has two explanations: the wheels are wrong, or the velocity is. For the second P is inflated, if most
readings were used lately. The accelerometer decides how a reading may return: where readings have left the integrated
force faster than its error allows, the wheels became wrong at once, and only their return ends it: a reading near the
estimate, by P without that inflation. A slip is a share of the speed, so it shrinks as the vehicle brakes, which is no
return. Else the inflated velocity passes the gate, and the wheels correct it. A reading
that repeats the last one, to the last digit, while by the integrated force the speed has changed, or for much longer
than ever before, is that of a sensor that has stopped: none is used until it changes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ....math.rotation import quat_rotate
from ...records import SPEED_VALUE
from ...tuning import Tunable
from ..ekf import add_covariance, innovation, innovation_variance
from ..fusion import REJECT
from ..mechanization import quaternion
from ..state import NEVER_NS, VELOCITY

if TYPE_CHECKING:
    from ....math.arrays import Reals
    from ....math.rotation import Vector
    from ...types import Measurement
    from ..types import Core, Parameters

TUNABLES = (
    Tunable(
        "odometer_inflation_time_s",
        2.0,
        "s",
        "Length of a rejection after which the inflated velocity passes the gate.",
        "A slip is mostly shorter.",
    ),
    Tunable(
        "odometer_inflation_psd",
        0.5,
        "m^2/s^3",
        "Largest noise density by which a rejection inflates P.",
        "0.7 m/s in a second.",
    ),
    Tunable(
        "odometer_max_inflation_s", 10.0, "s", "Length of a rejection after which P is inflated no more.", "Choice."
    ),
    Tunable(
        "odometer_min_used_share",
        0.5,
        "",
        "Share of readings that pass the gate below which none is used.",
        "Wrong units agree now and then, near standstill.",
        high=1.0,
    ),
    Tunable(
        "odometer_share_s",
        10.0,
        "s",
        "Time over which the share of odometer readings that pass the gate is taken.",
        "Longer than a slip.",
    ),
    Tunable(
        "odometer_max_accel_error",
        0.3,
        "m/s^2",
        "Largest error of the acceleration; what leaves it faster is an error of the wheels.",
        "A tilt of 1.7 deg.",
    ),
    Tunable(
        "odometer_frozen_s",
        2.0,
        "s",
        "Time over which the integrated force is compared with a reading that repeats itself.",
        "Its error grows with the time.",
    ),
    Tunable(
        "odometer_repetitions",
        3.0,
        "",
        "Ratio to the longest repetition of a reading so far beyond which a sensor has stopped.",
        "Choice: coarse readings repeat themselves at a constant speed.",
    ),
    Tunable(
        "odometer_return",
        0.5,
        "",
        "Share of the step that showed a fault, at the present speed, below which the wheels may have returned.",
        "Choice: nearer to none than to all of it.",
        high=1.0,
    ),
)


@kernel
def count_use(p: Parameters, c: Core, used: bool, dt: float) -> None:
    """Share of the readings that are used. dt: time since the last one, s."""
    g = c.odometer
    g.used_share += ((1.0 if used else 0.0) - g.used_share) * min(dt / p.tuning.odometer_share_s, 1.0)


@kernel
def mostly_used(p: Parameters, c: Core) -> bool:
    """Whether most readings pass the gate."""
    return bool(c.odometer.used_share >= p.tuning.odometer_min_used_share)


@kernel
def add_forward_variance(c: Core, forward: Vector, q: float) -> None:
    """Add q, m^2/s^2, to the variance of the velocity along the forward axis."""
    f = quat_rotate(quaternion(c), forward)
    for i in range(3):
        for k in range(i, 3):
            add_covariance(c, VELOCITY + i, VELOCITY + k, q * f[i] * f[k])


@kernel
def inflate_velocity(p: Parameters, c: Core, forward: Vector, z: float, dt: float) -> None:
    """After a rejection: the wheels slip, or the velocity is wrong. The longer it lasts, the more is added to P.

    z: innovation, m/s; dt: time since the last reading, s.
    """
    last_ns = c.odometer.last_used_ns
    if last_ns == NEVER_NS or 1e-9 * (c.nav.t_ns - last_ns) > p.tuning.odometer_max_inflation_s:
        return
    if not mostly_used(p, c):
        return
    most = z * z / (p.tuning.odometer_gate * p.tuning.odometer_inflation_time_s)
    q = min(most, p.tuning.odometer_inflation_psd) * min(dt, p.tuning.odometer_inflation_time_s)
    c.odometer.inflation += q
    add_forward_variance(c, forward, q)


@kernel
def correction_since(c: Core, forward: Vector, before: Reals) -> float:
    """Corrections of the velocity since their sum was `before`, along the forward axis, m/s."""
    v, f = c.odometer.corrections, quat_rotate(quaternion(c), forward)
    return f[0] * (v[0] - before[0]) + f[1] * (v[1] - before[1]) + f[2] * (v[2] - before[2])


@kernel
def error_since_used(c: Core, forward: Vector, z: float) -> float:
    """What readings and integrated force have come apart by since the last used reading, m/s. z: innovation."""
    corrected = (1.0 + c.nav.odometer_scale) * correction_since(c, forward, c.odometer.used_corrections)
    return z + corrected - c.odometer.residual


@kernel
def speed_of(c: Core) -> float:
    """Estimated speed, m/s."""
    v = c.nav.v_n
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@kernel
def step_noise(p: Parameters, r: float) -> float:
    """Largest change, m/s, between two readings of this variance that their noise explains."""
    return math.sqrt(2.0 * p.tuning.odometer_gate * r)


@kernel
def return_limit(p: Parameters, c: Core, r: float) -> float:
    """Error, m/s, below which readings that became wrong at once may have returned; r: variance of a reading.

    The error is taken for a slip, which is a share of the speed: the limit shrinks as the vehicle slows. Of a constant
    error that is the stricter limit.
    """
    g = c.odometer
    size = g.step * min(speed_of(c) / max(g.step_speed, p.tuning.odometer_dead_speed), 1.0)
    return p.tuning.odometer_return * max(size, step_noise(p, r))


@kernel
def check_step(p: Parameters, c: Core, forward: Vector, z: float, r: float) -> None:
    """At a rejected reading: did the readings leave the integrated force at once? z: innovation, m/s; r: variance.

    The innovation without the corrections since the last used reading, less what was left of that, is the error that
    readings and integrated force have gathered since.
    """
    g = c.odometer
    if g.step > 0.0 or g.last_used_ns == NEVER_NS:
        return
    most = step_noise(p, r)
    most += p.tuning.odometer_max_accel_error * 1e-9 * abs(c.nav.t_ns - g.last_used_ns)
    if abs(error_since_used(c, forward, z)) > most:
        g.step, g.step_speed, g.inflation = abs(z), speed_of(c), 0.0


@kernel
def step_gate(p: Parameters, c: Core, forward: Vector, z: float, s: float, r: float) -> float:
    """Gate of a reading with innovation z of variance s, r of the reading: while they are wrong at once, their return.

    Without the inflation P would let any reading pass. Where readings are back at the integrated force and the estimate
    is not, what has corrected it meanwhile may be wrong: a receiver that began to drift while the wheels slipped.
    """
    g = c.odometer
    if g.step == 0.0:
        return p.tuning.odometer_gate
    limit, error = return_limit(p, c, r), abs(error_since_used(c, forward, z))
    if error < limit:  # the readings are back at the force
        if error < step_noise(p, r) and z * z > p.tuning.odometer_gate * s:
            add_forward_variance(c, forward, z * z)
        g.step = g.inflation = 0.0
        return p.tuning.odometer_gate
    near = abs(z) < limit and z * z < p.tuning.odometer_gate * max(s - g.inflation, r)
    return p.tuning.odometer_gate if near else REJECT


@kernel
def store_residual(c: Core, residual: float) -> None:
    """After a reading was used, and its correction injected. residual: what is left of its innovation, m/s."""
    g = c.odometer
    g.residual, g.step, g.inflation = residual, 0.0, 0.0
    for i in range(3):
        g.used_corrections[i] = g.corrections[i]


@kernel
def is_frozen(p: Parameters, c: Core, m: Measurement, forward: Vector, predicted: float, r: float) -> bool:
    """Whether the sensor has repeated its last reading, to the last digit, in spite of the force, or for too long.

    predicted: of this reading, m/s; r: its variance. Slow wheels may be reported as standing: as 0, without noise.
    """
    g, reading = c.odometer, m.value[SPEED_VALUE]
    same = reading == g.reading and g.reading_ns != NEVER_NS
    if g.reading_ns != NEVER_NS and not same:
        g.resolution = min(g.resolution, abs(reading - g.reading))
        if g.reading != 0.0 and not g.frozen:
            g.longest_repetition = max(g.longest_repetition, 1e-9 * (m.t_ns - g.changed_ns))
    if not same:
        g.frozen, g.changed_ns = 0, m.t_ns
    if not same or 1e-9 * abs(m.t_ns - g.reading_ns) > p.tuning.odometer_frozen_s:
        g.reading, g.reading_ns, g.predicted = reading, m.t_ns, predicted
        for i in range(3):
            g.reading_corrections[i] = g.corrections[i]
    change = predicted - g.predicted
    change -= (1.0 + c.nav.odometer_scale) * correction_since(c, forward, g.reading_corrections)
    accel_error = p.tuning.odometer_max_accel_error * 1e-9 * abs(m.t_ns - g.reading_ns)
    coarse = max(g.resolution, p.tuning.odometer_dead_speed if reading == 0.0 else 0.0)
    noise = r - 0.25 * p.tuning.odometer_dead_speed**2 if abs(reading) <= p.tuning.odometer_dead_speed else r
    if abs(change) > math.sqrt(p.tuning.odometer_gate * noise) + accel_error + coarse:
        g.frozen = 1
    longest = max(p.tuning.odometer_frozen_s, p.tuning.odometer_repetitions * g.longest_repetition)
    if reading != 0.0 and 1e-9 * (m.t_ns - g.changed_ns) > longest:
        g.frozen = 1
    return bool(g.frozen)


@kernel
def reading_gate(
    p: Parameters, c: Core, m: Measurement, forward: Vector, predicted: float, length: int, z: float, r: float
) -> float:
    """Gate of a reading, or REJECT; arguments: see `is_frozen` and `step_gate`; its Jacobian has `length` elements."""
    if is_frozen(p, c, m, forward, predicted, r):
        return REJECT
    return step_gate(p, c, forward, innovation(c, length, z), innovation_variance(c, length) + r, r)


@kernel
def after_reading_over_ground(
    p: Parameters, c: Core, m: Measurement, forward: Vector, z: float, r: float, dt: float, used: bool
) -> None:
    """After a reading was used or rejected, and its correction injected. One through the water tells none of this."""
    if used:
        c.odometer.last_used_ns = m.t_ns
    elif not c.odometer.frozen:
        check_step(p, c, forward, z, r)
        inflate_velocity(p, c, forward, z, dt)
