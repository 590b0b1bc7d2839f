"""The satellites that a receiver reports: GSV lists those in view, GSA those in use.

A list is several GSV of one talker (and signal), in sequence; it is used once it is whole. Satellites are numbered by
system, as in NMEA; with talker GN the system is GSA's last field, or follows from the number.
Source: NMEA 0183 v4.11, GSA and GSV; gpsd's NMEA.adoc.
"""

import contextlib
from collections.abc import Callable

from ..fix import Satellite, Sky
from .sentences import RefusedError, Sentence, integer, number

SYSTEMS = {"GP": 0, "GA": 2, "GB": 3, "BD": 3, "GQ": 5, "GL": 6}  # as gpsd's gnssid
SYSTEM_OF_GSA = {"1": 0, "2": 6, "3": 2, "4": 3, "5": 5}
GPS, SBAS, GLONASS = 0, 1, 6
FIRST_SBAS, LAST_SBAS, FIRST_GLONASS, LAST_GLONASS = 33, 64, 65, 96
LISTS_MAX = 16  # at most: systems times signals
LIST_MAX = 64  # satellites in a list
IN_ONE = 4
NUMBERS_END = 14  # where the numbers in GSA end
UNKNOWN_DOP = 99.0


def system_of(talker: str, satellite: int) -> int:
    """gpsd's gnssid. GPS' list also holds others, by their numbers."""
    if talker in ("GP", "GN"):
        if FIRST_SBAS <= satellite <= LAST_SBAS:
            return SBAS
        if FIRST_GLONASS <= satellite <= LAST_GLONASS:
            return GLONASS
    return SYSTEMS.get(talker, 0)


class SkyCollector:
    """Sentences in, satellites out. Not thread-safe."""

    def __init__(self) -> None:
        self._lists: dict[tuple[str, str], list[tuple[str, ...]]] = {}  # whole ones
        self._growing: dict[tuple[str, str], list[tuple[str, ...]]] = {}
        self._used: dict[int, set[tuple[int, int]]] = {}  # system and number, by the system that GSA is of
        self._pdop: float | None = None
        self._vdop: float | None = None
        self._arrival_ns: int | None = None  # of the last GSV that completed a list
        self._sky: Sky | None = Sky()
        self._readers: dict[str, Callable[[Sentence], None]] = {"GSV": self._gsv, "GSA": self._gsa}

    def add(self, sentence: Sentence) -> None:
        """Any sentence; other kinds are ignored."""
        if reader := self._readers.get(sentence.kind):
            reader(sentence)

    @property
    def sky(self) -> Sky:
        """The last report; each satellite once, with its strongest signal."""
        if self._sky is None:
            self._sky = Sky(self._satellites(), self._pdop, self._vdop, self._arrival_ns)
        return self._sky

    def _gsv(self, s: Sentence) -> None:
        total, index = s.field(1), s.field(2)
        signal = s.field(len(s.fields)) if (len(s.fields) - 3) % IN_ONE == 1 else ""
        key = (s.talker, signal)
        rows = [s.fields[i : i + IN_ONE] for i in range(3, len(s.fields) - IN_ONE + 1, IN_ONE)]
        if index in ("1", "01"):
            if len(self._growing) >= LISTS_MAX:
                self._growing.clear()
            self._growing[key] = []
        elif len(self._growing.get(key, ())) != IN_ONE * (int(index) - 1 if index.isdecimal() else -1):
            self._growing.pop(key, None)  # one was lost
            return
        elif len(self._growing[key]) >= LIST_MAX:
            return
        self._growing[key] += rows
        if total == index and (key in self._lists or len(self._lists) < LISTS_MAX):
            self._lists[key] = self._growing.pop(key)
            self._arrival_ns, self._sky = s.arrival_ns, None

    def _gsa(self, s: Sentence) -> None:
        numbers = [int(text) for text in s.fields[2:NUMBERS_END] if text.isdecimal()]
        system = SYSTEM_OF_GSA.get(s.field(18), system_of(s.talker, numbers[0] if numbers else 0))
        self._used[system] = {(system_of(s.talker, n) if system == GPS else system, n) for n in numbers}
        self._sky = None
        with contextlib.suppress(RefusedError):
            self._pdop, self._vdop = (number(s.field(i), 0.0, UNKNOWN_DOP, "DOP") or None for i in (15, 17))

    def _satellites(self) -> tuple[Satellite, ...]:
        used: set[tuple[int, int]] = set().union(*self._used.values())
        found: dict[tuple[int, int], Satellite] = {}
        for (talker, _), rows in self._lists.items():
            for row in rows:
                satellite = _satellite(talker, row, used)
                if satellite is None:
                    continue
                before = found.get((satellite.system, satellite.number))
                if before is None or (before.signal_dbhz or 0) < (satellite.signal_dbhz or 0):
                    found[satellite.system, satellite.number] = satellite
        return tuple(found.values())


def _satellite(talker: str, row: tuple[str, ...], used: set[tuple[int, int]]) -> Satellite | None:
    """One satellite of a list; None if its fields are invalid."""
    try:
        name, elevation = integer(row[0], 999, "satellite"), integer(row[1].removeprefix("-"), 90, "elevation")
        azimuth, signal = integer(row[2], 360, "azimuth"), integer(row[3], 99, "signal")
    except RefusedError:
        return None
    if not name:
        return None
    system = system_of(talker, name)
    if elevation and row[1].startswith("-"):
        elevation = -elevation
    return Satellite(system, name, elevation, azimuth, signal, (system, name) in used)
