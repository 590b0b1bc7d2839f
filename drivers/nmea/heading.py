"""Headings from true north: HDT, THS, PASHR. Beside the epochs of fixes, as compasses send them far more often.

HDT and THS carry no time. In the burst of an epoch they are of its time; elsewhere their time is not known.
Source: NMEA 0183 v4.11 (HDT, THS); Trimble BD9xx, Applanix POS MV (PASHR).
"""

from collections.abc import Callable

from ..fix import Heading
from .content import course
from .epochs import Epoch
from .sentences import Sentence, number, utc_ns

BURST_NS = 300_000_000  # so long after the beginning of an epoch, or before it, a sentence is of that epoch
_SECOND = 1e-9


def hdt(s: Sentence) -> Heading | None:
    """Heading, T."""
    return _heading(s, 1) if s.field(2) in ("T", "") else None


def ths(s: Sentence) -> Heading | None:
    """Heading, mode: A autonomous; others are estimated, entered by hand, simulated, not valid."""
    return _heading(s, 1) if s.field(2) == "A" else None


def pashr(s: Sentence) -> Heading | None:
    """Time, heading, T, roll, pitch, heave, their sigmas, that of the heading, quality of the fix, state."""
    time_ns, sigma = utc_ns(s.field(1)), number(s.field(9), 0.0, 180.0, "sigma")
    return _heading(s, 2, time_ns, sigma or None) if s.field(3) == "T" else None


READERS: dict[str, Callable[[Sentence], Heading | None]] = {"HDT": hdt, "THS": ths, "ASHR": pashr}


def _heading(s: Sentence, i: int, time_ns: int | None = None, sigma: float | None = None) -> Heading | None:
    degrees = course(s.field(i))
    if degrees is None:
        return None
    return Heading(s.arrival_ns, None if time_ns is None else time_ns * _SECOND, degrees, sigma)


class HeadingCollector:
    """Gives headings the time of the epoch in whose burst they are. Not thread-safe."""

    def __init__(self) -> None:
        self._ready: list[Heading] = []
        self._untimed: Heading | None = None

    def add(self, heading: Heading, epoch: Epoch | None) -> None:
        """A heading; epoch: the newest, perhaps complete."""
        self._release()
        if heading.utc_s is not None:
            self._ready.append(heading)
        elif epoch is not None and _near(heading, epoch) and epoch.utc_ns is not None:
            self._ready.append(_timed(heading, epoch.utc_ns))
        else:
            self._untimed = heading

    def begin(self, epoch: Epoch) -> None:
        """An epoch has begun: a heading just before it is of the same burst."""
        heading = self._untimed
        if heading is not None and _near(heading, epoch) and epoch.utc_ns is not None:
            self._ready.append(_timed(heading, epoch.utc_ns))
            self._untimed = None

    def take(self) -> list[Heading]:
        """Those since the last call, but for one whose burst may not have begun."""
        ready, self._ready = self._ready, []
        return ready

    def _release(self) -> None:
        if self._untimed is not None:
            self._ready.append(self._untimed)
            self._untimed = None


def _near(heading: Heading, epoch: Epoch) -> bool:
    return abs(heading.arrival_ns - epoch.arrival_ns) < BURST_NS


def _timed(heading: Heading, time_ns: int) -> Heading:
    return Heading(heading.arrival_ns, time_ns * _SECOND, heading.degrees, heading.sigma_deg)
