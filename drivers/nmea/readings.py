"""What other sensors report in NMEA: heading, speed, air pressure. Such sentences come beside fixes, or alone.

Only PASHR has a time. A reading in the burst of an epoch is taken as of that epoch, since the receiver may send both.
A pressure is that of the air only if the name of its transducer, or a weather instrument as talker, says so.
Source: NMEA 0183 v4.11 (HDT, THS, VBW, VHW, XDR); Trimble BD9xx, Applanix POS MV (PASHR); Furuno SC-50 (VBW); Vaisala
WXT530 (units of XDR); names of transducers: Airmar 200WX, Signal K, OpenCPN, Yacht Devices.
"""

import re
from collections.abc import Callable

from ..fix import Reading
from .content import KMH, KNOTS, course
from .epochs import Epoch
from .sentences import NUMBER, RefusedError, Sentence, number, quotient, utc_ns

ALONE = 3  # headings without an epoch of fixes after which a heading no longer waits for one
BURST_NS = 300_000_000  # a sentence that near to the beginning of an epoch is of that epoch
KNOTS_MAX = 388.0  # 200 m/s
PASCALS = {"B": (100_000, 1), "P": (1, 1), "H": (100, 1), "M": (1_333_224, 10_000), "I": (3_386_389, 1000)}
LOWEST_PA, HIGHEST_PA = 19_000.0, 130_000.0  # of the air, where vehicles are
AIR = re.compile(r"BARO|ATM|STNP|AIRP|^(P|PRESS?(URE)?)$", re.IGNORECASE)
WEATHER = "WI"  # talker
FINE_PA, FINE_MPS = 4.0, 0.06  # a resolution up to these is smaller than the sensor's own error
_SECOND = 1e-9


def hdt(s: Sentence) -> list[Reading]:
    """Heading, T."""
    return _heading(s, 1) if s.field(2) in ("T", "") else []


def ths(s: Sentence) -> list[Reading]:
    """Heading, mode: A autonomous; others are estimated, entered by hand, simulated, not valid."""
    return _heading(s, 1) if s.field(2) == "A" else []


def pashr(s: Sentence) -> list[Reading]:
    """Time, heading, T, roll, pitch, heave, their sigmas, that of the heading, quality of the fix, state."""
    time_ns, sigma = utc_ns(s.field(1)), number(s.field(9), 0.0, 180.0, "sigma")
    return _heading(s, 2, time_ns, sigma or None) if s.field(3) == "T" else []


def vbw(s: Sentence) -> list[Reading]:
    """Speed through the water, along and across, status; the same over ground. A: valid. Below zero: astern."""
    found = [("water speed", 1, s.field(3)), ("speed", 4, s.field(6))]
    return [reading for source, i, status in found if status == "A" for reading in _speed(s, source, i, KNOTS)]


def vhw(s: Sentence) -> list[Reading]:
    """Headings, true and magnetic; speed through the water in knots and km/h."""
    if s.field(6) not in ("N", "") or s.field(8) not in ("K", ""):
        raise RefusedError("unit")
    return _speed(s, "water speed", 5, KNOTS) or _speed(s, "water speed", 7, KMH)


def xdr(s: Sentence) -> list[Reading]:
    """Type, value, unit, name of each transducer: the first that measures the pressure of the air."""
    for i in range(1, len(s.fields), 4):
        kind, text, unit, name = (s.field(i + k) for k in range(4))
        if kind == "P" and unit in PASCALS and text and (s.talker == WEATHER or AIR.search(name)):
            return [_pressure(s, text, PASCALS[unit])]
    return []


READERS: dict[str, Callable[[Sentence], list[Reading]]] = {
    "HDT": hdt,
    "THS": ths,
    "ASHR": pashr,
    "VBW": vbw,
    "VHW": vhw,
    "XDR": xdr,
}


def _heading(s: Sentence, i: int, time_ns: int | None = None, sigma: float | None = None) -> list[Reading]:
    degrees = course(s.field(i))
    if degrees is None:
        return []
    return [Reading("heading", s.arrival_ns, None if time_ns is None else time_ns * _SECOND, degrees, sigma)]


def _speed(s: Sentence, source: str, i: int, unit: tuple[int, int]) -> list[Reading]:
    text = s.field(i)
    if number(text, -KNOTS_MAX, KNOTS_MAX, "speed") is None:
        return []
    return [Reading(source, s.arrival_ns, None, quotient(text, *unit), _step(text, unit, FINE_MPS))]


def _pressure(s: Sentence, text: str, unit: tuple[int, int]) -> Reading:
    if not NUMBER.fullmatch(text) or not LOWEST_PA <= (pascals := quotient(text, *unit)) <= HIGHEST_PA:
        raise RefusedError("pressure")
    return Reading("pressure", s.arrival_ns, None, pascals, _step(text, unit, FINE_PA))


def _step(text: str, unit: tuple[int, int], fine: float) -> float | None:
    """The resolution of a reading as its sigma; None if it is finer than the sensor's own error."""
    step = unit[0] / unit[1] / 10.0 ** len(text.partition(".")[2])
    return step if step > fine else None


class ReadingCollector:
    """Gives readings the time of the epoch in whose burst they are. Not thread-safe."""

    def __init__(self) -> None:
        self._ready: list[Reading] = []
        self._untimed: Reading | None = None
        self._alone = 0  # headings since the last epoch began, up to ALONE

    def add(self, reading: Reading, epoch: Epoch | None) -> None:
        """A reading; epoch: the newest, perhaps complete. A heading outside its burst waits for the next one."""
        is_heading = reading.source == "heading"
        if is_heading:
            self._release()
            self._alone = min(self._alone + 1, ALONE)
        if reading.utc_s is not None:
            self._ready.append(reading)
        elif epoch is not None and _near(reading, epoch) and epoch.utc_ns is not None:
            self._ready.append(_timed(reading, epoch.utc_ns))
        elif is_heading and (epoch is not None or self._alone < ALONE):
            self._untimed = reading
        else:
            self._ready.append(reading)

    def begin(self, epoch: Epoch) -> None:
        """An epoch has begun: a heading just before it is of the same burst."""
        reading, self._alone = self._untimed, 0
        if reading is not None and _near(reading, epoch) and epoch.utc_ns is not None:
            self._ready.append(_timed(reading, epoch.utc_ns))
            self._untimed = None

    def take(self) -> list[Reading]:
        """The readings since the last call, except a heading whose burst may still begin."""
        ready, self._ready = self._ready, []
        return ready

    def _release(self) -> None:
        if self._untimed is not None:
            self._ready.append(self._untimed)
            self._untimed = None


def _near(reading: Reading, epoch: Epoch) -> bool:
    return abs(reading.arrival_ns - epoch.arrival_ns) < BURST_NS


def _timed(reading: Reading, time_ns: int) -> Reading:
    return reading._replace(utc_s=time_ns * _SECOND)
