"""What clients of the daemon received: states by number and lateness, estimates beside the truth.

`python -m imud.commands.soak.received STREAM` is the client of the stream: a process of its own that does nothing but
read, so that what it misses is the daemon's or the machine's loss. Each line on stdin is answered by its counts.
"""

import contextlib
import gc
import json
import math
import os
import select
import socket
import struct
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ...client import RECORD
from ...errors import ImudError
from ...math.arrays import Floats
from ...process.python import python_command
from ..demo import LiveComparison
from ..demo.comparison import Comparison

_NUMBERS = struct.Struct("<8xQqq")  # of a record: seq, utc_offset_ns, t_ns
NO_LATENESS = (math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class Counts:
    """States that came: how many, how many are missing between them, how late the others."""

    count: int = 0
    missing: int = 0
    gaps: int = 0
    longest_gap_s: float = 0.0  # between two states, by the time of their samples
    recent_s: tuple[float, float, float] = NO_LATENESS  # median, 99th percentile, most since the last counts
    late_s: tuple[float, float, float] = NO_LATENESS  # of all


class States:
    """Counts states as they come."""

    def __init__(self) -> None:
        self._count = self._missing = self._gaps = 0
        self._longest_ns = 0
        self._last: tuple[int, int] | None = None
        self._recent: list[float] = []
        self._before: list[Floats] = []

    def add(self, record: bytes, now_ns: int) -> None:
        seq, _, t_ns = _NUMBERS.unpack_from(record)
        if self._last is not None:
            self._missing += seq - self._last[0] - 1
            self._gaps += seq > self._last[0] + 1
            self._longest_ns = max(self._longest_ns, t_ns - self._last[1])
        self._last = seq, t_ns
        self._count += 1
        self._recent.append((now_ns - t_ns) * 1e-9)

    def counts(self) -> Counts:
        """Until now."""
        recent, self._recent = np.array(self._recent), []
        self._before.append(recent)
        lateness = percentiles(recent), percentiles(np.concatenate(self._before))
        return Counts(self._count, self._missing, self._gaps, self._longest_ns * 1e-9, *lateness)


def percentiles(late: Floats) -> tuple[float, float, float]:
    """Median, 99th percentile, maximum; NaN of nothing."""
    if not len(late):
        return NO_LATENESS
    median, most, longest = np.percentile(late, (50.0, 99.0, 100.0))
    return float(median), float(most), float(longest)


class StreamReader:
    """The client of the stream, from the outside."""

    def __init__(self, path: Path) -> None:
        command = python_command(__name__, str(path))
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        self.counts()

    @property
    def pid(self) -> int:
        """Of the process that reads."""
        return self._process.pid

    def counts(self) -> Counts:
        """What it has received until now. Raises ImudError when it has ended."""
        assert self._process.stdin and self._process.stdout
        with contextlib.suppress(BrokenPipeError):
            print(file=self._process.stdin, flush=True)
        if not (line := self._process.stdout.readline()):
            raise ImudError("soak: the daemon has closed the stream to a client that keeps up")
        return Counts(**json.loads(line))

    def close(self) -> None:
        self._process.communicate()


def _read(path: Path) -> None:
    """Read the stream until stdin ends."""
    gc.disable()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as stream:
        stream.connect(str(path))
        stream.setblocking(False)
        states = States()
        while True:
            ready = select.select([stream, sys.stdin], [], [])[0]
            if stream in ready:
                with contextlib.suppress(BlockingIOError):
                    while record := stream.recv(2 * RECORD.size):
                        states.add(record, time.monotonic_ns())
                    return
            if sys.stdin in ready:
                if not sys.stdin.readline():
                    return
                print(json.dumps(asdict(states.counts())), flush=True)


class EstimateReader:
    """A client of gpsd's protocol that compares the estimates with the truth."""

    def __init__(self, client: socket.socket, truth_file: Path) -> None:
        client.setblocking(False)
        self._socket, self._rest = client, b""
        self._live = LiveComparison(truth_file)

    @property
    def comparison(self) -> Comparison:
        return self._live.comparison

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> None:
        """Take what has come."""
        with contextlib.suppress(BlockingIOError):
            *lines, self._rest = (self._rest + self._socket.recv(65536)).split(b"\n")
            for message in map(json.loads, lines):
                if message["class"] == "EST":
                    self._live.add(message)


def take_priority_of(daemon: int, other: int) -> None:
    """Give a process the real-time priority of the daemon, if that has one: its lateness would be taken for theirs."""
    if (policy := os.sched_getscheduler(daemon)) in (os.SCHED_FIFO, os.SCHED_RR):
        os.sched_setscheduler(other, policy, os.sched_getparam(daemon))


if __name__ == "__main__":
    _read(Path(sys.argv[1]))
