"""A receiver's fixes on their way to the filter: which of them are used, and their time and units in the filter."""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from imud.drivers.fix import Fix

from ..configuration.settings import Gnss
from ..estimators.records import FIX
from ..math.arrays import Records

DEGREE_M = 111_195.0  # of latitude
HEIGHT_MAX_M, SPEED_MAX_MPS = 1e6, 1e4  # beyond them no fix can be right
LEAST_HDOP = 0.2  # of a hundred satellites, all on the horizon: 2 / sqrt(n)
SIGMA_MAX_M = 1e4  # 1 sigma; receivers state thousands of kilometres where they have no position
LEAST_SIGMA_M = 1e-3  # 1 sigma; none that measures while it moves knows its position better
_AWAY_FROM_0_0 = math.radians(1.0)
COARSE_M = 3.0  # 1 sigma of the rounding of a position from which on it counts: two decimals of a minute or fewer


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


IMPOSSIBLE = Refusal("range", "their position is 0, 0, or their height or velocity is beyond what can be")


INACCURATE = Refusal("unknown accuracy", "they may be off by more than 10 km, as they say: there is no position")


def refusal(fix: Fix, settings: Gnss) -> Refusal | None:
    """Why the settings forbid this fix; None: use it."""
    if fix.spoofed:
        return Refusal("spoofing", "the receiver reports forged signals")
    if not is_possible(fix):
        return IMPOSSIBLE
    if max(fix.sigma_n_m or 0.0, fix.sigma_e_m or 0.0) > SIGMA_MAX_M:
        return INACCURATE
    why = _forbidden(fix.quality, fix.satellites, fix.hdop, settings)
    return why or (Refusal("unknown time", "they have no time") if fix.utc_s is None else None)


def is_possible(fix: Fix) -> bool:
    """Whether height and velocity are below what anything with a receiver reaches; what is not known is possible.

    0, 0 to the last digit is what some receivers and multiplexers send as a valid position while they have no fix.
    """
    if fix.lat_deg == 0.0 and fix.lon_deg == 0.0:
        return False
    speeds = (fix.speed_mps, *(fix.velocity_mps or ()))
    heights = (fix.height_m, fix.alt_msl_m)
    impossible = (abs(_or_nan(speed)) > SPEED_MAX_MPS for speed in speeds)
    return not any(impossible) and not any(abs(_or_nan(height)) > HEIGHT_MAX_M for height in heights)


def _forbidden(quality: int, satellites: int | None, hdop: float | None, settings: Gnss) -> Refusal | None:
    """Which setting forbids a fix; satellites, hdop: None where it does not say."""
    if quality not in settings.qualities:
        named, allowed = _QUALITIES.get(quality, quality), ", ".join(map(str, settings.qualities))
        return Refusal("gnss.qualities", f"quality {named}, not in gnss.qualities = [{allowed}]")
    if satellites is not None and satellites < settings.min_satellites:
        limit = f"gnss.min_satellites = {settings.min_satellites}"
        return Refusal("gnss.min_satellites", f"{satellites} satellites, fewer than {limit}")
    if hdop is not None and hdop > settings.max_hdop:
        return Refusal("gnss.max_hdop", f"HDOP {hdop:g}, above gnss.max_hdop = {settings.max_hdop:g}")
    return None


def refusals(fixes: Records, settings: Gnss) -> list[Refusal | None]:
    """Of each fix (array of FIX) why the settings forbid it; None: use it. A row without a position is not judged.

    A position of 0, 0 is none (see `is_possible`), unless all are around it, as in simulated data.
    """
    known = np.isfinite(fixes["lat"])
    away = np.maximum(np.abs(fixes["lat"]), np.abs(fixes["lon"]))
    nowhere = (away == 0.0) & bool((away > _AWAY_FROM_0_0).any())
    columns = (fixes[name].tolist() for name in ("quality", "satellites", "hdop"))
    inaccurate = np.fmax(fixes["sigma"][:, 0], fixes["sigma"][:, 1]) > SIGMA_MAX_M
    found: list[Refusal | None] = []
    for k, zero, vague, quality, satellites, hdop in zip(known, nowhere, inaccurate, *columns, strict=True):
        of_number = _forbidden(
            quality, satellites if satellites >= 0 else None, hdop if math.isfinite(hdop) else None, settings
        )
        found.append((IMPOSSIBLE if zero else INACCURATE if vague else of_number) if k else None)
    return found


