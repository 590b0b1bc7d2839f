"""Air drag: what hangs on its rotors shows its velocity by the force across their thrust.

The force of a multicopter is its thrust, along one axis of the body, and drag, in proportion to its velocity through
the air: f_across = b - D v_across, D some 0.1 to 0.5 /s (Martin and Salaun 2010), b what the axis differs from that of
the mean force. So the force across the mean force shows a velocity that does not drift. Wind that lasts is a velocity
of all axes alike, and no acceleration.

Whether it is so is learned: the mean force across the thrust over `drag_block_s` and the mean of the integrated
velocity are both differenced from one block to the next, in NED, and the one is regressed on the other and on the turn
of b. In a hand or on wheels the force across the vertical is the acceleration, or a part of gravity, and no velocity.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.rotation import dcm_of_quat
from .state import REGRESSION

if TYPE_CHECKING:
    from .types import Parameters, State

VELOCITY_COLUMN, FORCE_COLUMN = 3, 4  # the first three are those of the constant force


@kernel
def update_drag(p: Parameters, s: State) -> None:
    """After one covariance interval: the force across the mean force, and once a block the regression."""
    c, drag, total, time, q = p.tuning, s.drag, s.integrals, s.integrals.time, s.nav.q_nb
    C = dcm_of_quat((q[0], q[1], q[2], q[3]))
    weight = time / (min(drag.mean_s, c.drag_mean_s) + time)
    drag.mean_s += time
    along = mean2 = 0.0
    for j in range(3):
        force = (C[j] * total.delta_v[0] + C[3 + j] * total.delta_v[1] + C[6 + j] * total.delta_v[2]) / time
        drag.mean_force[j] += weight * (force - drag.mean_force[j])
        along += force * drag.mean_force[j]
        mean2 += drag.mean_force[j] ** 2
    m = drag.mean_force
    for i in range(3):
        mean = C[3 * i] * m[0] + C[3 * i + 1] * m[1] + C[3 * i + 2] * m[2]
        drag.force[i] = total.delta_v[i] / time - along / mean2 * mean
        gained = total.delta_v[i] + (s.nav.gravity * time if i == 2 else 0.0)
        drag.block_force[i] += drag.force[i] * time
        drag.displacement[i] += (drag.gained[i] + 0.5 * gained) * time
        drag.gained[i] += gained
    for k in range(9):
        drag.block_c[k] += total.c[k]
    drag.block_s += time
    if drag.block_s >= c.drag_block_s:
        compare_blocks(p, s)
        find_drag(p, s)
        restart_block(s)


@kernel
def interrupt_drag(s: State) -> None:
    """The velocity is not integrated, or the attitude is a new one: the next block is compared with none before."""
    restart_block(s)
    s.drag.has_last = 0


@kernel
def restart_block(s: State) -> None:
    """The next block begins now."""
    drag = s.drag
    drag.block_s = 0.0
    for i in range(3):
        drag.block_force[i] = drag.gained[i] = drag.displacement[i] = 0.0
    for k in range(9):
        drag.block_c[k] = 0.0


@kernel
def compare_blocks(p: Parameters, s: State) -> None:
    """A block ends: add the changes of the mean force and of the mean velocity since the block before."""
    drag, row, m = s.drag, s.scratch.row, s.drag.mean_force
    mean2 = m[0] * m[0] + m[1] * m[1] + m[2] * m[2]
    if drag.has_last == 1:
        kept = max(1.0 - drag.block_s / p.tuning.drag_memory_s, 0.0)
        drag.blocks = kept * drag.blocks + 1.0
        for k in range(REGRESSION * REGRESSION):
            drag.products[k] *= kept
    along = 0.0  # of the velocity that was gained, times the mean force
    for i in range(3):
        for j in range(3):
            along += mean_gain(s, i) * drag.block_c[3 * i + j] / drag.block_s * m[j]
    for i in range(3):
        turned = thrust = 0.0
        for j in range(3):
            mean_c = drag.block_c[3 * i + j] / drag.block_s
            row[j] = mean_c - drag.last_c[3 * i + j]
            drag.last_c[3 * i + j] = mean_c
            turned += row[j] * m[j]
            thrust += mean_c * m[j]
        for j in range(3):
            row[j] -= turned * m[j] / mean2
        force = drag.block_force[i] / drag.block_s
        row[VELOCITY_COLUMN] = mean_gain(s, i) - along * thrust / mean2
        row[FORCE_COLUMN] = force - drag.last_force[i]
        drag.last_force[i] = force
        if drag.has_last == 1:
            add_products(s)
    for i in range(3):
        drag.last_gained[i] = drag.gained[i] - drag.displacement[i] / drag.block_s
    drag.has_last = 1


@kernel
def add_products(s: State) -> None:
    """One row of the regression."""
    row = s.scratch.row
    for j in range(REGRESSION):
        for k in range(REGRESSION):
            s.drag.products[REGRESSION * j + k] += row[j] * row[k]


@kernel
def mean_gain(s: State, i: int) -> float:
    """Of velocity along axis i of NED from the mean of the block before to that of this one, m/s."""
    return s.drag.last_gained[i] + s.drag.displacement[i] / s.drag.block_s


@kernel
def find_drag(p: Parameters, s: State) -> None:
    """The regression, by elimination: the constant force, then the velocity; and whether it is drag."""
    c, drag, A = p.tuning, s.drag, s.scratch.products
    n = REGRESSION
    for k in range(n * n):
        A[k] = drag.products[k]
    for j in range(3):
        A[n * j + j] += c.drag_constant_weight
    for j in range(VELOCITY_COLUMN):
        for i in range(j + 1, n):
            share = A[n * i + j] / A[n * j + j]
            for k in range(j, n):
                A[n * i + k] -= share * A[n * j + k]
    velocity2, force2 = A[n * VELOCITY_COLUMN + VELOCITY_COLUMN], A[n * FORCE_COLUMN + FORCE_COLUMN]
    product = A[n * VELOCITY_COLUMN + FORCE_COLUMN]
    drag.per_mass = 0.0
    correlated = product * product > c.min_drag_correlation2 * force2 * velocity2
    is_drag = -c.max_drag * velocity2 < product < 0.0
    if drag.blocks < c.min_drag_blocks or not correlated or not is_drag:
        return
    per_mass = -product / velocity2
    drag.per_mass = per_mass
    residual2 = max(force2 - per_mass * per_mass * velocity2, 0.0) / drag.blocks
    white = 0.25 * residual2 * c.drag_block_s / (per_mass * per_mass)  # of the mean of a block, two components
    drag.psd = c.drag_noise**2 * white + c.gust_noise**2
    for i in range(3):
        j = 2 - i
        rest = A[n * j + FORCE_COLUMN] + per_mass * A[n * j + VELOCITY_COLUMN]
        for k in range(j + 1, 3):
            rest -= A[n * j + k] * drag.constant[k]
        drag.constant[j] = rest / A[n * j + j]


@kernel
def velocity_by_drag(s: State, i: int) -> float:
    """Velocity through the air along axis i of NED, m/s."""
    drag, q = s.drag, s.nav.q_nb
    C = dcm_of_quat((q[0], q[1], q[2], q[3]))
    constant = C[3 * i] * drag.constant[0] + C[3 * i + 1] * drag.constant[1] + C[3 * i + 2] * drag.constant[2]
    return (constant - drag.force[i]) / drag.per_mass
