"""Evidence that a vehicle rolls on the ground: whether a boat, a walker, a drone or a motorcycle would move like this.

*Current.* Whatever floats or flies is carried by a current. On a land vehicle whose forward axis is off by an angle mu,

    lateral velocity = mu (forward velocity) + L (turn rate) + c_e cos(psi) - c_n sin(psi),    c = 0,

with the level body axes at the azimuth psi: a vehicle that turns separates a current c from mu and from the lever arm
L. Least squares over the velocities of about `evidence_time_s` give c, and the ratio of two likelihoods decides: that
of a land vehicle, whose c is only slip, and that of a body in a current. Before a turn the ratio is 1.

*Heave.* Waves and steps move a body up and down by centimetres, an uneven road by less at low speed. Vertical
velocity, integrated with a memory of `heave_time_s`, is compared with what wheels of that speed do.

*Coordinated turn.* A car's lateral specific force in a turn is forward velocity times turn rate; that of what leans
into turns, a motorcycle or an aircraft, is zero.

An odometer that agrees with the velocity shows a land vehicle, too, but no heave and no lean.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.kalman import packed_index
from ....math.rotation import cross, dot, quat_rotate, quat_rotate_back
from ...tuning import Tunable
from ..mechanization import quaternion
from ..state import EE, NE, NN
from .wheel_check import wheels_support

if TYPE_CHECKING:
    from ....math.rotation import Vector
    from ..types import Core, Parameters


TUNABLES = (
    Tunable("evidence_time_s", 40.0, "s", "Memory of the evidence for a land vehicle.", "Some turns."),
    Tunable(
        "evidence_correlation",
        1.0,
        "windows",
        "Windows of velocities that share their error.",
        "More find slow robots too late.",
    ),
    Tunable(
        "land_log_likelihood",
        0.9,
        "",
        "Log likelihood ratio that shows a land vehicle.",
        "Odds of 2.5 to 1; a recorded slow robot, simulated boats.",
    ),
    Tunable("land_slip", 0.05, "m/s", "Apparent current of a land vehicle.", "Recorded drives."),
    Tunable(
        "land_slip_share", 0.02, "", "Apparent current of a land vehicle, as a share of its speed.", "Recorded drives."
    ),
    Tunable("current_share", 0.3, "", "Current of a body that is no land vehicle, as a share of its speed.", "Boats."),
    Tunable("evidence_mount_sigma", 0.5, "rad", "Sigma of the angle of the forward axis, mu.", "30 deg."),
    Tunable("evidence_lever_arm_sigma", 1.5, "m", "Sigma of the lever arm, L.", "A car's rear axle."),
    Tunable("heave_time_s", 0.2, "s", "Time constant of the heave.", "Waves and steps of 0.8 Hz and above."),
    Tunable("heave_memory_s", 10.0, "s", "Time over which the heave is averaged.", "Some waves."),
    Tunable("max_heave", 0.006, "m", "Largest heave of a land vehicle.", "Walks have half as much again."),
    Tunable("max_heave_time", 0.0005, "s", "Largest heave of a land vehicle, per m/s of its speed.", "Rough roads."),
    Tunable(
        "max_heave_velocity_sigma",
        0.2,
        "m/s",
        "Largest sigma of the vertical velocity with which heave is observed.",
        "The corrections of a worse one look like it.",
    ),
    Tunable(
        "coordination_sigma",
        0.3,
        "m/s^2",
        "Least sigma of the lateral specific force in a window that no turn explains.",
        "Roll of 2 deg.",
    ),
)
ALONG, TURN, CURRENT_COS, CURRENT_SIN, LATERAL = range(5)  # the current's columns are those of c_e and -c_n


@kernel
def clear_evidence(c: Core) -> None:
    """Forget all evidence."""
    e = c.land_evidence
    e.products[:] = 0.0
    e.weight = e.heave_variance = 0.0
    e.leaky_height = e.mean_height = e.count = 0.0
    e.log_likelihood = 0.0
    e.turn_count = e.turn_sum = e.turn_force_sum = e.turn2_sum = e.turn_times_force_sum = e.turn_force2_sum = 0.0


@kernel
def level_axes(c: Core) -> tuple[float, float]:
    """Cosine and sine of the azimuth of the level body axes."""
    a = c.land_evidence.level_axis
    north, east, _ = quat_rotate(quaternion(c), (a[0], a[1], a[2]))
    length = max(elementary.hypot(north, east), 1e-6)
    return north / length, east / length


@kernel
def set_level_axis(c: Core, down: Vector) -> None:
    """The level body axis: the projection of that body axis which is most level; down: of the body."""
    k = 0
    for i in range(1, 3):
        if abs(down[i]) < abs(down[k]):
            k = i
    for i in range(3):
        c.land_evidence.level_axis[i] = (1.0 if i == k else 0.0) - down[k] * down[i]


@kernel
def slip_variance(p: Parameters, speed2: float) -> float:
    """Variance, m^2/s^2, of a component of a land vehicle's apparent current."""
    return p.tuning.land_slip**2 + p.tuning.land_slip_share**2 * speed2


