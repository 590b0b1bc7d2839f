"""Runs devices on their pseudo-terminals in real time: one process, one wait, absolute deadlines.

A deadline is a time since the start, so errors of waking do not add up; after a stall all that was missed is sent.
"""

import ctypes
import math
import select
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from .device import Device
from .motion import Trajectory
from .pty import Pty

_LONGEST_WAIT_S = 0.1  # signals and the end of the run are noticed after that
_PR_SET_TIMERSLACK = 29


class Task(Protocol):
    """Something that the loop does at its times."""

    def step(self, t: float) -> None: ...

    def idle(self) -> None: ...

    def deadline(self) -> float: ...


@dataclass(frozen=True)
class Port:
    """A device plugged into a pseudo-terminal."""

    name: str
    device: Device
    pty: Pty

    def listen(self, t: float) -> None:
        """The host has sent something."""
        self.device.receive(self.device.uart.hear(self.pty.read(), self.pty.baud()), t)

    def step(self, t: float) -> None:
        uart = self.device.uart
        self.device.advance(t)
        if uart.due() <= t:
            self.pty.write(uart.take(t, self.pty.baud()))

    def idle(self) -> None:
        self.device.prepare()

    def deadline(self) -> float:
        return min(self.device.uart.due(), self.device.deadline())


class TruthLog:
    """Truth as CSV at 100 Hz, up to now and never ahead, flushed ten times a second.

    start: CLOCK_MONOTONIC of time 0 in s.
    """

    HEADER = "t_mono_s,lat_deg,lon_deg,height_m,vn_mps,ve_mps,vd_mps,roll_deg,pitch_deg,yaw_deg"
    RATE_HZ, BATCH = 100, 10

    def __init__(self, path: Path, trajectory: Trajectory, start: float) -> None:
        self._file = path.open("w", encoding="utf-8")
        self._trajectory, self._start, self._row = trajectory, start, 0
        self._file.write(self.HEADER + "\n")
        self._file.flush()

    def step(self, t: float) -> None:
        """Write the rows that are due, in whole batches."""
        due = int(math.floor(t * self.RATE_HZ) + 1 - self._row) // self.BATCH * self.BATCH
        if due <= 0:
            return
        times = np.arange(self._row, self._row + due) / self.RATE_HZ
        self._row += due
        x = self._trajectory.at(times)
        yaw = (np.degrees(x.rpy[:, 2:]) + 180.0) % 360.0 - 180.0
        angles = np.hstack([np.degrees(x.rpy[:, :2]), yaw])
        position = np.stack([np.degrees(x.lat), np.degrees(x.lon), x.height], axis=1)
        table = np.hstack([self._start + times[:, None], position, x.v_n, angles])
        form = "%.6f,%.10f,%.10f,%.4f,%.5f,%.5f,%.5f,%.5f,%.5f,%.5f\n"
        self._file.write("".join(form % tuple(row) for row in table.tolist()))
        self._file.flush()

    def idle(self) -> None:
        """Nothing to compute ahead."""

    def deadline(self) -> float:
        return (self._row + self.BATCH - 1) / self.RATE_HZ

    def close(self) -> None:
        self._file.close()


def serve(ports: Sequence[Port], tasks: Sequence[Task], start: float, end: float, stopped: Callable[[], bool]) -> None:
    """Run until time `end` or until `stopped()`. start: CLOCK_MONOTONIC of time 0 in s; tasks: what else is to do."""
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1)  # ns; the default of 50 us would make every frame late
    everything: list[Task] = [*ports, *tasks]
    listeners = {port.pty.fileno(): port for port in ports}
    heard: list[int] = []
    while not stopped() and (now := time.monotonic() - start) < end:
        for descriptor in heard:
            listeners[descriptor].listen(now)
        for task in everything:
            task.step(now)
        for task in everything:
            task.idle()
        deadline = min(end, now + _LONGEST_WAIT_S, *(task.deadline() for task in everything))
        wait = max(deadline - (time.monotonic() - start), 0.0)
        heard = select.select(listeners, (), (), wait)[0]
