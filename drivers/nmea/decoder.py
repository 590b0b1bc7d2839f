"""From sentences to fixes: the sentences of one burst are one epoch, and give one fix.

A new burst begins after a pause, with another time, or with a kind of sentence that the epoch already has. Which kind
of sentence ends a burst is learned; then the fix is ready with that sentence. Otherwise it is ready when the next burst
begins, or when the line has been silent. A kind that others follow now and then (RMC once a second, GGA ten times) is
no such ending, unless what follows need not be waited for (GST once a second), or comes at equal intervals: then it is
known which bursts have to wait for it. GST and ZDA alone make no epoch: in some receivers their time is ahead. VTG,
without a time, makes none either: it is of the burst that is nearer to it.
"""

import math
from collections import Counter

from ..fix import Fix, Reading, ReceiverStatus, Sky
from .accuracy import STATED_NS, StatedAccuracy
from .burst_order import FIRST_ELSEWHERE, LAST_ELSEWHERE, BurstOrder, RegularKinds
from .burst_silence import SILENCE_NS, BurstSilence
from .content import READERS, Content, GgaGns, GsaMode, Gst, RmcGllGroup, Vtg
from .epochs import DAY_NS, Epoch, contradictory, same_time
from .gsa_history import GsaHistory
from .readings import READERS as READINGS
from .readings import ReadingCollector
from .sentences import RefusedError, Sentence, Splitter
from .sky import SkyCollector
from .untimed import ADJACENT, SAME_BURST, HeldVtg

IDLE_NS = 25_000_000  # from this on it is a pause, not the way in which an adapter delivers bytes
LATE_INTERVALS = 1.1  # intervals after an epoch's first sentence, in which one without a time can be of that epoch
INTERVAL_MAX_NS = 10_000_000_000
COMPANIONS = {"GST", "ZDA"}
RECEIVERS = {"GP", "GN", "GL", "GA", "GB", "BD", "GQ", "QZ", "GI"}  # talkers
ECHO_NS = 5_000_000_000  # after a receiver's last position it is not away yet


