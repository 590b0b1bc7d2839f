"""An SPI device through spidev: words with the pauses that it needs between them; samples fetched when they are due.

An edge of the data-ready line says that a sample is there; the kernel stamps the edges. Without such a line, or while
it has no edges, samples are fetched by time: each a little earlier after the last, until one is not there yet and is
fetched again a moment later. So the fetches follow the sensor, whose clock is not ours. An SPI device queues nothing: a
sample that is not fetched before the next one is overwritten.
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
from .timer import timer_and_epoll

BITS = 8  # a word is sent as two bytes
ADVANCE = 256  # each sample is fetched one 256th of a period earlier than the last
RETRIES, RETRY_PERIODS = 16, 2  # a missing sample is fetched again 16 times per period, for 2 periods
EDGE_TIMEOUT = 4  # periods without an edge after which a sample is fetched without one
MISSING_EDGES = 50  # samples in a row without an edge before the warning
EDGE_AGE_MAX = 1.25  # periods; an older edge is not that of the sample


class SpiPort:
    """An open device. Not thread-safe. Raises what `imud.drivers.errors` has: on opening, and PortLostError in use."""

    plain = False

    def __init__(self, spec: PortSpec) -> None:
        self.path = spec.path
        self._device = _open(spec)
        self._edges: DataReady | None = None
        with contextlib.ExitStack() as opened:
            opened.callback(self._device.close)
            if spec.data_ready:
                self._edges = DataReady(spec.data_ready)
                opened.callback(self._edges.close)
            self._timer, self._epoll = timer_and_epoll(self.path)
            opened.pop_all()
        self.fd: int = self._epoll.fileno()  # readable when answers wait, or when a sample is due
        self._bus = Bus(0, 0, 0)
        self._fetch: Fetch | None = None
        self._answers = bytearray()
        self._due_ns = 0
        self._overruns = self._torn = self._unannounced = 0
        self._retries = 0  # in a row
        self._missing_edges = 0  # samples without an edge since the last one with

    @property
    def counters(self) -> Mapping[str, int]:
        """overruns: samples overwritten before they were fetched, as far as edges show; torn: overwritten meanwhile.

        unannounced: samples fetched by time although there is a data-ready line.
        """
        if self._edges is None:
            return {"overruns": self._overruns, "torn": self._torn}
        overruns = self._overruns + self._edges.dropped
        return {"overruns": overruns, "torn": self._torn, "unannounced": self._unannounced}

    @property
    def warning(self) -> str:
        """See `Line`."""
        if self._edges and self._missing_edges >= MISSING_EDGES:
            return (
                f"no edges on the data-ready line {self._edges.line}: samples are fetched by time; is it wired to it?"
            )
        return ""

    def set_baud(self, baud: int) -> None:
        """Has no meaning here; see `set_spi`."""

    def set_spi(self, setup: Bus | Fetch) -> None:
        """Set the bus up; or begin to fetch samples, which are what `read` and `receive` give from then on."""
        self._watch_edges(isinstance(setup, Fetch))
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

    def _watch_edges(self, fetching: bool) -> None:
        """Wake up at edges only while samples are fetched: a sensor that was left sampling makes edges, too."""
        if self._edges is None or fetching == (self._fetch is not None):
            return
        if fetching:
            self._edges.discard()
            self._epoll.register(self._edges.fd, select.EPOLLIN)
        else:
            self._epoll.unregister(self._edges.fd)

    def write(self, data: bytes) -> int:
        """Exchange 16-bit words. While samples are fetched, the answers are not kept."""
        for i in range(0, len(data), 2):
            answer = self._exchange(Cycle(data[i : i + 2], self._bus.stall_us), self._bus.clock_hz)
            if self._fetch is None:
                self._answers += answer
        if self._answers:
            self._timer.set(1)
        return len(data)

    def read(self) -> bytes:
        """The answers that wait; or the next sample's frame, if it is there."""
        if self._fetch is not None:
            return self._fetch_next(self._fetch)[0]
        self._timer.clear()
        answers = bytes(self._answers)
        self._answers.clear()
        return answers

    def receive(self, buffer: memoryview, now_ns: int) -> tuple[int, int]:
        """The next sample's frame, if it is there, into `buffer`; returns its bytes, and when the sample was ready."""
        if self._fetch is None:
            return 0, now_ns
        frame, ready_ns = self._fetch_next(self._fetch)
        buffer[: len(frame)] = frame
        return len(frame), ready_ns

    def discard(self) -> None:
        """Discard the waiting answers."""
        self._answers.clear()
        if self._fetch is None:
            self._timer.clear()

    def close(self) -> None:
        """Close all descriptors. May be called twice."""
        if self._epoll.closed:
            return
        self._epoll.close()
        self._timer.close()
        if self._edges:
            self._edges.close()
        with contextlib.suppress(OSError):
            self._device.close()

    def _exchange(self, cycle: Cycle, clock_hz: int) -> bytes:
        try:  # xfer2 overwrites the list with the answer
            return bytes(self._device.xfer2(list(cycle.word), clock_hz, cycle.stall_us))
        except OSError as error:
            raise self._lost(error) from error

    def _fetch_next(self, fetch: Fetch) -> tuple[bytes, int]:
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
                    self._edges.pop_until(begun_ns)  # of samples that were fetched already
                self._schedule_retry(fetch.period_ns)
                return b"", 0
            answers += answer
        self._retries = 0
        frame = fetch.frame(bytes(answers))
        edge_ns = self._edge_of(captured_ns, bool(frame))
        self._schedule_next(fetch, captured_ns, edge_ns, bool(frame))
        ready_ns = edge_ns if captured_ns - edge_ns < EDGE_AGE_MAX * fetch.period_ns else captured_ns
        return frame, ready_ns

    def _edge_of(self, captured_ns: int, whole: bool) -> int:
        """Time of the edge of the sample captured at that time, 0 if there was none; counts the samples missed."""
        self._torn += not whole
        if self._edges is None:
            return 0
        edges = self._edges.pop_until(captured_ns)
        self._overruns += max(len(edges) - whole, 0)
        self._unannounced += not edges
        self._missing_edges = 0 if edges else self._missing_edges + 1
        return edges[-1] if edges else 0

    def _schedule_retry(self, period_ns: int) -> None:
        """Fetch again a moment later; later if there are edges, or if there was no sample for long."""
        self._retries += 1
        if self._edges and self._missing_edges == 0:
            pause_ns = EDGE_TIMEOUT * period_ns
        else:
            pause_ns = period_ns // RETRIES if self._retries < RETRY_PERIODS * RETRIES else period_ns
        self._due_ns = time.monotonic_ns() + pause_ns
        self._timer.set(self._due_ns)

    def _schedule_next(self, fetch: Fetch, captured_ns: int, edge_ns: int, whole: bool) -> None:
        """Set the time of the next fetch."""
        if not whole or (self._edges and self._edges.waiting):
            self._due_ns = 1
        elif edge_ns:
            self._due_ns = captured_ns + EDGE_TIMEOUT * fetch.period_ns
        else:
            step_ns = fetch.period_ns - fetch.period_ns // ADVANCE
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
            raise PortAbsentError(path, _absent(node)) from error
        if error.errno in DENIED:
            remedy = "join group spi (sudo usermod -aG spi $USER) and log in again"
            raise PortDeniedError(path, f"no permission to open {node}: {remedy}") from error
        raise NotSerialError(path, f"{node} cannot be used: {reason(error)}") from error
    others = holders(node.stat()) if node.exists() else []
    if others:
        device.close()
        raise PortBusyError(path, f"{node} is in use by {', '.join(map(str, others))}: stop it first")
    return device


def _absent(node: Path) -> str:
    present = ", ".join(f"spi:{found.name.removeprefix('spidev')}" for found in sorted(Path("/dev").glob("spidev*")))
    return (
        f"there is no {node}; SPI ports present: {present or 'none'}. On a Raspberry Pi switch SPI on "
        "(sudo raspi-config nonint do_spi 0, or dtparam=spi=on in /boot/firmware/config.txt) and reboot"
    )
