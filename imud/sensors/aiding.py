"""Measurements beside fixes as the daemon sees them: of receivers, and of other programs as datagrams of JSON lines.

A line of a datagram is an object such as `{"class": "HDG", "heading": 123.4, "sigma": 0.3, "t": 1700000000.25}`: the
class says which aiding source it is, the other names are those of its columns without their units, and `t` is the epoch
in Unix time; without it the epoch is the arrival. A line that cannot be used is counted, and costs nothing else.
"""

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..estimators.aiding_source import AidingSource
from ..estimators.records import MEASUREMENT
from ..math.arrays import Records
from .rate import RateMeter


@dataclass(frozen=True)
class NamedMeasurement:
    """A measurement by names and columns, as in a table."""

    source: str
    values: dict[str, float]
    t_ns: int
    arrival_ns: int

    def row(self, known: Iterable[AidingSource]) -> Records | None:
        """As an array of one MEASUREMENT. known: the sources that the estimator takes; None: this is of another.

        Raises ImpossibleValueError: a pressure in bar of one decimal has a sigma of 700 m.
        """
        for source in known:
            if source.name == self.source:
                row = np.zeros(1, MEASUREMENT)
                source.fill(row[0], self.values)
                row["t_ns"], row["arrival_ns"] = self.t_ns, self.arrival_ns
                return row
        return None


RATE_HZ_MAX = 100  # measurements of a source per second: the fusion horizon has room for so many
LINES_MAX = 32  # of a datagram: 32 cost some milliseconds
_OLDEST_S, _NEWEST_S = -10.0, 1.0  # of an epoch, from the arrival
_STALE_NS = 3_000_000_000
_SECOND_NS = 1_000_000_000
_LARGEST = 1e21  # of any number: Unix time in ns, which is refused as such, is 2e18
_SHOWN = 60  # characters of a line that cannot be used
_REASON_MAX = 200  # and of why: names in it are the sender's


class _RefusedError(ValueError):
    """A line cannot be used. rule: for counting."""

    def __init__(self, rule: str, why: str) -> None:
        super().__init__(why)
        self.rule = rule


class SourceCounter:
    """What came of one source."""

    def __init__(self) -> None:
        self.count = self.last_ns = self._second = self._in_second = 0
        self.refused = 0  # of a receiver's: those with an impossible value
        self.last_refused: str | None = None
        self.message = ""  # why the first was refused, until the daemon has logged it
        self.rate = RateMeter()

    def add(self, now_ns: int) -> bool:
        """Count one more; False: too many come."""
        second = now_ns // _SECOND_NS
        self._in_second = self._in_second + 1 if second == self._second else 1
        self._second = second
        if self._in_second > RATE_HZ_MAX:
            return False
        self.count += 1
        self.last_ns = now_ns
        return True

    def refuse(self, why: str) -> None:
        """One of those that were counted cannot be used."""
        self.refused += 1
        self.last_refused = why
        if self.refused == 1:
            self.message = f"refused: {why}; others like it are only counted"

    def table(self, now_ns: int) -> dict[str, Any]:
        """What `imud status` shows."""
        age_s = round((now_ns - self.last_ns) * 1e-9, 3)
        refused = {"refused": self.refused, "last_refused": self.last_refused} if self.refused else {}
        return {"received": self.count, "rate_hz": self.rate.hz, "age_s": age_s, **refused}


