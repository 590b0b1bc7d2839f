"""A receiver's velocity against its own positions: the two contradict each other for seconds, so one of them is wrong.

The way from fix to fix less the integral of the velocity is a sum that stays where both are right. Its rate over a
chord is the discrepancy, its variance follows from the errors that a receiver has. A jump of the position is in one
chord only. So a discrepancy is what two successive chords of the same length have in common: the smaller of their
rates, if both have the same sign, are beyond their gates, and differ by no more than the error of a velocity may change
meanwhile. Chords of several lengths run beside each other: short ones find a large discrepancy soon, long ones a small
one at all. An outlier would be an end of two chords: so every point but the newest is the median of itself and its
neighbours, which a discrepancy and a jump do not change.

Which of the two is wrong? Positions drift no faster and for no longer than `max_drift_speed` and `max_reject_s` say;
beyond that the velocity is wrong, unless the estimate uses it and rejects the positions: these come back fast after an
outage. It is wrong as well where the estimate has rejected it, that is where the inertial
sensor has not measured such a change. Until one of these decides, either may be wrong: the discrepancy is part of the
stated velocity, and what it has done since it began of the stated position. A wrong velocity is not used; one that may
be wrong is used while navigating, but not in coarse alignment, where nothing holds against it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.rotation import Vector, wrap_angle
from ...records import NEW_RECEIVER
from ...tuning import Tunable
from ..aiding.gnss_noise import horizontal_sigma
from ..aiding.gnss_velocity import velocity_of
from ..alignment.velocity_pairs import restart_in_motion_alignment
from ..ekf import add_covariance, add_variance
from ..glr_tests.reset import reset_glr_tests
from ..mechanization import ned_difference
from ..state import CHORD_POINTS, HORIZONTAL, NAVIGATING, NEVER_NS, POSITION, VELOCITY
from .reset_inflation import inflate_position

if TYPE_CHECKING:
    from ...types import Fix
    from ..types import ChordPoint, Core, Parameters, StoredMeasurement, VelocityDiscrepancy

CHORDS = (1, 2, 4, 8, 16)  # lengths in points
# verdicts: of the second and the third either may be wrong; the velocity is used in the first two
AGREES, UNDECIDED, UNUSED, VELOCITY_WRONG = 0, 1, 2, 3
TUNABLES = (
    Tunable("chord_step_s", 0.95, "s", "Least time between two points of a chord.", "Receivers of 1 Hz."),
    Tunable("max_chord_step_s", 3.0, "s", "Longest time between two fixes of a chord.", "Choice."),
    Tunable("max_chord_speed", 1000.0, "m/s", "Positions that move faster have jumped.", "Choice."),
    Tunable("max_chord_turn", 1e-3, "rad", "Largest turn of north from fix to fix, as at a pole.", "Choice."),
    Tunable("discrepancy_gate", 9.0, "NIS", "Gate of the rate of a chord.", "Three sigma, twice."),
    Tunable("discrepancy_accel", 10.0, "m/s^2", "Fastest change of a velocity's error.", "Vehicles, but for impacts."),
    Tunable("discrepancy_rejects", 2, "fixes", "Rejected velocities in a row by which they are wrong.", "Choice."),
    Tunable("velocity_lag_sigma", 0.3, "s", "Lag of a velocity behind its position.", "Recorded receivers."),
    Tunable("trapezoid_share", 0.25, "", "Error of a velocity's mean between two fixes over its change.", "Choice."),
)


@kernel
def begin_comparison(g: VelocityDiscrepancy) -> None:
    """Nothing is known of the velocity between the last fix and this one."""
    g.count = 0
    g.verdict = AGREES
    g.onset_ns = NEVER_NS
    for i in range(2):
        g.rate[i] = 0.0


@kernel
def compare_with_positions(p: Parameters, c: Core, g: VelocityDiscrepancy, fix: Fix) -> None:
    """Take a fix, in the order of the epochs: the discrepancy until now."""
    v_n, v_e, dt = velocity_of(p, fix, 0), velocity_of(p, fix, 1), 1e-9 * (fix.t_ns - g.last_ns)
    g.repeated = 1 if fix.lat == g.last_lat and fix.lon == g.last_lon else 0
    known = math.isfinite(v_n + v_e)
    if (c.integrity.frozen != 0 and g.repeated) or (not known and dt >= p.tuning.max_chord_step_s):
        begin_comparison(g)
    if not known or (c.integrity.frozen != 0 and g.repeated):
        return
    if g.last_ns == NEVER_NS or fix.flags & NEW_RECEIVER != 0 or not 0.0 < dt < p.tuning.max_chord_step_s:
        begin_comparison(g)
    if g.count > 0:
        north, east = ned_difference(c, g.last_lat, g.last_lon, fix.lat, fix.lon)
        turn = abs(wrap_angle(fix.lon - g.last_lon) * elementary.sin(fix.lat))
        if elementary.hypot(north, east) > p.tuning.max_chord_speed * dt or turn > p.tuning.max_chord_turn:
            begin_comparison(g)
        change = elementary.hypot(v_n - g.last_velocity[0], v_e - g.last_velocity[1])
        g.sum[0] += north - 0.5 * dt * (v_n + g.last_velocity[0])
        g.sum[1] += east - 0.5 * dt * (v_e + g.last_velocity[1])
        g.sum_variance += dt * dt * ((p.tuning.trapezoid_share * change) ** 2 + c.gnss.velocity_noise_var)
    g.last_ns, g.last_lat, g.last_lon = fix.t_ns, fix.lat, fix.lon
    g.last_velocity[0], g.last_velocity[1] = v_n, v_e
    if g.count > 0 and 1e-9 * (fix.t_ns - g.points[(g.count - 1) % CHORD_POINTS].t_ns) < p.tuning.chord_step_s:
        return
    point = g.points[g.count % CHORD_POINTS]
    point.t_ns, point.variance = fix.t_ns, g.sum_variance
    for i in range(2):
        point.sum[i], point.median[i], point.velocity[i] = g.sum[i], g.sum[i], g.last_velocity[i]
    g.count += 1
    if g.count > 2:
        remove_outlier(g)
    find_discrepancy(p, c, g, horizontal_sigma(p, fix))


@kernel
def remove_outlier(g: VelocityDiscrepancy) -> None:
    """Set the median of the point before the newest, in each axis."""
    before, after = g.points[(g.count - 3) % CHORD_POINTS].sum, g.points[(g.count - 1) % CHORD_POINTS].sum
    point = g.points[(g.count - 2) % CHORD_POINTS]
    for i in range(2):
        point.median[i] = min(max(point.sum[i], min(before[i], after[i])), max(before[i], after[i]))


@kernel
def chord_variance(p: Parameters, c: Core, a: ChordPoint, b: ChordPoint, t: float, sigma: float) -> float:
    """Variance, m^2, of what the sum changes by from point a to b, t s later; sigma: of the position, m."""
    bias2 = c.drift.noise_scale * sigma**2 * (1.0 - elementary.exp(-t / p.tuning.gnss_bias_time_s))
    return float(2.0 * (c.gnss.noise_var[HORIZONTAL] + bias2) + b.variance - a.variance)


@kernel
def chord_rate(p: Parameters, c: Core, g: VelocityDiscrepancy, last: int, n: int, sigma: float) -> Vector:
    """Rate north and east over the n points until point `last`, m/s, by medians, and its variance.

    sigma: of the position, m.
    """
    a, b = g.points[(last - n) % CHORD_POINTS], g.points[last % CHORD_POINTS]
    t = 1e-9 * (b.t_ns - a.t_ns)
    lag2 = p.tuning.velocity_lag_sigma**2 * difference2(b.velocity[0], b.velocity[1], a.velocity[0], a.velocity[1])
    r = chord_variance(p, c, a, b, t, sigma) + lag2
    variance = r / (t * t) + p.tuning.gnss_velocity_bias_sigma**2
    return (b.median[0] - a.median[0]) / t, (b.median[1] - a.median[1]) / t, variance


@kernel
def away_from_held(g: VelocityDiscrepancy, last: int, n: int) -> float:
    """Squared difference of the rate over the n points until point `last` from the one held, m^2/s^2.

    By the sums, whose changes medians would blunt: a drift of the positions that ends is to be seen as long as it was.
    """
    a, b = g.points[(last - n) % CHORD_POINTS], g.points[last % CHORD_POINTS]
    t = 1e-9 * (b.t_ns - a.t_ns)
    return difference2((b.sum[0] - a.sum[0]) / t, (b.sum[1] - a.sum[1]) / t, g.rate[0], g.rate[1])


@kernel
def is_common(p: Parameters, g: VelocityDiscrepancy, n: int, now: Vector, before: Vector) -> bool:
    """Whether the rates of two successive chords of n points (see `chord_rate`) may be of one error of a velocity."""
    t = 1e-9 * (g.points[(g.count - 1) % CHORD_POINTS].t_ns - g.points[(g.count - 1 - n) % CHORD_POINTS].t_ns)
    most2 = (p.tuning.discrepancy_accel * t) ** 2 + p.tuning.discrepancy_gate * (now[2] + before[2])
    return bool(difference2(now[0], now[1], before[0], before[1]) <= most2)


@kernel
def difference2(north: float, east: float, from_north: float, from_east: float) -> float:
    """Square of the length of a difference of two vectors."""
    return (north - from_north) ** 2 + (east - from_east) ** 2


@kernel
def find_discrepancy(p: Parameters, c: Core, g: VelocityDiscrepancy, sigma: float) -> None:
    """The largest rate that two successive chords have in common; without any the last one, until two refute it.

    sigma: of the position, m.
    """
    gate, largest2, longest, refuted, last = p.tuning.discrepancy_gate, 0.0, 0, False, g.count - 1
    common_n = common_e = 0.0
    for n in CHORDS:
        if g.count <= 2 * n:
            continue
        now, before = chord_rate(p, c, g, last, n, sigma), chord_rate(p, c, g, last - n, n, sigma)
        now2, before2 = now[0] ** 2 + now[1] ** 2, before[0] ** 2 + before[1] ** 2
        beyond = now2 > gate * now[2] and before2 > gate * before[2]
        if beyond and now[0] * before[0] + now[1] * before[1] > 0.0 and is_common(p, g, n, now, before):
            common = now if now2 < before2 else before
            if min(now2, before2) > largest2:
                largest2, longest = min(now2, before2), n
                common_n, common_e = common[0], common[1]
        refuted = refuted or (
            away_from_held(g, last, n) > gate * now[2] and away_from_held(g, last - n, n) > gate * before[2]
        )
    if longest > 0:
        g.rate[0], g.rate[1] = common_n, common_e
    if longest == 0 and refuted:
        g.onset_ns, g.verdict = NEVER_NS, AGREES
        g.rate[0] = g.rate[1] = 0.0
    elif longest > 0 and g.onset_ns == NEVER_NS:
        g.onset_ns = g.points[(g.count - 1 - 2 * longest) % CHORD_POINTS].t_ns


@kernel
def is_confirmed(c: Core, g: VelocityDiscrepancy) -> bool:
    """Whether the estimate uses the velocities and rejects the positions.

    The inertial sensor then has measured the motion that the velocities report.
    """
    used = c.alignment.mode == NAVIGATING and g.verdict < UNUSED and c.integrity.velocity_reject_count == 0
    return bool(used and c.integrity.reject_count[HORIZONTAL] > 0)


@kernel
def judge_discrepancy(p: Parameters, c: Core, g: VelocityDiscrepancy, e: StoredMeasurement) -> None:
    """Set the verdict, and what the discrepancy adds to the stated variances while that is open.

    e: the fix, which gets what `allow_for_discrepancy` does whenever it is fused.
    """
    e.velocity_lost = e.discrepancy_lasts = e.discrepancy_open = 0
    e.discrepancy_s = 0.0
    for i in range(2):
        c.scratch.discrepancy2[i] = 0.0
    if g.onset_ns == NEVER_NS:
        return
    since_s, last = min(1e-9 * (g.last_ns - g.onset_ns), p.tuning.max_reject_s), g.verdict
    too_fast = elementary.hypot(g.rate[0], g.rate[1]) > p.tuning.max_drift_speed and not g.repeated
    too_fast = too_fast and not is_confirmed(c, g)
    too_long = since_s >= p.tuning.max_reject_s and c.drift.detected == 0
    rejected = c.alignment.mode == NAVIGATING and c.integrity.velocity_reject_count >= p.tuning.discrepancy_rejects
    if too_fast or too_long or rejected:
        g.verdict = VELOCITY_WRONG
    elif last < UNUSED:
        g.verdict = UNDECIDED if c.alignment.mode == NAVIGATING or g.repeated else UNUSED
    e.discrepancy_s = since_s
    e.discrepancy_open = 1 if g.verdict < VELOCITY_WRONG and since_s < p.tuning.max_reject_s else 0
    e.discrepancy_lasts = 1 if too_long and last < VELOCITY_WRONG else 0
    e.velocity_lost = 1 if last < UNUSED and g.verdict >= UNUSED else 0
    for i in range(2):
        e.discrepancy[i] = g.rate[i]
    if g.verdict < VELOCITY_WRONG:
        c.scratch.discrepancy_onset_ns = g.onset_ns
        for i in range(2):
            c.scratch.discrepancy2[i] = g.rate[i] ** 2


@kernel
def allow_for_discrepancy(c: Core, e: StoredMeasurement) -> None:
    """Before a fix is fused: state what the discrepancy may have done until now.

    When the velocity is not used any more, the estimate has followed it since the onset: P has that from then on. A
    discrepancy that has lasted for too long leaves it least certain which of the two is wrong.
    """
    for i in range(2):
        v2 = e.discrepancy[i] ** 2
        c.scratch.drift[i] = e.discrepancy[i] * e.discrepancy_s if e.discrepancy_open else 0.0
        if e.discrepancy_lasts:
            inflate_position(c, i, v2 * e.discrepancy_s**2)
        if e.velocity_lost:
            add_variance(c, VELOCITY + i, v2)
            add_covariance(c, POSITION + i, VELOCITY + i, v2 * e.discrepancy_s)
            add_variance(c, POSITION + i, v2 * e.discrepancy_s**2)
    if e.velocity_lost:
        restart_in_motion_alignment(c)
        reset_glr_tests(c)


@kernel
def is_unused(g: VelocityDiscrepancy) -> bool:
    """Whether the velocity is wrong, or may be and is not used for that."""
    return bool(g.verdict >= UNUSED)


@kernel
def remove_velocity(fix: Fix) -> None:
    """Take the velocity out of a fix."""
    fix.speed = fix.course = math.nan
    for i in range(3):
        fix.v[i] = fix.sigma_v[i] = math.nan
