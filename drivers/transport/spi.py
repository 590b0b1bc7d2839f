"""An SPI device through spidev: words with the pauses that it needs between them; samples fetched when they are due.

A sample is due when the data-ready line says so; the kernel stamps its edges. Without such a line, or while it is
silent, samples are fetched by time: each a little earlier after the last, until one is not there yet and is asked for
again a moment later. So the reading stays just behind the sensor, whose clock is not ours. An SPI device queues
nothing: a sample that is not fetched before the next one is overwritten.
"""

import contextlib
import select
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import NotSerialError, PortAbsentError, PortBusyError, PortDeniedError, PortLostError, PortSupportError
from ..spi import Bus, Cycle, Fetch
from .data_ready import REMEDY, DataReady
from .holders import holders
from .portspec import PortSpec
from .reasons import ABSENT, DENIED, reason
from .timer import Timer

BITS = 8  # a word is sent as two bytes
EARLIER = 256  # each sample is asked for one 256th of a period earlier than the last
AGAIN, PATIENCE = 16, 2  # one that was not there is asked for again every 16th of a period, for 2 periods
OVERDUE = 4  # periods without an edge after which the sensor is asked without one
MUTE = 50  # samples in a row fetched without an edge before the user is told
BELIEVED = 1.25  # periods; an edge longer ago than that is not the one of the sample read


class SpiPort:
    """An open device. Not thread-safe. Raises the errors of `drivers.errors` on opening and PortLostError in use."""

    plain = False

    def __init__(self, spec: PortSpec) -> None:
        self.path = spec.path
        self._device = _open(spec)
        self._edges: DataReady | None = None
        try:
            self._edges = DataReady(spec.data_ready) if spec.data_ready else None
        except BaseException:
            self._device.close()
            raise
        self._timer = Timer()
        self._wakers = select.epoll()
        self._wakers.register(self._timer.fd, select.EPOLLIN)
        self.fd: int = self._wakers.fileno()  # readable when answers wait, or when a sample is due
        self._bus = Bus(0, 0, 0)
        self._fetch: Fetch | None = None
        self._answers = bytearray()
        self._due_ns = 0
        self._overruns = self._torn = self._unannounced = 0
        self._waits = 0  # in a row
        self._mute = 0  # samples without an edge since the last one with

    @property
    def counters(self) -> Mapping[str, int]:
        """overruns: samples overwritten before they were fetched, as far as edges tell; torn: overwritten meanwhile.

        unannounced: samples fetched by time although there is a data-ready line.
        """
        if self._edges is None:
            return {"overruns": self._overruns, "torn": self._torn}
        overruns = self._overruns + self._edges.dropped
        return {"overruns": overruns, "torn": self._torn, "unannounced": self._unannounced}

    @property
    def complaint(self) -> str:
        """See `Line`."""
        if self._edges and self._mute >= MUTE:
            return (
                f"no edges on the data-ready line {self._edges.line}: samples are fetched by time; is it wired to it?"
            )
        return ""

    def set_baud(self, baud: int) -> None:
        """Has no meaning here; see `set_spi`."""

    def set_spi(self, setup: Bus | Fetch) -> None:
        """Set the bus up; or begin to fetch samples, which are what `read` and `receive` give from then on."""
        self._attend(isinstance(setup, Fetch))
        if isinstance(setup, Bus):
            self._bus, self._fetch = setup, None
            try:
                self._device.mode = setup.mode
                self._device.bits_per_word = BITS
                self._device.max_speed_hz = setup.clock_hz
            except (OSError, TypeError) as error:
                raise self._lost(error) from error
        else:
            self._fetch = setup
            self._due_ns = time.monotonic_ns()
            self._timer.set(self._due_ns)

    def _attend(self, fetching: bool) -> None:
        """Wake up at edges only while samples are fetched: a sensor that was left sampling makes edges, too."""
        if self._edges is None or fetching == (self._fetch is not None):
            return
        if fetching:
            self._edges.forget()
            self._wakers.register(self._edges.fd, select.EPOLLIN)
        else:
            self._wakers.unregister(self._edges.fd)

    def write(self, data: bytes) -> None:
        """Exchange 16-bit words. While samples are fetched, the answers are not kept."""
        for i in range(0, len(data), 2):
            answer = self._exchange(Cycle(data[i : i + 2], self._bus.stall_us), self._bus.clock_hz)
            if self._fetch is None:
                self._answers += answer
        if self._answers:
            self._timer.set(1)

    def read(self) -> bytes:
        """The answers that wait; or the next sample's frame, if it is there."""
        if self._fetch is not None:
            return self._next(self._fetch)[0]
        self._timer.clear()
        answers = bytes(self._answers)
        self._answers.clear()
        return answers

    def receive(self, room: memoryview, now_ns: int) -> tuple[int, int]:
        """The next sample's frame, if it is there, into `room`; returns its bytes, and when the sample was ready."""
        if self._fetch is None:
            return 0, now_ns
        frame, ready_ns = self._next(self._fetch)
        room[: len(frame)] = frame
        return len(frame), ready_ns

    def discard(self) -> None:
        """Throw away what waits."""
        self._answers.clear()
        if self._fetch is None:
            self._timer.clear()

    def close(self) -> None:
        """Give everything back. May be called twice."""
        if self._wakers.closed:
            return
        self._wakers.close()
        self._timer.close()
        if self._edges:
            self._edges.close()
        with contextlib.suppress(OSError):
            self._device.close()

    def _exchange(self, cycle: Cycle, clock_hz: int) -> bytes:
        try:  # a list that is handed over is overwritten with the answer
            return bytes(self._device.xfer2(list(cycle.word), clock_hz, cycle.stall_us))
        except OSError as error:
            raise self._lost(error) from error

    def _next(self, fetch: Fetch) -> tuple[bytes, int]:
        """The next sample's frame and when it was ready; an empty one if there is none yet, or it was overwritten."""
        self._timer.clear()
        answers = bytearray()
        begun_ns = captured_ns = time.monotonic_ns()
        for i, cycle in enumerate(fetch.cycles):
            answer = self._exchange(cycle, fetch.clock_hz)
            if i == fetch.capture:
                captured_ns = time.monotonic_ns() - 1000 * cycle.stall_us
            if i == fetch.gate and not fetch.is_new(answer):
                if self._edges:
                    self._edges.take(begun_ns)  # of samples that were fetched already
                self._wait(fetch.period_ns)
                return b"", 0
            answers += answer
        self._waits = 0
        frame = fetch.frame(bytes(answers))
        edge_ns = self._edge_of(captured_ns, bool(frame))
        self._plan(fetch, captured_ns, edge_ns, bool(frame))
        ready_ns = edge_ns if captured_ns - edge_ns < BELIEVED * fetch.period_ns else captured_ns
        return frame, ready_ns

    def _edge_of(self, captured_ns: int, whole: bool) -> int:
        """Time of the edge of the sample captured at that time, 0 if there was none; counts the samples missed."""
        self._torn += not whole
        if self._edges is None:
            return 0
        edges = self._edges.take(captured_ns)
        self._overruns += max(len(edges) - whole, 0)
        self._unannounced += not edges
        self._mute = 0 if edges else self._mute + 1
        return edges[-1] if edges else 0

    def _wait(self, period_ns: int) -> None:
        """Look again a moment later; less often if an edge will tell, or if nothing has come for long."""
        self._waits += 1
        if self._edges and self._mute == 0:
            pause_ns = OVERDUE * period_ns
        else:
            pause_ns = period_ns // AGAIN if self._waits < PATIENCE * AGAIN else period_ns
        self._due_ns = time.monotonic_ns() + pause_ns
        self._timer.set(self._due_ns)

    def _plan(self, fetch: Fetch, captured_ns: int, edge_ns: int, whole: bool) -> None:
        """Say when to look next."""
        if not whole or (self._edges and self._edges.waiting):
            self._due_ns = 1
        elif edge_ns:
            self._due_ns = captured_ns + OVERDUE * fetch.period_ns
        else:
            step_ns = fetch.period_ns - fetch.period_ns // EARLIER
            self._due_ns = max(self._due_ns, captured_ns - fetch.period_ns) + step_ns
        self._timer.set(self._due_ns)

    def _lost(self, error: Exception) -> PortLostError:
        return PortLostError(self.path, f"{self.path} does not work any more: {reason(error)}")


