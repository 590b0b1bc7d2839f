"""The two kinds of sensor as the daemon sees them: bytes in; solutions, or fixes, out. No waiting, no logging."""

import math
from collections import Counter
from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.driver import GnssDriver, ImuConfigured, ImuDriver
from drivers.fix import Fix
from drivers.transport.line import Known, Line

from .epochs import EpochClock
from .gnss import Refusal, record, refusal
from .health import shown, words
from .outputs.view import NO_VECTOR, ClockFit, Gnss
from .pipeline import Stream
from .rate import Pace, Rate
from .settings import Gnss as GnssSettings

READ = 4096  # bytes at a time: fewer frames than the pipeline takes in one batch
SILENCE_NS = {"imu": 1_000_000_000, "gnss": 5_000_000_000}  # a stream this long silent is broken
STEADY = 3  # fixes
SILENT_PERIODS = 4  # at least
STALE_NS, STALE_PERIODS = 200_000_000, 3
STALE_FIX_NS = 3_000_000_000
EARTH_RADIUS_M = 6.371e6
JUMP_M, JUMP_MPS, JUMPED_NS = 100.0, 100.0, 5_000_000_000  # so far, and that fast beyond its own speed; shown so long
Records = NDArray[np.void]


class Tap(Protocol):
    """Is handed all bytes as they are read, when they were there, and the last pulse per second before."""

    def __call__(self, data: bytes | memoryview, t_ns: int, pulse_ns: int | None = None) -> None: ...


class Pulse(Protocol):
    """A receiver's pulse per second: see `PulsePerSecond`."""

    def newest_ns(self, now_ns: int) -> int | None: ...


class Inertial:
    """An inertial sensor that streams into a filter."""

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self.silence_ns = SILENCE_NS["imu"]
        self.period_s = 0.0  # nominal, between samples
        self.rate = Rate()
        self.pace: Pace | None = None  # of a sensor that sends by itself
        self.tap: Tap | None = None
        self._has_gyros = False
        self._room = stream.rx.data
        self._line: Line | None = None
        self._complaints: Mapping[int, str] = {}
        self._complained: int | None = None  # status word of the first look: the driver has told of that

    def connect(self, line: Line, driver: ImuDriver, configured: ImuConfigured, now_ns: int) -> None:
        """A new connection; the filter keeps what it knows."""
        self._line = line
        self.stream.restart(driver.new_state(configured), configured)
        self.stream.record["heard_ns"] = now_ns
        self._complaints, self._complained = driver.complaints, None
        self.rate = Rate()
        by_itself = configured.request is None and not isinstance(line, Known)
        self.pace = Pace(1e9 / configured.period_ns) if by_itself else None
        self.period_s = 1.0 / configured.rate_hz
        self._has_gyros = all(configured.gyro_axes)
        self.silence_ns = max(SILENCE_NS["imu"], SILENT_PERIODS * round(1e9 / configured.rate_hz))

    def read(self, now_ns: int) -> int:
        """Read and step; returns how many solutions are new, the newest last. Raises PortLostError."""
        assert self._line is not None
        fill = self.stream.fill
        received, arrival_ns = self._line.receive(self._room[fill : fill + READ], now_ns)
        if received == 0:
            return 0
        if self.tap is not None:
            self.tap(self._room[fill : fill + received], arrival_ns)
        return self.stream.ingest(received, arrival_ns)

    @property
    def samples(self) -> int:
        """Since the start."""
        return int(self.stream.record["count"][0])

    @property
    def heard_ns(self) -> int:
        """When the newest of them came, or else the connection was made."""
        return int(self.stream.record["heard_ns"][0])

    @property
    def _newest(self) -> int:
        return int(self.stream.record["newest"][0])

    def share_of_rate(self) -> float | None:
        """At what share of the agreed rate its samples come; None if that is not known. To be asked now and then."""
        if self.pace is None or self._newest < 0:
            return None
        self.pace.look(int(self.stream.samples[self._newest]["tick"]), self.heard_ns)
        return self.pace.share

    @property
    def newest(self) -> np.void | None:
        """The newest solution, a SOLUTION row that the next reading overwrites; None before the first."""
        return None if self._newest < 0 else self.stream.solutions[self._newest]

    @property
    def sensed(self) -> tuple[float, ...]:
        """Rates (rad/s) and specific force (m/s^2) of the last sample, body axes; NaN without a whole set of gyros."""
        sample = self.stream.samples[self._newest]
        rates = sample["w"].tolist() if self._has_gyros else NO_VECTOR
        return (*rates, *sample["f"].tolist())

    @property
    def heard(self) -> int:
        """The same, as of any sensor."""
        return self.samples

    def troubles(self, now_ns: int) -> tuple[str, ...]:
        """What is wrong with the sensor, in words."""
        if now_ns - self.heard_ns > max(STALE_NS, STALE_PERIODS * self.period_s * 1e9):
            return ("inertial sensor: stale, nothing new comes",)
        return (*words(shown(self.stream.filter.health)), *self._complains())

    def _complains(self) -> tuple[str, ...]:
        """What the sensor itself complained of since it streams."""
        status = int(self.stream.decoder["status"][0])
        if self._complained is None and self.stream.decoder["frames"][0] > 0:
            self._complained = status
        self._complained = status & (self._complained or 0)
        if status == self._complained:
            return ()
        return tuple(
            self._complaints.get(1 << bit, f"the sensor sets bit {bit} of its status word, meaning not known")
            for bit in range(16)
            if (status & ~self._complained) >> bit & 1
        )

    def clock_fit(self) -> ClockFit:
        """How well the sensor's counter fits our time."""
        clock = self.stream.clock[0]
        if not clock["fitted"]:
            return ClockFit()
        n, residual_ns = int(clock["count"]), float(clock["residual_ns"])
        span_ns = float(clock["ticks"][n - 1] - clock["ticks"][0]) * float(clock["period_ns"])
        sigma_drift = residual_ns / span_ns * math.sqrt(12.0 / n)  # of a straight line through n even points
        return ClockFit(residual_ns * 1e-9, float(clock["slope"] / clock["period_ns"]) - 1.0, sigma_drift)

    def facts(self, now_ns: int) -> dict[str, object]:
        """What `imud status` shows of it: counters, and how its samples come."""
        fit, clock = self.clock_fit(), self.stream.clock[0]
        return {
            **self.counters(),
            "heard_ago_s": (now_ns - self.heard_ns) * 1e-9,
            "clock": {
                "drift_ppm": 1e6 * fit.drift,
                "residual_us": 1e6 * fit.residual_s,
                "late_us": 1e-3 * float(clock["late_ns"]),
                "latest_us": 1e-3 * float(clock["latest_ns"]),
                "corrections": int(clock["corrections"]),
            },
        }

    @property
    def lost(self) -> int:
        """Samples that never came, since this connection."""
        return int(self.stream.decoder["lost"][0])

    def counters(self) -> dict[str, int]:
        """What decoder and line counted since this connection."""
        names = ("frames", "junk", "bad", "lost", "suspect", "errors")
        counted = {name: int(self.stream.decoder[name][0]) for name in names}
        return counted | (dict(self._line.counters) if self._line else {})


