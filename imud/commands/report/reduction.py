"""Reduces estimates and samples for a report, block by block, to envelopes, counts and what looked wrong."""

import math

import numpy as np
from numpy.typing import NDArray

from ...estimators.records import HEADING_VALID
from ...math.arrays import Floats, Records
from ...sensor_errors.profiles import PROFILES
from ...sensor_monitor.findings import counted
from ...sensor_monitor.health import check_samples, new_health
from ...tables.estimates import ESTIMATE_COLUMNS
from .envelope import Envelope
from .session import Estimates, Sensor

NAMES = ("t_s", *(name for name, _ in ESTIMATE_COLUMNS if not name.startswith("q") and name != "status"))
BITS = 16
LOSSES_MAX = 100
_POSITION = ("lat_deg", "lon_deg")
_TURNING = ("roll_deg", "yaw_deg")  # angles that go on over a half turn
_SENSED = ("t_s", "wx", "wy", "wz", "fx", "fy", "fz", "interval_ms", "temperature_c")
_RATE_SAMPLES = 4096  # from which the rate is computed: stamps of the first ones may be bunched on a busy machine
_GAP = 2.5  # periods


class EstimateReduction:
    """Of one run. Blocks are columns by the names of est.csv; times are since the run's origin."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._envelope = Envelope(len(NAMES))
        self._counts = np.zeros(BITS, np.int64)
        self.rows = 0
        self._angle = dict.fromkeys(_TURNING, math.nan)  # of the last row that has one
        self._status = 0
        self._lost: list[float] = []

    def add(self, block: dict[str, Floats]) -> None:
        """The next rows."""
        status = block["status"].astype(np.int64)
        self._counts += ((status[:, None] >> np.arange(BITS)) & 1).sum(axis=0)
        self._add_losses(block["t_s"], status)
        columns = block | {name: self._unwrapped(name, block[name]) for name in _TURNING}
        self._envelope.add(np.stack([columns[name] for name in NAMES], axis=1), status)
        self.rows += len(status)

    def _add_losses(self, t: Floats, status: NDArray[np.int64]) -> None:
        heading = (np.concatenate([[self._status], status]) & HEADING_VALID) > 0
        self._lost += t[heading[:-1] & ~heading[1:]].tolist()[: LOSSES_MAX - len(self._lost)]
        self._status = int(status[-1])

    def _unwrapped(self, name: str, angle: Floats) -> Floats:
        """Degrees without the jump at a half turn, from block to block; NaN stays."""
        known = np.flatnonzero(np.isfinite(angle))
        out = angle.copy()
        if len(known):
            before = [self._angle[name]] if math.isfinite(self._angle[name]) else []
            out[known] = np.unwrap(np.concatenate([before, angle[known]]), period=360.0)[len(before) :]
            self._angle[name] = float(out[known[-1]])
        return out

    def close(self) -> Estimates:
        """The reduced estimates."""
        extremes, ends, greatest, status = self._envelope.close()
        columns = {}
        for i, name in enumerate(NAMES):
            points = ends if name in _POSITION else greatest if name.startswith("s") else extremes
            columns[name] = points[:, i]
        shares = {1 << bit: float(count) / max(self.rows, 1) for bit, count in enumerate(self._counts)}
        return Estimates(self._name, columns, status, shares, tuple(self._lost))


class SensorReduction:
    """Of one inertial sensor, checked by the daemon's health checks; its range is not known."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._envelope = Envelope(len(_SENSED))
        self._waiting: list[Records] = []
        self._health: Records | None = None
        self.rate_hz = 0.0
        self.rows = 0
        self._last_ns: int | None = None
        self._gaps, self._longest_s, self._longest_at_s = 0, 0.0, 0.0

    def add(self, rows: Records) -> None:
        """The next SAMPLE rows; t_ns since the run's origin."""
        rows = rows.copy()
        if self._health is None:
            self._waiting.append(rows)
            if sum(map(len, self._waiting)) < _RATE_SAMPLES:
                return
            rows = self._begin()
        self._reduce(rows)

    def _begin(self) -> Records:
        """Judge the rate by what has waited for that; returns it."""
        rows, self._waiting = np.concatenate(self._waiting), []
        self.rate_hz = 1e9 / max(1.0, float(np.median(np.diff(rows["t_ns"]))))
        self._health = new_health(PROFILES["consumer-mems"], self.rate_hz)
        self._health["range"] = math.inf  # not known from a table
        return rows

    def _reduce(self, rows: Records) -> None:
        assert self._health is not None
        check_samples(self._health, rows)
        t = rows["t_ns"]
        before = t[0] if self._last_ns is None else self._last_ns
        intervals = np.diff(np.concatenate([[before], t])) * 1e-9
        self._add_gaps(intervals, t)
        if self._last_ns is None:
            intervals[0] = math.nan
        self._last_ns = int(t[-1])
        columns = [t[:, None] * 1e-9, rows["w"], rows["f"], intervals[:, None] * 1e3, rows["temperature"][:, None]]
        self._envelope.add(np.concatenate(columns, axis=1), rows["flags"].astype(np.int64))
        self.rows += len(rows)

    def _add_gaps(self, intervals: Floats, t: NDArray[np.int64]) -> None:
        self._gaps += int(np.count_nonzero(intervals > _GAP / self.rate_hz))
        if (longest := float(intervals.max())) > self._longest_s:
            self._longest_s = longest
            self._longest_at_s = float(t[int(np.argmax(intervals))]) * 1e-9 - longest

    def close(self) -> Sensor | None:
        """The reduced samples; None: there were fewer than two."""
        if self._health is None:
            if sum(map(len, self._waiting)) < 2:
                return None
            self._reduce(self._begin())
        extremes, _, _, flags = self._envelope.close()
        columns = {name: extremes[:, i] for i, name in enumerate(_SENSED)}
        return Sensor(self._name, self.rate_hz, columns, flags, tuple(self._findings()))

    def _findings(self) -> list[str]:
        assert self._health is not None
        findings = counted(self._health)
        if self._gaps:
            findings.append(
                f"{self._gaps} {'gap' if self._gaps == 1 else 'gaps'} between samples, "
                f"the longest {self._longest_s:.3g} s at {self._longest_at_s:.1f} s"
            )
        return findings
