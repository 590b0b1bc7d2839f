"""A GNSS receiver as the daemon sees it: bytes in, fixes out. No waiting, no logging."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Protocol

from imud.drivers.driver import GnssDriver, NativeProtocol, ReadingDecoder
from imud.drivers.fix import Fix, Reading, Sky
from imud.drivers.transport.line import Line

from ..clocks.epochs import EpochClock
from ..clocks.week_rollover import without_rollover
from ..configuration.settings import Aiding as AidingSettings
from ..configuration.settings import Gnss as GnssSettings
from ..estimators.aiding_source import AidingSource, ImpossibleValueError
from ..estimators.records import NEW_RECEIVER
from ..math.arrays import Records
from ..math.earth import MEAN_RADIUS_M
from .aiding import NamedMeasurement, SourceCounter
from .byte_sink import READ_BYTES, ByteSink
from .fix_consistency import FROZEN, FixConsistency
from .gnss import IMPOSSIBLE, INACCURATE, Refusal, is_precise, record, refusal
from .limits import BY_SETTING, LIMITS
from .line_load import LineLoad
from .loss import HIGH, LossMonitor
from .nmea_aiding import measured_of
from .rate import RateMeter
from .readings import ReceiverReport
from .silence import SilenceLimit

STEADY = 3  # fixes
TOO_LATE_NS = 2_000_000_000  # the fusion horizon of `navigation`
STALE_FIX_NS = round(LIMITS["gnss_age_s"].most * 1e9)
_STALE_PERIODS = 1.5  # of a receiver whose period is longer than two seconds
JUMP_M, JUMP_MPS = 100.0, 100.0  # a jump goes farther than that, plus what JUMP_MPS above its own speed would make
JUMPED_NS = 5_000_000_000  # for which a jump is shown
_SKY_NS = 10_000_000_000  # for which satellites and dilutions are shown; some receivers send them each fifth second
_DAMAGED = f"receiver: more than {HIGH:.0%} of its messages do not arrive whole"
_MEASURED_MAX = 64  # that are kept until they are used
_QUEUE = Refusal("unknown age", "their age is not known: they have waited somewhere and come faster than they are made")
_CLOCK = Refusal("unknown age", "their age is not known: their times do not go on as they come")
_NO_PAUSE = Refusal("unknown age", "their age is not known: the line has no pauses, so they may have waited for it")
_TOO_SLOW = "its line is too slow for all that it sends, which comes late: a higher baud rate, or fewer messages"
_UNTIMED = "receiver: its fixes have no time, and are not used; a gpsd knows it from RMC or ZDA"
_NO_POSITION = "sends no position: no GGA, RMC, GNS, GLL, NAV-PVT or TPV"
_POSITIONS = ("GGA ", "RMC ", "GNS ", "GLL ", "NAV-PVT ")  # begin the reasons for which a decoder rejects a position
_VELOCITY = ("VTG ",)  # the same of a velocity alone
_UNUSED = (
    "sensor: sends nothing that is used: no position (GGA, RMC, GNS, GLL); headings must be true (HDT, THS), "
    "pressures the air's (XDR), speeds over ground (VBW) or with aiding.current_mps"
)
_NO_AIDING = AidingSettings()
_JAMMED = {1: "receiver: reports interference", 2: "receiver: reports interference so strong that it has no fix"}
_SPOOFED = {1: "receiver: reports signs of spoofing", 2: "receiver: reports spoofing, so its fixes are refused"}


class Pulse(Protocol):
    """A receiver's pulse per second: see `PulsePerSecond`."""

    def newest_ns(self) -> int | None: ...


