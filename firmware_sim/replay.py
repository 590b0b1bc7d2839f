"""Recorded data as a source of motion and fixes: the CSV pair of `imud replay`, played as the devices' true motion.

imu.csv: t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2. gnss.csv by column name: t_s,lat_deg,lon_deg,height_m,
then optionally arrival_s, hdop, and speed_mps,course_deg or vn_mps,ve_mps. Time 0 is the first row of imu.csv, or of
gnss.csv if that is alone. A receiver's log of sentences is `sentence_playback.py`'s, a daemon's recording
`recorded_bytes.py`'s.
"""

import csv
import math
from bisect import bisect_right
from dataclasses import replace
from pathlib import Path

import numpy as np

from .ellipsoid import Array
from .fixes import COMPUTE_S, Fix

_IMU_HEADER = "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2"
_NEEDED = {"t_s", "lat_deg", "lon_deg", "height_m"}


class DataError(Exception):
    """A file does not hold what it should: which, where, and what was expected."""


def kind(path: Path) -> str:
    """What a file is by its beginning: imu, gnss, nmea or mcap. Raises DataError, OSError."""
    with path.open("rb") as file:
        beginning = file.readline(1000)
    if beginning.startswith(b"\x89MCAP"):
        return "mcap"
    first = beginning.decode("ascii", "replace").strip()
    names = first.split(",")
    if set(names) >= _NEEDED:
        return "gnss"
    if names[:2] == _IMU_HEADER.split(",")[:2]:
        return "imu"
    if any(mark in first for mark in ("$G", "$P")):
        return "nmea"
    columns = ",".join(sorted(_NEEDED))
    raise DataError(
        f"{path}:1: not a recording (MCAP), and no table: the header must be {_IMU_HEADER}, or have {columns}, or be "
        f"an NMEA sentence; found {first[:40]!a}"
    )


class RecordedImu:
    """The recorded rates and forces, sample by sample and never between them; `loop`: again and again."""

    def __init__(self, path: Path, loop: bool = False) -> None:
        with path.open(encoding="utf-8") as file:
            header = file.readline().strip()
            if not header.startswith(_IMU_HEADER):
                raise DataError(f"{path}:1: the header must be {_IMU_HEADER}, found {header[:80]!a}")
            try:
                rows = np.loadtxt(file, delimiter=",", usecols=range(7), ndmin=2)
            except (ValueError, UnicodeDecodeError) as error:
                raise DataError(f"{path}: {error}") from None
        if len(rows) < 2 or not np.isfinite(rows).all():
            raise DataError(f"{path}: at least two rows of finite numbers are needed, found {len(rows)}")
        late = np.flatnonzero(np.diff(rows[:, 0]) <= 0.0)
        if len(late):
            raise DataError(f"{path}:{late[0] + 3}: time does not increase")
        self.start = float(rows[0, 0])
        self.duration = float(rows[-1, 0]) - self.start
        self.end = math.inf if loop else self.duration
        self._t, self._values = rows[:, 0] - self.start, rows[:, 1:]
        self.lap = math.inf if not loop else self.duration + self.duration / (len(rows) - 1)

    @property
    def rate_hz(self) -> float:
        """On the average."""
        return (len(self._t) - 1) / self.duration

    def after(self, t: float) -> float:
        """Time of the first sample after time `t`, in s since the first one of all; infinite behind the last."""
        lap = max(math.floor(t / self.lap), 0)
        i = int(np.searchsorted(self._t, t - (lap * self.lap if lap else 0.0) + 1e-9, side="right"))
        if i == len(self._t):
            lap, i = lap + 1, 0
        return float(self._t[i] + (lap * self.lap if lap else 0.0))

    def imu(self, t: Array) -> Array:
        """w_ib_b in rad/s and f_b in m/s^2, (n, 6), of the sample nearest to each of the times `t` (n,)."""
        t = t if math.isinf(self.lap) else np.mod(t + 1e-9, self.lap)
        after = np.clip(np.searchsorted(self._t, t), 1, len(self._t) - 1)
        nearest = np.where(t - self._t[after - 1] <= self._t[after] - t, after - 1, after)
        return np.asarray(self._values[nearest])


class RecordedFixes:
    """The recorded fixes at their recorded arrival times; the receiver's own fix interval does not apply."""

    def __init__(self, path: Path, imu: RecordedImu | None, loop: bool = False) -> None:
        """imu: what they were recorded with, and whether that is repeated; `loop` says so where there is none."""
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            missing = _NEEDED - set(reader.fieldnames or ())
            if missing:
                raise DataError(f"{path}:1: columns missing: {', '.join(sorted(missing))}")
            fixes = [_fix(row, f"{path}:{line}") for line, row in enumerate(reader, 2)]
        start = imu.start if imu else fixes[0].t if fixes else 0.0
        duration = imu.duration if imu else math.inf
        fixes = [replace(fix, t=fix.t - start, arrival=fix.arrival - start) for fix in fixes]
        self._fixes = [fix for fix in fixes if 0.0 <= fix.t <= duration]
        self._epochs = [fix.t for fix in self._fixes]
        if not self._fixes:
            raise DataError(f"{path}: no fix lies within the time of the inertial data")
        late = next((i for i in range(1, len(self._epochs)) if self._epochs[i] <= self._epochs[i - 1]), 0)
        if late:
            raise DataError(f"{path}: time does not increase after t_s={self._epochs[late] + start:.3f}")
        lap = imu.lap if imu else self._epochs[-1] + 1.0
        self._period = lap if imu or loop else math.inf

    @property
    def phase(self) -> float:
        """Fraction of a second by which the epochs lie after whole seconds since the start."""
        return self._epochs[0] % 1.0

    def after(self, t: float, interval: float) -> Fix | None:
        """The first fix with its epoch after time `t`; None at the end. `interval` is what the recording has."""
        lap = max(math.floor(t / self._period), 0)
        offset = lap * self._period if lap else 0.0
        i = bisect_right(self._epochs, t - offset + 1e-9)
        if i == len(self._epochs):
            if math.isinf(self._period):
                return None
            i, offset = 0, (lap + 1) * self._period
        fix = self._fixes[i]
        return replace(fix, t=fix.t + offset, arrival=fix.arrival + offset)


def _fix(row: dict[str, str], where: str) -> Fix:
    try:
        given = {name: float(value) for name, value in row.items() if name and value and value.strip()}
        t, lat, lon, height = (given[name] for name in ("t_s", "lat_deg", "lon_deg", "height_m"))
    except (ValueError, TypeError, KeyError) as error:
        raise DataError(f"{where}: not a fix: {error}") from None
    if not all(map(math.isfinite, (t, lat, lon, height))):
        raise DataError(f"{where}: not a fix: time and position must be finite")
    speed, course = given.get("speed_mps"), given.get("course_deg")
    if "vn_mps" in given and "ve_mps" in given:
        speed = math.hypot(given["vn_mps"], given["ve_mps"])
        course = math.degrees(math.atan2(given["ve_mps"], given["vn_mps"])) % 360.0
    arrival = given.get("arrival_s", t + COMPUTE_S)
    return Fix(t, arrival, lat, lon, height, speed, course, given.get("hdop", 1.0))
