"""Kernels over solutions in order of time: the body in `odom` and in `map` (see `frames`), its velocity in its axes.

World is ENU, body FLU; quaternions turn vectors of the body into the world, scalar first.
"""

import math
from typing import Any

import numpy as np

from ..compile.entry import entry
from ..compile.jit import kernel
from ..estimators.records import ATTITUDE_VALID
from ..math.arrays import Records
from ..math.rotation import (
    Quaternion,
    Vector,
    cross,
    dcm_of_quat,
    quat_exp,
    quat_normalised,
    quat_product,
    quat_rotate,
    quat_rotate_back,
)

GAP_NS = 1_000_000_000  # an interruption, over which the body's motion is not known
_HALF = math.sqrt(0.5)

_TRANSFORM = [("place", "<f8", (3,)), ("q", "<f8", (4,))]  # of a child in its parent, m
FRAMES = np.dtype([("map_to_odom", _TRANSFORM), ("odom_to_body", _TRANSFORM)])
RECKONING = np.dtype(  # what is known of the body so far
    [
        ("frames", FRAMES),
        ("is_known", "<i8"),  # whether there was an attitude
        ("t_ns", "<i8"),  # of the newest one
        ("velocity", "<f8", (3,)),  # then, in the body; zeros if not known
        ("rate", "<f8", (3,)),
    ],
    align=True,
)
MOTION = np.dtype([("is_known", "<i8"), ("place", "<f8", (3,)), ("frames", FRAMES)], align=True)
BODY_VELOCITY = np.dtype([("velocity", "<f8", (3,)), ("covariance", "<f8", (9,))], align=True)  # m/s, FLU; by rows


@kernel
def attitude_enu_flu(q_nb: Any) -> Quaternion:
    """From FRD in NED to FLU in ENU."""
    q = quat_product((0.0, _HALF, _HALF, 0.0), (q_nb[0], q_nb[1], q_nb[2], q_nb[3]))
    return quat_product(q, (0.0, 1.0, 0.0, 0.0))


@kernel
def _in_body(q_nb: Any, v: Vector) -> Vector:
    """A vector (NED) in the body (FLU)."""
    x, y, z = quat_rotate_back((q_nb[0], q_nb[1], q_nb[2], q_nb[3]), v)
    return x, -y, -z


@kernel
def _keep(out: Any, v: Vector) -> None:
    """Zeros if one of them is not known."""
    is_known = math.isfinite(v[0] + v[1] + v[2])
    for i in range(3):
        out[i] = v[i] if is_known else 0.0


@entry
def follow_body(state: Records, solutions: Records, motions: Records) -> None:
    """state: a RECKONING. motions: of each of the solutions a MOTION, whose place in the map is given, NaN: unknown."""
    body = state[0]
    for i in range(len(solutions)):
        if solutions[i].status & ATTITUDE_VALID:
            _reckon(body, solutions[i])
            _correct(body.frames, attitude_enu_flu(solutions[i].q_nb), motions[i].place)
        motions[i].is_known = body.is_known
        _copy(body.frames.map_to_odom, motions[i].frames.map_to_odom)
        _copy(body.frames.odom_to_body, motions[i].frames.odom_to_body)


