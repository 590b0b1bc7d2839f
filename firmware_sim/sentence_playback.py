"""A receiver's recorded sentences, played byte by byte, damaged ones included.

A sentence with another time begins a new epoch; sentences without a time belong to the epoch before. The interval
between epochs is that of their times; a second where these step back, or ahead by more than a minute (a clock that was
set).
"""

import math
from pathlib import Path

from .replay import DataError
from .uart import Uart

_TIME_FIELD = {"GGA": 1, "RMC": 1, "GNS": 1, "GST": 1, "ZDA": 1, "GLL": 5}
_GAP_MAX_S, _DEFAULT_GAP_S, _DAY_S = 60.0, 1.0, 86400.0


def read(path: Path) -> list[tuple[float, bytes]]:
    """(time since the first epoch in s, bytes) of every epoch of a log. Raises DataError, OSError."""
    epochs: list[tuple[float, list[bytes]]] = [(0.0, [])]
    last: float | None = None
    for line in path.read_bytes().splitlines(keepends=True):
        stamp = _time_of_day(line)
        if stamp is not None and stamp != last:
            if last is not None:
                gap = (stamp - last) % _DAY_S
                epochs.append((epochs[-1][0] + (gap if gap <= _GAP_MAX_S else _DEFAULT_GAP_S), []))
            last = stamp
        epochs[-1][1].append(line)
    if last is None:
        raise DataError(f"{path}: no sentence with a time ({', '.join(_TIME_FIELD)})")
    return [(t, b"".join(lines)) for t, lines in epochs]


def _time_of_day(line: bytes) -> float | None:
    """s, of a sentence that has one."""
    fields = line.decode("ascii", "replace").split("*")[0].strip().split(",")
    index = _TIME_FIELD.get(fields[0][-3:], 0) if fields[0].startswith("$") else 0
    text = fields[index] if 0 < index < len(fields) else ""
    try:
        return int(text[:2]) * 3600.0 + int(text[2:4]) * 60.0 + float(text[4:])
    except ValueError:
        return None


class SentencePlayback:
    """A device that plays a log and ignores all input. loop: repeat it for ever."""

    def __init__(self, epochs: list[tuple[float, bytes]], baud: int, loop: bool = False) -> None:
        self.uart = Uart(baud)
        self._epochs = epochs
        self._lap = epochs[-1][0] + _DEFAULT_GAP_S if loop else math.inf
        self._next, self._on = 0, 0.0

    def receive(self, data: bytes, t: float) -> None:
        """Ignored."""
        self.advance(t)

    def advance(self, t: float) -> None:
        """Send all epochs that were due until time `t`, sentence by sentence."""
        while (due := self._due()) <= t:
            for sentence in self._epochs[self._next % len(self._epochs)][1].splitlines(keepends=True):
                self.uart.send(sentence, due)
            self._next += 1

    def deadline(self) -> float:
        due = self._due()
        return self.uart.earliest(due, 1) if due < math.inf else due

    def restart(self, t: float) -> None:
        """From the beginning."""
        self.uart.clear()
        self._next, self._on = 0, t

    def prepare(self) -> None:
        """Nothing to compute ahead."""

    def _due(self) -> float:
        laps, i = divmod(self._next, len(self._epochs))
        return self._on + self._epochs[i][0] + (laps * self._lap if laps else 0.0)