class Receiver:
    """A GNSS receiver whose fixes go to the filter, or a sensor with its protocol that has other readings only."""

    def __init__(
        self,
        driver: GnssDriver,
        settings: GnssSettings,
        now_ns: int,
        pulse: Pulse | None = None,
        aiding: AidingSettings = _NO_AIDING,
        positions: bool = True,
        baud: int = 0,
        recorded: bool = False,
    ) -> None:
        """positions: it sends any. Fixes of one that does not are not used. baud: of its line; 0: it has none.

        recorded: its bytes are of a recording, whose dates stay as they are.
        """
        self.positions, self.aiding, self._recorded = positions, aiding, recorded
        self._pulse = pulse
        self.decoder = driver.new_decoder(not settings.require_checksum)
        self._readings = self.decoder if isinstance(self.decoder, ReadingDecoder) else None
        self._speaks_two = isinstance(driver, NativeProtocol)
        self._position_ns = 0  # the epoch of the last position, or of that there is none
        self.rate, self._loss_monitor, self._unread_monitor = RateMeter(), LossMonitor(), LossMonitor()
        self._silence = SilenceLimit(now_ns)
        self.used = 0
        self.refused = Counter[str]()  # by rule
        self.message = ""  # a change of whether its fixes are used, until the daemon has logged it
        self.settings = settings
        self.byte_sink: ByteSink | None = None
        self._verdict: str | None = None  # the rule that refuses them
        self._dissent_count = 0  # fixes in sequence of another verdict
        self._room = memoryview(bytearray(READ_BYTES))
        self._epochs = EpochClock(settings.latency_s)
        self._consistency = FixConsistency()
        self._line_load = LineLoad(baud)
        self._last: Fix | None = None
        self._last_used_fix: Fix | None = None
        self._row: Records | None = None  # the same for the filter
        self._jumped_ns: int | None = None
        self._backward_count = 0  # fixes in sequence, each of an earlier time than the one before
        self._leap_count = 0  # fixes in sequence, each of a time that has not gone on as the arrival
        self._connected_ns = now_ns
        self.received: dict[str, SourceCounter] = {}  # of its readings, by aiding source
        self.measured: list[NamedMeasurement] = []  # of its readings, until they are used

    def read(self, line: Line, now_ns: int) -> list[Records]:
        """Fixes (arrays of one FIX) that the new bytes complete. Raises PortLostError."""
        received, arrival_ns = line.receive(self._room, now_ns)
        return self.feed(bytes(self._room[:received]), arrival_ns) if received else []

    def feed(self, data: bytes, now_ns: int) -> list[Records]:
        """The same for bytes that came at `now_ns`."""
        pulse_ns = self._pulse.newest_ns() if self._pulse else None
        if self.byte_sink is not None:
            self.byte_sink(data, now_ns, pulse_ns)
        self._line_load.add(len(data), now_ns)
        whole, fixes = self.decoder.whole, self.decoder.feed(data, now_ns)
        self._add_to_silence(self.decoder.whole > whole, now_ns)
        return self._accepted(fixes, now_ns, pulse_ns)

    def _add_to_silence(self, is_of_use: bool, now_ns: int) -> None:
        """Bytes came; is_of_use: they completed a message.

        A receiver of two protocols may return to the other one when it is reset, and some messages of its own go on: of
        one that has sent positions nothing else is of use, so that it is looked for anew.
        """
        before_ns, self._position_ns = self._position_ns, self.decoder.status.arrival_ns
        if not (self._speaks_two and before_ns):
            self._silence.add(now_ns, is_of_use)
        elif self._position_ns > before_ns:
            self._silence.add(now_ns, True)

    @property
    def last_data_ns(self) -> int:
        """When something of use came."""
        return self._silence.last_ns

    @property
    def silence_ns(self) -> int:
        """For which it may be silent from then on."""
        return self._silence.limit_ns

    @property
    def fix_count(self) -> int:
        """Fixes since this connection, used or not."""
        return self.used + self.refused.total()

    def flush(self, now_ns: int) -> list[Records]:
        """The fix of an epoch that ended by silence."""
        pending = self.decoder.pending
        fixes = self.decoder.flush(now_ns)
        if not pending or self.decoder.pending:
            return []
        pulse_ns = self._pulse.newest_ns() if self._pulse else None
        if self.byte_sink is not None:
            self.byte_sink(b"", now_ns, pulse_ns)
        return self._accepted(fixes, now_ns, pulse_ns)

    def _accepted(self, fixes: list[Fix], now_ns: int, pulse_ns: int | None) -> list[Records]:
        rows = []
        for reported in fixes if self.positions else ():
            fix = reported if self._recorded else without_rollover(reported)
            if self._last and jumps(self._last, fix):
                self._jumped_ns = now_ns
            self._backward_count = self._backward_count + 1 if self._last and runs_backward(self._last, fix) else 0
            self._leap_count = self._leap_count + 1 if self._last and leaps(self._last, fix) else 0
            self._last = fix
            t_ns = 0 if fix.utc_s is None else self._epochs.epoch_ns(fix.utc_s, fix.arrival_ns, pulse_ns)
            row = record(fix, t_ns, now_ns)
            refused = refusal(fix, self.settings) or self._contradiction(row)
            self._update_verdict(refused)
            if refused:
                self.refused[refused.rule] += 1
            else:
                row["flags"] = 0 if self._last_used_fix else NEW_RECEIVER
                self._last_used_fix = fix
                rows.append(self._consistency.without_wrong_velocity(row))
                self._row = rows[-1]
                if fix.heading_deg is not None:
                    reading = Reading("heading", fix.arrival_ns, fix.utc_s, fix.heading_deg, fix.heading_sigma_deg)
                    self._keep(reading, pulse_ns)
        self.used += len(rows)
        if self._readings is not None:
            for reading in self._readings.take_readings():
                self._keep(reading, pulse_ns)
        return rows

    def _contradiction(self, row: Records) -> Refusal | None:
        """Why a fix that the settings allow cannot be right."""
        if not self._epochs.is_known:
            return _QUEUE
        if self._line_load.hides_age:
            return _NO_PAUSE
        if max(self._backward_count, self._leap_count) >= STEADY:
            return _CLOCK
        self._consistency.add(row)
        return FROZEN if self._consistency.is_frozen else None

    def _keep(self, reading: Reading, pulse_ns: int | None) -> None:
        """A reading on its way to the filter. A heading without a time is as old as the settings say, others new."""
        if self._line_load.is_saturated or (measured := measured_of(reading, self.settings, self.aiding)) is None:
            return
        t_ns = reading.arrival_ns
        if reading.source == "heading" and reading.utc_s is None:
            t_ns -= round(self.settings.latency_s * 1e9)
        elif reading.source == "heading" and reading.utc_s is not None:
            t_ns = self._epochs.epoch_ns(reading.utc_s, reading.arrival_ns, pulse_ns)
            if not self._epochs.is_known:
                return
        source, values = measured
        self.received.setdefault(source, SourceCounter()).add(reading.arrival_ns)
        self.measured.append(NamedMeasurement(source, values, t_ns, reading.arrival_ns))
        del self.measured[:-_MEASURED_MAX]

    def take_measured(self, known: Iterable[AidingSource]) -> Iterator[tuple[str, Records]]:
        """Source and measurement (array of one MEASUREMENT) of the readings since the last call.

        known: the sources that the estimator takes; readings of others are left out, impossible ones are counted.
        """
        measured, self.measured = self.measured, []
        for each in measured:
            try:
                row = each.row(known)
            except ImpossibleValueError as error:
                self.received[each.source].refuse(f"{each.source}: {error}")
                continue
            if row is not None:
                yield each.source, row

    @property
    def last_used_fix(self) -> Fix:
        """The last fix that was used; there must have been one."""
        assert self._last_used_fix is not None
        return self._last_used_fix

    def fresh_fix(self, now_ns: int) -> Records | None:
        """The last fix that was used, as it goes to the filter; None if it is stale, or the receiver has none since."""
        if self._row is None or self._last is None or self._has_lost_fix(self._last):
            return None
        return self._row if now_ns - int(self._row["arrival_ns"][0]) <= STALE_FIX_NS else None

    def _update_verdict(self, refused: Refusal | None) -> None:
        """Leave a message about a changed verdict, once several fixes in sequence share it."""
        verdict = refused.rule if refused else None
        self._dissent_count = 0 if verdict == self._verdict else self._dissent_count + 1
        if self._dissent_count == STEADY:
            self._verdict, self._dissent_count = verdict, 0
            self.message = f"the fixes are refused: {refused}" if refused else "the fixes are used again"

    def properties(self, now_ns: int) -> dict[str, object]:
        """What `imud status` shows of it: what became of its sentences and fixes, and what it says of itself."""
        status, last = self.decoder.status, self._last
        return {
            "out_of_limits": ",".join(self.out_of_limits(now_ns)) or None,
            "used": self.used,
            "refused": {rule.removeprefix("gnss."): count for rule, count in self.refused.items()},
            "sentences": dict(self.decoder.counters),
            "lat_deg": last.lat_deg if last else None,
            "lon_deg": last.lon_deg if last else None,
            "quality": status.quality,
            "satellites": status.satellites,
            "hdop": last.hdop if last else None,
            "jamming": status.jamming,
            "spoofing": status.spoofing,
            "fix_age_s": _age_s(last, now_ns) if last else None,
        }

    def counters(self) -> dict[str, object]:
        """What became of its sentences and fixes in this connection."""
        counters = {"sentences": self.decoder.counters, "refused": self.refused}
        tables = {name: ", ".join(f"{count} {key}" for key, count in table.items()) for name, table in counters.items()}
        return {"fixes_used": self.used, **{name: text for name, text in tables.items() if text}}

    def update(self, now_ns: int) -> None:
        """Call now and then: how fast fixes come, and how many sentences do not."""
        self.rate.update(self.fix_count, now_ns)
        for received in self.received.values():
            received.rate.update(received.count, now_ns)
        self._loss_monitor.update(self.decoder.whole, self.decoder.counters["wrong checksum"], now_ns)
        self._unread_monitor.update(self.decoder.whole, sum(self._unread().values()), now_ns)

    def faults(self, now_ns: int) -> tuple[str, ...]:
        """What is wrong with the receiver, in words."""
        damaged = _DAMAGED if self._loss_monitor.is_high else ""
        status = self.decoder.status
        slow = f"{'receiver' if self.positions else 'sensor'}: {_TOO_SLOW}" if self._line_load.is_saturated else ""
        velocity = f"receiver: {self._consistency.fault}" if self._consistency.fault else ""
        interference = (_JAMMED.get(status.jamming or 0, ""), _SPOOFED.get(status.spoofing or 0, ""))
        of_fixes = self._fix_fault(now_ns) or self._reading_fault()
        return tuple(text for text in (of_fixes, slow, velocity, damaged, *interference) if text)

    def _unread(self) -> dict[str, int]:
        """How many positions and velocities arrived whole and could not be read, by reason."""
        return {why: n for why, n in self.decoder.counters.items() if why.startswith(_POSITIONS + _VELOCITY)}

    def _reading_fault(self) -> str:
        """What is missing in its fixes, as it cannot be read; empty: nothing."""
        if not self._unread_monitor.is_high:
            return ""
        unread = self._unread()
        return f"receiver: some of its sentences cannot be read: {max(unread, key=unread.__getitem__)}"

    def _fix_fault(self, now_ns: int) -> str:
        """What is wrong with its fixes; empty: nothing."""
        if not self.positions:
            is_stale, is_new = now_ns - self.last_data_ns > self._stale_ns, now_ns - self._connected_ns <= STALE_FIX_NS
            return "sensor: stale, nothing new comes" if is_stale else "" if self.received or is_new else _UNUSED
        return self._lack_of_fixes(now_ns) or self._wrong_time() or self._unusable_fixes(now_ns)

    @property
    def _stale_ns(self) -> int:
        """After which it lacks something. A receiver that sends rarely, but regularly, does not."""
        return max(STALE_FIX_NS, round(_STALE_PERIODS * (self._silence.period_ns or 0)))

    def _lack_of_fixes(self, now_ns: int) -> str:
        status = self.decoder.status
        if now_ns - max(status.arrival_ns, self._connected_ns) > self._stale_ns:
            talks = now_ns - self.last_data_ns <= self._stale_ns
            return f"receiver: {self._lack_of_positions() if talks else 'stale, nothing new comes'}"
        if status.arrival_ns and status.quality == 0:
            return "receiver: no fix"
        if now_ns - (self._last.arrival_ns if self._last else self._connected_ns) > self._stale_ns:
            untimed = self._last is None and self.decoder.counters.get("no time")
            return _UNTIMED if untimed else "receiver: reports a fix, but sends no new one"
        return ""

    def _lack_of_positions(self) -> str:
        unread = ", ".join(reason for reason in self.decoder.counters if reason.startswith(_POSITIONS))
        return f"its positions cannot be read: {unread}" if unread else _NO_POSITION

    def _wrong_time(self) -> str:
        if self._backward_count >= STEADY:
            return "receiver: its time runs backward"
        if self._leap_count >= STEADY:
            return "receiver: its time jumps from fix to fix"
        return ""

    def _unusable_fixes(self, now_ns: int) -> str:
        if self._consistency.is_frozen:
            return "receiver: its position has never changed although its velocity says that it moves"
        if self._row is not None and int(self._row["arrival_ns"][0] - self._row["t_ns"][0]) > TOO_LATE_NS:
            return "receiver: its fixes come more than two seconds late, too late for the filter"
        for lasting in (IMPOSSIBLE, INACCURATE):
            if self._verdict == lasting.rule:
                return f"receiver: its fixes are refused: {lasting}"
        if self._verdict in BY_SETTING:
            return f"receiver: its fixes are refused by {self._verdict}"
        if self._jumped_ns is not None and now_ns - self._jumped_ns < JUMPED_NS:
            return "receiver: implausible, its position jumped"
        return ""

    def out_of_limits(self, now_ns: int) -> tuple[str, ...]:
        """Which quantities are beyond their limits, or those of the settings."""
        stale = ("gnss_age_s",) if self._last and _age_s(self._last, now_ns) * 1e9 > self._stale_ns else ()
        return (*stale, *filter(None, (BY_SETTING.get(self._verdict or ""),)))

    def utc_less_monotonic_s(self, near_ns: int) -> float | None:
        """By its last used fix; None before the first, or while their age is not known. near_ns: Unix time, about."""
        if self._row is None or self._last_used_fix is None or not self._epochs.is_known:
            return None
        utc_ns = self._last_used_fix.utc_ns(near_ns)
        return None if utc_ns is None else (utc_ns - int(self._row["t_ns"][0])) * 1e-9

    @property
    def is_precise(self) -> bool:
        """Whether its last position is one of centimetres."""
        return self._row is not None and is_precise(self._row[0])

    def view(self, now_ns: int) -> ReceiverReport | None:
        """The last fix, for those who publish it, or that there is none now; None before the receiver says either."""
        fix, status, sky = self._last, self.decoder.status, self._recent_sky(now_ns)
        if fix is None:
            none_yet = ReceiverReport(satellites=status.satellites, quality=status.quality, sky=sky)
            return none_yet if status.arrival_ns else None
        report = ReceiverReport(
            satellites=fix.satellites,
            hdop=math.nan if fix.hdop is None else fix.hdop,
            quality=fix.quality,
            alt_msl=math.nan if fix.alt_msl_m is None else fix.alt_msl_m,
            geoid_sep=math.nan if fix.geoid_sep_m is None else fix.geoid_sep_m,
            age_s=_age_s(fix, now_ns),
            sky=sky,
            fix=b"" if self._row is None else self._row.tobytes(),
            reported=self._last_used_fix,
        )
        if not self._has_lost_fix(fix):
            return report
        sky = sky._replace(pdop=None, vdop=None)
        return report._replace(satellites=status.satellites, hdop=math.nan, quality=0, sky=sky)

    def _recent_sky(self, now_ns: int) -> Sky:
        """The receiver's satellites and dilutions, unless the last report of them is old."""
        sky = self.decoder.sky
        if sky.arrival_ns is not None and now_ns - sky.arrival_ns > _SKY_NS:
            sky = sky._replace(satellites=())
        if sky.dops_arrival_ns is not None and now_ns - sky.dops_arrival_ns > _SKY_NS:
            sky = sky._replace(pdop=None, vdop=None)
        return sky

    def _has_lost_fix(self, last: Fix) -> bool:
        """Whether it has said since its last fix that it has none."""
        return self.decoder.status.quality == 0 and self.decoder.status.arrival_ns > last.arrival_ns


