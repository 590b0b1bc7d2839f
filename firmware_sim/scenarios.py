"""The scenarios by name: a sensor at rest, on a turntable, in a car, on a figure eight.

Vehicles follow a truncated Fourier path: closed form, smooth to any order, periodic. Speed follows from the path and a
timeline; heading is the path's direction; the body rolls outwards in curves, pitches up when accelerating, and follows
the slope.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from .ellipsoid import Array
from .motion import Kinematics, Path
from .timeline import Timeline


@dataclass(frozen=True)
class Pivot:
    """Rotation about the vertical at a fixed position, with constant roll and pitch (rad)."""

    timeline: Timeline
    roll: float
    pitch: float
    yaw: float

    def at(self, t: Array) -> Kinematics:
        angle, rate, _, _ = self.timeline.at(t)
        zero = np.zeros((len(t), 3))
        still = np.zeros_like(t)
        rpy = np.stack([still + self.roll, still + self.pitch, self.yaw + angle], axis=1)
        return Kinematics(zero, zero, zero, rpy, np.stack([still, still, rate], axis=1))


@dataclass(frozen=True)
class Course:
    """A vehicle on the path r(u) = sum over k of cos(k u) a_k + sin(k u) b_k, metres north, east, down.

    harmonics: k -> (a_k, b_k). timeline: u(t) in rad. start: u at time 0.
    """

    harmonics: Mapping[int, tuple[tuple[float, float, float], tuple[float, float, float]]]
    timeline: Timeline
    start: float
    lean: float = math.radians(0.6)  # roll per lateral acceleration, rad/(m/s^2)
    squat: float = math.radians(0.5)  # pitch per longitudinal acceleration, rad/(m/s^2)

    def _shape(self, u: Array) -> list[Array]:
        """r(u) and its first three derivatives by u, each (n, 3)."""
        derivatives = [np.zeros((len(u), 3)) for _ in range(4)]
        for k, (a, b) in self.harmonics.items():
            c, s = np.outer(np.cos(k * u), a), np.outer(np.sin(k * u), a)
            c, s = c + np.outer(np.sin(k * u), b), np.outer(np.cos(k * u), b) - s
            for order, term in enumerate((c, s, -c, -s)):
                derivatives[order] += k**order * term
        return derivatives

    def at(self, t: Array) -> Kinematics:
        u, du, ddu, dddu = (column[:, None] for column in self.timeline.at(t))
        r0, r1, r2, r3 = self._shape(self.start + u[:, 0])
        origin = self._shape(np.array([self.start]))[0]
        velocity = r1 * du
        acceleration = r2 * du**2 + r1 * ddu
        jerk = r3 * du**3 + 3.0 * r2 * du * ddu + r1 * dddu
        rpy, rpy_rate = self._attitude(r1, r2, du[:, 0], acceleration, jerk)
        return Kinematics(r0 - origin, velocity, acceleration, rpy, rpy_rate)

    def _attitude(self, r1: Array, r2: Array, du: Array, acceleration: Array, jerk: Array) -> tuple[Array, Array]:
        north, east, down = r1.T
        run = np.hypot(north, east)
        yaw_rate = (north * r2[:, 1] - east * r2[:, 0]) / run**2 * du
        run_rate = (north * r2[:, 0] + east * r2[:, 1]) / run * du
        slope_rate = (down * run_rate - run * r2[:, 2] * du) / (run**2 + down**2)
        ahead, right = np.stack([north, east]) / run, np.stack([-east, north]) / run
        forward, lateral = _along(acceleration, ahead), _along(acceleration, right)
        forward_rate = _along(jerk, ahead) + lateral * yaw_rate
        lateral_rate = _along(jerk, right) - forward * yaw_rate
        slope = np.arctan2(-down, run)
        rpy = [-self.lean * lateral, slope + self.squat * forward, np.arctan2(east, north)]
        rates = [-self.lean * lateral_rate, slope_rate + self.squat * forward_rate, yaw_rate]
        return np.stack(rpy, axis=1), np.stack(rates, axis=1)


def _along(vector: Array, direction: Array) -> Array:
    result: Array = vector[:, 0] * direction[0] + vector[:, 1] * direction[1]
    return result


def rest(roll: float, pitch: float, yaw: float) -> Path:
    """No motion."""
    return Pivot(Timeline([], [(1.0, 0.0)]), roll, pitch, yaw)


def turntable(roll: float, pitch: float, yaw: float) -> Path:
    """Steps of rotation about the vertical, each 1 s up, 5 s held, 1 s down, 3 s still."""
    steps = [math.radians(rate) for rate in (10.0, -10.0, 50.0, -50.0, 125.0, -125.0, 250.0, -250.0)]
    loop = [segment for rate in steps for segment in ((1.0, rate), (5.0, rate), (1.0, 0.0), (3.0, 0.0))]
    return Pivot(Timeline([(5.0, 0.0)], loop), roll, pitch, yaw)


def car(_roll: float, _pitch: float, _yaw: float) -> Path:
    """Laps of a square with rounded corners (130 m) over a hill of 5 m, up to 14 m/s and 3 m/s^2, with stops.

    The third harmonic of -1/9 makes the sides straight at their middle, and halves the speed in the corners.
    """
    size, third, hill = 73.5, -1.0 / 9.0, 2.5
    harmonics = {
        1: ((size, 0.0, hill), (0.0, size, 0.0)),
        3: ((size * third, 0.0, 0.0), (0.0, -size * third, 0.0)),
    }
    fast, slow = 0.143, 0.08  # rad/s of u
    start = [(7.0, fast), (50.0, fast)]
    loop = [(8.0, 0.0), (5.0, 0.0), (7.0, slow), (20.0, slow), (6.0, fast), (40.0, fast)]
    return Course(harmonics, Timeline([(5.0, 0.0), *start], loop), start=-0.6)


def figure8(_roll: float, _pitch: float, _yaw: float) -> Path:
    """Gerono's lemniscate, 80 m by 40 m, at 6 to 8.5 m/s after 5 s at rest, level ground."""
    harmonics = {1: ((0.0, 0.0, 0.0), (40.0, 0.0, 0.0)), 2: ((0.0, 0.0, 0.0), (0.0, 20.0, 0.0))}
    return Course(harmonics, Timeline([(5.0, 0.0), (6.0, 0.15)], [(60.0, 0.15)]), start=0.0)


SCENARIOS: dict[str, Callable[[float, float, float], Path]] = {
    "rest": rest,
    "turntable": turntable,
    "car": car,
    "figure8": figure8,
}
"""Name -> builder of roll, pitch, yaw in rad; vehicles find their own attitude."""
