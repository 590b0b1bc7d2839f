"""From sentences to fixes: what a receiver sends in one burst is one epoch, and gives one fix.

A new burst begins after a pause, with another time, or with a kind of sentence that the epoch has already: VTG has no
time of its own. Which kind ends a burst is learned from two bursts that ended alike; from then on a fix is ready with
that sentence. Otherwise it is ready when the next burst begins, or when the line has been quiet.
"""

from collections import Counter
from dataclasses import dataclass

from ..fix import Fix, ReceiverStatus
from .content import READERS, Calendar, Content, Errors, Minimum, Position, Velocity
from .sentences import RefusedError, Sentence, Splitter

QUIET_NS = 200_000_000  # longer than any pause within a burst


@dataclass
class Epoch:
    """The sentences of one burst."""

    arrival_ns: int
    fresh: bool  # its first sentence followed a pause, so it belongs to nothing before
    utc_ns: int | None = None
    last: str = ""
    done: bool = False
    gga: Position | None = None
    rmc: Minimum | None = None
    vtg: Velocity | None = None
    gst: Errors | None = None
    zda: Calendar | None = None

    def takes(self, kind: str, utc_ns: int | None) -> bool:
        """Whether a sentence belongs to this burst."""
        if self.done or getattr(self, kind.lower()) is not None:
            return False
        return utc_ns is None or utc_ns == self.utc_ns or (self.utc_ns is None and self.fresh)

    def add(self, kind: str, content: Content) -> None:
        """Take it."""
        setattr(self, kind.lower(), content)
        self.last = kind
        if content.utc_ns is not None:
            self.utc_ns = content.utc_ns

    def status(self) -> ReceiverStatus | None:
        """What the receiver says of itself; None if it did not."""
        if self.gga is None:
            return ReceiverStatus(self.rmc.quality, None, self.arrival_ns) if self.rmc else None
        void = self.rmc is not None and self.rmc.quality == 0
        return ReceiverStatus(0 if void else self.gga.quality, self.gga.satellites, self.arrival_ns)

    def fix(self, quality: int) -> Fix | None:
        """The burst as a fix of `quality`; None without a position."""
        place = self.gga or self.rmc
        if place is None:
            return None
        motion = self.vtg or self.rmc or Velocity(None, None, "")
        dated = self.rmc or self.zda
        gga = self.gga or Position(None, quality, None)
        gst = self.gst or Errors(None, None, None, None)
        return Fix(
            arrival_ns=self.arrival_ns,
            utc_s=None if self.utc_ns is None else self.utc_ns / 1e9,
            date=dated.date if dated else None,
            lat_deg=place.lat_deg,
            lon_deg=place.lon_deg,
            alt_msl_m=gga.alt_msl_m,
            geoid_sep_m=gga.geoid_sep_m,
            quality=quality,
            satellites=gga.satellites,
            hdop=gga.hdop,
            speed_mps=motion.speed_mps,
            course_deg=motion.course_deg,
            mode=motion.mode,
            sigma_n_m=gst.sigma_n_m,
            sigma_e_m=gst.sigma_e_m,
            sigma_d_m=gst.sigma_d_m,
        )


class NmeaDecoder:
    """Bytes of one receiver to fixes. Not thread-safe.

    Counters: `fixes`; `no fix` and `repeated`, epochs without one and epochs whose time stood still; `other`,
    sentences of no interest; `noise bytes`; and refused sentences by reason.
    """

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()
        self.status = ReceiverStatus()
        self._splitter = Splitter(self.counters)
        self._epoch: Epoch | None = None
        self._ending = ""  # the kind of sentence that ends a burst; empty: not known
        self._last_ending = ""
        self._told_utc_ns: int | None = None
        self._heard_ns: int | None = None
        self._pause_ns: int | None = None  # when the first bytes after a pause came

    def feed(self, data: bytes, arrival_ns: int) -> list[Fix]:
        """See `GnssDecoder`."""
        if self._heard_ns is not None and arrival_ns - self._heard_ns >= QUIET_NS:
            self._pause_ns = arrival_ns
        self._heard_ns = arrival_ns
        fixes = []
        for sentence in self._splitter.feed(data, arrival_ns):
            fixes += self._take(sentence)
        return fixes

    def flush(self, now_ns: int) -> list[Fix]:
        """See `GnssDecoder`."""
        if self._heard_ns is None or now_ns - self._heard_ns < QUIET_NS:
            return []
        return self._finish()

    def _take(self, sentence: Sentence) -> list[Fix]:
        fixes = []
        fresh = self._pause_ns is not None and sentence.arrival_ns >= self._pause_ns
        if fresh:
            fixes += self._finish()
        reader = READERS.get(sentence.kind)
        if reader is None:
            self.counters["other"] += 1
            return fixes
        try:
            content = reader(sentence)
        except RefusedError as reason:
            self.counters[f"{sentence.kind} {reason}"] += 1
            return fixes
        if self._epoch is None or not self._epoch.takes(sentence.kind, content.utc_ns):
            fixes += self._finish()
            self._learn_ending(content.utc_ns)
            self._epoch = Epoch(sentence.arrival_ns, fresh)
            self._pause_ns = None
        self._epoch.add(sentence.kind, content)
        if sentence.kind == self._ending:
            fixes += self._finish()
        return fixes

    def _learn_ending(self, next_utc_ns: int | None) -> None:
        """From the epoch that is left, and the time of the sentence with which the next one begins."""
        if self._epoch is None:
            return
        if self._epoch.last == self._last_ending:
            self._ending = self._last_ending
        elif next_utc_ns is not None and next_utc_ns == self._epoch.utc_ns:  # the burst went on
            self._ending = ""
        self._last_ending = self._epoch.last

    def _finish(self) -> list[Fix]:
        """Close the epoch; its fix, once."""
        epoch = self._epoch
        if epoch is None or epoch.done:
            return []
        epoch.done = True
        status = epoch.status()
        if status is None:
            return []
        self.status = status
        if status.quality == 0:
            self.counters["no fix"] += 1
            return []
        if epoch.utc_ns is not None and epoch.utc_ns == self._told_utc_ns:
            self.counters["repeated"] += 1
            return []
        self._told_utc_ns = epoch.utc_ns
        fix = epoch.fix(status.quality)
        if fix is None:
            return []
        self.counters["fixes"] += 1
        return [fix]
