"""A receiver's fixes on their way to the filter: which of them are used, and their time and units in the filter."""

import math
from dataclasses import dataclass

import numpy as np

from drivers.fix import Fix

from ..configuration.settings import Gnss
from ..estimators.records import FIX
from ..math.arrays import Records


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


_QUALITIES = {6: "6 (dead reckoning by the receiver)", 7: "7 (entered by hand)", 8: "8 (simulated)"}


@dataclass(frozen=True)
class Refusal:
    """Why a fix is not used. rule: the setting that forbids it, or what it lacks."""

    rule: str
    why: str

    def __str__(self) -> str:
        return self.why


def refusal(fix: Fix, settings: Gnss) -> Refusal | None:
    """Why the settings forbid this fix; None: use it."""
    if fix.quality not in settings.qualities:
        quality, allowed = _QUALITIES.get(fix.quality, fix.quality), ", ".join(map(str, settings.qualities))
        return Refusal("gnss.qualities", f"quality {quality}, not in gnss.qualities = [{allowed}]")
    if fix.satellites is not None and fix.satellites < settings.min_satellites:
        limit = f"gnss.min_satellites = {settings.min_satellites}"
        return Refusal("gnss.min_satellites", f"{fix.satellites} satellites, fewer than {limit}")
    if fix.hdop is not None and fix.hdop > settings.max_hdop:
        return Refusal("gnss.max_hdop", f"HDOP {fix.hdop}, above gnss.max_hdop = {settings.max_hdop:g}")
    return Refusal("time", "they have no time") if fix.utc_s is None else None


def record(fix: Fix, t_ns: int, arrival_ns: int) -> Records:
    """The fix as an array of one FIX. Without a geoid separation the height above sea level must do.

    The height of a two-dimensional fix is an old one that the receiver holds, or a guess: it counts as unknown.
    """
    row = np.zeros(1, FIX)
    height = fix.height_m if fix.height_m is not None else fix.alt_msl_m
    if fix.dimensions == 2:
        height = None
    row["t_ns"], row["arrival_ns"] = t_ns, arrival_ns
    row["lat"], row["lon"], row["height"] = math.radians(fix.lat_deg), math.radians(fix.lon_deg), _or_nan(height)
    row["sigma"] = [_or_nan(fix.sigma_n_m), _or_nan(fix.sigma_e_m), _or_nan(fix.sigma_d_m)]
    row["v"] = math.nan
    row["hdop"], row["speed"] = _or_nan(fix.hdop), _or_nan(fix.speed_mps)
    row["course"] = math.radians(_or_nan(fix.course_deg))
    row["quality"] = fix.quality
    row["satellites"] = -1 if fix.satellites is None else fix.satellites
    return row