@kernel
def current_variance(p: Parameters, speed2: float) -> float:
    """The same of a body that is no land vehicle."""
    return p.tuning.land_slip**2 + p.tuning.current_share**2 * speed2


@kernel
def add_evidence(p: Parameters, c: Core, v: Vector, level2: float, down: Vector) -> None:
    """Add a velocity v of a window (m/s, NED; level2: variance of a component) to the sums; down: body axes."""
    e = c.land_evidence
    if e.weight == 0.0:
        set_level_axis(c, down)
    decay = 1.0 - p.tuning.rest_window_s / p.tuning.evidence_time_s
    cos, sin = level_axes(c)
    row = np.empty(5)
    row[ALONG], row[LATERAL] = v[0] * cos + v[1] * sin, v[1] * cos - v[0] * sin
    row[TURN] = dot(down, (c.imu.rate_b[0], c.imu.rate_b[1], c.imu.rate_b[2]))
    row[CURRENT_COS], row[CURRENT_SIN] = cos, sin
    w = 1.0 / (p.tuning.evidence_correlation * (level2 + slip_variance(p, v[0] ** 2 + v[1] ** 2)))
    for i in range(5):
        for j in range(i, 5):
            k = packed_index(5, i, j)
            e.products[k] = decay * e.products[k] + w * row[i] * row[j]
    e.weight = decay * e.weight + w
    e.count = decay * e.count + 1.0 / p.tuning.evidence_correlation
    add_turn(c, quat_rotate_back(quaternion(c), v), row[TURN], decay)


@kernel
def add_turn(c: Core, u: Vector, rate: float, decay: float) -> None:
    """Add the lateral force of a window at velocity u (m/s, body) and turn rate, rad/s, to the sums of turns."""
    h, f, ba = c.nhc, c.stationarity.mean_f, c.nav.ba
    axis = (h.principal_axis[0], h.principal_axis[1], h.principal_axis[2])
    across = cross((h.down_sum[0], h.down_sum[1], h.down_sum[2]), axis)  # leans with the body
    axis2, across2 = max(dot(axis, axis), 1e-12), max(dot(across, across), 1e-12)
    turn = rate * dot(axis, u) / math.sqrt(axis2)
    force = dot(across, (f[0] - ba[0], f[1] - ba[1], f[2] - ba[2])) / math.sqrt(across2)
    e = c.land_evidence
    e.turn_count = decay * e.turn_count + 1.0
    e.turn_sum = decay * e.turn_sum + turn
    e.turn_force_sum = decay * e.turn_force_sum + force
    e.turn2_sum = decay * e.turn2_sum + turn * turn
    e.turn_times_force_sum = decay * e.turn_times_force_sum + turn * force
    e.turn_force2_sum = decay * e.turn_force2_sum + force * force


@kernel
def log_evidence(I00: float, I01: float, I11: float, z0: float, z1: float, variance: float) -> float:
    """Log likelihood of a current of this variance per component, m^2/s^2, relative to that of none."""
    k = 1.0 / variance
    a, b = I00 + k, I11 + k
    det = a * b - I01 * I01
    return float(0.5 * (b * z0 * z0 - 2.0 * I01 * z0 * z1 + a * z1 * z1) / det - 0.5 * elementary.log(det / (k * k)))


