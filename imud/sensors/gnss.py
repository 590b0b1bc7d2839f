"""A receiver's fixes on their way to the filter: which of them are used, and their time and units in the filter."""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.fix import Fix
from drivers.registry import by_name

from ..configuration.settings import Gnss
from ..errors import BadDataError
from ..estimators.records import FIX
from ..math.arrays import Records
from ..tables.lines import content

_DAY_S = 86_400.0


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def _instead(counters: Mapping[str, int]) -> str:
    """What a log without fixes has."""
    seen = "".join(f"; {count} x {what}" for what, count in counters.items())
    hint = ": accept them with --set gnss.require_checksum=false" if "no checksum" in counters else ""
    return seen + hint


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


def fixes_of_log(
    path: Path, origin: int, first_ns: int, settings: Gnss, tell: Callable[[str], object] = lambda _: None
) -> Records:
    """The fixes of an NMEA log, placed by their UTC time of day near the samples that start `first_ns` after `origin`.

    A log holds no arrival times: each fix is known `latency_s` after its epoch. tell: is told if the settings refuse
    some. Raises BadDataError without any fix, or if the settings refuse all.
    """
    driver = by_name("nmea")
    assert driver.kind == "gnss"
    decoder = driver.new_decoder(not settings.require_checksum)
    fixes: list[Fix] = []
    lines = content(path).splitlines(keepends=True)
    for number, line in enumerate([*lines, b"$"]):  # the last line may lack its end
        fixes += decoder.feed(line, number)
    fixes += decoder.flush(1 << 62)
    if not fixes:
        raise BadDataError(f"{path}: no fix in it{_instead(decoder.counters)}")
    start_s = origin + first_ns * 1e-9
    rows = []
    day = None
    refused: Counter[str] = Counter()
    for fix in fixes:
        if (why := refusal(fix, settings)) or fix.utc_s is None:
            refused[str(why)] += 1
            continue
        near = start_s if day is None else rows[-1]["t_ns"][0] * 1e-9 + origin
        day = round((near - fix.utc_s) / _DAY_S)
        t_ns = round((fix.utc_s + day * _DAY_S - origin) * 1e9)
        rows.append(record(fix, t_ns, t_ns + round(settings.latency_s * 1e9)))
    reasons = ", ".join(f"{why} ({count} times)" for why, count in refused.items())
    if not rows:
        raise BadDataError(f"{path}: none of its fixes is used: {reasons}")
    if refused:
        tell(f"{refused.total()} of {len(fixes)} fixes are not used: {reasons}")
    return np.concatenate(rows)
