"""The data of a report: the contents of each file, reduced while it is read to what a page can show.

Files whose times overlap share one time axis, in seconds since the earliest of them. Runs at other times or on other
machines begin at a 0 of their own, so that their curves lie over each other.
"""

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...math.arrays import Floats, Records

TIME = "time, s"  # title of that axis


@dataclass(frozen=True)
class Estimates:
    """Of one run, as points that lose no spike. columns: t_s and others by their names in est.csv; unknown is NaN.

    shares: of the rows that had each bit of the status. lost_s: when the heading was lost.
    """

    name: str
    columns: dict[str, Floats]
    status: NDArray[np.int64]
    shares: dict[int, float]
    lost_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class Innovations:
    """Of one quantity (`pn_m`, …) from one file: value and its predicted 1 sigma in the unit of the name."""

    name: str
    kind: str
    t: Floats
    value: Floats
    sigma: Floats
    used: NDArray[np.bool_]

    @property
    def normalised(self) -> Floats:
        """Value over sigma: standard normal and white if the filter is right."""
        return self.value / self.sigma


@dataclass(frozen=True)
class Sensor:
    """An inertial sensor as points that lose no spike. columns: t_s, wx…fz in SI, interval_ms, temperature_c.

    flags: those of the samples. findings: what looks wrong.
    """

    name: str
    rate_hz: float
    columns: dict[str, Floats]
    flags: NDArray[np.int64]
    findings: tuple[str, ...]


@dataclass(frozen=True)
class Fixes:
    """Of a receiver. rows: FIX, times since the report's time 0."""

    name: str
    rows: Records


@dataclass(frozen=True)
class Clock:
    """How the sensor's counter fitted the host's time, and what the wire lost. rows: CLOCK_FIT.

    has_quartz: of the sensor; its drift is judged.
    """

    name: str
    rows: Records
    has_quartz: bool = False


@dataclass(frozen=True)
class States:
    """What the filter estimated beside its solution, a row a second. columns: t_s and others as in states.csv."""

    name: str
    columns: dict[str, Floats]


@dataclass(frozen=True)
class Event:
    """A line of warning from a daemon's log; t in s."""

    name: str
    t: float
    text: str


@dataclass(frozen=True)
class Session:
    """The contents of all files."""

    estimates: tuple[Estimates, ...] = ()
    innovations: tuple[Innovations, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    fixes: tuple[Fixes, ...] = ()
    clocks: tuple[Clock, ...] = ()
    events: tuple[Event, ...] = ()
    states: tuple[States, ...] = ()


@dataclass(frozen=True)
class Part:
    """The contents of one file. Its times are since origin_s; first_s and last_s are its span on its own clock."""

    origin_s: int
    first_s: float
    last_s: float
    session: Session = field(default_factory=Session)


def _shifted(session: Session, seconds: int) -> Session:
    """The session with `seconds` added to all times."""

    def columns(of: dict[str, Floats]) -> dict[str, Floats]:
        return {**of, "t_s": of["t_s"] + seconds}

    def rows(of: Records) -> Records:
        of = of.copy()
        for name in ("t_ns", "arrival_ns"):
            if name in (of.dtype.names or ()):
                of[name] += seconds * 1_000_000_000
        return of

    change = dataclasses.replace
    return Session(
        tuple(
            change(e, columns=columns(e.columns), lost_s=tuple(t + seconds for t in e.lost_s))
            for e in session.estimates
        ),
        tuple(change(i, t=i.t + seconds) for i in session.innovations),
        tuple(change(s, columns=columns(s.columns)) for s in session.sensors),
        tuple(change(f, rows=rows(f.rows)) for f in session.fixes),
        tuple(change(c, rows=rows(c.rows)) for c in session.clocks),
        tuple(change(e, t=e.t + seconds) for e in session.events),
        tuple(change(s, columns=columns(s.columns)) for s in session.states),
    )


def merged(parts: Iterable[Part]) -> Session:
    """All parts on one axis: those whose spans overlap, directly or through others, share a beginning."""
    ordered = sorted(parts, key=lambda part: part.first_s)
    whole: list[Session] = []
    origin, until = 0, -math.inf
    for part in ordered:
        if part.first_s > until:
            origin = math.floor(part.first_s)
        until = max(until, part.last_s)
        whole.append(_shifted(part.session, part.origin_s - origin))
    names = [each.name for each in dataclasses.fields(Session)]
    return Session(**{name: tuple(item for s in whole for item in getattr(s, name)) for name in names})
