"""Programs that send measurements by datagrams: poses and velocities of lidar, cameras or tags, two wheels of an axle.

Each sends one line of JSON at a fixed rate, of the true motion at that instant, with errors of its own and its faults.
"""

import json
import logging
import math
import socket
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .ellipsoid import Array
from .faults.readings import FaultyReadings
from .faults.spec import Fault, of_layer
from .faults.wire import Wire
from .motion import Trajectory, Truth, rotation

_RATE_HZ = 10.0
_LASTS_S = 1.0  # errors: one view, one error
_DEG_PER_M = 1.0 / 111_320.0
TRACK_M = 1.5  # between the two wheels

_log = logging.getLogger("firmware_sim")


def _pose(truth: Truth) -> Array:
    return np.array(
        [
            *np.degrees([truth.lat[0], truth.lon[0]]),
            truth.height[0],
            math.degrees(math.remainder(truth.rpy[0, 2], 2.0 * math.pi)),
        ]
    )


def _velocity(truth: Truth) -> Array:
    return np.asarray(truth.v_n[0])


def _body_velocity(truth: Truth) -> Array:
    return np.asarray(truth.v_n[0] @ rotation(truth.rpy)[0])


def _axle(truth: Truth) -> Array:
    """Speeds of the left and the right wheel; in a turn to the right the left one is faster."""
    mean, turn = _body_velocity(truth)[0], 0.5 * TRACK_M * truth.w_ib_b[0, 2]
    return np.array([mean + turn, mean - turn])


@dataclass(frozen=True)
class Kind:
    """What a program sends."""

    message: str  # class of the datagrams
    fields: tuple[str, ...]
    values: Callable[[Truth], Array]  # what an ideal system measures, by `fields`
    sigma: tuple[float, ...]  # of its errors, in m, deg or m/s
    unit: tuple[float, ...]  # of these in the units of the fields
    scale: float  # its lasting error
    shifted: int  # the field to which the fault "offset" adds
    scaled: tuple[int, ...]  # those that "scale" multiplies
    stated: dict[str, float]  # its sigmas, as it says them


_POSE = Kind(
    message="POSE",
    fields=("lat", "lon", "height", "yaw"),
    values=_pose,
    sigma=(0.1, 0.1, 0.1, 0.5),
    unit=(_DEG_PER_M, _DEG_PER_M, 1.0, 1.0),
    scale=1.0,
    shifted=0,
    scaled=(2,),
    stated={"sn": 0.15, "se": 0.15, "sd": 0.15, "syaw": 1.0},
)
_VELOCITY = Kind(
    message="VEL",
    fields=("vn", "ve", "vd"),
    values=_velocity,
    sigma=(0.08,) * 3,
    unit=(1.0,) * 3,
    scale=1.01,
    shifted=0,
    scaled=(0, 1, 2),
    stated={"svn": 0.1, "sve": 0.1, "svd": 0.1},
)
_BODY_VELOCITY = replace(
    _VELOCITY,
    message="BODYVEL",
    fields=("vx", "vy", "vz"),
    values=_body_velocity,
    stated={"svx": 0.1, "svy": 0.1, "svz": 0.1},
)
_WHEELS = Kind(
    message="ODO",
    fields=("left", "right"),
    values=_axle,
    sigma=(0.01,) * 2,
    unit=(1.0,) * 2,
    scale=1.015,
    shifted=0,
    scaled=(0, 1),
    stated={"sigma": 0.05},
)
KINDS = {"pose": _POSE, "velocity": _VELOCITY, "body_velocity": _BODY_VELOCITY, "wheels": _WHEELS}


class Program:
    """One program, as a task of the emulator's loop. Context manager: its socket is open inside.

    send_to: path of a Unix socket, or HOST:PORT. utc: of time 0, s. faults: of the layer "reading"; wire: those of its
    messages. What nobody receives is lost.
    """

    def __init__(
        self,
        name: str,
        trajectory: Trajectory,
        rng: np.random.Generator,
        send_to: str,
        utc: float,
        faults: Sequence[Fault] = (),
        *,
        ideal: bool = False,
        wire: Wire | None = None,
    ) -> None:
        self.name, self.path = name, send_to
        self._kind, self._trajectory, self._rng, self._utc, self._wire = KINDS[name], trajectory, rng, utc, wire
        self._faults = of_layer("reading", faults)
        self._readings = [FaultyReadings(self._of_field(i)) for i in range(len(self._kind.fields))]
        self._size = 0.0 if ideal else 1.0
        self._error = rng.standard_normal(len(self._kind.fields))
        self._count, self._unreceived = 1, 0
        self._queue: deque[tuple[float, bytes]] = deque()  # when each is sent
        host, _, port = send_to.rpartition(":")
        local = "/" in send_to
        self._where: str | tuple[str, int] = send_to if local else (host, int(port))
        self._socket = socket.socket(socket.AF_UNIX if local else socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def __enter__(self) -> "Program":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        if self._unreceived:
            _log.info("%s: %d messages that nobody received", self.name, self._unreceived)

    def step(self, t: float) -> None:
        """Measure and send what was due until time `t`."""
        while (due := self._count / _RATE_HZ) <= t:
            message, until = self.message(due).encode(), -math.inf
            if self._wire is not None:
                message, until = self._wire(message, due)
            after = self._queue[-1][0] if self._queue else due
            self._queue.append((max(due, until, after), message))
            self._count += 1
        while self._queue and self._queue[0][0] <= t:
            self._send(self._queue.popleft()[1])

    def message(self, t: float) -> str:
        """What it says of time `t`; times never decrease."""
        kind = self._kind
        decay = math.exp(-1.0 / (_RATE_HZ * _LASTS_S))
        self._error = decay * self._error + math.sqrt(1.0 - decay**2) * self._rng.standard_normal(len(self._error))
        true = kind.values(self._trajectory.at(np.array([t])))
        scale = 1.0 + self._size * (kind.scale - 1.0)
        values = scale * true + self._size * np.multiply(kind.sigma, kind.unit) * self._error
        readings = [fault(t, float(value)) for fault, value in zip(self._readings, values, strict=True)]
        active = {fault.name: fault.value for fault in self._faults if fault.span.holds(t)}
        time = {} if "untimed" in active else {"t": round(self._utc + t - active.get("clock", 0.0), 6)}
        numbers = {name: round(value, 9) for name, value in zip(kind.fields, readings, strict=True)}
        return json.dumps({"class": kind.message, **time, **numbers, **kind.stated})

    def idle(self) -> None:
        """Nothing to compute ahead."""

    def deadline(self) -> float:
        """When it sends the next message."""
        due = self._count / _RATE_HZ
        return min(due, self._queue[0][0]) if self._queue else due

    def _of_field(self, i: int) -> list[Fault]:
        """The faults of the reading of field `i`, in its unit."""
        kind, found = self._kind, []
        for fault in self._faults:
            if fault.name == "offset" and i == kind.shifted:
                found.append(Fault("offset", fault.value * kind.unit[i], 0.0, (), fault.span))
            elif fault.name == "held" or (fault.name == "scale" and i in kind.scaled):
                found.append(fault)
        return found

    def _send(self, message: bytes) -> None:
        try:
            if message:
                self._socket.sendto(message, self._where)
        except OSError:  # no daemon, or one that is behind
            self._unreceived += 1
