"""A device's data-ready line: a GPIO whose rising edges the kernel stamps, read through libgpiod 2.

The interrupt handler takes the time stamp, so late wake-ups do no harm.
Source: libgpiod's Python bindings (gpiod 2.x), `gpiod.request_lines`.
"""

import contextlib
import select
from typing import Any

from ..errors import (
    NotSerialError,
    PortAbsentError,
    PortBusyError,
    PortDeniedError,
    PortError,
    PortLostError,
    PortSupportError,
)
from .reasons import ABSENT, BUSY, DENIED, reason

REMEDY = "pip install 'imud[spi]'"


class DataReady:
    """The requested line. `fd` is readable while edges wait. Raises the errors of `imud.drivers.errors`."""

    def __init__(self, line: str) -> None:
        """line: CHIP:LINE, as /dev/gpiochip0:24 or gpiochip0:GPIO24 (offset, or the line's name)."""
        chip, _, name = line.rpartition(":")
        self.line = line
        self.dropped = 0  # edges for which the kernel had no room (it keeps 16)
        self.waiting: list[int] = []  # edges that were read and not popped
        self._next: int | None = None  # sequence number
        self._request = _request(line, chip if chip.startswith("/") else f"/dev/{chip}", name)
        self.fd: int = self._request.fd
        self._poll = select.poll()
        self._poll.register(self.fd, select.POLLIN)

    def discard(self) -> None:
        """Drop the edges until now, before the first fetch."""
        self._read()
        self.waiting.clear()
        self.dropped = 0

    def pop_until(self, until_ns: int) -> list[int]:
        """Remove and return the times in ns (CLOCK_MONOTONIC) of the waiting edges until then, oldest first."""
        self._read()
        edges = self.waiting
        self.waiting = [edge for edge in edges if edge > until_ns]
        return edges[: len(edges) - len(self.waiting)]

    def _read(self) -> None:
        """Take what the kernel has, without blocking."""
        try:
            events = self._request.read_edge_events() if self._poll.poll(0) else []
        except OSError as error:
            raise PortLostError(self.line, f"the data-ready line {self.line} is gone: {reason(error)}") from error
        if not events:
            return
        if self._next is not None:
            self.dropped += events[-1].line_seqno + 1 - self._next - len(events)
        self._next = events[-1].line_seqno + 1
        self.waiting += [event.timestamp_ns for event in events]

    def close(self) -> None:
        """Release the line."""
        with contextlib.suppress(OSError):
            self._request.release()


def _request(line: str, chip: str, name: str) -> Any:
    try:
        import gpiod
        from gpiod.line import Clock, Direction, Edge

        settings = gpiod.LineSettings(
            direction=Direction.INPUT, edge_detection=Edge.RISING, event_clock=Clock.MONOTONIC
        )
    except (ImportError, AttributeError) as error:
        raise PortSupportError(
            line, f"the data-ready line {line} needs the Python package gpiod 2: {REMEDY}"
        ) from error
    offset = int(name) if name.isdecimal() else name
    try:
        return gpiod.request_lines(chip, consumer="imud", config={offset: settings})
    except (OSError, ValueError) as error:
        raise _port_error(line, chip, error) from error


def _port_error(line: str, chip: str, error: Exception) -> PortError:
    number = getattr(error, "errno", None)
    if number in ABSENT:
        return PortAbsentError(line, f"there is no GPIO chip {chip} for the data-ready line {line}: see `gpioinfo`")
    if number in DENIED:
        return PortDeniedError(
            line, f"no permission to open {chip}: join group gpio (sudo usermod -aG gpio $USER) and log in again"
        )
    if number in BUSY:
        return PortBusyError(line, f"the data-ready line {line} is in use: `gpioinfo` prints the user")
    return NotSerialError(line, f"the data-ready line {line} cannot be used: {reason(error)}")