class NmeaDecoder:
    """Bytes of one receiver to fixes. Not thread-safe.

    Counters: `fixes`; readings by source, `heading`, `speed`, `water speed`, `pressure`; `no reading`, sentences of
    such kinds without one; epochs without a fix: `no fix`, `repeated` (also repeated sentences), `contradictory`;
    `other`, sentences of unused kinds; `late`, those of an epoch that is complete; `noise bytes`; and rejected
    sentences by reason.
    """

    def __init__(self, unchecked: bool = False) -> None:
        """unchecked: see `GnssDriver.new_decoder`."""
        self.counters: Counter[str] = Counter()
        self.status = ReceiverStatus()
        self.whole = 0
        self._splitter = Splitter(self.counters, unchecked)
        self._epoch: Epoch | None = None
        self._beginnings, self._endings = BurstOrder(FIRST_ELSEWHERE), BurstOrder(LAST_ELSEWHERE)
        self._regular, self._silence = RegularKinds(), BurstSilence()
        self._accuracy = StatedAccuracy()
        self._burst = 0  # number of the newest
        self._came: dict[str, tuple[int, int]] = {}  # by kind that others precede: burst and arrival of its last epoch
        self._held: HeldVtg | None = None
        self._pauses_ns = 0  # since the last sentence
        self._vtg_agrees = True  # with RMC, where there was both
        self._interval_ns = INTERVAL_MAX_NS  # between epochs
        self._gsa = GsaHistory()
        self._sky = SkyCollector()
        self._readings = ReadingCollector()
        self._waiting: dict[str, tuple[Content, int]] = {}  # companions of an epoch to come, with their arrival
        self._last_fix_utc_ns: int | None = None
        self._last_arrival_ns: int | None = None
        self._idle_ns = 0  # pauses since the epoch's last sentence
        self._pause_ns: int | None = None  # when the first bytes after a pause came
        self._receiver_utc_ns: int | None = None  # of the last position that a receiver itself sent

    @property
    def sky(self) -> Sky:
        """See `GnssDecoder`."""
        return self._sky.sky

    @property
    def pending(self) -> bool:
        """See `GnssDecoder`."""
        return self._held is not None or (self._epoch is not None and not self._epoch.done)

    def feed(self, data: bytes, arrival_ns: int) -> list[Fix]:
        """See `GnssDecoder`."""
        self._note_pause(arrival_ns)
        self._last_arrival_ns = arrival_ns
        fixes = []
        for sentence in self._splitter.feed(data, arrival_ns):
            self.whole += 1
            if self._held and self._held.after_ns is None:
                self._held.after_ns = self._pauses_ns
            fixes += self._process(sentence)
            self._pauses_ns = 0
        return fixes

    def _note_pause(self, arrival_ns: int) -> None:
        pause_ns = 0 if self._last_arrival_ns is None else arrival_ns - self._last_arrival_ns
        if pause_ns >= IDLE_NS:
            self._pauses_ns += pause_ns
            self._idle_ns += pause_ns
        if max(pause_ns, self._idle_ns) >= self._silence.ns:
            self._pause_ns, self._idle_ns = arrival_ns, 0

    def flush(self, now_ns: int) -> list[Fix]:
        """See `GnssDecoder`."""
        if self._last_arrival_ns is None or now_ns - self._last_arrival_ns < self._silence.ns:
            return []
        self._settle()
        return self._close()

    def take_readings(self) -> list[Reading]:
        """See `ReadingDecoder`."""
        return self._readings.take()

    def _add_readings(self, sentence: Sentence) -> None:
        try:
            found = READINGS[sentence.kind](sentence)
        except RefusedError as reason:
            self.counters[f"{sentence.kind} {reason}"] += 1
        else:
            for reading in found:
                self.counters[reading.source] += 1
                self._readings.add(reading, self._epoch)
            if not found:
                self.counters["no reading"] += 1

    def _process(self, sentence: Sentence) -> list[Fix]:
        self._sky.add(sentence)
        if sentence.kind in READINGS:
            self._add_readings(sentence)
            return []
        content = self._read(sentence)
        after_pause = self._pause_ns is not None and sentence.arrival_ns >= self._pause_ns
        if after_pause and self._epoch and content and same_time(content.utc_ns, self._epoch.utc_ns):
            after_pause = False  # a pause in the burst, for bytes that were lost
        if after_pause and self._held and self._held.sentence.arrival_ns < (self._pause_ns or 0):
            self._settle()
        fixes = self._close() if after_pause else []
        if content is None:
            return fixes
        if isinstance(content, GsaMode):
            self._gsa.add(content)
            return fixes
        self._gsa.end_group()
        return fixes + self._assign(sentence, content, after_pause)

    def _read(self, sentence: Sentence) -> Content | None:
        """Its contents; None: an unused kind, or rejected."""
        reader = READERS.get(sentence.kind)
        if reader is None:
            self.counters["other"] += 1
            return None
        try:
            return reader(sentence)
        except RefusedError as reason:
            self.counters[f"{sentence.kind} {reason}"] += 1
            return None

    def _assign(self, sentence: Sentence, content: Content, after_pause: bool) -> list[Fix]:
        """Put a sentence into the epoch to which it belongs."""
        epoch, kind = self._epoch, sentence.kind
        belongs = epoch is not None and not after_pause and self._belongs(sentence, content, epoch)
        if isinstance(content, Vtg) and not (belongs and self._is_ending(sentence)):
            return self._hold(sentence, content)
        if sentence.talker in RECEIVERS and isinstance(content, GgaGns | RmcGllGroup) and content.quality:
            self._receiver_utc_ns = content.utc_ns
        if epoch is not None and belongs:
            self._settle(between=True)
            if not self._join(epoch, kind, content):
                return []
            self._beginnings.contradict(kind)
        elif kind in COMPANIONS:
            self._waiting[kind] = content, sentence.arrival_ns
            return []
        elif epoch is not None and self._is_of_other_talker(sentence, content, epoch):
            self.counters["repeated"] += 1
            if isinstance(content, GgaGns | RmcGllGroup) and content.quality and epoch.lacks_fix(kind):
                epoch.add(kind, content)
            return []
        elif self._is_echo(sentence, content.utc_ns):
            self.counters["repeated"] += 1
            return []
        else:
            return self._begin(sentence, content, after_pause)
        return self._finish() if self._is_complete(kind) else []

    def _is_of_other_talker(self, sentence: Sentence, content: Content, epoch: Epoch) -> bool:
        """Whether it is of the epoch's time, as of a receiver with a sentence of each system; some may have no fix."""
        if not same_time(content.utc_ns, epoch.utc_ns):
            return False
        without_fix = isinstance(content, GgaGns | RmcGllGroup) and content.quality == 0
        soon = sentence.arrival_ns - epoch.arrival_ns < SILENCE_NS
        return not epoch.done or (without_fix and soon and same_time(content.utc_ns, self._last_fix_utc_ns))

    def _is_complete(self, kind: str) -> bool:
        """Whether `kind`, the newest sentence, ends bursts, and nothing that comes in some of them only is due now.

        An epoch without a fix is not: another system may have one.
        """
        epoch = self._epoch
        if epoch is None or not epoch.positions() or not self._endings.is_established(kind):
            return False
        due = [] if epoch.utc_ns is None else self._regular.due(epoch.utc_ns)
        return all(epoch.has(other) or epoch.can_do_without(other) for other in due)

    def _join(self, epoch: Epoch, kind: str, content: Content) -> bool:
        """Add a sentence to the epoch; False: that is complete."""
        was_due = epoch.utc_ns is not None and self._regular.is_due(kind, epoch.utc_ns)
        if epoch.utc_ns is not None and self._regular.note(kind, epoch.utc_ns):
            self._endings.forget(epoch.last)
        elif not was_due and self._is_waited_for(epoch, kind):
            self._endings.contradict(epoch.last)
        self._came[kind] = self._burst, epoch.arrival_ns
        if epoch.done and isinstance(content, Gst):
            self._accuracy.add_late(content, epoch)
            return False
        if epoch.done:
            self.counters["late"] += 1
            if epoch.ended_by_silence:
                self._silence.was_too_short(self._burst)
            return False
        epoch.add(kind, content)
        self._idle_ns = 0
        return True

    def _is_waited_for(self, epoch: Epoch, kind: str) -> bool:
        """Whether a fix is to wait for such a sentence: it comes in each burst, or says what is not known otherwise."""
        burst, arrival_ns = self._came.get(kind, (0, -STATED_NS))
        if burst >= self._burst - 1:
            return True
        is_recent = epoch.arrival_ns - arrival_ns < STATED_NS
        return not (self._regular.is_regular(kind) or (is_recent and epoch.can_do_without(kind)))

    def _is_ending(self, vtg: Sentence) -> bool:
        """Whether VTG is the last sentence of bursts, and this one surely is of the newest."""
        return self._endings.is_established(vtg.kind) and self._pauses_ns <= ADJACENT * self._interval_ns

    def _hold(self, vtg: Sentence, content: Vtg) -> list[Fix]:
        """Wait for the sentence after it."""
        self._settle()
        self._held = HeldVtg(vtg, content, self._pauses_ns)
        return []

    def _settle(self, between: bool = False) -> None:
        """The VTG that waits is of the newest epoch, or of none. between: its epoch goes on after it."""
        held, self._held = self._held, None
        if held is None:
            return
        adjacent = between or held.before_ns <= SAME_BURST * self._interval_ns
        if self._epoch is None or not adjacent or not self._belongs(held.sentence, held.content, self._epoch):
            self.counters["late"] += 1
        else:
            self._join(self._epoch, held.sentence.kind, held.content)

    def _is_echo(self, sentence: Sentence, utc_ns: int | None) -> bool:
        """Whether an instrument (II, IN, EC …) sends its own copy of what a receiver on the same line has just sent.

        It comes later, and perhaps with another time than that of its position.
        """
        if sentence.talker in RECEIVERS or utc_ns is None or self._receiver_utc_ns is None:
            return False
        return abs(math.remainder(utc_ns - self._receiver_utc_ns, DAY_NS)) < ECHO_NS

    def _belongs(self, sentence: Sentence, content: Content, epoch: Epoch) -> bool:
        late = content.utc_ns is None and sentence.arrival_ns - epoch.arrival_ns > LATE_INTERVALS * self._interval_ns
        return not late and epoch.fits(sentence.kind, content.utc_ns)

    def _begin(self, sentence: Sentence, content: Content, after_pause: bool) -> list[Fix]:
        kind, held = sentence.kind, self._held
        if held and held.is_of_next and not self._endings.is_established(held.sentence.kind):
            self._held = None
            self._endings.contradict(held.sentence.kind)
            self._waiting[held.sentence.kind] = held.content, held.sentence.arrival_ns
        self._settle()
        fixes = self._close()
        unusual = self._beginnings.is_contradicted(kind) or self._endings.is_established(kind)
        first = self._beginnings.is_established(kind) or (after_pause and not unusual)
        self._beginnings.confirm(kind)
        epoch = self._epoch = Epoch(sentence.arrival_ns, open_time=first)
        self._pause_ns = None
        self._burst += 1
        for name, (waiting, arrival_ns) in self._waiting.items():
            if isinstance(waiting, Vtg) or same_time(waiting.utc_ns, content.utc_ns):
                epoch.add(name, waiting)
                epoch.arrival_ns = min(epoch.arrival_ns, arrival_ns)
        self._waiting.clear()
        epoch.add(kind, content)
        self._idle_ns = 0
        self._readings.begin(epoch)
        return fixes + (self._finish() if self._is_complete(kind) else [])

    def _close(self) -> list[Fix]:
        """The epoch is over."""
        if self._epoch is None or self._epoch.done:
            return []
        self._endings.confirm(self._epoch.last)
        self._epoch.ended_by_silence = True
        return self._finish()

    def _finish(self) -> list[Fix]:
        """The epoch's fix, once."""
        epoch = self._epoch
        assert epoch is not None
        epoch.done = True
        self._accuracy.complete(epoch)
        status = epoch.status()
        if status is None:
            return []
        self.status = status
        if status.quality == 0:
            self.counters["no fix"] += 1
        elif same_time(epoch.utc_ns, self._last_fix_utc_ns):
            self.counters["repeated"] += 1
        elif contradictory(positions := epoch.positions()):
            self.counters["contradictory"] += 1
        else:
            return [self._make_fix(epoch, positions[0], status)]
        return []

    def _make_fix(self, epoch: Epoch, position: GgaGns | RmcGllGroup, status: ReceiverStatus) -> Fix:
        agrees = epoch.vtg_agrees()
        self._vtg_agrees = self._vtg_agrees if agrees is None else agrees
        fix = epoch.fix(position, status, self._gsa.dimensions_for_fix(), self._vtg_agrees)
        if epoch.utc_ns is not None and self._last_fix_utc_ns is not None:
            step_ns = epoch.utc_ns - self._last_fix_utc_ns
            self._interval_ns = step_ns if 0 < step_ns < INTERVAL_MAX_NS else INTERVAL_MAX_NS
        self._last_fix_utc_ns = epoch.utc_ns
        self.counters["fixes"] += 1
        return fix
