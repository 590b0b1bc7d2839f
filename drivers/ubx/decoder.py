"""From messages to fixes: those of one time of week are one epoch, and give one fix.

NAV-EOE ends an epoch. A receiver without it ends one with the last of the messages that the epoch before had. Otherwise
the fix is ready when the next epoch begins, or when the line has been quiet.
"""

from collections import Counter

from ..fix import Fix, ReceiverStatus, Sky
from .epochs import Epoch
from .frames import Frame, Framer
from .messages import NAV_EOE, READERS, Content, Interference, Kind, RefusedError, content, week_ms

SILENCE_NS = 200_000_000  # longer than any pause within an epoch


class UbxDecoder:
    """Bytes of one receiver to fixes. Not thread-safe.

    Counters: `fixes`; epochs without one: `no fix`, `without NAV-PVT`; `other`, messages of unused kinds; `late`, those
    of an epoch that is complete; `noise bytes`, in no frame; and rejected messages by reason.
    """

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()
        self.status = ReceiverStatus()
        self.sky = Sky()
        self.whole = 0
        self._framer = Framer(self.counters)
        self._epoch: Epoch | None = None
        self._expected: frozenset[Kind] = frozenset()  # the messages of the epoch before; empty: not known
        self._last_arrival_ns: int | None = None

    @property
    def pending(self) -> bool:
        """See `GnssDecoder`."""
        return self._epoch is not None and not self._epoch.done

    def feed(self, data: bytes, arrival_ns: int) -> list[Fix]:
        """See `GnssDecoder`."""
        self._last_arrival_ns = arrival_ns
        fixes = []
        for frame in self._framer.feed(data, arrival_ns):
            self.whole += 1
            fixes += self._process(frame)
        return fixes

    def flush(self, now_ns: int) -> list[Fix]:
        """See `GnssDecoder`."""
        if self._last_arrival_ns is None or now_ns - self._last_arrival_ns < SILENCE_NS:
            return []
        return self._close()

    def _process(self, frame: Frame) -> list[Fix]:
        if frame.kind not in READERS:
            self.counters["other"] += 1
            return []
        try:
            read = content(frame.kind, frame.payload)
        except RefusedError as reason:
            self.counters[str(reason)] += 1
            return []
        if isinstance(read, Sky):
            self.sky = read._replace(pdop=self.sky.pdop, vdop=self.sky.vdop, arrival_ns=frame.arrival_ns)
            return []
        if isinstance(read, Interference):
            self._note(read)
        time = week_ms(frame.kind, frame.payload)
        return [] if time is None else self._assign(frame, read, time)

    def _note(self, read: Interference) -> None:
        jamming = self.status.jamming if read.jamming is None else read.jamming
        spoofing = self.status.spoofing if read.spoofing is None else read.spoofing
        self.status = self.status._replace(jamming=jamming, spoofing=spoofing)

    def _assign(self, frame: Frame, read: Content, time: int) -> list[Fix]:
        """Put a message into the epoch to which it belongs."""
        fixes: list[Fix] = []
        if self._epoch is None or time != self._epoch.week_ms:
            fixes = self._close()
            self._epoch = Epoch(time, frame.arrival_ns)
        epoch = self._epoch
        if epoch.done:
            self.counters["late"] += 1
            epoch.kinds.add(frame.kind)
            self._expected = frozenset(epoch.kinds)
            return fixes
        epoch.add(frame.kind, read)
        ended = frame.kind == NAV_EOE or (
            NAV_EOE not in self._expected and bool(self._expected) and epoch.kinds >= self._expected
        )
        return fixes + (self._finish(epoch) if ended else [])

    def _close(self) -> list[Fix]:
        """The epoch is over."""
        return self._finish(self._epoch) if self._epoch and not self._epoch.done else []

    def _finish(self, epoch: Epoch) -> list[Fix]:
        """The epoch's fix."""
        epoch.done = True
        self._expected = frozenset(epoch.kinds)
        if epoch.pvt is None:
            self.counters["without NAV-PVT"] += 1
            return []
        self.status = epoch.status(self.status)
        self.sky = self.sky._replace(pdop=epoch.pvt.pdop, vdop=epoch.dop.vdop)
        if not epoch.pvt.quality:
            self.counters["no fix"] += 1
            return []
        self.counters["fixes"] += 1
        return [epoch.fix(self.status)]
