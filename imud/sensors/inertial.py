"""An inertial sensor as the daemon sees it: bytes in, solutions out. No waiting, no logging."""

import math
from collections import Counter
from collections.abc import Mapping

import numpy as np

from imud.drivers.driver import ImuConfigured, ImuDriver
from imud.drivers.transport.line import KnownDevice, Line

from ..pipeline import InertialPipeline
from ..sensor_errors.profiles import SampleSigma, profile_of, sample_sigmas
from ..sensor_monitor.findings import words
from ..sensor_monitor.health import recent_findings
from .byte_sink import READ_BYTES, ByteSink
from .limits import LIMITS, is_beyond
from .loss import HIGH, LossMonitor
from .rate import RateMeter, SampleRateMonitor
from .readings import NO_VECTOR, ClockFit

SILENCE_NS = 1_000_000_000  # a stream this long silent is broken
SILENT_PERIODS = 4  # at least
STALE_NS, STALE_PERIODS = 200_000_000, 3
AHEAD_NS = 1_000_000_000
_BEYOND = {
    "clock_residual_us": "inertial sensor: its samples come so irregularly that their times are uncertain by more than "
    f"{LIMITS['clock_residual_us'].most * 1e-3:g} ms",
    "clock_drift_ppm": "inertial sensor: its clock differs from this machine's by more than "
    f"{LIMITS['clock_drift_ppm'].most:g} ppm",
    "temperature_c": "inertial sensor: it is colder than {0.least:g} or hotter than {0.most:g} degC".format(
        LIMITS["temperature_c"]
    ),
}
_DAMAGED = f"inertial sensor: more than {HIGH:.0%} of its samples do not arrive whole"
_OTHER_RATE = "inertial sensor: its samples come at another rate than was agreed: their times are wrong"


