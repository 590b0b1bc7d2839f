"""Stand-in for the package gpiod 2: the same calls, on the data-ready lines of `imud.firmware_sim.bench`."""

import errno
import os
import select
import time
from collections.abc import Mapping
from dataclasses import dataclass

from imud.firmware_sim.bench import CHIP, FIRST_LINE, DataReadyLine, chip_selects

from .line import Bias, Clock, Direction, Edge

__version__ = "2.5.0"


@dataclass
class LineSettings:
    """What a line is requested for."""

    direction: Direction = Direction.AS_IS
    edge_detection: Edge = Edge.NONE
    bias: Bias = Bias.AS_IS
    active_low: bool = False
    event_clock: Clock = Clock.MONOTONIC


@dataclass(frozen=True)
class EdgeEvent:
    """A rising edge."""

    timestamp_ns: int
    line_offset: int
    global_seqno: int
    line_seqno: int


class LineRequest:
    """Requested lines; here one."""

    def __init__(self, wire: DataReadyLine, offset: int, settings: LineSettings, capacity: int) -> None:
        self._wire, self._offset = wire, offset
        realtime = settings.event_clock is Clock.REALTIME
        self._shift_ns = time.time_ns() - time.monotonic_ns() if realtime else 0
        self._timer = wire.listen(capacity)
        self.fd = self._timer.fd

    def fileno(self) -> int:
        return self.fd

    def read_edge_events(self, max_events: int | None = None) -> list[EdgeEvent]:
        """Blocks until there is one, as the original does."""
        while not (edges := self._wire.read_edges()):
            select.select([self.fd], [], [])
        return [EdgeEvent(ns + self._shift_ns, self._offset, number, number) for number, ns in edges]

    def release(self) -> None:
        self._wire.timer = None
        self._timer.close()


def request_lines(
    path: str,
    config: Mapping[int | str, LineSettings | None],
    consumer: str | None = None,
    event_buffer_size: int | None = None,
) -> LineRequest:
    """Raises OSError and ValueError like the original."""
    if path != CHIP:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
    ((wanted, settings),) = config.items()
    lines = {FIRST_LINE + i: socket.wire for i, socket in enumerate(chip_selects())}
    names = {f"GPIO{offset}": offset for offset in lines}
    offset = names.get(wanted, -1) if isinstance(wanted, str) else wanted
    if offset not in lines or settings is None or settings.direction is not Direction.INPUT:
        raise ValueError(f"no such input: {wanted!r}")
    if settings.edge_detection not in (Edge.RISING, Edge.BOTH):
        raise ValueError("a data-ready line rises")
    if lines[offset].timer is not None:
        raise OSError(errno.EBUSY, os.strerror(errno.EBUSY))
    return LineRequest(lines[offset], offset, settings, event_buffer_size or 16)
