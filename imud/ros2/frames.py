"""The frames of REP-105: the body in `map` by the filter, in `odom` by dead reckoning from the filter's velocity.

`map` jumps when a fix corrects the filter and does not drift; `odom` drifts and does not jump. The sensor's axes are
those of the body, as its samples are turned by the mounting, and the filter's position is that of the sensor.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..estimators.records import ATTITUDE_VALID, POSITION_VALID
from ..math.arrays import Floats, Records
from ..recording.enu import LocalMap, attitude, body, each, length, product, world

GAP_NS = 1_000_000_000  # an interruption, over which the body's motion is not known

Columns = Any  # of a vector or quaternion: numbers, or an array each
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Transform = tuple[Vector, Quaternion]  # of a child in its parent: place, and the rotation of vectors into the parent
IDENTITY: Transform = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)


def inverse(q: Columns) -> Columns:
    return q[0], -q[1], -q[2], -q[3]


def turned(q: Columns, v: Columns) -> Columns:
    """The vector in the parent."""
    return product(product(q, (0.0, *v)), inverse(q))[1:]


def _rotation(v: Floats) -> Columns:
    """By rotation vectors (n x 3), rad."""
    angle = length(v)
    half = np.where(angle > 1e-9, 0.5 * angle, 1.0)
    factor = np.where(angle > 1e-9, 0.5 * each(math.sin, half) / half, 0.5)
    return each(math.cos, 0.5 * angle), *(factor[:, None] * v).T


class Motion(NamedTuple):
    """Of the body through n solutions. Places (n x 3), m; transforms (n x 7): place and quaternion, scalar first."""

    is_placed: NDArray[np.bool_]  # whether the place in the map is known
    place: Floats
    is_known: NDArray[np.bool_]  # whether the transforms are
    map_to_odom: Floats
    odom_to_body: Floats


class Frames:
    """Follows the body through solutions in order of time."""

    def __init__(self) -> None:
        self._plane = LocalMap()
        self._map_to_odom = self._odom_to_body = np.array([sum(IDENTITY, ())])  # the newest, as one row
        self._t_ns: int | None = None  # of the newest solution with an attitude
        self._twist = np.zeros((1, 6))  # velocity and rate, in the body

    def step(self, solutions: Records) -> Motion:
        """The next rows of SOLUTION."""
        is_placed, has_attitude = ((solutions["status"] & bit) != 0 for bit in (POSITION_VALID, ATTITUDE_VALID))
        place = np.full((len(solutions), 3), np.nan)
        if is_placed.any():
            place[is_placed] = self._plane.places(*(solutions[name][is_placed] for name in ("lat", "lon", "height")))
        newest = np.cumsum(has_attitude)
        is_known = (newest > 0) | (self._t_ns is not None)
        to_odom, to_body = self._map_to_odom, self._odom_to_body
        if newest[-1]:
            q = attitude(solutions["q_nb"][has_attitude].T)
            to_body = np.concatenate([to_body, self._reckon(solutions[has_attitude], q)])
            to_odom = np.concatenate([to_odom, self._correct(q, place[has_attitude], to_body[1:])])
            self._map_to_odom, self._odom_to_body = to_odom[-1:], to_body[-1:]
        return Motion(is_placed, place, is_known, to_odom[newest], to_body[newest])

    def _reckon(self, solutions: Records, q: Columns) -> Floats:
        """The body in odom: half of each interval with the twist before, half with the new one."""
        t_ns = solutions["t_ns"]
        v, w = turned(inverse(q), world(solutions["v"].T)), body(solutions["w"].T)
        twist = np.concatenate([self._twist, np.hstack([_known(v), _known(w)])])
        start = self._odom_to_body[0].copy()
        if self._t_ns is None:
            start[3:] = [column[0] for column in q]
        elapsed_ns = np.diff(t_ns, prepend=t_ns[0] if self._t_ns is None else self._t_ns)
        goes_on = (elapsed_ns > 0) & (elapsed_ns <= GAP_NS)
        half_s = 0.5e-9 * elapsed_ns[:, None]
        path, angle = np.hsplit(half_s * twist[:-1] + half_s * twist[1:], 2)
        half = _rotation(0.5 * angle)
        directions = np.array(_directions(start[3:].tolist(), product(half, half), goes_on))
        middle = product(directions[:-1].T, half)
        paths = np.where(goes_on[:, None], np.stack(turned(middle, path.T), axis=1), 0.0)
        places = np.cumsum(np.concatenate([start[None, :3], paths]), axis=0)
        self._t_ns, self._twist = int(t_ns[-1]), twist[-1:]
        return np.hstack([places, directions])[1:]

    def _correct(self, q: Columns, place: Floats, to_body: Floats) -> Floats:
        """odom in the map, so that the body is where the filter says; without a position it goes on by reckoning."""
        rotation = product(q, inverse(to_body[:, 3:].T))
        within = np.stack(turned(rotation, to_body[:, :3].T), axis=1)
        found = np.hstack([place - within, np.stack(rotation, axis=1)])
        for k in np.flatnonzero(np.isnan(place[:, 0])).tolist():
            before = found[k - 1] if k else self._map_to_odom[0]
            found[k, :3] = before[:3] + turned(before[3:].tolist(), to_body[k, :3].tolist()) - within[k]
        return found


def _known(v: Columns) -> Floats:
    """Vectors, one a row; zeros where one is not known."""
    rows = np.stack(v, axis=1)
    rows[~np.isfinite(rows).all(axis=1)] = 0.0
    return rows


def _directions(q: Sequence[float], turns: Columns, goes_on: NDArray[np.bool_]) -> list[Sequence[float]]:
    """q, and what it becomes by each turn that goes on."""
    found = [q]
    for turn, goes in zip(zip(*(column.tolist() for column in turns), strict=True), goes_on.tolist(), strict=True):
        if goes:
            w, x, y, z = product(q, turn)
            size = math.hypot(w, x, y, z)
            q = w / size, x / size, y / size, z / size
        found.append(q)
    return found
