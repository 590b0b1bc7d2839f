"""Speed of a wheel, an odometer or a log: along the forward axis of the vehicle, signed or not.

z = reading - (1 + scale) u, with u = e_x' (C' v + w x l): e_x is the forward axis, l the wheel's place in the body. A
measurement has value[0]: speed, m/s, value[1]: of two wheels left less right (`two_wheels.py`), else NaN, and sigma[0]:
m/s, NaN where it is not reported. Used while navigating.

*Axis.* e_x is the body's x axis as the settings say, or as the constraint of a land vehicle has found it. Its errors
MOUNT_YAW and MOUNT_PITCH are estimated in any case: a sensor that was mounted 10 deg off would else turn the heading.
At 90 deg a reading tells no direction, and is not used, until a land vehicle's axis is found.

*Current.* A speed through the water differs from that over ground by the water's own speed, sigma[1]: an error that
lasts. So many readings in its time know no more than one; and none of them tells whether the receiver drifts.

*Scale.* The error of a wheel's radius is an error state. *Slip.* Tyres slip in proportion to the force on them, for
about a second, so that readings in that time are not independent: the gate has the variance of a single reading, the
update that of what so many of them know together. More slip than that is rejected. *Sign.* Many sensors do not tell
backward from forward. Where the filter's own velocity does, it decides; where it does not, a reading without a sign is
left out. *Time.* The reading may be late by an unknown time, an error in proportion to the acceleration.

*Faults.* See `odometer_faults`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ....math.rotation import Vector, dot, quat_rotate, quat_rotate_back
from ...records import ODOMETER, SPEED_VALUE
from ...tuning import Tunable
from ..ekf import add_variance, innovation_variance, set_jacobian
from ..fusion import REJECT, correct_state, correlated_update, write_innovation
from ..mechanization import quaternion
from ..state import ATTITUDE, MOUNT_PITCH, MOUNT_YAW, NEVER_NS, ODOMETER_SCALE, OTHER_AXIS, VELOCITY
from ..vehicle_axes import forward_axis, lateral_axis, vertical_axis
from .external_aid import others_of_error
from .odometer_faults import after_reading_over_ground, count_use, mostly_used, reading_gate, store_residual
from .records import CONTRADICTED, NO_DIRECTION
from .two_wheels import fuse_yaw_rate, least_of_both, tells_yaw_rate

if TYPE_CHECKING:
    from ....math.arrays import Reals
    from ...types import Innovation, Measurement
    from ..types import Core, Parameters

TUNABLES = (
    Tunable("odometer_sigma", 0.05, "m/s", "Sigma of a reading that reports none.", "Pulses of an ABS ring at 10 Hz."),
    Tunable("odometer_scale_sigma", 0.05, "", "Sigma of the scale factor at the start.", "Worn or other tyres: 3 %."),
    Tunable(
        "odometer_scale_psd",
        (0.003 / 60.0) ** 2,
        "1/s",
        "Random walk of the scale factor, with pressure, temperature and load.",
        "0.3 % in an hour.",
    ),
    Tunable(
        "odometer_slip",
        0.004,
        "",
        "Sigma of the slip of a driven wheel at a constant speed, as a share of the speed.",
        "Rolling resistance.",
    ),
    Tunable(
        "odometer_slip_per_accel",
        0.004,
        "1/(m/s^2)",
        "Sigma of the slip per acceleration.",
        "A tyre that slips by 10 % at 1 g, one axle braking more than its share: Wong (2008), ch. 1.",
    ),
    Tunable("odometer_slip_time_s", 1.0, "s", "Correlation time of slip.", "A manoeuvre."),
    Tunable(
        "odometer_current_s", 600.0, "s", "Correlation time of a current of the water.", "Tides: hours; rivers: bends."
    ),
    Tunable(
        "odometer_time_sigma", 0.03, "s", "Sigma of the unknown age of a reading.", "Choice: half a period of 20 Hz."
    ),
    Tunable(
        "odometer_dead_speed",
        0.3,
        "m/s",
        "Speed below which wheels are reported as standing.",
        "Pulses of an ABS ring.",
    ),
    Tunable("odometer_gate", 12.0, "NIS", "Gate of a wheel speed.", "3.5 sigma: slip is common."),
    Tunable(
        "odometer_sign_sigmas",
        3.0,
        "sigma",
        "Least speed, in sigmas, of an estimate that gives an unsigned reading its sign.",
        "Three sigma.",
    ),
)


@kernel
def signed_reading(p: Parameters, c: Core, reading: float, along: float, sigma: float) -> float:
    """The reading with the sign of the motion along the forward axis; NaN where that is not known.

    along: predicted speed, of standard deviation `sigma`, m/s.
    """
    g = c.odometer
    if reading < 0.0:
        g.reverses = 1
    if abs(along) > p.tuning.odometer_sign_sigmas * sigma + p.tuning.odometer_dead_speed:
        ahead = 1.0 if along > 0.0 else -1.0
        if abs(reading) > p.tuning.odometer_dead_speed:
            g.direction = ahead if reading > 0.0 else -ahead
        return ahead * abs(reading)
    if g.reverses and g.direction != 0.0:
        return g.direction * reading
    return 0.0 if abs(reading) <= p.tuning.odometer_dead_speed else math.nan


@kernel
def odometer_jacobian(c: Core, forward: Vector, v_b: Vector, along: float) -> int:
    """Jacobian of a reading; returns its length. v_b: velocity of the wheel in the body; along: its forward part."""
    gain = 1.0 + c.nav.odometer_scale
    f, v = quat_rotate(quaternion(c), forward), c.nav.v_n
    length = 0
    for i in range(3):
        length = set_jacobian(c, length, VELOCITY + i, gain * f[i])
    length = set_jacobian(c, length, ATTITUDE, gain * (f[1] * v[2] - f[2] * v[1]))
    length = set_jacobian(c, length, ATTITUDE + 1, gain * (f[2] * v[0] - f[0] * v[2]))
    length = set_jacobian(c, length, ATTITUDE + 2, gain * (f[0] * v[1] - f[1] * v[0]))
    length = set_jacobian(c, length, ODOMETER_SCALE, along)
    length = set_jacobian(c, length, MOUNT_YAW, gain * dot(lateral_axis(c), v_b))  # e_x <- e_x + yaw e_y - pitch e_z
    return set_jacobian(c, length, MOUNT_PITCH, -gain * dot(vertical_axis(c), v_b))


@kernel
def wheel_velocity(c: Core, w: Vector, arm: Reals) -> Vector:
    """Velocity of the wheel in the body, m/s, at `arm` (m) from the sensor, which turns at w (rad/s)."""
    v = quat_rotate_back(quaternion(c), (c.nav.v_n[0], c.nav.v_n[1], c.nav.v_n[2]))
    return (
        v[0] + w[1] * arm[2] - w[2] * arm[1],
        v[1] + w[2] * arm[0] - w[0] * arm[2],
        v[2] + w[0] * arm[1] - w[1] * arm[0],
    )


@kernel
def forward_acceleration(c: Core, forward: Vector) -> float:
    """Acceleration along the forward axis, m/s^2."""
    return dot(forward, quat_rotate_back(quaternion(c), (c.imu.accel_n[0], c.imu.accel_n[1], c.imu.accel_n[2])))


@kernel
def time_since_reading(p: Parameters, c: Core, m: Measurement) -> float:
    """Time since the last reading, s; stores the epoch."""
    g = c.odometer
    dt = 1e-9 * (m.t_ns - g.last_ns) if g.last_ns != NEVER_NS else p.tuning.odometer_slip_time_s
    g.last_ns = m.t_ns
    return float(max(dt, 1e-3))


@kernel
def current_of(m: Measurement) -> float:
    """Sigma of the current, m/s, if the speed is one through the water; else 0."""
    return float(m.sigma[1] if m.sigma[1] > 0.0 else 0.0)


@kernel
def reading_noise(
    p: Parameters, c: Core, m: Measurement, reading: float, accel: float, dt: float
) -> tuple[float, float, float, float]:
    """Variances, (m/s)^2: of a single reading, what others that share its errors add, of slip; how many share slip.

    accel: acceleration, m/s^2. dt: time since the last reading, s.
    """
    sigma = m.sigma[0] if m.sigma[0] > 0.0 else p.tuning.odometer_sigma
    dead = 0.5 * p.tuning.odometer_dead_speed if abs(reading) <= p.tuning.odometer_dead_speed else 0.0
    slip_sigma = (p.tuning.odometer_slip + p.tuning.odometer_slip_per_accel * abs(accel)) * abs(reading)
    timing = accel * accel * (p.tuning.odometer_time_sigma**2 + c.scratch.age_variance)
    current = current_of(m)
    r = sigma * sigma + dead * dead + slip_sigma * slip_sigma + timing + current * current
    others = others_of_error(dt, p.tuning.odometer_slip_time_s)
    of_current = others_of_error(dt, p.tuning.odometer_current_s) * current * current
    return r, others * (slip_sigma * slip_sigma + timing) + of_current, slip_sigma * slip_sigma, others


@kernel
def fuse_odometer(p: Parameters, c: Core, m: Measurement, innovations: list[Innovation]) -> int:
    """Gate and fuse a reading; returns the rows of innovations."""
    dt = time_since_reading(p, c, m)
    add_variance(c, ODOMETER_SCALE, p.tuning.odometer_scale_psd * dt)
    forward = forward_axis(c)
    w = (c.imu.w[0] - c.nav.bg[0], c.imu.w[1] - c.nav.bg[1], c.imu.w[2] - c.nav.bg[2])
    wheel = wheel_velocity(c, w, p.odometer_lever_arm)
    along, accel = dot(forward, wheel), forward_acceleration(c, forward)
    length = odometer_jacobian(c, forward, wheel, along)
    sigma = math.sqrt(max(innovation_variance(c, length), 0.0))
    reading = signed_reading(p, c, m.value[SPEED_VALUE], along, sigma)
    if not math.isfinite(reading):
        c.odometer.unused = NO_DIRECTION
        return 0
    ahead_s = 1e-9 * (m.t_ns - c.nav.t_ns)  # 0 but for an epoch after the newest sample
    predicted = (1.0 + c.nav.odometer_scale) * (along + accel * ahead_s)
    z, n = reading - predicted, 0
    r, shared, slip2, others = reading_noise(p, c, m, reading, accel, dt)
    if tells_yaw_rate(p, c, m):
        contradiction = fuse_yaw_rate(p, c, m, w, (r, slip2, others), dt, innovations)
        z, n = least_of_both(z, contradiction), 1
        length = odometer_jacobian(c, forward, wheel, along)
    gate = reading_gate(p, c, m, forward, predicted, length, z, r)
    z, s, nis = correlated_update(c, length, z, r, shared, gate if mostly_used(p, c) else REJECT, OTHER_AXIS)
    used = nis >= 0.0
    if used or n > 0:
        correct_state(p, c)
    count_use(p, c, gate != REJECT and z * z <= gate * s, dt)
    c.odometer.unused = 0 if used else CONTRADICTED
    if used:
        store_residual(c, z * (r + shared) / (s + shared))
    if current_of(m) == 0.0:
        after_reading_over_ground(p, c, m, forward, z, r, dt, used)
    return write_innovation(innovations, n, m.t_ns, ODOMETER, z, s, used)