class DatagramDecoder:
    """Datagrams to measurements. Not thread-safe; all times are monotonic nanoseconds."""

    def __init__(self) -> None:
        self.messages: list[str] = []  # what is new, until the daemon has logged it
        self._received: dict[str, SourceCounter] = {}
        self._refused = Counter[str]()
        self._last_refused: str | None = None

    def decode(
        self, data: bytes, known: Iterable[AidingSource], now_ns: int, unix_ns: int
    ) -> Iterator[tuple[AidingSource, Records]]:
        """Source and measurement (array of one MEASUREMENT) of each line of a datagram that came at `now_ns`.

        known: the sources that the estimator takes. unix_ns: Unix time then.
        """
        sources = {source.message: source for source in known}
        lines = [line for line in data.split(b"\n") if line.strip()]
        if len(lines) > LINES_MAX:
            self.refuse("lines", f"a datagram of more than {LINES_MAX} lines")
        for line in lines[:LINES_MAX]:
            try:
                yield self._measurement(line, sources, now_ns, unix_ns)
            except ValueError as error:
                self._last_refused = f"{str(error)[:_REASON_MAX]}: {_shown(line)}"
                self.refuse(error.rule if isinstance(error, _RefusedError) else "value", self._last_refused)

    def refuse(self, rule: str, why: str) -> None:
        """Count what cannot be used, and log the first of each kind."""
        self._refused[rule] += 1
        if self._refused[rule] == 1:
            self.messages.append(f"refused: {why}; others like it are only counted")

    def _measurement(
        self, line: bytes, sources: dict[str, AidingSource], now_ns: int, unix_ns: int
    ) -> tuple[AidingSource, Records]:
        values = _object(line)
        kind = values.pop("class", None)
        if not isinstance(kind, str) or kind not in sources:
            there_are = ", ".join(sources) or "none"
            raise _RefusedError("class", f"class {kind!r} is not one of the estimator's: {there_are}")
        source = sources[kind]
        t_s = _number("t", values.pop("t", None))
        row = _row(source, values)
        measurement = np.zeros(1, MEASUREMENT)
        source.fill(measurement[0], row)
        measurement["t_ns"], measurement["arrival_ns"] = _epoch_ns(t_s, now_ns, unix_ns), now_ns
        received = self._received.setdefault(source.name, SourceCounter())
        if not received.add(now_ns):
            raise _RefusedError("rate", f"{source.name}: more than {RATE_HZ_MAX} per second")
        if received.count == 1:
            self.messages.append(f"measurements come: {source.name}")
        return source, measurement

    def update(self, now_ns: int) -> None:
        """Call now and then: how fast they come."""
        for received in self._received.values():
            received.rate.update(received.count, now_ns)

    def faults(self, now_ns: int) -> tuple[str, ...]:
        """The sources that fell silent, in words."""
        silent = (name for name, received in self._received.items() if now_ns - received.last_ns > _STALE_NS)
        return tuple(f"{name}: stale, nothing new comes" for name in silent)

    def properties(self, now_ns: int) -> dict[str, object]:
        """What `imud status` shows."""
        sources = {name: received.table(now_ns) for name, received in self._received.items()}
        return {"sources": sources, "refused": dict(self._refused), "last_refused": self._last_refused}


def _object(line: bytes) -> dict[str, Any]:
    try:
        values = json.loads(line, object_pairs_hook=_once, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise _RefusedError("JSON", f"no JSON ({error})") from None
    if not isinstance(values, dict):
        raise _RefusedError("JSON", "no JSON object")
    return values


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object. Raises ValueError for a name that is there twice: which of them was meant?"""
    values = dict(pairs)
    if len(values) < len(pairs):
        raise ValueError("a name is there twice")
    return values


def _refuse(constant: str) -> None:
    """NaN and the infinite are not JSON."""
    raise ValueError(f"{constant} is no number of JSON")


def _row(source: AidingSource, values: dict[str, Any]) -> dict[str, float]:
    """The values by column. Raises ValueError for one that is missing, unknown or no number."""
    names = {source.short_name(column): column for column in source.names}
    if unknown := values.keys() - names.keys():
        others = ", ".join(_shown(name.encode()) for name in sorted(unknown))
        raise ValueError(f"{source.message} has no {others}; it has {', '.join(names)}, t")
    row = {names[name]: _number(name, value) for name, value in values.items()}
    for column in source.missing(name for name, number in row.items() if not math.isnan(number)):
        raise ValueError(f"{source.message} without {source.short_name(column)}")
    return row


def _number(name: str, value: Any) -> float:
    """NaN: it is absent. Raises ValueError."""
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{name} is no number")
    if not abs(value) < _LARGEST:
        raise ValueError(f"{name} is too large")
    return float(value)


def _epoch_ns(t_s: float, now_ns: int, unix_ns: int) -> int:
    if math.isnan(t_s):
        return now_ns
    fraction, whole = math.modf(t_s)
    since_ns = int(whole) * _SECOND_NS + round(fraction * 1e9) - unix_ns
    if not _OLDEST_S <= since_ns * 1e-9 <= _NEWEST_S:
        raise _RefusedError(
            "time", f"t is {since_ns * 1e-9:+.1f} s from its arrival: is it this machine's Unix time, in s?"
        )
    return now_ns + since_ns


def _shown(line: bytes) -> str:
    text = line[: _SHOWN + 1].decode("utf-8", "backslashreplace")
    return repr(text if len(line) <= _SHOWN else f"{text[:_SHOWN]}…")