def forget_implausible(fixes: Records) -> None:
    """Make unknown what no receiver can know (array of FIX, changed): a dilution or sigma below the least, as 0 is, and
    a height with a sigma of more than SIGMA_MAX_M. A position north and east with such a sigma is refused instead.
    """
    sigma, hdop = fixes["sigma"], fixes["hdop"]
    vague = sigma[:, 2] > SIGMA_MAX_M
    sigma[vague, 2] = fixes["height"][vague] = math.nan
    sigma[sigma < LEAST_SIGMA_M] = math.nan
    hdop[hdop < LEAST_HDOP] = math.nan


def record(fix: Fix, t_ns: int, arrival_ns: int) -> Records:
    """The fix as an array of one FIX. Without a geoid separation the height above sea level must do.

    A dilution or sigma that none can have is unknown: see `forget_implausible`.

    The height of a two-dimensional fix is an old one that the receiver holds, or a guess: it counts as unknown.
    """
    height = fix.height_m if fix.height_m is not None else fix.alt_msl_m
    if fix.dimensions == 2:
        height = None
    sigma = [_or_nan(stated) for stated in (fix.sigma_n_m, fix.sigma_e_m, fix.sigma_d_m)]
    rounding_m = fix.step_deg * DEGREE_M / math.sqrt(12.0)  # 1 sigma of an error that is evenly distributed
    if rounding_m > COARSE_M:
        sigma[:2] = [math.hypot(each or 0.0, rounding_m) for each in (fix.sigma_n_m, fix.sigma_e_m)]
    row = np.zeros(1, FIX)
    row[0] = (  # in the order of FIX, at once: several times as fast as field by field
        t_ns,
        arrival_ns,
        math.radians(fix.lat_deg),
        math.radians(fix.lon_deg),
        _or_nan(height),
        sigma,
        _or_nan(fix.hdop),
        [_or_nan(component) for component in fix.velocity_mps] if fix.velocity_mps else math.nan,
        _or_nan(fix.speed_mps),
        math.radians(_or_nan(fix.course_deg)),
        fix.quality,
        -1 if fix.satellites is None else fix.satellites,
        fix.velocity_sigma_mps or math.nan,
        0,
    )
    forget_implausible(row)
    return row


def position_sigma(fix: np.void) -> tuple[float, float, float]:
    """1 sigma north, east, down of a row of FIX; what the receiver does not report, as `navigation` takes it."""
    parameters = navigation_parameters()
    row: Any = SimpleNamespace(**dict(zip(FIX.names or (), fix.item(), strict=True)))
    horizontal = float(_horizontal_sigma()(parameters, row))
    down = float(row.sigma[2]) if math.isfinite(row.sigma[2]) else float(parameters.tuning.vertical_ratio) * horizontal
    return horizontal, horizontal, down


@functools.cache
def _horizontal_sigma() -> Callable[[Any, Any], float]:
    """How `navigation` finds it, in Python."""
    from ..compile.jit import interpreted  # all of the navigation filter: not at every start
    from ..estimators.ins.aiding.gnss_noise import horizontal_sigma

    return interpreted(horizontal_sigma)


def is_precise(fix: np.void) -> bool:
    """Whether `navigation` takes the position of a row of FIX for one of centimetres."""
    return bool(position_sigma(fix)[0] < navigation_parameters().tuning.survey_sigma)


@functools.cache
def navigation_parameters() -> Any:
    """The parameters of `navigation` that are no setting's: `tuning`, in a form that is read faster than numpy's."""
    from ..estimators.ins.parameters import TUNABLES

    return SimpleNamespace(tuning=SimpleNamespace(**{tunable.name: tunable.default for tunable in TUNABLES}))
