"""From a gpsd's reports to fixes: TPV, with the errors of GST and the dilution and satellites of SKY.

gpsd may send several TPV for one epoch, each with more: those of one time are merged. The fix is ready with as many of
them as the epoch before had; else with the next epoch, or when the line has been silent. TOFF is sent as the epoch
begins, so its arrival is that of the epoch's first byte. Of several devices only one is used, until it has had no fix
for some seconds. Not used: epx, epy and epv, which gpsd estimates from the dilution unless the receiver reported them,
and climb and velD, which are differences of heights unless the receiver reported them; a report does not say which.
"""

from collections import Counter
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any

from ..fix import Fix, ReceiverStatus, Sky
from .reports import Lines, Report, quality, sky

SILENCE_NS = 200_000_000  # longer than any pause between the TPV of an epoch
DEVICE_TIMEOUT_NS = 3_000_000_000  # time without a fix after which another device is used
SKY_AGE_MAX_NS = 10_000_000_000  # after which a SKY is not used
TOFF_AGE_MAX_NS = 1_500_000_000  # a TOFF belongs to an epoch that arrives at most that long after it
EPOCH_0 = datetime(1970, 1, 1)
USED = ("mode", "status", "lat", "lon", "altMSL", "altHAE", "geoidSep", "track", "speed")  # of a TPV, in a fix


@dataclass
class Epoch:
    """The TPV of one time."""

    time: datetime
    arrival_ns: int
    values: dict[str, Any] = field(default_factory=dict)
    count: int = 0
    done: bool = False


