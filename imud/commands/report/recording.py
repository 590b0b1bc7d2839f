"""A daemon's recording (MCAP) for a report: the estimates that it recorded, not a replay.

It is read once from end to end, block by block; data at the full rate are never held as a whole.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from imud.errors import BadDataError
from imud.estimators.innovation_kinds import KINDS
from imud.recording.messages import (
    CLOCK_TABLE,
    ESTIMATE_TABLE,
    EVENTS,
    FIX_TABLE,
    INNOVATION_TABLE,
    SAMPLE_TABLE,
    Table,
)
from imud.recording.source import Recording, tell
from imud.tables.estimates import estimate_cells

from ...math.arrays import Records
from .session import Clock, Event, Fixes, Innovations, Part, Session
from .watch import EstimateWatch, SensorWatch

_BLOCK = 2000  # messages that are looked at together
_MOST_EVENTS = 60
_TOLD = ("warning", "error", "critical")
Progress = Callable[[int], None]


class _Collector:
    """Takes messages, and passes their rows on in blocks."""

    def __init__(self, name: str) -> None:
        self._name = name
        self.origin_ns: int | None = None
        self.first_ns = self.last_ns = 0
        self._waiting: dict[str, list[Any]] = {table.topic: [] for table in _TABLES}
        self._kept: dict[str, list[Records]] = {table.topic: [] for table in _TABLES}
        self.estimates, self.sensor = EstimateWatch(name), SensorWatch(name)
        self.events: list[tuple[int, str]] = []

    def take(self, topic: str, data: bytes) -> None:
        if topic == EVENTS:
            self._event(msgspec.json.decode(data))
        elif topic in self._waiting:
            waiting = self._waiting[topic]
            waiting.append(msgspec.json.decode(data))
            if len(waiting) >= _BLOCK:
                self._pass_on(_TABLES_BY_TOPIC[topic])

    def finish(self) -> None:
        for table in _TABLES:
            if self._waiting[table.topic]:
                self._pass_on(table)

    def _event(self, said: dict[str, Any]) -> None:
        if said["level"] in _TOLD and len(self.events) < _MOST_EVENTS:
            facts = ", ".join(f"{name} {fact}" for name, fact in said["facts"].items())
            self.events.append((said["t_ns"], f"{said['text']} ({facts})" if facts else said["text"]))

    def _pass_on(self, table: Table) -> None:
        rows = table.rows(self._waiting[table.topic])
        self._waiting[table.topic].clear()
        if self.origin_ns is None:
            self.origin_ns = math.floor(rows["t_ns"][0] * 1e-9) * 1_000_000_000
            self.first_ns = int(rows["t_ns"][0])
        self.first_ns, self.last_ns = (
            min(self.first_ns, int(rows["t_ns"].min())),
            max(self.last_ns, int(rows["t_ns"].max())),
        )
        for name in ("t_ns", "arrival_ns"):
            if name in (rows.dtype.names or ()):
                rows[name] -= self.origin_ns
        if table is ESTIMATE_TABLE:
            self.estimates.add({"t_s": rows["t_ns"] * 1e-9, **estimate_cells(rows)})
        elif table is SAMPLE_TABLE:
            self.sensor.add(rows)
        else:
            self._kept[table.topic].append(rows)

    def kept(self, table: Table) -> Records:
        """All rows of a table that is small enough."""
        return np.concatenate([np.zeros(0, table.dtype), *self._kept[table.topic]])


_TABLES = (ESTIMATE_TABLE, SAMPLE_TABLE, INNOVATION_TABLE, FIX_TABLE, CLOCK_TABLE)
_TABLES_BY_TOPIC = {table.topic: table for table in _TABLES}


def read_recording(path: Path, name: str, progress: Progress) -> Part:
    """What it tells, under that name. progress: told bytes as they are read. What is wrong with it is told on stderr.

    Raises BadDataError, InputMissingError, UsageError.
    """
    recording, found = Recording([path]), _Collector(name)
    done = 0
    try:
        for entry in recording:
            found.take(entry.topic, entry.data)
            if recording.read_bytes != done:
                progress(recording.read_bytes - done)
                done = recording.read_bytes
        found.finish()
    except (ValueError, KeyError, TypeError) as error:
        raise BadDataError(f"{path}: a message cannot be understood: {error}") from error
    tell("report", recording.notes)
    if not found.estimates.rows or found.origin_ns is None:
        raise BadDataError(f"{path}: no estimates in it; `imud replay {path} -o est.csv` makes them of its bytes")
    sensor, fixes, clock = found.sensor.close(), found.kept(FIX_TABLE), found.kept(CLOCK_TABLE)
    session = Session(
        (found.estimates.close(),),
        tuple(innovations_of(name, found.kept(INNOVATION_TABLE))),
        (sensor,) if sensor else (),
        (Fixes(name, fixes),) if len(fixes) else (),
        (Clock(name, clock),) if len(clock) else (),
        tuple(Event(name, (t_ns - found.origin_ns) * 1e-9, text) for t_ns, text in found.events),
    )
    return Part(found.origin_ns // 1_000_000_000, found.first_ns * 1e-9, found.last_ns * 1e-9, session)


def innovations_of(name: str, rows: Records) -> list[Innovations]:
    """Of each quantity, from rows of INNOVATION."""
    found = []
    for code, kind in KINDS.items():
        of = rows[(rows["kind"] == code) & (rows["variance"] > 0.0)]
        if len(of):
            sigma = np.sqrt(of["variance"])
            found.append(Innovations(name, kind.column, of["t_ns"] * 1e-9, of["value"], sigma, of["used"] > 0))
    return found
