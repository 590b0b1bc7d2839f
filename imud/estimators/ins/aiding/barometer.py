"""Height by air pressure: precise over minutes, with an unknown offset that weather, wind and windows change.

z = reading - h - offset. A measurement has value[0]: height in the standard atmosphere, m, and sigma[0]: m, NaN where
it is not reported. The offset is an error state: a random walk in time (weather), in height (the atmosphere is warmer
or colder than the standard one) and in squared speed (the wind of the vehicle's own motion). Readings that jump, as by
a door or a gust, are rejected; if they stay, the offset begins anew. A reading that repeats the last one to the last
digit says nothing new: it is not used, as of a sensor that has stopped. Where the height changes otherwise than the
readings, as of one in feet, their scale is wrong, and the offset walks as much as that makes it. Used once a fix has
given a height.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...aiding_source import AidingSource, Column
from ...innovation_kinds import KINDS
from ...records import BAROMETER, BAROMETER_SOURCE
from ...tuning import Tunable
from ..ekf import add_variance, decorrelate, set_jacobian, variance
from ..fusion import correct_state, correlated_update, write_innovation
from ..state import BARO_OFFSET, NEVER_NS, OTHER_AXIS, POSITION, VELOCITY, VERTICAL
from .external_aid import others_of_error

if TYPE_CHECKING:
    from ...types import Fix, Innovation, Measurement
    from ..types import Core, Parameters


def standard_height(pressure_pa: float) -> float:
    """Height, m, in the standard atmosphere below 11 km. Source: ISO 2533 (ICAO Doc 7488)."""
    return float(44330.77 * (1.0 - (pressure_pa / 101325.0) ** 0.190263))


SOURCE = AidingSource(
    "barometer",
    BAROMETER_SOURCE,
    "BARO",
    {"height_m": Column(1.0, -2000.0, 12000.0)},
    {"sigma_m": Column(1.0, 0.01, 100.0)},
    {BAROMETER: KINDS[BAROMETER]},
    alternatives={"pressure_pa": ("height_m", standard_height, 19000.0, 130000.0)},
)
TUNABLES = (
    Tunable(
        "baro_sigma", 0.3, "m", "Sigma of a pressure height that reports none.", "4 Pa: MEMS barometers and light wind."
    ),
    Tunable("baro_correlation_s", 1.0, "s", "Correlation time of the error of a pressure height.", "Gusts."),
    Tunable(
        "baro_offset_sigma",
        500.0,
        "m",
        "Sigma of the offset of the pressure height at the start.",
        "60 hPa: the deepest low.",
    ),
    Tunable(
        "baro_offset_psd",
        0.01,
        "m^2/s",
        "Random walk of the offset of the pressure height by the weather.",
        "0.7 hPa in an hour.",
    ),
    Tunable(
        "baro_offset_per_height",
        0.16,
        "m",
        "Variance of the offset per difference of height.",
        "Scale error of 4 %, over 100 m.",
    ),
    Tunable(
        "baro_offset_per_speed2", 0.0025, "s^2", "Variance of the offset per squared speed.", "1 m from 0 to 20 m/s."
    ),
    Tunable("baro_gate", 16.0, "NIS", "Gate of a pressure height.", "Four sigma: doors and gusts are common."),
    Tunable(
        "baro_reopen_s",
        5.0,
        "s",
        "Time of rejections after which the offset of the pressure height begins anew.",
        "Choice.",
    ),
    Tunable("baro_ratio_s", 5.0, "s", "Time over which changes of reading and height are compared.", "Choice."),
    Tunable("baro_ratio_change", 5.0, "m", "Least change of the reading that is compared.", "Choice."),
    Tunable("baro_ratio_noise", 1.5, "m", "Error of the change of the height in baro_ratio_s.", "Fixes of 4 m."),
    Tunable("baro_ratio_memory_s", 300.0, "s", "Time over which the ratio of the changes is taken.", "Choice."),
    Tunable(
        "baro_ratio_tolerance",
        0.15,
        "",
        "Difference of the ratio from 1, beyond limit_sigmas, from which the scale of the readings is wrong.",
        "Hot or cold air: 10 %.",
    ),
    Tunable(
        "baro_fix_s", 20.0, "s", "Smoothing time of the heights of fixes and readings that are compared.", "Choice."
    ),
    Tunable(
        "baro_fix_sigmas",
        2.5,
        "sigma",
        "Difference of the heights of fixes and readings from which the scale of the readings is wrong.",
        "Smoothing leaves half of a fix's error.",
    ),
    Tunable("baro_ratio_height", 20.0, "m", "Height over which a wrong scale is an error that lasts.", "Choice."),
    Tunable(
        "baro_known_height",
        50.0,
        "m",
        "Largest sigma of the height with which pressure heights are used.",
        "A first fix.",
    ),
)


@kernel
def repeats(c: Core, m: Measurement) -> bool:
    """Whether a reading is the last one again, to the last digit; stores it, and since when it has not changed."""
    g = c.barometer
    same = g.changed_ns != NEVER_NS and m.value[0] == g.reading
    if not same:
        g.reading, g.changed_ns = m.value[0], m.t_ns
    return same


@kernel
def scale_error2(p: Parameters, c: Core, m: Measurement) -> float:
    """Square of the scale error of the readings, by the changes of reading and height so far; 0: none is seen."""
    g = c.barometer
    dt = 1e-9 * (m.t_ns - g.ratio_ns)
    if dt >= p.tuning.baro_ratio_s:
        reading, height = m.value[0] - g.ratio_reading, c.nav.height - g.ratio_height
        keep = max(1.0 - dt / p.tuning.baro_ratio_memory_s, 0.0)
        steady = dt < 2.0 * p.tuning.baro_ratio_s and g.rejected_ns < g.ratio_ns  # no door, no gust
        changed = steady and abs(reading) > p.tuning.baro_ratio_change
        g.reading2 = keep * g.reading2 + (reading * reading if changed else 0.0)
        g.reading_height = keep * g.reading_height + (reading * height if changed else 0.0)
        g.ratio_ns, g.ratio_reading, g.ratio_height = m.t_ns, m.value[0], c.nav.height
    if not g.reading2 > 0.0:
        return float(g.scale_error2_by_fixes)
    ratio = g.reading_height / g.reading2  # of the height to the reading, which is precise
    noise = p.tuning.baro_ratio_noise / math.sqrt(g.reading2)
    wrong = abs(ratio - 1.0) >= p.tuning.baro_ratio_tolerance + p.tuning.limit_sigmas * noise
    found = (1.0 / max(ratio, p.tuning.baro_ratio_tolerance) - 1.0) ** 2 if wrong else 0.0
    return float(max(found, g.scale_error2_by_fixes))


@kernel
def compare_heights(p: Parameters, c: Core, fix: Fix) -> None:
    """After a fix: compare its height less the smoothed one with the same of the readings; in hPa they hardly change.

    Where they differ, the estimate may have followed the readings: the variances of height and climb have what it may
    be off by, and the offset begins anew.
    """
    g = c.barometer
    if g.changed_ns == NEVER_NS or not math.isfinite(fix.height) or c.integrity.reject_count[VERTICAL] > 0:
        return
    dt = 1e-9 * (fix.t_ns - g.fix_ns)
    if g.fix_ns == NEVER_NS or dt > p.tuning.baro_fix_s or 1e-9 * (fix.t_ns - g.changed_ns) > p.tuning.baro_reopen_s:
        g.mean_fix_height, g.mean_reading, dt = fix.height, g.reading, 0.0
    g.fix_ns = fix.t_ns
    g.mean_fix_height += (fix.height - g.mean_fix_height) * dt / p.tuning.baro_fix_s
    g.mean_reading += (g.reading - g.mean_reading) * dt / p.tuning.baro_fix_s
    g.scale_error2_by_fixes *= max(1.0 - dt / p.tuning.baro_ratio_memory_s, 0.0)
    climb, shown = fix.height - g.mean_fix_height, g.reading - g.mean_reading
    difference, noise2 = climb - shown, c.gnss.noise_var[VERTICAL] + c.gnss.bias_sigma[VERTICAL] ** 2
    if abs(difference) < p.tuning.baro_ratio_tolerance * abs(climb) + p.tuning.baro_fix_sigmas * math.sqrt(noise2):
        return
    if g.scale_error2_by_fixes == 0.0:
        add_variance(c, POSITION + 2, difference * difference)
        add_variance(c, VELOCITY + 2, (difference / p.tuning.baro_fix_s) ** 2)
        decorrelate(c, BARO_OFFSET, p.tuning.baro_offset_sigma**2)
    g.scale_error2_by_fixes = max(g.scale_error2_by_fixes, difference * difference / max(climb * climb, noise2))


@kernel
def walk_offset(p: Parameters, c: Core, m: Measurement) -> float:
    """Add the variance of the offset since the last reading; returns the time since then, s."""
    g = c.barometer
    speed2 = c.nav.v_n[0] ** 2 + c.nav.v_n[1] ** 2
    first = g.last_ns == NEVER_NS
    dt = p.tuning.baro_correlation_s if first else max(1e-9 * (m.t_ns - g.last_ns), 1e-3)
    if not first:
        per_height = p.tuning.baro_offset_per_height + p.tuning.baro_ratio_height * scale_error2(p, c, m)
        q = p.tuning.baro_offset_psd * dt + per_height * abs(c.nav.height - g.height)
        add_variance(c, BARO_OFFSET, q + p.tuning.baro_offset_per_speed2 * abs(speed2 - g.speed2))
    g.last_ns, g.height, g.speed2 = m.t_ns, c.nav.height, speed2
    return dt


@kernel
def fuse_barometer(p: Parameters, c: Core, m: Measurement, innovations: list[Innovation]) -> int:
    """Gate and fuse a reading; returns the rows of innovations."""
    if variance(c, POSITION + 2) > p.tuning.baro_known_height**2 or repeats(c, m):
        return 0
    dt = walk_offset(p, c, m)
    length = set_jacobian(c, set_jacobian(c, 0, POSITION + 2, -1.0), BARO_OFFSET, 1.0)
    sigma = m.sigma[0] if m.sigma[0] > 0.0 else p.tuning.baro_sigma
    climb = -c.nav.v_n[2] * 1e-9 * (m.t_ns - c.nav.t_ns)  # 0 but for an epoch after the newest sample
    z = m.value[0] - c.nav.height - c.nav.baro_offset - climb
    others = others_of_error(dt, p.tuning.baro_correlation_s)
    z, s, nis = correlated_update(c, length, z, sigma * sigma, others * sigma * sigma, p.tuning.baro_gate, OTHER_AXIS)
    used = nis >= 0.0
    if used:
        correct_state(p, c)
        c.barometer.last_used_ns = m.t_ns
    else:
        c.barometer.rejected_ns = m.t_ns
        if 1e-9 * (m.t_ns - c.barometer.last_used_ns) > p.tuning.baro_reopen_s:
            decorrelate(c, BARO_OFFSET, p.tuning.baro_offset_sigma**2)
    return write_innovation(innovations, 0, m.t_ns, BAROMETER, z, s, used)