def _age_s(fix: Fix, now_ns: int) -> float:
    """Since it arrived; 0 for one that has come since `now_ns` was read."""
    return max(0, now_ns - fix.arrival_ns) * 1e-9


def jumps(before: Fix, after: Fix) -> bool:
    """Whether no vehicle can have gone from one fix to the other."""
    seconds = (after.arrival_ns - before.arrival_ns) * 1e-9
    north = math.radians(after.lat_deg - before.lat_deg) * MEAN_RADIUS_M
    turns = math.radians((after.lon_deg - before.lon_deg + 180.0) % 360.0 - 180.0)
    east = turns * MEAN_RADIUS_M * math.cos(math.radians(after.lat_deg))
    speed = max(before.speed_mps or 0.0, after.speed_mps or 0.0)
    return math.hypot(north, east) > JUMP_M + (JUMP_MPS + speed) * max(seconds, 1.0)


def runs_backward(before: Fix, after: Fix) -> bool:
    """Whether the later fix has the earlier time of day; over midnight the day is the nearest one."""
    if before.utc_s is None or after.utc_s is None:
        return False
    return math.remainder(after.utc_s - before.utc_s, 86_400.0) < 0.0


def leaps(before: Fix, after: Fix) -> bool:
    """Whether the time of day has gone on by another amount than the arrival, by more than any fix may be late."""
    if before.utc_s is None or after.utc_s is None:
        return False
    passed_s = (after.arrival_ns - before.arrival_ns) * 1e-9
    return abs(math.remainder(after.utc_s - before.utc_s - passed_s, 86_400.0)) > TOO_LATE_NS * 1e-9
