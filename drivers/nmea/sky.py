"""The satellites that a receiver reports: GSV lists those in view, GSA those in use.

A list is several GSV of one talker (and signal), in sequence; it is used once it is whole. Satellites are numbered by
system, as in NMEA; with talker GN the system is GSA's last field, or follows from the number. Each list and each GSA
counts for some seconds: a receiver may cease to send those of one system, or all.
Source: NMEA 0183 v4.11, GSA and GSV; gpsd's NMEA.adoc.
"""

import contextlib
from collections.abc import Callable

from ..fix import Satellite, Sky
from .sentences import RefusedError, Sentence, integer, number

SYSTEMS = {"GP": 0, "GA": 2, "GB": 3, "BD": 3, "GQ": 5, "QZ": 5, "GL": 6, "GI": 7}  # as gpsd's gnssid
SYSTEM_OF_GSA = {"1": 0, "2": 6, "3": 2, "4": 3, "5": 5, "6": 7}
GPS, SBAS, GLONASS, NAVIC = 0, 1, 6, 7
FIRST_SBAS, LAST_SBAS, FIRST_GLONASS, LAST_GLONASS = 33, 64, 65, 96
LISTS_MAX = 32  # at most: systems times signals
LIST_MAX = 64  # satellites in a list
IN_ONE = 4
NUMBERS_END = 14  # where the numbers in GSA end
UNKNOWN_DOP = 99.0
NO_FIX = "1"  # mode of GSA
GROUP_NS = 900_000_000  # in which the GSA of an epoch come, also at 4800 baud; the next epoch's come later
LASTS_NS = 10_000_000_000  # for which a sentence counts; some receivers send one each fifth second


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
        self._lists: dict[tuple[str, str], tuple[int, list[tuple[str, ...]]]] = {}  # whole ones, with their arrival
        self._growing: dict[tuple[str, str], list[tuple[str, ...]]] = {}
        self._used: dict[int, tuple[int, set[tuple[int, int]]]] = {}  # system and number, by the system that GSA is of
        self._dops: tuple[float | None, float | None] = None, None  # of position, of height
        self._list_ns: int | None = None  # arrival of the last GSV that completed a list
        self._gsa_ns: int | None = None
        self._group: set[int] = set()  # the systems of the GSA that follow one another
        self._group_ns = 0  # arrival of the first of them
        self._sky: Sky | None = Sky()
        self._readers: dict[str, Callable[[Sentence], None]] = {"GSV": self._gsv, "GSA": self._gsa}

    def add(self, sentence: Sentence) -> None:
        """Any sentence; other kinds are ignored."""
        if sentence.kind != "GSA":
            self._group.clear()
        if reader := self._readers.get(sentence.kind):
            reader(sentence)

    @property
    def sky(self) -> Sky:
        """The last report; each satellite once, with its strongest signal."""
        if self._sky is None:
            self._sky = Sky(self._satellites(), *self._dops, self._list_ns, self._gsa_ns)
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
            self._lists[key] = s.arrival_ns, self._growing.pop(key)
            self._list_ns, self._sky = s.arrival_ns, None

    def _gsa(self, s: Sentence) -> None:
        numbers = [int(text) for text in s.fields[2:NUMBERS_END] if text.isdecimal()]
        named = SYSTEM_OF_GSA.get(s.field(18))
        system = system_of(s.talker, numbers[0] if numbers else 0) if named is None else named
        used = {(system_of(s.talker, n) if system == GPS else system, n) for n in numbers}
        if s.arrival_ns - self._group_ns > GROUP_NS:
            self._group.clear()
        if not self._group:
            self._group_ns = s.arrival_ns
        if system in self._group:  # more than one sentence holds
            used |= self._used[system][1]
        if numbers or s.talker != "GN" or named is not None or s.field(2) == NO_FIX:  # else it is not known of which
            self._group.add(system)
            self._used[system] = s.arrival_ns, used
        self._sky = None
        with contextlib.suppress(RefusedError):
            pdop, vdop = (number(s.field(i), 0.0, UNKNOWN_DOP, "DOP") or None for i in (15, 17))
            self._dops, self._gsa_ns = (pdop, vdop), s.arrival_ns

    def _satellites(self) -> tuple[Satellite, ...]:
        since_ns = max(self._list_ns or 0, self._gsa_ns or 0) - LASTS_NS
        used: set[tuple[int, int]] = set().union(*(used for at_ns, used in self._used.values() if at_ns >= since_ns))
        found: dict[tuple[int, int], Satellite] = {}
        for (talker, _), (at_ns, rows) in self._lists.items():
            for row in rows if at_ns >= since_ns else ():
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
    if not name or (system := system_of(talker, name)) == NAVIC:
        return None
    if elevation and row[1].startswith("-"):
        elevation = -elevation
    return Satellite(system, name, elevation, azimuth, signal, (system, name) in used)