class Inertial:
    """An inertial sensor that streams into a filter."""

    configured: ImuConfigured  # of the connection

    def __init__(self, pipeline: InertialPipeline, before: Mapping[str, int] | None = None) -> None:
        """before: the totals of the sensor that was in use before."""
        self.pipeline = pipeline
        self.silence_ns, self.stale_ns = SILENCE_NS, STALE_NS
        self.period_s = 0.0  # nominal, between samples
        self.rate, self._loss_monitor = RateMeter(), LossMonitor()
        self._before = Counter[str](before or {})  # counted in earlier connections
        # of the ticks of a sensor that sends by itself; of its samples, too, if the ticks are those of a timer
        self._rate_monitors: list[SampleRateMonitor] = []
        self.byte_sink: ByteSink | None = None
        self.has_gyros = self.has_quartz = False
        self._room = pipeline.rx.data
        self._line: Line | None = None
        self._fault_texts: Mapping[int, str] = {}
        # bits of unknown meaning that have been set since the first frame, as the driver has reported: this unit is so
        self._initial_status: int | None = None

    def connect(
        self, line: Line, driver: ImuDriver, configured: ImuConfigured, now_ns: int, first_flags: int = 0
    ) -> None:
        """Begin a new connection; the filter keeps its state. first_flags: of its first sample."""
        if self._line is not None:
            self._before.update(self.counters())
        self.pipeline.restart(driver.new_state(configured), configured, first_flags)
        self._line, self.configured = line, configured
        self.pipeline.record["last_data_ns"] = now_ns
        self._fault_texts, self._initial_status = driver.fault_texts, None
        self.rate, self._loss_monitor = RateMeter(), LossMonitor()
        by_itself = configured.request is None and not isinstance(line, KnownDevice)
        has_timer = configured.period_ns * 1e-9 * configured.rate_hz < 0.5
        agreed_hz = [1e9 / configured.period_ns, configured.rate_hz] if has_timer else [configured.rate_hz]
        self._rate_monitors = [SampleRateMonitor(hz) for hz in agreed_hz] if by_itself else []
        self.period_s = 1.0 / configured.rate_hz
        self.has_gyros, self.has_quartz = all(configured.gyro_axes), configured.has_quartz
        self.silence_ns = max(SILENCE_NS, SILENT_PERIODS * round(1e9 / configured.rate_hz))
        self.stale_ns = max(STALE_NS, STALE_PERIODS * round(1e9 / configured.rate_hz))

    def read(self, now_ns: int) -> int:
        """Read and step; returns how many solutions are new, the newest last. Raises PortLostError."""
        assert self._line is not None
        fill = self.pipeline.fill
        received, arrival_ns = self._line.receive(self._room[fill : fill + READ_BYTES], now_ns)
        if received == 0:
            return 0
        if self.byte_sink is not None:
            self.byte_sink(self._room[fill : fill + received], arrival_ns)
        return self.pipeline.ingest(received, arrival_ns)

    @property
    def samples(self) -> int:
        """Number of samples since the start."""
        return int(self.pipeline.record["count"][0])

    @property
    def last_data_ns(self) -> int:
        """When the newest sample came; before the first, when the connection was made."""
        return int(self.pipeline.record["last_data_ns"][0])

    @property
    def _newest(self) -> int:
        return int(self.pipeline.record["newest"][0])

    def is_ahead(self, now_ns: int) -> bool:
        """Whether the filter's time has run ahead of the clock: more samples came than the agreed rate allows.

        A filter that is given earlier samples then stands still until its time has come.
        """
        return self.newest is not None and int(self.newest["t_ns"]) - now_ns > AHEAD_NS

    def rate_ratio(self) -> float | None:
        """The samples' rate over the agreed one; None while it is not known. Call it now and then."""
        if self._newest < 0:
            return None
        frames, junk = (int(self.pipeline.decoder[name][0]) for name in ("frames", "junk"))
        counts = int(self.pipeline.samples[self._newest]["tick"]), frames + junk // max(1, self.configured.frame_bytes)
        for monitor, count in zip(self._rate_monitors, counts, strict=False):
            monitor.update(count, self.last_data_ns)
        return self._rate_share

    @property
    def _rate_share(self) -> float | None:
        """As `rate_ratio`, of what was seen until its last call."""
        shares = [monitor.share for monitor in self._rate_monitors]
        return next((share for share in shares if share not in (None, 1.0)), shares[0] if shares else None)

    @property
    def newest(self) -> np.void | None:
        """The newest solution, a SOLUTION row that the next reading overwrites; None before the first."""
        return None if self._newest < 0 else self.pipeline.solutions[self._newest]

    @property
    def sensed(self) -> tuple[float, ...]:
        """Rates (rad/s) and specific force (m/s^2) of the last sample, body axes; NaN without a whole set of gyros."""
        sample = self.pipeline.samples[self._newest]
        rates = sample["w"].tolist() if self.has_gyros else NO_VECTOR
        return (*rates, *sample["f"].tolist())

    @property
    def sample_sigmas(self) -> tuple[SampleSigma | None, SampleSigma]:
        """What a sample's rates and forces are worth by the noise profile; None without a whole set of gyros."""
        filter_ = self.pipeline.filter
        gyro, accel = sample_sigmas(profile_of(filter_.settings), filter_.rate_hz)
        return gyro if self.has_gyros else None, accel

    def update(self, now_ns: int) -> None:
        """Call now and then: how fast samples come, and how many of them do not."""
        self.rate.update(self.samples, now_ns)
        self._loss_monitor.update(int(self.pipeline.decoder["frames"][0]), self.lost, now_ns)

    def faults(self, now_ns: int) -> tuple[str, ...]:
        """What is wrong with the sensor, in words."""
        if now_ns - self.last_data_ns > self.stale_ns:
            return ("inertial sensor: stale, nothing new comes",)
        damaged = (_DAMAGED,) if self._loss_monitor.is_high else ()
        other_rate = () if self._rate_share in (None, 1.0) else (_OTHER_RATE,)
        beyond = (_BEYOND[name] for name in self.out_of_limits())
        return (*damaged, *other_rate, *beyond, *self._faults_found())

    def reading_faults(self) -> tuple[str, ...]:
        """Those that make its readings wrong: none of its line or clock, nor of a machine that is too busy."""
        beyond = (_BEYOND[name] for name in self.out_of_limits() if name == "temperature_c")
        return (*beyond, *self._faults_found())

    def _faults_found(self) -> tuple[str, ...]:
        """Those that its samples show, and those that it reports."""
        return (*words(recent_findings(self.pipeline.filter.health)), *self._reported_faults())

    def out_of_limits(self) -> tuple[str, ...]:
        """Which quantities are beyond their limits, by their names in `LIMITS`."""
        fit = self.clock_fit()
        drift = 1e6 * fit.drift if self.has_quartz else math.nan
        temperature = float(self.pipeline.samples[self._newest]["temperature"]) if self._newest >= 0 else math.nan
        shown = (
            ("clock_residual_us", 1e6 * fit.residual_s, 0.0),
            ("clock_drift_ppm", drift, 1e6 * fit.sigma_drift),
            ("temperature_c", temperature, 0.0),
        )
        return tuple(name for name, value, sigma in shown if is_beyond(name, value, sigma))

    def _reported_faults(self) -> tuple[str, ...]:
        """Faults that the sensor itself reports."""
        status = int(self.pipeline.decoder["status"][0])
        if self._initial_status is None and self.pipeline.decoder["frames"][0] > 0:
            self._initial_status = status & ~sum(self._fault_texts)
        self._initial_status = status & (self._initial_status or 0)
        if status == self._initial_status:
            return ()
        return tuple(
            self._fault_texts.get(1 << bit, f"the sensor sets bit {bit} of its status word, meaning not known")
            for bit in range(16)
            if (status & ~self._initial_status) >> bit & 1
        )

    def clock_fit(self) -> ClockFit:
        """How well the sensor's counter fits our time."""
        clock = self.pipeline.clock[0]
        if not clock["fitted"]:
            return ClockFit()
        slope, sigma = clock["slope"] / clock["period_ns"], clock["sigma_slope"] / clock["period_ns"]
        return ClockFit(float(clock["residual_ns"]) * 1e-9, float(slope) - 1.0, float(sigma))

    def properties(self, now_ns: int) -> dict[str, object]:
        """What `imud status` shows of the sensor: counters, and the fit of its clock."""
        fit, clock = self.clock_fit(), self.pipeline.clock[0]
        return {
            **self.counters(),
            "sample_age_s": (now_ns - self.last_data_ns) * 1e-9,
            "out_of_limits": ",".join(self.out_of_limits()) or None,
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
        """Samples of this connection that never came: by the sensor's counter, as our clock corrected it."""
        clock = self.pipeline.clock[0]
        uncounted = float(clock["uncounted_ticks"] * clock["period_ns"]) * 1e-9 / self.period_s
        return max(0, int(self.pipeline.decoder["lost"][0]) + round(uncounted))

    def counters(self) -> dict[str, int]:
        """What decoder and line have counted in this connection."""
        names = ("frames", "junk", "bad", "lost", "suspect", "errors")
        counted = {name: int(self.pipeline.decoder[name][0]) for name in names} | {"lost": self.lost}
        return counted | (dict(self._line.counters) if self._line else {})

    def totals(self) -> dict[str, int]:
        """The same of all connections together, as `samples`."""
        now = self.counters()
        return {name: now.get(name, 0) + self._before[name] for name in {**self._before, **now}}
