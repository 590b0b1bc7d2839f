"""What a client of the daemon received: states by number and lateness; and the daemon's own account of its samples."""

import contextlib
import json
import select
import socket
import struct
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from imud.client import RECORD

from ..demo import LiveComparison
from ..demo.comparison import Comparison

_NUMBERS = struct.Struct("<8xQqq")  # of a record: seq, utc_offset_ns, t_ns
_TIMEOUT_S = 10.0


@dataclass
class States:
    """States of the stream as they came: how many, which are missing, how late."""

    count: int = 0
    missing: int = 0
    gaps: int = 0
    longest_gap_s: float = 0.0  # between two states, by the time of their samples
    late_s: list[float] = field(default_factory=list)  # since the last `take_lateness`
    all_late_s: list[np.ndarray] = field(default_factory=list)
    _last: tuple[int, int] | None = None

    def add(self, record: bytes, now_ns: int) -> None:
        seq, _, t_ns = _NUMBERS.unpack_from(record)
        if self._last is not None:
            self.missing += seq - self._last[0] - 1
            self.gaps += seq > self._last[0] + 1
            self.longest_gap_s = max(self.longest_gap_s, (t_ns - self._last[1]) * 1e-9)
        self._last = seq, t_ns
        self.count += 1
        self.late_s.append((now_ns - t_ns) * 1e-9)

    def take_lateness(self) -> tuple[float, float, float]:
        """Median, 99th percentile and maximum in s since the last call; NaN without a state."""
        late, self.late_s = np.array(self.late_s), []
        self.all_late_s.append(late)
        return percentiles(late)

    def lateness(self) -> tuple[float, float, float]:
        """The same of all."""
        self.take_lateness()
        return percentiles(np.concatenate(self.all_late_s))


def percentiles(late: np.ndarray) -> tuple[float, float, float]:
    """Median, 99th percentile, maximum; NaN of nothing."""
    if not len(late):
        return (np.nan, np.nan, np.nan)
    median, most, longest = np.percentile(late, (50.0, 99.0, 100.0))
    return float(median), float(most), float(longest)


class StreamReader:
    """A client of the binary stream that keeps up."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.connect(str(path))
        self._socket.setblocking(False)
        self.states = States()
        self.ended = False

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> None:
        """Take what has come."""
        try:
            while record := self._socket.recv(2 * RECORD.size):
                self.states.add(record, time.monotonic_ns())
            self.ended = True
        except BlockingIOError:
            pass
        except OSError:
            self.ended = True

    def close(self) -> None:
        self._socket.close()


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


def status_of(path: Path) -> dict[str, Any]:
    """The daemon's answer to ?STATUS. Raises OSError, TimeoutError."""
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(_TIMEOUT_S)
        client.connect(str(path))
        client.sendall(b"?STATUS;\n")
        text = b""
        while b'"STATUS"' not in text or not text.endswith(b"\n"):
            if not select.select([client], [], [], _TIMEOUT_S)[0] or not (data := client.recv(65536)):
                raise TimeoutError("the daemon does not answer ?STATUS")
            text += data
    found: dict[str, Any] = next(
        message for line in text.splitlines() if (message := json.loads(line))["class"] == "STATUS"
    )
    return found