@kernel
def judge_evidence(p: Parameters, c: Core) -> None:
    """Once per window: the log likelihood ratio of a land vehicle against a body in a current."""
    e = c.land_evidence
    down, axis, level = c.nhc.down_sum, c.nhc.principal_axis, e.level_axis
    x = axis[0] * level[0] + axis[1] * level[1] + axis[2] * level[2]
    right = cross((down[0], down[1], down[2]), (level[0], level[1], level[2]))
    y = dot(right, (axis[0], axis[1], axis[2])) / max(c.nhc.scatter_weight, 1e-6)
    length = max(elementary.hypot(x, y), 1e-6)
    rotated = np.empty(25)
    for i in range(5):
        for j in range(5):
            rotated[5 * i + j] = e.products[packed_index(5, min(i, j), max(i, j))]
    cos, sin = x / length, y / length
    for j in range(5):  # velocity along and across the principal axis
        a, b = rotated[5 * ALONG + j], rotated[5 * LATERAL + j]
        rotated[5 * ALONG + j], rotated[5 * LATERAL + j] = cos * a + sin * b, cos * b - sin * a
    for j in range(5):
        a, b = rotated[5 * j + ALONG], rotated[5 * j + LATERAL]
        rotated[5 * j + ALONG], rotated[5 * j + LATERAL] = cos * a + sin * b, cos * b - sin * a
    speed2 = rotated[5 * ALONG + ALONG] / e.weight
    rotated[5 * ALONG + ALONG] += 1.0 / p.tuning.evidence_mount_sigma**2
    rotated[5 * TURN + TURN] += 1.0 / p.tuning.evidence_lever_arm_sigma**2
    for k in range(2):  # eliminate mu and L
        for i in range(k + 1, 5):
            share = rotated[5 * i + k] / rotated[5 * k + k]
            for j in range(k + 1, 5):
                rotated[5 * i + j] -= share * rotated[5 * k + j]
    scale = 1.0 / max(rotated[5 * LATERAL + LATERAL] / max(e.count, 1.0), 1.0)
    I00, I01, I11 = rotated[5 * 2 + 2] * scale, rotated[5 * 2 + 3] * scale, rotated[5 * 3 + 3] * scale
    z0, z1 = rotated[5 * 2 + 4] * scale, rotated[5 * 3 + 4] * scale
    e.log_likelihood = log_evidence(I00, I01, I11, z0, z1, slip_variance(p, speed2))
    e.log_likelihood -= log_evidence(I00, I01, I11, z0, z1, current_variance(p, speed2))
    e.current_vector[0], e.current_vector[1] = -sin * z0 - cos * z1, cos * z0 - sin * z1
    e.current_information[NN] = sin * sin * I00 + 2.0 * sin * cos * I01 + cos * cos * I11
    e.current_information[NE] = sin * cos * (I11 - I00) + (sin * sin - cos * cos) * I01
    e.current_information[EE] = cos * cos * I00 - 2.0 * sin * cos * I01 + sin * sin * I11


@kernel
def add_heave(p: Parameters, c: Core, vertical: float, speed: float, dt: float) -> None:
    """Add the vertical velocity in the body, m/s, after another `dt` s, at a speed, m/s; after a gap begin anew."""
    e, share = c.land_evidence, dt / p.tuning.heave_time_s
    if share > 1.0:
        e.leaky_height = e.mean_height = 0.0
        return
    e.leaky_height += vertical * dt - share * e.leaky_height
    e.mean_height += share * (e.leaky_height - e.mean_height)
    most = p.tuning.max_heave + p.tuning.max_heave_time * speed
    heave = (e.leaky_height - e.mean_height) / most
    e.heave_variance += dt / p.tuning.heave_memory_s * (min(heave * heave, 4.0) - e.heave_variance)


@kernel
def heaves(c: Core) -> bool:
    """Whether the body moves up and down by more than a land vehicle."""
    return bool(c.land_evidence.heave_variance > 1.0)


@kernel
def coordinates_turns(p: Parameters, c: Core, sigmas: float) -> bool:
    """Whether less than half of the force of turns is lateral, by so many sigmas."""
    e = c.land_evidence
    n = max(e.turn_count, 1.0) + p.tuning.evidence_correlation  # about the means: a tilt or bias of coordination_sigma
    square = max(e.turn2_sum - e.turn_sum * e.turn_sum / n, 1e-12)
    product = e.turn_times_force_sum - e.turn_sum * e.turn_force_sum / n
    energy = e.turn_force2_sum - e.turn_force_sum * e.turn_force_sum / n
    residual = max((energy - product * product / square) / n, p.tuning.coordination_sigma**2)
    return bool(0.5 * square - product > sigmas * math.sqrt(p.tuning.evidence_correlation * residual * square))


@kernel
def set_log_likelihood(c: Core, ratio: float) -> None:
    """Set the log likelihood ratio of a land vehicle, which another test has found."""
    c.land_evidence.log_likelihood = ratio


@kernel
def shows_land_vehicle(p: Parameters, c: Core) -> bool:
    """Whether the evidence is that of a land vehicle."""
    if heaves(c) or coordinates_turns(p, c, 1.0):
        return False
    return wheels_support(p, c) or bool(c.land_evidence.log_likelihood > p.tuning.land_log_likelihood)


@kernel
def refutes_land_vehicle(p: Parameters, c: Core) -> bool:
    """Whether the evidence is that of none."""
    floats = c.land_evidence.log_likelihood < -p.tuning.land_log_likelihood and not wheels_support(p, c)
    return bool(floats or heaves(c) or coordinates_turns(p, c, p.tuning.limit_sigmas))