def _open(spec: PortSpec) -> Any:
    """The device, opened and not used by others."""
    path = spec.path
    try:
        import spidev
    except ImportError as error:
        raise PortSupportError(path, f"SPI needs the Python package spidev: {REMEDY}") from error
    assert spec.spi is not None
    bus, chip_select = spec.spi
    node = Path(f"/dev/spidev{bus}.{chip_select}")
    device = spidev.SpiDev()
    try:
        device.open(bus, chip_select)
    except OSError as error:
        if error.errno in ABSENT:
            raise PortAbsentError(path, _absent(path, node)) from error
        if error.errno in DENIED:
            mend = "join group spi (sudo usermod -aG spi $USER) and log in again"
            raise PortDeniedError(path, f"no permission to open {node}: {mend}") from error
        raise NotSerialError(path, f"{node} cannot be used: {reason(error)}") from error
    rivals = holders(node.stat()) if node.exists() else []
    if rivals:
        device.close()
        raise PortBusyError(path, f"{node} is in use by {', '.join(map(str, rivals))}: stop it first")
    return device


def _absent(path: str, node: Path) -> str:
    present = ", ".join(f"spi:{found.name.removeprefix('spidev')}" for found in sorted(Path("/dev").glob("spidev*")))
    return (
        f"there is no {node}; SPI ports present: {present or 'none'}. On a Raspberry Pi switch SPI on "
        "(sudo raspi-config nonint do_spi 0, or dtparam=spi=on in /boot/firmware/config.txt) and reboot"
    )