@kernel
def _reckon(body: Any, solution: Any) -> None:
    """The body in odom: half of the interval with the twist before, half with the new one."""
    at = body.frames.odom_to_body
    q = (at.q[0], at.q[1], at.q[2], at.q[3])
    if not body.is_known:
        q = attitude_enu_flu(solution.q_nb)
    elapsed_ns = solution.t_ns - body.t_ns
    goes_on = body.is_known and 0 < elapsed_ns <= GAP_NS
    half_s = 0.5e-9 * elapsed_ns
    v, w = body.velocity, body.rate
    path, angle = (half_s * v[0], half_s * v[1], half_s * v[2]), (half_s * w[0], half_s * w[1], half_s * w[2])
    _keep(v, _in_body(solution.q_nb, (solution.v[0], solution.v[1], solution.v[2])))
    _keep(w, (solution.w[0], -solution.w[1], -solution.w[2]))
    body.is_known, body.t_ns = 1, solution.t_ns
    if goes_on:
        path = path[0] + half_s * v[0], path[1] + half_s * v[1], path[2] + half_s * v[2]
        x, y, z = angle[0] + half_s * w[0], angle[1] + half_s * w[1], angle[2] + half_s * w[2]
        half = quat_exp(0.5 * x, 0.5 * y, 0.5 * z)
        middle = quat_product(q, half)
        step = quat_rotate(middle, path)
        for i in range(3):
            at.place[i] += step[i]
        q = quat_normalised(quat_product(middle, half))
    for i in range(4):
        at.q[i] = q[i]


@kernel
def _correct(frames: Any, q: Quaternion, place: Any) -> None:
    """odom in the map, so that the body is where the filter says; without a position it goes on by reckoning."""
    to_odom, to_body = frames.map_to_odom, frames.odom_to_body
    where = (to_body.place[0], to_body.place[1], to_body.place[2])
    before = quat_rotate((to_odom.q[0], to_odom.q[1], to_odom.q[2], to_odom.q[3]), where)
    rotation = quat_product(q, (to_body.q[0], -to_body.q[1], -to_body.q[2], -to_body.q[3]))
    within = quat_rotate(rotation, where)
    for i in range(3):
        in_map = to_odom.place[i] + before[i] if math.isnan(place[0]) else place[i]
        to_odom.place[i] = in_map - within[i]
    for i in range(4):
        to_odom.q[i] = rotation[i]


@kernel
def _copy(transform: Any, out: Any) -> None:
    for i in range(3):
        out.place[i] = transform.place[i]
    for i in range(4):
        out.q[i] = transform.q[i]


@entry
def body_velocities(solutions: Records, out: Records) -> None:
    """Of each of the solutions a BODY_VELOCITY: its covariance is that of the velocity in NED, and what the errors of
    the attitude make of it.
    """
    for i in range(len(solutions)):
        row, covariance = solutions[i], out[i].covariance
        v = (row.v[0], row.v[1], row.v[2])
        in_body = _in_body(row.q_nb, v)
        for k in range(3):
            out[i].velocity[k] = in_body[k]
        for k in range(9):
            covariance[k] = 0.0
        _add_error(covariance, row, (row.sigma_v[0], 0.0, 0.0))
        _add_error(covariance, row, (0.0, row.sigma_v[1], 0.0))
        _add_error(covariance, row, (0.0, 0.0, row.sigma_v[2]))
        c = dcm_of_quat((row.q_nb[0], row.q_nb[1], row.q_nb[2], row.q_nb[3]))
        across = math.sqrt(c[0] * c[0] + c[3] * c[3])  # the nose's horizontal part; straight up or down yaw is 0
        cosine, sine = (c[0] / across, c[3] / across) if across > 0.0 else (1.0, 0.0)
        _add_turn(covariance, row, v, (c[0], c[3], c[6]), row.sigma_rpy[0])
        _add_turn(covariance, row, v, (-sine, cosine, 0.0), row.sigma_rpy[1])
        _add_turn(covariance, row, v, (0.0, 0.0, 1.0), row.sigma_rpy[2])


@kernel
def _add_turn(covariance: Any, row: Any, v: Vector, axis: Vector, sigma: float) -> None:
    """What an attitude's error about an axis (NED) makes of the velocity."""
    x, y, z = cross(v, axis)
    _add_error(covariance, row, (sigma * x, sigma * y, sigma * z))


@kernel
def _add_error(covariance: Any, row: Any, error: Vector) -> None:
    """error: of the velocity (NED), one sigma, independent of the others."""
    e = _in_body(row.q_nb, error)
    for a in range(3):
        for b in range(3):
            covariance[3 * a + b] += e[a] * e[b]
