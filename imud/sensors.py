"""The two kinds of sensor as the daemon sees them: bytes in; solutions, or fixes, out. No waiting, no logging."""

import math
import os

import numpy as np
from numpy.typing import NDArray

from drivers.driver import GnssDriver, ImuConfigured, ImuDriver
from drivers.errors import PortLostError
from drivers.fix import Fix
from drivers.transport.line import Line

from .epochs import EpochClock
from .gnss import record, refusal
from .outputs.view import Gnss
from .pipeline import Stream
from .settings import Gnss as GnssSettings

READ = 4096  # bytes at a time: fewer frames than the pipeline takes in one batch
SILENCE_NS = {"imu": 1_000_000_000, "gnss": 5_000_000_000}  # a stream this long silent is broken
SILENT_PERIODS = 4  # at least
Records = NDArray[np.void]


class Inertial:
    """An inertial sensor that streams into a filter."""

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self.heard_ns = 0
        self.silence_ns = SILENCE_NS["imu"]
        self.samples = 0
        self.period_s = 0.0  # nominal, between samples
        self._room = stream.rx.data
        self._line: Line | None = None

    def connect(self, line: Line, driver: ImuDriver, configured: ImuConfigured, now_ns: int) -> None:
        """A new connection; the filter keeps what it knows."""
        self._line = line
        self.stream.restart(driver.new_state(configured), configured)
        self.heard_ns = now_ns
        self.period_s = 1.0 / configured.rate_hz
        self.silence_ns = max(SILENCE_NS["imu"], SILENT_PERIODS * round(1e9 / configured.rate_hz))

    def read(self, now_ns: int) -> int:
        """Read and step; returns how many solutions are new, the newest last. Raises PortLostError."""
        assert self._line is not None
        fill = self.stream.fill
        received, arrival_ns = self._line.receive(self._room[fill : fill + READ], now_ns)
        if received == 0:
            return 0
        n = self.stream.ingest(received, arrival_ns)
        if n:
            self.heard_ns = now_ns
        self.samples += n
        return n

    def counters(self) -> dict[str, int]:
        """What decoder and line counted since this connection."""
        names = ("frames", "junk", "bad", "lost", "suspect", "errors")
        counted = {name: int(self.stream.decoder[name][0]) for name in names}
        return counted | (dict(self._line.counters) if self._line else {})


class Receiver:
    """A GNSS receiver whose fixes go to the filter."""

    def __init__(self, driver: GnssDriver, settings: GnssSettings, now_ns: int) -> None:
        self.decoder = driver.new_decoder()
        self.heard_ns = now_ns
        self.silence_ns = SILENCE_NS["gnss"]
        self.used = 0
        self.refused: dict[str, int] = {}
        self.settings = settings
        self._epochs = EpochClock(settings.latency_s)
        self._last: Fix | None = None

    def read(self, fd: int, now_ns: int) -> list[Records]:
        """Fixes (arrays of one FIX) that the new bytes complete. Raises PortLostError."""
        try:
            data = os.read(fd, READ)
        except BlockingIOError:
            return []
        except OSError as error:
            raise PortLostError("", f"the device is gone ({error.strerror})") from error
        if not data:
            raise PortLostError("", "the device is gone")
        self.heard_ns = now_ns
        return self._accepted(self.decoder.feed(data, now_ns), now_ns)

    def flush(self, now_ns: int) -> list[Records]:
        """A fix whose epoch ended without an end."""
        return self._accepted(self.decoder.flush(now_ns), now_ns)

    def _accepted(self, fixes: list[Fix], now_ns: int) -> list[Records]:
        rows = []
        for fix in fixes:
            self._last = fix
            if why := refusal(fix, self.settings):
                self.refused[why] = self.refused.get(why, 0) + 1
            elif fix.utc_s is not None:
                rows.append(record(fix, self._epochs.epoch_ns(fix.utc_s, fix.arrival_ns), now_ns))
        self.used += len(rows)
        return rows

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
        )
