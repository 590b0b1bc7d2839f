"""The frames of REP-105: the body in `map` by the filter, in `odom` by dead reckoning from the filter's velocity.

`map` jumps when a fix corrects the filter and does not drift; `odom` drifts and does not jump. The sensor's axes are
those of the body, as its samples are turned by the mounting, and the filter's position is that of the sensor.
"""

import math

import numpy as np

from ..estimators.records import ATTITUDE_VALID, POSITION_VALID
from ..recording.enu import LocalMap, attitude, body, product, world

GAP_NS = 1_000_000_000  # an interruption, over which the body's motion is not known

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Transform = tuple[Vector, Quaternion]  # of a child in its parent: place, and the rotation of vectors into the parent
IDENTITY: Transform = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)


def inverse(q: Quaternion) -> Quaternion:
    return q[0], -q[1], -q[2], -q[3]


def turned(q: Quaternion, v: Vector) -> Vector:
    """The vector in the parent."""
    _, x, y, z = product(product(q, (0.0, *v)), inverse(q))
    return x, y, z


def _sum(a: Vector, b: Vector, factor: float = 1.0) -> Vector:
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


def _rotation(v: Vector) -> Quaternion:
    """By a rotation vector, rad."""
    angle = math.hypot(*v)
    factor = 0.5 * math.sin(0.5 * angle) / (0.5 * angle) if angle > 1e-9 else 0.5
    return math.cos(0.5 * angle), factor * v[0], factor * v[1], factor * v[2]


class Frames:
    """Follows the body through solutions in order of time."""

    def __init__(self) -> None:
        self._plane = LocalMap()
        self.map_to_odom, self.odom_to_body = IDENTITY, IDENTITY
        self.place: Vector | None = None  # of the body in the map; None: not known
        self._t_ns: int | None = None  # of the newest solution with an attitude
        self._velocity: Vector = (0.0, 0.0, 0.0)  # in the body, like the rate
        self._rate: Vector = (0.0, 0.0, 0.0)

    def step(self, solution: np.void) -> bool:
        """The next row of SOLUTION; returns whether the transforms are known."""
        status = int(solution["status"])
        self.place = None
        if status & POSITION_VALID:
            self.place = self._plane.place(*(float(solution[name]) for name in ("lat", "lon", "height")))
        if status & ATTITUDE_VALID:
            self._reckon(solution)
            self._correct(solution)
        return self._t_ns is not None

    def _reckon(self, solution: np.void) -> None:
        """The body in odom: half the time with the twist before, half with the new one."""
        t_ns, q = int(solution["t_ns"]), attitude(solution["q_nb"].tolist())
        v, w = world(solution["v"].tolist()), body(solution["w"].tolist())
        v = turned(inverse(q), v) if math.isfinite(sum(v)) else (0.0, 0.0, 0.0)
        w = w if math.isfinite(sum(w)) else (0.0, 0.0, 0.0)
        place, direction = self.odom_to_body
        if self._t_ns is None:
            direction = q
        elif 0 < t_ns - self._t_ns <= GAP_NS:
            half_s = 0.5e-9 * (t_ns - self._t_ns)
            angle = _sum(_sum((0.0, 0.0, 0.0), self._rate, half_s), w, half_s)
            path = _sum(_sum((0.0, 0.0, 0.0), self._velocity, half_s), v, half_s)
            middle = product(direction, _rotation(_sum((0.0, 0.0, 0.0), angle, 0.5)))
            place = _sum(place, turned(middle, path))
            direction = product(direction, _rotation(angle))
            size = math.hypot(*direction)
            direction = direction[0] / size, direction[1] / size, direction[2] / size, direction[3] / size
        self.odom_to_body = place, direction
        self._t_ns, self._velocity, self._rate = t_ns, v, w

    def _correct(self, solution: np.void) -> None:
        """odom in the map, so that the body is where the filter says; without a position it goes on by reckoning."""
        place, direction = self.odom_to_body
        at = self.place
        if at is None:
            at = _sum(self.map_to_odom[0], turned(self.map_to_odom[1], place))
        q = product(attitude(solution["q_nb"].tolist()), inverse(direction))
        self.map_to_odom = _sum(at, turned(q, place), -1.0), q
