"""The gravity monitor: a rate that the direction of gravity in the body does not confirm is an error of the gyro bias.

While the means of the windows hardly change, the integral of the rate less the known bias predicts the rotation of
gravity in the body. If gravity has not rotated, there was no rotation, and the bias is wrong: the sensor restarted
without notice, or it warms up. This is found as soon as the predicted rotation exceeds the noise, within a second for
0.2 deg/s. A rate about the vertical does not rotate gravity and cannot be tested. In coordinated flight the force stays
fixed in the body while it rolls, so the last speed that the receiver reported must be low.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.earth import EARTH_RATE_RADPS, gravity
from ....math.rotation import Vector, cross, dot
from ...tuning import Tunable
from ..alignment.velocity_pairs import restart_in_motion_alignment
from ..ekf import add_variance, decorrelate, innovation_variance, set_jacobian3, variance
from ..fusion import NO_GATE, correct_state, gated_update
from ..glr_tests.reset import reset_glr_tests
from ..glr_tests.velocity_drift import reset_confirmations
from ..mechanization import ned_to_body
from ..state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS

if TYPE_CHECKING:
    from ..types import Core, Parameters


TUNABLES = (
    Tunable(
        "gravity_memory_s",
        5.0,
        "s",
        "Longest time over which rotation and direction of gravity are compared.",
        "Choice.",
    ),
    Tunable(
        "fixed_gravity_gate",
        8.0,
        "sigma",
        "Expected rotation of gravity from which it is compared with the measured one.",
        "Choice.",
    ),
    Tunable(
        "fixed_gravity_share",
        0.5,
        "",
        "Share of the expected rotation of gravity that must be missing to prove a wrong bias.",
        "Half: as likely seen as not.",
        high=1.0,
    ),
    Tunable(
        "min_rate_across_gravity",
        0.5,
        "",
        "Least sine of the angle between rate and gravity for which gravity rotates in the body.",
        "Choice.",
    ),
    Tunable(
        "max_gravity_excess",
        0.3,
        "m/s^2",
        "Largest specific force beyond gravity and bias that is not a coordinated turn.",
        "14 deg bank.",
    ),
    Tunable(
        "max_speed_of_gravity", 2.0, "m/s", "Largest speed of a body that does not fly coordinated turns.", "Choice."
    ),
    Tunable(
        "recent_rest_s",
        10.0,
        "s",
        "Longest time for which a wrong bias is taken to have turned the attitude.",
        "Choice.",
    ),
    Tunable("wrong_bias_gate", 16.0, "NIS", "Gate of the bias that a fixed gravity shows.", "Four sigma."),
)


@kernel
def window_variance(p: Parameters, c: Core) -> float:
    """Variance of the mean force of this window per axis, by noise and vibration, m^2/s^4."""
    s = c.stationarity
    scatter = s.sum_f2 / s.sample_count
    for i in range(3):
        scatter -= s.mean_f[i] * s.mean_f[i]
    return max(p.accel_psd / s.duration, scatter / (3.0 * s.sample_count))


@kernel
def restart_gravity_monitor(p: Parameters, c: Core) -> None:
    """Compare later windows with this one."""
    g, s = c.gravity_monitor, c.stationarity
    g.time = 0.0
    g.variance = window_variance(p, c)
    for i in range(3):
        g.angle[i] = 0.0
        g.mean_w[i], g.first_f[i] = s.mean_w[i], s.mean_f[i]


@kernel
def add_window(p: Parameters, c: Core) -> None:
    """Add the rotation from the window before to this one."""
    g, s = c.gravity_monitor, c.stationarity
    g.time += s.duration
    g.variance = max(g.variance, window_variance(p, c))
    for i in range(3):
        g.angle[i] += 0.5 * (g.mean_w[i] + s.mean_w[i]) * s.duration
        g.mean_w[i] = s.mean_w[i]


@kernel
def is_gravity_alone(p: Parameters, c: Core) -> bool:
    """Whether the magnitude of the mean force is that of gravity, within the error of the accelerometer."""
    f, ba, bias2 = c.stationarity.mean_f, c.nav.ba, 0.0
    for i in range(3):
        bias2 = max(bias2, variance(c, ACCEL_BIAS + i))
    magnitude = math.sqrt((f[0] - ba[0]) ** 2 + (f[1] - ba[1]) ** 2 + (f[2] - ba[2]) ** 2)
    excess = abs(magnitude - gravity(c.nav.lat, c.nav.height))
    return bool(excess < p.tuning.max_gravity_excess + p.tuning.limit_sigmas * math.sqrt(bias2))


@kernel
def may_fly(p: Parameters, c: Core) -> bool:
    """Whether the body may be in coordinated flight: by the receiver's last speed, else by the filter's."""
    v, speed = c.nav.v_n, c.gnss.speed
    if math.isnan(speed):
        speed = math.sqrt(v[0] * v[0] + v[1] * v[1])
    return bool(speed > p.tuning.max_speed_of_gravity)


@kernel
def bias_error(p: Parameters, c: Core) -> Vector:
    """The error of the gyro bias across gravity, rad/s, if gravity stayed where it was in the body; else zero."""
    g, f = c.gravity_monitor, (c.stationarity.mean_f[0], c.stationarity.mean_f[1], c.stationarity.mean_f[2])
    north, down = EARTH_RATE_RADPS * elementary.cos(c.nav.lat), -EARTH_RATE_RADPS * elementary.sin(c.nav.lat)
    earth, bg = ned_to_body(c, (north, 0.0, down)), c.nav.bg
    angle = (
        g.angle[0] - (bg[0] + earth[0]) * g.time,
        g.angle[1] - (bg[1] + earth[1]) * g.time,
        g.angle[2] - (bg[2] + earth[2]) * g.time,
    )
    expected_change, f2 = cross(f, angle), dot(f, f)  # m/s^2: by which the force would have changed
    change = (f[0] - g.first_f[0], f[1] - g.first_f[1], f[2] - g.first_f[2])
    expected2 = dot(expected_change, expected_change)
    across = expected2 > p.tuning.min_rate_across_gravity**2 * dot(angle, angle) * f2
    seen = expected2 > p.tuning.fixed_gravity_gate**2 * 2.0 * g.variance
    fixed = dot(change, change) < p.tuning.fixed_gravity_share**2 * expected2
    if may_fly(p, c) or not (across and seen and fixed and is_gravity_alone(p, c)):
        return (0.0, 0.0, 0.0)
    error = cross((expected_change[0] - change[0], expected_change[1] - change[1], expected_change[2] - change[2]), f)
    scale = 1.0 / (f2 * g.time)
    return (scale * error[0], scale * error[1], scale * error[2])


@kernel
def across_gravity(c: Core, k: int) -> Vector:
    """One of two unit vectors across the mean force and each other, body axes; k: 0 or 1."""
    f = (c.stationarity.mean_f[0], c.stationarity.mean_f[1], c.stationarity.mean_f[2])
    e = cross(f, (1.0, 0.0, 0.0)) if abs(f[0]) < abs(f[1]) else cross(f, (0.0, 1.0, 0.0))
    if k == 1:
        e = cross(f, e)
    scale = 1.0 / math.sqrt(dot(e, e))
    return (scale * e[0], scale * e[1], scale * e[2])


@kernel
def contradicts_bias(p: Parameters, c: Core, error: Vector, r: float) -> bool:
    """Whether the error (rad/s, variance r) is more than the bias's own uncertainty explains."""
    if dot(error, error) == 0.0:
        return False
    for k in range(2):
        e = across_gravity(c, k)
        z = dot(e, error)
        if z * z > p.tuning.wrong_bias_gate * (innovation_variance(c, set_jacobian3(c, 0, GYRO_BIAS, e)) + r):
            return True
    return False


