"""The input of all contestants: a vehicle's motion as samples, as fixes, and as the bytes of an M-G350."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imud.drivers.sample import SAMPLE

from ...estimators.records import (
    BAROMETER_SOURCE,
    BODY_VELOCITY_SOURCE,
    FIX,
    HEADING_SOURCE,
    MEASUREMENT,
    ODOMETER_SOURCE,
    POSE_SOURCE,
    VELOCITY_SOURCE,
)
from ...math.arrays import Floats, Records
from ...math.earth import STANDARD_GRAVITY

RATE_HZ = 1000
REST_S = 5.0
FIX_HZ, AIDING_HZ = 5, 10
ROW = np.dtype([("head", "u1"), ("words", ">i2", (9,)), ("count", ">u2"), ("tail", "u1")])  # packed: 22 bytes
FRAME = ROW.itemsize
GYRO_LSB, ACCEL_LSB = np.radians(0.0125), 0.125e-3 * STANDARD_GRAVITY
COUNT_STEP = 2
_SPEED, _TURN = 15.0, 0.1  # m/s, rad/s: round a circle
_LAT, _LON = np.radians(35.6586), np.radians(139.7454)
_HEIGHT_M, _EARTH_M = 60.0, 6.37e6


def _motion(n: int) -> tuple[Floats, Floats, Floats]:
    """Time, rates and forces: at rest, then accelerating, then on a circle with vibration.

    The vibration is fast enough not to move the sensor: fixes must agree with samples, or a filter detects a fault.
    """
    rng = np.random.default_rng(1)
    t = np.arange(n) / RATE_HZ
    moving = np.clip((t - REST_S) / 5.0, 0.0, 1.0)
    w = 0.002 * rng.standard_normal((n, 3)) + 0.05 * moving[:, None] * np.sin(np.outer(t, (71.0, 107.0, 89.0)))
    f = 0.02 * rng.standard_normal((n, 3)) + 0.3 * moving[:, None] * np.sin(np.outer(t, (131.0, 83.0, 197.0)))
    w[:, 2] += _TURN * (t > REST_S + 5.0)
    f[:, 0] += _SPEED / 5.0 * ((t > REST_S) & (t < REST_S + 5.0))
    f[:, 1] += _SPEED * _TURN * (t > REST_S + 5.0)
    f[:, 2] -= STANDARD_GRAVITY
    return t, w, f


def samples(n: int) -> Records:
    """n samples (SAMPLE), 1000 a second."""
    t, w, f = _motion(n)
    rows = np.zeros(n, SAMPLE)
    rows["t_ns"] = np.round(t * 1e9)
    rows["tick"] = np.arange(n)
    rows["w"], rows["f"] = w, f
    rows["temperature"] = 25.0
    return rows


class _Path(NamedTuple):
    """Where the vehicle is, rad, its speed, m/s, and its course, which is its heading, rad."""

    lat: Floats
    lon: Floats
    speed: Floats
    course: Floats


def _path(t: Floats) -> _Path:
    """At these times, s."""
    ramp, circle = np.clip(t - REST_S, 0.0, 5.0), np.maximum(t - REST_S - 5.0, 0.0)
    north = 0.5 * _SPEED / 5.0 * ramp**2 + _SPEED / _TURN * np.sin(_TURN * circle)
    east = _SPEED / _TURN * (1.0 - np.cos(_TURN * circle))
    lat, lon = _LAT + north / _EARTH_M, _LON + east / (_EARTH_M * np.cos(_LAT))
    return _Path(lat, lon, _SPEED / 5.0 * ramp, _TURN * circle % (2.0 * np.pi))


def fixes(seconds: float) -> Records:
    """Fixes (FIX) of the same journey, 5 a second, known 150 ms late."""
    t = np.arange(0.5, seconds, 1.0 / FIX_HZ)
    path = _path(t)
    rows = np.zeros(len(t), FIX)
    rows["t_ns"] = np.round(t * 1e9)
    rows["arrival_ns"] = rows["t_ns"] + 150_000_000
    rows["lat"], rows["lon"], rows["height"] = path.lat, path.lon, _HEIGHT_M
    rows["sigma"], rows["hdop"], rows["quality"], rows["satellites"] = 1.5, 1.0, 1, 10
    rows["speed"], rows["course"] = path.speed, path.course
    rows["v"] = np.nan
    return rows


def measurements(seconds: float, kind: int) -> Records:
    """Measurements (MEASUREMENT) of the same journey by a source beside GNSS, 10 a second, known at once."""
    t = np.arange(0.5, seconds, 1.0 / AIDING_HZ)
    path, height, nothing = _path(t), np.full(len(t), _HEIGHT_M), np.zeros(len(t))
    noise = 0.01 * np.random.default_rng(3).standard_normal(len(t))  # what never changes is left out
    speed = path.speed + noise
    values = {
        HEADING_SOURCE: (path.course,),
        ODOMETER_SOURCE: (speed,),
        BAROMETER_SOURCE: (height + noise,),
        POSE_SOURCE: (path.lat, path.lon, height, path.course),
        VELOCITY_SOURCE: (speed * np.cos(path.course), speed * np.sin(path.course), nothing),
        BODY_VELOCITY_SOURCE: (speed, nothing, nothing),
    }[kind]
    rows = np.zeros(len(t), MEASUREMENT)
    rows["t_ns"] = rows["arrival_ns"] = np.round(t * 1e9)
    rows["kind"], rows["value"], rows["sigma"] = kind, np.nan, np.nan
    for i, column in enumerate(values):
        rows["value"][:, i] = column
    return rows


def frames(n: int) -> NDArray[np.uint8]:
    """The same motion as n automatic frames of an M-G350 with COUNT (data sheet; `drivers/epson/flat.py`), n x 22."""
    _, w, f = _motion(n)
    rows = np.zeros(n, ROW)
    rows["head"], rows["tail"] = 0x20, 0x0D
    rows["words"][:, 0] = -0x200  # FLAG: all new
    rows["words"][:, 1] = -15214  # 25 degC
    rows["words"][:, 2:5] = np.round(w / GYRO_LSB)
    rows["words"][:, 5:8] = np.round(f / ACCEL_LSB)
    rows["words"][:, 8] = 0x0707
    rows["count"] = np.arange(n) * COUNT_STEP & 0xFFFF
    return rows.view(np.uint8).reshape(n, FRAME)
