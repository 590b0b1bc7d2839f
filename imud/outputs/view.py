"""The view: the data of one instant that all outputs publish; unpacking of a solution into their units.

Values only, frozen: an output may keep a view. Unknown is NaN, as in the records.
"""

import math
import struct
from collections.abc import Callable, Iterable, Mapping
from operator import itemgetter, mul
from typing import Any, NamedTuple

import numpy as np

from .. import client
from ..estimators.records import HEIGHT_VALID, POSITION_VALID, SOLUTION
from ..sensors.readings import NO_VECTOR, ClockFit, ReceiverReport

NAN = math.nan
Vector = tuple[float, ...]


def _nan_solution() -> bytes:
    row = np.zeros(1, SOLUTION)
    for name in SOLUTION.names or ():
        if SOLUTION[name].base.kind == "f":
            row[name] = NAN
    return row.tobytes()


NO_SOLUTION = _nan_solution()


class Device(NamedTuple):
    """A sensor as the clients see it."""

    path: str
    driver: str
    bps: int | None = None
    model: str = ""
    serial: str = ""
    activated_s: float = NAN  # unix time of opening


class Health(NamedTuple):
    """The faults of the sensors, as texts; empty: none. None: there is no such sensor."""

    imu: tuple[str, ...] | None = None
    gnss: tuple[str, ...] | None = None
    clock: ClockFit = ClockFit()
    out_of_limits: tuple[str, ...] = ()  # names of shown quantities, as `sensors/limits.py` has them


class View(NamedTuple):
    """Everything that is published of one instant. `solution` holds the bytes of one SOLUTION row (`row.tobytes()`)."""

    solution: bytes = NO_SOLUTION
    utc_s: float | None = None  # unix time of the solution
    utc_error_s: float = NAN  # 95 %
    t_mono_ns: int = 0
    seq: int = 0
    estimator: str = ""  # empty: the solution is the receiver's, or there is none
    devices: tuple[Device, ...] = ()  # the first is named as the source of the messages
    gnss: ReceiverReport | None = None
    temperature: float = NAN  # of the inertial sensor, degC
    emulated: bool = False
    health: Health = Health()
    states: Callable[[], Mapping[str, float]] = dict  # what the filter estimates beside the solution, read if asked for
    receiver: "View | None" = None  # the receiver's own position, where the estimator takes no fixes
    sensed: Vector = 2 * NO_VECTOR  # by the inertial sensor: rates in rad/s and specific force in m/s^2, body


class State(NamedTuple):
    """The columns of SOLUTION in the units of the records, but angles in degrees and rates in degrees per second."""

    status: int
    lat: float
    lon: float
    height: float
    v: Vector
    q_nb: Vector
    w: Vector
    f: Vector
    bg: Vector
    ba: Vector
    sigma_p: Vector
    sigma_v: Vector
    sigma_rpy: Vector
    sigma_bg: Vector
    sigma_ba: Vector


_ANGLES = {"lat", "lon", "w", "bg", "sigma_rpy", "sigma_bg"}


def _layout() -> tuple[struct.Struct, tuple[float, ...], Callable[[tuple[float, ...]], Iterable[Any]]]:
    """From SOLUTION: how to unpack a row, the factor of each number, and where each column of State is."""
    form, where = "<", {}
    scale: list[float] = []
    for name in SOLUTION.names or ():
        first, count = len(scale), math.prod(SOLUTION[name].shape)
        where[name] = slice(first, first + count) if SOLUTION[name].shape else first
        form += {"i": "q", "f": "d"}[SOLUTION[name].base.kind] * count
        scale += [math.degrees(1.0) if name in _ANGLES else 1] * count
    return struct.Struct(form), tuple(scale), itemgetter(*(where[name] for name in State._fields))


_row, _scale, _columns = _layout()


def decode(solution: bytes) -> State:
    """The numbers of a solution.

    Position and velocity are unknown without POSITION_VALID, and the height without HEIGHT_VALID, whatever the bytes
    say.
    """
    state = State._make(_columns(tuple(map(mul, _row.unpack(solution), _scale))))
    if state.status & POSITION_VALID:
        return state if state.status & HEIGHT_VALID else state._replace(height=NAN)
    return state._replace(lat=NAN, lon=NAN, height=NAN, v=NO_VECTOR, sigma_p=NO_VECTOR, sigma_v=NO_VECTOR)


def euler(q: Vector) -> tuple[float, float, float]:
    """Roll, pitch, yaw in degrees of q_nb, ZYX; with the nose straight up or down roll is 0."""
    roll, pitch, yaw = client.euler(q)
    return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)
