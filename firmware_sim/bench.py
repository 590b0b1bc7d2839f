"""Emulated sensors inside the host's own process: /dev/spidev0.0, 0.1, … and their data-ready lines.

The stand-ins for the Python packages spidev and gpiod (in `stand_in/`) call them here. A sensor needs no process of
its own: at each call it computes the samples until now, so its timing does not depend on the load.
The environment names the sensors: IMUD_SIM="g350 --scenario car --ideal", as for `imud sim` (default: g350).
"""

import argparse
import math
import os
import shlex
import time
from collections import deque
from functools import cache

from . import build, cli
from .epson import EpsonSensor
from .epson_spi import EpsonSpi
from .timerfd import TimerFd

CHIP = "/dev/gpiochip0"
IDLE_S = 0.6e-3  # before a sample: the last one has been fetched, so there is time to compute ahead
FIRST_LINE = 24  # of the sensor at chip select 0; the next one's is the next


class DataReadyLine:
    """A data-ready line as the kernel sees it: rising edges with their times, kept until they are read."""

    def __init__(self, sensor: EpsonSensor, start: float) -> None:
        self._sensor, self._start = sensor, start
        self._edges: deque[tuple[int, int]] = deque()
        self._seen = 0
        self.timer: TimerFd | None = None  # while the line is requested
        sensor.on_data_ready = self._add_edge

    def listen(self, capacity: int) -> TimerFd:
        """Keep up to `capacity` edges from now on; returns the timer that becomes readable with them."""
        self._edges, self._seen = deque(maxlen=capacity), 0
        self.timer = TimerFd()
        self.update_timer()
        return self.timer

    def read_edges(self) -> list[tuple[int, int]]:
        """Edges since the last call: sequence number from 1 on, CLOCK_MONOTONIC in ns."""
        self._sensor.advance(time.monotonic() - self._start)
        edges = list(self._edges)
        self._edges.clear()
        self.update_timer()
        return edges

    def update_timer(self) -> None:
        """Be readable when there will be an edge, or while there is one."""
        due = self._start if self._edges else self._start + self._sensor.next_sample
        if self.timer is not None and due != self.timer.at:
            self.timer.set(due)

    def _add_edge(self, t: float) -> None:
        if self.timer is not None:
            self._seen += 1
            self._edges.append((self._seen, round((self._start + t) * 1e9)))


class ChipSelect:
    """One chip select: its sensor, and the time on its bus."""

    def __init__(self, sensor: EpsonSensor, start: float) -> None:
        self.spi, self.wire = EpsonSpi(sensor), DataReadyLine(sensor, start)
        self._sensor, self._start = sensor, start
        self._free = -math.inf  # when the pause that the host set is over

    def transfer(self, data: bytes, clock_hz: int, mode: int, delay_s: float) -> bytes:
        """A transfer and the delay after it, as in the kernel; returns when both are over."""
        begin = max(time.monotonic(), self._free)
        answer = self.spi.transfer(data, begin - self._start, clock_hz, mode)
        self._free = begin + 8 * len(data) / clock_hz + delay_s
        self.wire.update_timer()
        if self._sensor.next_sample - (begin - self._start) < IDLE_S:
            self._sensor.prepare()
        while time.monotonic() < self._free:
            pass
        return answer

    def __str__(self) -> str:
        broken = ", ".join(f"{rule} {count}" for rule, count in self.spi.violations.items())
        return f"{self.spi.words} words, broken rules: {broken or 'none'}"


@cache
def chip_selects() -> tuple[ChipSelect, ...]:
    """The sensors of this process, switched on at the first call."""
    parser = argparse.ArgumentParser(prog="IMUD_SIM", allow_abbrev=False)
    cli.add_arguments(parser)
    args = parser.parse_args(shlex.split(os.environ.get("IMUD_SIM", "g350")))
    scene = build.scene(args)
    start, utc = scene.time_zero()
    found = []
    for i, (name, _) in enumerate(args.devices):
        sensor = build.device(args, scene, utc, i)
        if not isinstance(sensor, EpsonSensor):
            parser.error(f"{name} does not speak SPI")
        found.append(ChipSelect(sensor, start))
    return tuple(found)
