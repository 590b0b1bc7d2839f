"""Estimate against truth: the errors of each quantity beside its claimed sigma, and the emulator's truth file."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

UNITS = {"roll": "deg", "pitch": "deg", "heading": "deg", "position": "m", "velocity": "m/s"}  # of what is compared
_METRES_PER_DEG = 111_320.0


@dataclass
class Errors:
    """The errors of one quantity: sums of their squares, and of the variances claimed for them."""

    total: float = 0.0
    claimed: float = 0.0
    count: int = 0
    last: float = math.nan  # NaN: not known now
    last_claimed: float = math.nan  # sigma of the last

    def add(self, error: float, *sigmas: float) -> None:
        variance = sum(sigma * sigma for sigma in sigmas)
        self.last, self.last_claimed = error, math.sqrt(variance)
        self.total += error * error
        self.claimed += variance
        self.count += 1

    @property
    def rms(self) -> float:
        return math.sqrt(self.total / self.count) if self.count else math.nan

    @property
    def claimed_rms(self) -> float:
        return math.sqrt(self.claimed / self.count) if self.count else math.nan


@dataclass
class Comparison:
    """Estimate against truth, quantity by quantity; only what the daemon claims to know is compared.

    Before the heading is known a vehicle that moves has no velocity worth comparing: its sigmas say so.
    """

    errors: dict[str, Errors] = field(default_factory=lambda: {name: Errors() for name in UNITS})

    def add(self, est: dict[str, Any], truth: dict[str, float]) -> None:
        state = est.get("state", "")
        for errors in self.errors.values():
            errors.last = errors.last_claimed = math.nan
        if "aligning" not in state:
            for name in ("roll", "pitch"):
                self.errors[name].add(_wrapped_deg(est[f"{name}_deg"] - truth[f"{name}_deg"]), est[f"s{name}_deg"])
        if "heading" in state:
            self.errors["heading"].add(_wrapped_deg(est["yaw_deg"] - truth["yaw_deg"]), est["syaw_deg"])
        if "position" in state:
            north = (est["lat_deg"] - truth["lat_deg"]) * _METRES_PER_DEG
            east = (est["lon_deg"] - truth["lon_deg"]) * _METRES_PER_DEG * math.cos(math.radians(truth["lat_deg"]))
            self.errors["position"].add(math.hypot(north, east), est["sn_m"], est["se_m"])
        if "position" in state and ("heading" in state or "at-rest" in state):
            velocities = ([d[f"v{axis}_mps"] for axis in "ned"] for d in (est, truth))
            self.errors["velocity"].add(math.dist(*velocities), *(est[f"sv{axis}_mps"] for axis in "ned"))


def _wrapped_deg(angle_deg: float) -> float:
    return (angle_deg + 180.0) % 360.0 - 180.0


class Truth:
    """The emulator's truth file, read as it grows; gives the truth at a time by interpolation."""

    def __init__(self, path: Path) -> None:
        self._file = path.open()
        self._names = self._file.readline().strip().split(",")
        self._rows: list[list[float]] = []
        self._rest = ""

    def covers(self, t_s: float) -> bool:
        """True when the truth at monotonic time t_s is written."""
        *lines, self._rest = (self._rest + self._file.read()).split("\n")
        self._rows += [[float(cell) for cell in line.split(",")] for line in lines if line]
        return bool(self._rows) and self._rows[-1][0] >= t_s

    def at(self, t_s: float) -> dict[str, float] | None:
        """The truth at t_s, which it must cover; None before its beginning. Deletes older rows."""
        while len(self._rows) > 2 and self._rows[1][0] < t_s:
            del self._rows[0]
        (t0, *before), (t1, *after) = self._rows[0], self._rows[min(1, len(self._rows) - 1)]
        if not t0 <= t_s <= t1 or t0 == t1:
            return None
        share = (t_s - t0) / (t1 - t0)
        return {
            name: a + share * (_wrapped_deg(b - a) if name in ("roll_deg", "yaw_deg") else b - a)
            for name, a, b in zip(self._names[1:], before, after, strict=True)
        }
