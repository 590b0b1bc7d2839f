"""Runs devices on their pseudo-terminals in real time: one process, one wait, absolute deadlines.

A deadline is a time since the start, so errors of waking do not add up; after a stall all that was missed is sent.
"""

import ctypes
import logging
import math
import os
import select
import signal
import time
from array import array
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from .device import Device
from .faults.spec import Span
from .motion import Trajectory
from .pty import Pty

_PR_SET_PDEATHSIG = 1
_WAIT_MAX_S = 0.1  # signals and the end of the run are noticed after that
_PR_SET_TIMERSLACK = 29

_log = logging.getLogger("firmware_sim")


class Task(Protocol):
    """Work of the loop that is due at certain times."""

    def step(self, t: float) -> None: ...

    def idle(self) -> None: ...

    def deadline(self) -> float: ...


class EmulatedPort:
    """A device and the pseudo-terminal into which it is plugged, but for the outages. Context manager.

    patient: bytes without room in the pseudo-terminal wait for the reader, and are not lost. Otherwise they wait only
    for the kernel.
    """

    def __init__(
        self, name: str, device: Device, link: Path | None, outages: Sequence[Span] = (), *, patient: bool = False
    ) -> None:
        self.name, self.device = name, device
        self.longest_wait_s = 0.0  # until the kernel had passed bytes on
        self.late_s = array("f")  # by how much each write was later than the line would have delivered its first byte
        self._lost = 0
        self._behind_since = 0.0
        self._link, self._outages, self._patient = link, outages, patient
        self._next_change = 0.0
        self.pty: Pty | None = self._plug()

    def __enter__(self) -> "EmulatedPort":
        return self

    def __exit__(self, *_: object) -> None:
        self._unplug()

    @property
    def path(self) -> Path | None:
        """Path of the port; None while it is unplugged."""
        return None if self.pty is None else self.pty.path

    @property
    def lost(self) -> int:
        """Bytes that the host did not read in time."""
        return self._lost + (self.pty.lost if self.pty else 0)

    @property
    def behind(self) -> Pty | None:
        """The pseudo-terminal, if bytes wait there for the reader."""
        return self.pty if self.pty is not None and self.pty.waiting else None

    def listen(self, t: float) -> None:
        """The host has sent bytes."""
        if self.pty is not None:
            self.device.receive(self.device.uart.receive_from(self.pty.read(), self.pty.baud()), t)

    def step(self, t: float) -> None:
        self._check_plug(t)
        uart = self.device.uart
        self.device.advance(t)
        if self.pty is not None and self.pty.waits_for_kernel:
            self.longest_wait_s = max(self.longest_wait_s, t - self._behind_since)
        else:
            self._behind_since = t
        if self.pty is None:
            self._lost += len(uart.take(t, uart.baud))
        elif self._patient and self.behind is not None:
            self.pty.flush()
        elif self.behind is not None or uart.due() <= t:
            self.late_s.append(max(t - uart.due(), 0.0))
            self.pty.write(uart.take(t, self.pty.baud()))

    def idle(self) -> None:
        self.device.prepare()

    def deadline(self) -> float:
        due = math.inf if self._patient and self.behind is not None else self.device.uart.due()
        return min(due, self.device.deadline(), self._next_change)

    def _check_plug(self, t: float) -> None:
        self._next_change = min((outage.after(t) for outage in self._outages), default=math.inf)
        out = any(outage.holds(t) for outage in self._outages)
        if out and self.pty is not None:
            self._unplug()
            _log.info("%s: unplugged", self.name)
        elif not out and self.pty is None:
            self.pty = self._plug()
            _log.info("%s: plugged in again, %s", self.name, self.pty.path)

    def _plug(self) -> Pty:
        return Pty(self._link, self.device.uart.baud, patient=self._patient)

    def _unplug(self) -> None:
        if self.pty is not None:
            self._lost += self.pty.lost
            self.pty.close()
            self.pty = None


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


class RealTime:
    """Real time, or so many times as fast. start: CLOCK_MONOTONIC of time 0 in s."""

    def __init__(self, start: float, speed: float = 1.0) -> None:
        self._start, self._speed = start, speed

    def now(self) -> float:
        return (time.monotonic() - self._start) * self._speed

    def wait(self, deadline: float, ports: Sequence[EmulatedPort]) -> list[EmulatedPort]:
        """Wait until `deadline`, or until the host sends; the ports on which it has sent."""
        return _listen(ports, max(min((deadline - self.now()) / self._speed, _WAIT_MAX_S), 0.0), _behind(ports))


class AsFastAsRead:
    """Time jumps from deadline to deadline while the sensors stream, and stops while a reader is behind.

    Until all `leaders` stream it is real time, so that a host has the time to configure them.
    """

    def __init__(self, leaders: Sequence[EmulatedPort]) -> None:
        self._t, self._leaders = 0.0, leaders

    def now(self) -> float:
        return self._t

    def wait(self, deadline: float, ports: Sequence[EmulatedPort]) -> list[EmulatedPort]:
        """Jump to `deadline`, or wait; the ports on which the host has sent."""
        if behind := _behind(ports):
            return _listen(ports, _WAIT_MAX_S, behind)
        if all(port.device.deadline() < math.inf for port in self._leaders):
            self._t = max(deadline, self._t)
            return _listen(ports, 0.0)
        begin = time.monotonic()
        ready = _listen(ports, max(min(deadline - self._t, _WAIT_MAX_S), 0.0))
        self._t += time.monotonic() - begin
        return ready


def _behind(ports: Sequence[EmulatedPort]) -> list[Pty]:
    return [port.behind for port in ports if port.behind is not None]


def _listen(ports: Sequence[EmulatedPort], seconds: float, behind: Sequence[Pty] = ()) -> list[EmulatedPort]:
    listeners = {port.pty.fileno(): port for port in ports if port.pty is not None}
    ready = select.select(listeners, behind, (), seconds)[0]
    return [listeners[descriptor] for descriptor in ready]


def end_with_parent(parent: int) -> None:
    """Receive SIGTERM when the process `parent`, which started this one, ends."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        os.kill(os.getpid(), signal.SIGTERM)


def serve(
    ports: Sequence[EmulatedPort],
    tasks: Sequence[Task],
    clock: RealTime | AsFastAsRead,
    end: float,
    stopped: Callable[[], bool],
) -> None:
    """Run until time `end` or until `stopped()`. tasks: work beside the ports."""
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1)  # ns; the default of 50 us would make every frame late
    everything: list[Task] = [*ports, *tasks]
    ready: list[EmulatedPort] = []
    while not stopped() and (now := clock.now()) < end:
        for port in ready:
            port.listen(now)
        for task in everything:
            task.step(now)
        for task in everything:
            task.idle()
        ready = clock.wait(min(end, *(task.deadline() for task in everything)), ports)