@kernel
def monitor_gravity(p: Parameters, c: Core) -> None:
    """At the end of a window, once classified: correct a gyro bias that fixed gravity contradicts.

    The attitude has turned by the error since the last rest, and the bias about the vertical may have changed as well.
    """
    g = c.gravity_monitor
    if c.stationarity.at_rest:
        g.last_rest_ns = c.nav.t_ns
    if c.stationarity.low_motion_count < 2:
        restart_gravity_monitor(p, c)
        return
    add_window(p, c)
    error = bias_error(p, c)
    f = c.stationarity.mean_f
    r = 2.0 * g.variance / ((f[0] * f[0] + f[1] * f[1] + f[2] * f[2] + 1e-9) * g.time**2)
    if contradicts_bias(p, c, error, r):
        since_rest = 1e-9 * (c.nav.t_ns - g.last_rest_ns)
        turned = min(since_rest, p.tuning.recent_rest_s) ** 2 * dot(error, error)
        for i in range(3):
            decorrelate(c, GYRO_BIAS + i, p.gyro_bias_sigma**2)
            add_variance(c, ATTITUDE + i, turned)
        for k in range(2):
            e = across_gravity(c, k)
            gated_update(c, set_jacobian3(c, 0, GYRO_BIAS, e), dot(e, error), r, NO_GATE)
        correct_state(p, c)
        restart_in_motion_alignment(c)
        reset_glr_tests(c)
        reset_confirmations(c)
        restart_gravity_monitor(p, c)
    elif g.time > p.tuning.gravity_memory_s:
        restart_gravity_monitor(p, c)