class GpsdDecoder:
    """Bytes of one gpsd to fixes. Not thread-safe.

    Counters: `fixes`; `no fix`, `no position`, `no time`: TPV that give none; `late`, those of an epoch that is
    complete; `other device`; `other`, reports of unused classes; lines that are rejected, by reason.
    """

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()
        self.status = ReceiverStatus()
        self.sky = Sky()
        self.whole = 0
        self._lines = Lines(self.counters)
        self._epoch: Epoch | None = None
        self._expected = 0  # TPV in an epoch; 0: not known
        self._device: str | None = None
        self._fix_ns = 0  # when it last had a fix
        self._hdop: float | None = None
        self._used: int | None = None  # satellites
        self._sky_ns = -SKY_AGE_MAX_NS
        self._epoch_start: tuple[datetime, int] | None = None  # epoch of the last TOFF, and its arrival
        self._errors: tuple[datetime, Report] | None = None  # the last GST
        self._last_arrival_ns: int | None = None

    @property
    def pending(self) -> bool:
        """See `GnssDecoder`."""
        return self._epoch is not None and not self._epoch.done

    def feed(self, data: bytes, arrival_ns: int) -> list[Fix]:
        """See `GnssDecoder`."""
        self._last_arrival_ns = arrival_ns
        fixes: list[Fix] = []
        for report in self._lines.feed(data, arrival_ns):
            if report.kind not in ("TPV", "SKY", "GST", "TOFF"):
                self.counters["other"] += 1
            elif self._is_of_device(report):
                self.whole += 1
                fixes += self._take(report)
        return fixes

    def flush(self, now_ns: int) -> list[Fix]:
        """See `GnssDecoder`."""
        if self._last_arrival_ns is None or now_ns - self._last_arrival_ns < SILENCE_NS:
            return []
        return self._close()

    def _is_of_device(self, report: Report) -> bool:
        """Whether a report is of the device in use; another device comes into use with a fix."""
        if report.device == self._device or not report.device:
            return True
        has_fix = report.kind == "TPV" and quality(report) > 0
        if self._device is None or (has_fix and report.arrival_ns - self._fix_ns > DEVICE_TIMEOUT_NS):
            self._device, self._hdop, self._used = report.device, None, None
            self._epoch_start = self._errors = None
            self._fix_ns = report.arrival_ns
            return True
        self.counters["other device"] += 1
        return False

    def _take(self, report: Report) -> list[Fix]:
        if report.kind == "TPV":
            return self._tpv(report)
        if report.kind == "SKY":
            self._hdop, self._sky_ns = report.number("hdop", 0.01, 99.0), report.arrival_ns
            if (listed := sky(report)) is not None:
                self.sky = listed
                self._used = sum(one.used for one in listed.satellites)
            used = report.number("uSat", 0, 1000)
            self._used = self._used if used is None else int(used)
        elif report.kind == "TOFF":
            seconds, ns = report.number("real_sec", 0, 1e11), report.number("real_nsec", 0, 1e9) or 0.0
            if seconds is not None:
                self._epoch_start = EPOCH_0 + timedelta(seconds=seconds, microseconds=ns // 1000), report.arrival_ns
        elif (time := report.time()) is not None:
            self._errors = time, report
        return []

    def _tpv(self, report: Report) -> list[Fix]:
        found, time = quality(report), report.time()
        if not found:
            self.counters["no fix"] += 1
            fixes = self._close()
            self.status = ReceiverStatus(0, self._satellites(report.arrival_ns), report.arrival_ns)
            return fixes
        self._fix_ns = report.arrival_ns
        if time is None:
            self.counters["no time"] += 1
            self.status = ReceiverStatus(found, self._satellites(report.arrival_ns), report.arrival_ns)
            return []
        fixes = []
        if self._epoch is None or time != self._epoch.time:
            fixes = self._close()
            self._epoch = Epoch(time, self._first_byte_ns(time, report.arrival_ns))
        epoch = self._epoch
        epoch.count += 1
        if epoch.done:
            self.counters["late"] += 1
            self._expected = epoch.count
            return fixes
        epoch.values |= {name: report.values[name] for name in USED if name in report.values}
        return fixes + (self._finish(epoch) if 0 < self._expected <= epoch.count else [])

    def _first_byte_ns(self, time: datetime, arrival_ns: int) -> int:
        epoch, start_ns = self._epoch_start or (None, 0)
        return start_ns if epoch == time and 0 <= arrival_ns - start_ns < TOFF_AGE_MAX_NS else arrival_ns

    def _satellites(self, now_ns: int) -> int | None:
        return self._used if now_ns - self._sky_ns <= SKY_AGE_MAX_NS else None

    def _close(self) -> list[Fix]:
        """The epoch is over."""
        if self._epoch is None or self._epoch.done:
            return []
        self._expected = self._epoch.count
        return self._finish(self._epoch)

    def _finish(self, epoch: Epoch) -> list[Fix]:
        epoch.done = True
        merged = Report("TPV", "", epoch.values, epoch.arrival_ns)
        self.status = ReceiverStatus(quality(merged), self._satellites(epoch.arrival_ns), epoch.arrival_ns)
        fix = self._fix(merged, epoch)
        self.counters["no position" if fix is None else "fixes"] += 1
        return [] if fix is None else [fix]

    def _fix(self, tpv: Report, epoch: Epoch) -> Fix | None:
        lat, lon = tpv.number("lat", -90.0, 90.0), tpv.number("lon", -180.0, 180.0)
        if lat is None or lon is None:
            return None
        above, geoid = tpv.number("altMSL", -1e6, 1e6), tpv.number("geoidSep", -1e3, 1e3)
        ellipsoidal = tpv.number("altHAE", -1e6, 1e6)
        if ellipsoidal is not None and above is not None:
            geoid = ellipsoidal - above
        elif ellipsoidal is not None and geoid is not None:
            above = ellipsoidal - geoid
        sigma: list[float | None] = [None, None, None]
        if self._errors and self._errors[0] == epoch.time:
            sigma = [self._errors[1].number(name, 1e-3, 1e5) for name in ("lat", "lon", "alt")]
        course, speed = tpv.number("track", 0.0, 360.0), tpv.number("speed", 0.0, 1e5)
        midnight = datetime(epoch.time.year, epoch.time.month, epoch.time.day)
        return Fix(
            arrival_ns=epoch.arrival_ns,
            utc_s=(epoch.time - midnight).total_seconds(),
            date=epoch.time.date(),
            lat_deg=lat,
            lon_deg=lon,
            alt_msl_m=above,
            geoid_sep_m=geoid,
            quality=self.status.quality,
            satellites=self.status.satellites,
            hdop=self._hdop if epoch.arrival_ns - self._sky_ns <= SKY_AGE_MAX_NS else None,
            speed_mps=None if course is None else speed,
            course_deg=None if course is None else course % 360.0,
            sigma_n_m=sigma[0],
            sigma_e_m=sigma[1],
            sigma_d_m=sigma[2],
            dimensions=2 if tpv.number("mode") == 2 else 3,
        )
