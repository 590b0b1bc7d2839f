"""The mounting of a sensor in its vehicle: down from a rest on level ground, forwards from a straight start."""

import math

import numpy as np

from ..math.arrays import Floats, Records
from .rest import WINDOW_S, UnfitError, mean, rest_intervals, windows

_ACCELERATION = 0.5  # m/s^2, the least that shows where forwards is
_STRAIGHT_DEG = 20.0
_START_S = 1.5
_CURVES_S, _CURVE = 30.0, 0.3  # of data that are tested; m/s^2, the least acceleration that counts
_CURVE_SHARE = 0.5  # of what a curve turned the start by, as sigma: where the sensor sits in the vehicle counts, too
_MIRRORED = "gyro and accelerometer contradict each other: an axis is mirrored; no mounting can correct that"


def mounting(samples: Records, rate_hz: float) -> tuple[Floats, Floats]:
    """Matrix (3 x 3) from the sensor's to the vehicle's axes, and 1 sigma (3, rad) of roll, pitch, yaw.

    From a rest on level ground followed by a straight start forwards. Raises UnfitError, also for mirrored axes.
    """
    intervals = rest_intervals(samples, rate_hz)
    rest = intervals[0]
    m = max(2, round(WINDOW_S * rate_hz))
    up_force = mean(samples["f"][rest.start : rest.stop], m)
    bias = samples["w"][rest.start : rest.stop].mean(axis=0)
    down = -up_force.value / np.linalg.norm(up_force.value)
    _refuse_mirrored(samples, bias, rate_hz)
    after = samples[rest.stop :]
    acceleration = windows(after["f"], m).mean(axis=1) - up_force.value if len(after) >= m else np.empty((0, 3))
    level = acceleration - np.outer(acceleration @ down, down)
    size = np.linalg.norm(level, axis=1)
    strong = np.flatnonzero(size > _ACCELERATION)
    if len(strong) == 0:
        raise UnfitError(
            f"no acceleration above {_ACCELERATION} m/s^2 after the rest: start forwards, straight, briskly"
        )
    turning = windows(after["w"] - bias, m).mean(axis=1) @ down
    soon = np.arange(strong[0], min(strong[0] + max(1, int(_START_S / WINDOW_S)), len(level)))
    first = soon[size[soon] > _ACCELERATION]
    if np.degrees(_from_their_sum(level[first], down)).max() > _STRAIGHT_DEG:
        raise UnfitError("the start was not straight, or not forwards only: the acceleration turns by more than 20 deg")
    straight = _without_curve(level, turning, down)[first]
    forward = straight.sum(axis=0) / np.linalg.norm(straight.sum(axis=0))
    matrix = np.stack([forward, np.cross(down, forward), down])
    across = np.degrees(np.arctan2(straight @ matrix[1], straight @ forward))
    total = level[first].sum(axis=0)
    curve = math.degrees(math.atan2(total @ matrix[1], total @ forward))
    _refuse_mirrored_curves(turning, level @ forward, level @ matrix[1])
    tilt = up_force.sigma / np.linalg.norm(up_force.value)
    yaw = math.radians(math.hypot(max(1.0, float(across.std()) / math.sqrt(len(first))), _CURVE_SHARE * curve))
    return matrix, np.array([max(np.nanmax(tilt), 1e-3), max(np.nanmax(tilt), 1e-3), yaw])


def _without_curve(level: Floats, turning: Floats, down: Floats) -> Floats:
    """The level acceleration, window by window, without what turns the vehicle: the rate about down times the speed."""
    straight, velocity = level.copy(), np.zeros(3)
    for k in range(len(level)):
        middle = velocity + 0.5 * WINDOW_S * level[k]
        straight[k] -= turning[k] * np.cross(down, middle)
        velocity += WINDOW_S * straight[k]
    return straight


def _from_their_sum(level: Floats, down: Floats) -> Floats:
    """The angle of each acceleration from the sum of all, without sign, rad."""
    total = level.sum(axis=0)
    angles: Floats = np.abs(np.arctan2(level @ np.cross(down, total), level @ total))
    return angles


def _refuse_mirrored(samples: Records, bias: Floats, rate_hz: float) -> None:
    """When the sensor tilts slowly, the force in its axes changes by -w x f; with mirrored axes by the opposite."""
    m = max(1, round(0.1 * rate_hz))
    w = windows(samples["w"] - bias, m).mean(axis=1)
    f = windows(samples["f"], m).mean(axis=1)
    change = np.diff(f, axis=0) * rate_hz / m
    expected = -np.cross(0.5 * (w[1:] + w[:-1]), 0.5 * (f[1:] + f[:-1]))
    turning = np.linalg.norm(expected, axis=1) > 1.0  # m/s^3: six degrees of tilt a second
    if turning.sum() < 5:
        return
    agreement = float((change[turning] * expected[turning]).sum() / (expected[turning] ** 2).sum())
    if agreement < -0.5:
        raise UnfitError(_MIRRORED)


def _refuse_mirrored_curves(turning: Floats, forwards: Floats, sideways: Floats) -> None:
    """In a curve a vehicle is accelerated inwards by speed times rate of turn; with mirrored axes outwards.

    Window by window since the start: rate about down (rad/s), acceleration (m/s^2).
    """
    soon = slice(0, int(_CURVES_S / WINDOW_S))  # later the summed speed is too uncertain
    speed = np.cumsum(forwards[soon]) * WINDOW_S
    expected = turning[soon] * speed
    curve = np.abs(expected) > _CURVE
    if curve.sum() >= 4 and (sideways[soon] * expected)[curve].sum() < -0.5 * (expected[curve] ** 2).sum():
        raise UnfitError(_MIRRORED)