class Receiver:
    """A GNSS receiver whose fixes go to the filter."""

    def __init__(self, driver: GnssDriver, settings: GnssSettings, now_ns: int, pulse: Pulse | None = None) -> None:
        self._pulse = pulse
        self.decoder = driver.new_decoder()
        self.rate = Rate()
        self.heard_ns = now_ns
        self.silence_ns = SILENCE_NS["gnss"]
        self.used = 0
        self.refused = Counter[str]()  # by rule
        self.news = ""  # a change of the verdict on its fixes, until somebody has told it
        self.settings = settings
        self.tap: Tap | None = None
        self._verdict: str | None = None  # the rule that refuses them
        self._dissent = 0  # fixes in sequence of another verdict
        self._room = memoryview(bytearray(READ))
        self._epochs = EpochClock(settings.latency_s)
        self._last: Fix | None = None
        self._used_last: Fix | None = None
        self._row: Records | None = None  # the same for the filter
        self._jumped_ns: int | None = None
        self._connected_ns = now_ns

    def read(self, line: Line, now_ns: int) -> list[Records]:
        """Fixes (arrays of one FIX) that the new bytes complete. Raises PortLostError."""
        received, arrival_ns = line.receive(self._room, now_ns)
        return self.take(bytes(self._room[:received]), arrival_ns) if received else []

    def take(self, data: bytes, now_ns: int) -> list[Records]:
        """The same for bytes that came at `now_ns`."""
        pulse_ns = self._pulse.newest_ns(now_ns) if self._pulse else None
        if self.tap is not None:
            self.tap(data, now_ns, pulse_ns)
        whole, fixes = self.decoder.whole, self.decoder.feed(data, now_ns)
        if self.decoder.whole > whole:
            self.heard_ns = now_ns
        return self._accepted(fixes, now_ns, pulse_ns)

    @property
    def heard(self) -> int:
        """Fixes since this connection, used or not."""
        return self.used + self.refused.total()

    def flush(self, now_ns: int) -> list[Records]:
        """A fix whose epoch ended without an end."""
        pending = self.decoder.pending
        fixes = self.decoder.flush(now_ns)
        if not pending or self.decoder.pending:
            return []
        pulse_ns = self._pulse.newest_ns(now_ns) if self._pulse else None
        if self.tap is not None:
            self.tap(b"", now_ns, pulse_ns)
        return self._accepted(fixes, now_ns, pulse_ns)

    def _accepted(self, fixes: list[Fix], now_ns: int, pulse_ns: int | None) -> list[Records]:
        rows = []
        for fix in fixes:
            if self._last and jumps(self._last, fix):
                self._jumped_ns = now_ns
            self._last = fix
            refused = refusal(fix, self.settings)
            self._judge(refused)
            if refused:
                self.refused[refused.rule] += 1
            elif fix.utc_s is not None:
                self._used_last = fix
                rows.append(record(fix, self._epochs.epoch_ns(fix.utc_s, fix.arrival_ns, pulse_ns), now_ns))
                self._row = rows[-1]
        self.used += len(rows)
        return rows

    @property
    def used_last(self) -> Fix:
        """The last fix that was used; there must have been one."""
        assert self._used_last is not None
        return self._used_last

    def fresh(self, now_ns: int) -> Records | None:
        """The last fix that was used, as it goes to the filter; None if it is stale."""
        if self._row is None or now_ns - int(self._row["arrival_ns"][0]) > STALE_FIX_NS:
            return None
        return self._row

    def _judge(self, refused: Refusal | None) -> None:
        """Have news when several fixes in sequence are taken otherwise than those before."""
        verdict = refused.rule if refused else None
        self._dissent = 0 if verdict == self._verdict else self._dissent + 1
        if self._dissent == STEADY:
            self._verdict, self._dissent = verdict, 0
            self.news = f"the fixes are refused: {refused}" if refused else "the fixes are used again"

    def facts(self, now_ns: int) -> dict[str, object]:
        """What `imud status` shows of it: what became of its sentences and fixes, and what it says of itself."""
        said, last = self.decoder.status, self.view(now_ns)
        return {
            "used": self.used,
            "refused": {rule.removeprefix("gnss."): count for rule, count in self.refused.items()},
            "sentences": dict(self.decoder.counters),
            "quality": said.quality,
            "satellites": said.satellites,
            "hdop": last.hdop if last else None,
            "fix_age_s": last.age_s if last else None,
        }

    def counters(self) -> dict[str, object]:
        """What became of its sentences and fixes since this connection."""
        told = {"sentences": self.decoder.counters, "refused": self.refused}
        tables = {name: ", ".join(f"{count} {key}" for key, count in table.items()) for name, table in told.items()}
        return {"fixes_used": self.used, **{name: text for name, text in tables.items() if text}}

    def troubles(self, now_ns: int) -> tuple[str, ...]:
        """What is wrong with the receiver, in words."""
        status = self.decoder.status
        if now_ns - max(status.arrival_ns, self._connected_ns) > STALE_FIX_NS:
            return ("receiver: stale, nothing new comes",)
        if status.arrival_ns and status.quality == 0:
            return ("receiver: no fix",)
        if self._jumped_ns is not None and now_ns - self._jumped_ns < JUMPED_NS:
            return ("receiver: implausible, its position jumped",)
        return ()

    def view(self, now_ns: int) -> Gnss | None:
        """The last fix, for those who publish it; None before the first."""
        fix = self._last
        if fix is None:
            return None
        return Gnss(
            satellites=fix.satellites,
            hdop=math.nan if fix.hdop is None else fix.hdop,
            quality=fix.quality,
            alt_msl=math.nan if fix.alt_msl_m is None else fix.alt_msl_m,
            geoid_sep=math.nan if fix.geoid_sep_m is None else fix.geoid_sep_m,
            age_s=(now_ns - fix.arrival_ns) * 1e-9,
            sky=self.decoder.sky,
        )


def jumps(before: Fix, after: Fix) -> bool:
    """Whether no vehicle can have gone from one fix to the other."""
    seconds = (after.arrival_ns - before.arrival_ns) * 1e-9
    north = math.radians(after.lat_deg - before.lat_deg) * EARTH_RADIUS_M
    turns = math.radians((after.lon_deg - before.lon_deg + 180.0) % 360.0 - 180.0)
    east = turns * EARTH_RADIUS_M * math.cos(math.radians(after.lat_deg))
    speed = max(before.speed_mps or 0.0, after.speed_mps or 0.0)
    return math.hypot(north, east) > JUMP_M + (JUMP_MPS + speed) * max(seconds, 1.0)
