"""A daemon's recording (MCAP) for a report: the estimates that it recorded, not a replay; of the samples, every one.

Most samples are not recorded as such: they are decoded anew from the bytes, as a sensor's faults show in single ones.
The recording is read once from end to end, block by block; data at the full rate are never held as a whole.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from imud.drivers.capture_messages import Entry

from ...configuration.settings import Initial
from ...errors import BadDataError
from ...estimators.filter_states import cells
from ...estimators.innovation_kinds import KINDS
from ...math.arrays import Records
from ...recording.messages import (
    CLOCK_TABLE,
    ESTIMATE_TABLE,
    EVENTS,
    FIX_TABLE,
    INNOVATION_TABLE,
    SAMPLE_TABLE,
    STATES,
    Table,
)
from ...recording.player import Handlers, Player
from ...recording.source import Recording, adapter, print_notes
from ...recording.state_messages import states_rows
from ...tables.estimates import estimate_cells
from .reduction import EstimateReduction, SensorReduction
from .session import Clock, Event, Fixes, Innovations, Part, Session, States

_BLOCK = 2000  # messages that are decoded together
_EVENTS_MAX = 60
_LEVELS = ("warning", "error", "critical")
Progress = Callable[[int], None]


class _Collector:
    """Collects messages, and forwards their rows in blocks."""

    def __init__(self, name: str) -> None:
        self._name = name
        self.origin_ns: int | None = None
        self.first_ns = self.last_ns = 0
        self._undecoded: dict[str, list[bytes]] = {table.topic: [] for table in _TABLES}
        self._schemas: dict[str, str] = {}
        self._rows: dict[str, list[Records]] = {table.topic: [] for table in _TABLES}
        self.estimates, self.sensor = EstimateReduction(name), SensorReduction(name)
        self.recorded_samples = SensorReduction(name)  # for a recording without the sensor's bytes
        self.events: list[tuple[int, str]] = []
        self._states: list[bytes] = []

    def take(self, entry: Entry) -> None:
        if entry.topic == EVENTS:
            self._event(msgspec.json.decode(entry.data))
        elif entry.topic == STATES:
            self._states.append(entry.data)
        elif (undecoded := self._undecoded.get(entry.topic)) is not None:
            undecoded.append(entry.data)
            self._schemas[entry.topic] = entry.schema
            if len(undecoded) >= _BLOCK:
                self._forward(_TABLES_BY_TOPIC[entry.topic])

    def decoded(self, samples: Records, solutions: Records) -> None:
        """Samples, of the sensor's bytes."""
        self._begin(int(samples["t_ns"][0]))
        rows = samples.copy()
        rows["t_ns"] -= self.origin_ns
        self.sensor.add(rows)

    def _begin(self, t_ns: int) -> None:
        """Times count from the whole second of the first."""
        if self.origin_ns is None:
            self.origin_ns, self.first_ns = math.floor(t_ns * 1e-9) * 1_000_000_000, t_ns

    def finish(self) -> None:
        for table in _TABLES:
            if self._undecoded[table.topic]:
                self._forward(table)

    def _event(self, event: dict[str, Any]) -> None:
        if event["level"] in _LEVELS and len(self.events) < _EVENTS_MAX:
            fields = ", ".join(f"{name} {value}" for name, value in event["facts"].items())
            self.events.append((event["t_ns"], f"{event['text']} ({fields})" if fields else event["text"]))

    def _forward(self, table: Table) -> None:
        rows = table.read(self._schemas[table.topic], self._undecoded[table.topic])
        self._undecoded[table.topic].clear()
        self._begin(int(rows["t_ns"][0]))
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
            self.recorded_samples.add(rows)
        else:
            self._rows[table.topic].append(rows)

    def rows_of(self, table: Table) -> Records:
        """All rows of a table that is not reduced."""
        return np.concatenate([np.zeros(0, table.dtype), *self._rows[table.topic]])

    def states(self, name: str) -> tuple[States, ...]:
        """What the filter estimated beside its solution."""
        rows = states_rows(self._states)
        if not len(rows):
            return ()
        return (States(name, {"t_s": (rows["t_ns"] - (self.origin_ns or 0)) * 1e-9, **cells(rows)}),)


_TABLES = (ESTIMATE_TABLE, SAMPLE_TABLE, INNOVATION_TABLE, FIX_TABLE, CLOCK_TABLE)
_TABLES_BY_TOPIC = {table.topic: table for table in _TABLES}


def read_recording(path: Path, name: str, progress: Progress) -> Part:
    """The recording's data, labelled `name`. progress: called with bytes read. Damage is reported on stderr.

    Raises BadDataError, InputMissingError, UsageError.
    """
    recording, found = Recording([path]), _Collector(name)
    adapt = adapter(None, (), "tilt")  # the cheapest estimator: only the samples are wanted
    handlers = Handlers(found.decoded, warn=recording.notes.append)
    player = Player(recording.settings(adapt), adapt, Initial(), handlers, with_receivers=False)
    done = 0
    try:
        for entry in recording:
            player.take(entry)
            found.take(entry)
            if (read := recording.read_bytes) != done:
                progress(read - done)
                done = read
        progress(recording.bytes - done)  # behind the last message is the file's index
        found.finish()
    except (ValueError, KeyError, TypeError) as error:
        raise BadDataError(f"{path}: a message cannot be decoded: {error}") from error
    print_notes("report", recording.notes)
    sensor = found.sensor.close() or found.recorded_samples.close()
    if not found.estimates.rows or found.origin_ns is None:
        if player.inertial is None and sensor is None:
            raise BadDataError(f"{path}: no samples of an inertial sensor in it")
        raise BadDataError(f"{path}: no estimates in it; `imud replay {path} -o est.csv` makes them of its bytes")
    fixes, clock = found.rows_of(FIX_TABLE), found.rows_of(CLOCK_TABLE)
    has_quartz = player.inertial is not None and player.inertial.has_quartz
    session = Session(
        (found.estimates.close(),),
        tuple(innovations_of(name, found.rows_of(INNOVATION_TABLE))),
        (sensor,) if sensor else (),
        (Fixes(name, fixes),) if len(fixes) else (),
        (Clock(name, clock, has_quartz),) if len(clock) else (),
        tuple(Event(name, (t_ns - found.origin_ns) * 1e-9, text) for t_ns, text in found.events),
        found.states(name),
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
