"""A receiver's velocity beside the way from fix to fix: units that are wrong from the start, positions that never move.

Over each chord of the way the displacement of the positions is compared with the integral of the velocity. Several
chords in sequence with the same ratio, far from one, are wrong units (km/h that stand where knots belong: 0.54); noise
and drifts of the positions have another ratio in each chord.
"""

import cmath
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..math.arrays import Floats, Records
from ..math.earth import MEAN_RADIUS_M
from .gnss import Refusal
from .misread_columns import misread_columns

FROZEN = Refusal("frozen", "their position has never changed although their velocity says that it moves")

_CHORD_M, _SIGMAS = 25.0, 15.0  # least integral of the velocity of a chord; in sigmas of the position
_CHORDS = 3  # in sequence that decide
_WRONG, _RIGHT = (0.7, 1.5), (0.85, 1.2)  # ratios beyond and within
_ASIDE, _SPREAD = 0.2, 1.2  # most displacement across the chord; largest ratio of two chords
_LONGEST_NS = 3_000_000_000  # between fixes; over a longer time the velocity is not known
_SLOW_MPS, _FAST_MPS = 0.5, 1e4  # below the first many receivers hold position or speed; beyond the other none is
_HDOP_M = 1.5  # sigma for each unit of HDOP, where the receiver states none
_UNITS = {1.852: "km/h in place of knots", 1 / 1.852: "knots in place of km/h", 0.5144: "m/s in place of knots",
          1 / 0.5144: "knots in place of m/s", 3.6: "km/h in place of m/s"}  # fmt: skip


class FixConsistency:
    """Takes each fix that may be used, in sequence; what it finds is of the fixes until now. One for each receiver.

    velocity_ratio: displacement over the integral of the velocity where that is wrong by a factor; None: it is right,
    or not known to be wrong. is_frozen: the position has never changed although the velocity says that it moves.
    """

    def __init__(self) -> None:
        self.velocity_ratio: float | None = None
        self.is_frozen = False
        self._last: tuple[int, float, float, complex] | None = None  # t_ns, lat, lon (rad), velocity
        self._moved = False  # the position has changed
        self._integral = self._displacement = 0j  # of velocity and positions since the chord began, m
        self._wrong: list[float] = []  # ratios of the chords for which the velocity was wrong
        self._chords: list[tuple[float, float]] = []  # of the last ones: ratio, and part of the displacement across

    def add(self, fix: Records) -> None:
        """fix: array of one FIX."""
        row: Any = fix.item()
        t_ns, _, lat, lon, _, sigma, hdop, v, speed, course, *_ = row
        if not (math.isfinite(speed) or math.isfinite(v[0])):  # some receivers send it with one position in ten
            self._moved = self._moved or (self._last is not None and (lat, lon) != self._last[1:3])
            self.is_frozen = self.is_frozen and not self._moved
            return
        last, now = self._last, (t_ns, lat, lon, _velocity(v, speed, course))
        self._last = now
        if last is None:
            return
        interval_ns, mean = now[0] - last[0], 0.5 * (now[3] + last[3])
        known = cmath.isfinite(mean) and all(map(math.isfinite, (*last[1:3], *now[1:3])))
        if not (0 < interval_ns < _LONGEST_NS and known):
            self._integral = self._displacement = 0j
            return
        step = complex(now[1] - last[1], math.remainder(now[2] - last[2], math.tau) * math.cos(now[1])) * MEAN_RADIUS_M
        self._moved = self._moved or step != 0.0
        self.is_frozen = self.is_frozen and not self._moved
        self._integral += mean * interval_ns * 1e-9
        self._displacement += step
        if abs(self._integral) >= max(_CHORD_M, _SIGMAS * _sigma(sigma, hdop)):
            self._end_chord()

    def _end_chord(self) -> None:
        quotient = self._displacement / self._integral
        self._integral = self._displacement = 0j
        self._chords = [*self._chords[1 - _CHORDS :], (quotient.real, abs(quotient.imag))]
        self.is_frozen = not self._moved
        ratios = [ratio for ratio, _ in self._chords]
        least, most = min(ratios), max(ratios)
        if len(ratios) < _CHORDS or max(aside for _, aside in self._chords) > _ASIDE:
            return
        if (0.0 < most < _WRONG[0] or least > _WRONG[1]) and most < _SPREAD * least:
            self._wrong = [*self._wrong[-99:], ratios[-1]] if self._wrong else ratios
            self.velocity_ratio = sum(self._wrong) / len(self._wrong)
        elif _RIGHT[0] < least and most < _RIGHT[1]:
            self._wrong, self.velocity_ratio = [], None

    def without_wrong_velocity(self, fix: Records) -> Records:
        """The fix (array of one FIX) for the filter: without a velocity if that is wrong."""
        if self.velocity_ratio is None:
            return fix
        fix = fix.copy()
        for name in ("v", "sigma_v", "speed", "course"):
            fix[name] = math.nan
        return fix

    @property
    def fault(self) -> str:
        """What is wrong with the velocity, in words; empty: nothing."""
        if self.velocity_ratio is None:
            return ""
        factor = 1.0 / self.velocity_ratio
        named = min(_UNITS, key=lambda known: abs(math.log(known / factor)))
        units = f" ({_UNITS[named]}?)" if abs(named / factor - 1.0) < 0.08 else ""
        return f"its velocity is {factor:.2f} times that of its positions{units} and is not used"


def consistent(fixes: Records, warn: Callable[[str], object]) -> Records:
    """The fixes (array of FIX) of one receiver without those that cannot be right, and without wrong velocities.

    warn: called if there are such. Where columns are misread, nothing is left out.
    """
    if misread := misread_columns(fixes):
        warn(misread)
        return fixes
    consistency, kept, wrong, fault = FixConsistency(), [fixes[:0]], 0, ""
    for k in range(len(fixes)):
        fix = fixes[k : k + 1]
        consistency.add(fix)
        if consistency.is_frozen:
            continue
        kept.append(consistency.without_wrong_velocity(fix))
        fault = consistency.fault or fault
        wrong += consistency.velocity_ratio is not None
    if len(kept) <= len(fixes):
        warn(f"{len(fixes) - len(kept) + 1} of {len(fixes)} fixes are not used: {FROZEN}")
    if wrong:
        warn(f"{wrong} of {len(fixes)} fixes without their velocity: {fault}")
    return np.concatenate(kept)


def _velocity(v: Floats, speed: float, course: float) -> complex:
    """North + i east, m/s; NaN where the fix does not say, or hardly moves."""
    stated = complex(v[0], v[1])
    if not cmath.isfinite(stated) and abs(speed) < _FAST_MPS and math.isfinite(course):
        stated = cmath.rect(speed, course)
    size = max(abs(stated.real), abs(stated.imag))
    return stated if _SLOW_MPS < size < _FAST_MPS else complex(math.nan)


def _sigma(sigma: Floats, hdop: float) -> float:
    """Horizontal, m; 0 where the fix does not say."""
    stated = max(float(sigma[0]), float(sigma[1]))
    return stated if math.isfinite(stated) else _HDOP_M * hdop if math.isfinite(hdop) else 0.0
