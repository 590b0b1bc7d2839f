"""What looks wrong in a run, as sentences. A finding names the file, the quantity, the number and what to check."""

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ...estimators.innovation_kinds import KINDS
from ...estimators.records import ASSUMED, ATTITUDE_VALID, REJECTING, REST_N, REST_Z, SATURATED
from ...math.arrays import Floats
from ...sensors.limits import LIMITS, is_beyond
from .session import Clock, Estimates, Innovations, Session
from .statistics import COUNT_MIN, autocorrelation, chi2_bounds, effective_number

BIAS_MIN = 0.3  # of a sigma; a smaller bias is harmless
SIGNIFICANT = 3.3  # sigmas: one false finding in a thousand
CORRELATION_MAX = 0.5  # of neighbours
REJECTED_MAX = LIMITS["rejected_share"].most
CONSERVATIVE = 0.5  # of the claimed variance
FIX_LATENCY_MAX_S = LIMITS["fix_latency_s"].most
SAMPLE_LATENCY_MAX_S = LIMITS["samples_late_us"].most * 1e-6
TIMES_MAX = 5  # in one finding
LOSSES = {
    "lost": "samples are missing by the sensor's own counter",
    "bad": "frames were damaged on the wire",
    "errors": "frames carry the sensor's own error bit",
    "corrections": "corrections of the sensor's counter: samples were skipped without a trace",
}
CLOCK = {
    "clock_drift_ppm": ("the drift of the sensor's clock", "ppm"),
    "clock_residual_us": ("the distance of samples from the fitted clock", "µs"),
}
AT_REST = {KINDS[kind].column for kind in range(REST_N, REST_Z + 1)}
SETTING_OFF = 2  # windows of a rest, at its end, in which the vehicle may move already
ASSUMPTIONS = {KINDS[kind].column for kind in ASSUMED}  # their sigma is large because their errors are correlated


def _of_innovations(i: Innovations) -> list[str]:
    z = i.normalised[i.used]
    gated = i.used[_before_motion(i)]
    rejected = 1.0 - np.count_nonzero(gated) / max(len(gated), 1)
    where = f"{i.name}: {i.kind}"
    found = []
    if len(gated) >= COUNT_MIN and rejected > REJECTED_MAX:
        found.append(
            f"{where}: {100 * rejected:.0f} % of {len(gated)} innovations were rejected: the gate is too tight, the "
            "filter is overconfident, or the receiver is worse than it says"
        )
    if len(z) < COUNT_MIN:
        return found
    n = effective_number(z)
    assumed = i.kind in ASSUMPTIONS
    mean_square, mean = float(np.mean(z * z)), float(np.mean(z))
    low, high = chi2_bounds(n, SIGNIFICANT)
    if mean_square > high:
        found.append(
            f"{where}: overconfident: the innovations are {math.sqrt(mean_square):.2f} times as large as claimed "
            f"(mean square of the normalised ones {mean_square:.2f}, at most {high:.2f} by chance)"
        )
    elif mean_square < min(low, CONSERVATIVE) and not assumed:
        found.append(
            f"{where}: conservative: the innovations are only {math.sqrt(mean_square):.2f} times as large as claimed; "
            "the measurement's sigma is too large"
        )
    if abs(mean) > max(BIAS_MIN, SIGNIFICANT * float(np.std(z)) / math.sqrt(n)):
        found.append(f"{where}: biased: mean {mean:+.2f} sigma; look at lever arm, latency, mounting, datum of height")
    rho = float(autocorrelation(z, 1)[1])
    if not assumed and rho > CORRELATION_MAX and rho * math.sqrt(len(z)) > SIGNIFICANT:
        found.append(
            f"{where}: not white: neighbours correlate by {rho:.2f}; the receiver smooths its fixes, or a slow error "
            "is not in the model"
        )
    return found


def _before_motion(i: Innovations) -> NDArray[np.bool_]:
    """Which innovations the share of rejected ones is of: all but those of the last windows of each rest.

    While a vehicle sets off, the receiver's newest speed is still zero; such a window is rejected, as it must be.
    """
    counted = np.ones(len(i.t), bool)
    if i.kind in AT_REST and len(i.t) > 1:
        apart = np.diff(i.t)
        ends = np.append(np.flatnonzero(apart > 2.0 * np.median(apart)), len(i.t) - 1)
        for back in range(SETTING_OFF):
            counted[np.maximum(ends - back, 0)] = False
    return counted


def not_judged(innovations: Iterable[Innovations]) -> list[str]:
    """The quantities with too few innovations to judge the filter by, a sentence for each file.

    Nothing is wrong with that: the recording is short, or seldom at rest.
    """
    few: dict[str, list[str]] = {}
    for i in innovations:
        if (used := np.count_nonzero(i.used)) < COUNT_MIN:
            few.setdefault(i.name, []).append(f"{i.kind} ({used})")
    return [
        f"{name}: too few innovations to judge the filter by {', '.join(kinds)}; {COUNT_MIN} are needed"
        for name, kinds in few.items()
    ]


def _of_estimates(e: Estimates) -> list[str]:
    found = []
    for bit, what in ((REJECTING, "fixes contradict the estimate"), (SATURATED, "the sensor is saturated")):
        if share := e.shares[bit]:
            found.append(f"{e.name}: {what} in {100 * share:.2g} % of the time")
    if not e.shares[ATTITUDE_VALID]:
        found.append(f"{e.name}: roll and pitch never became valid")
    if e.lost_s:
        times = ", ".join(f"{t:.1f}" for t in e.lost_s[:TIMES_MAX])
        more = " and later" if len(e.lost_s) > TIMES_MAX else ""
        found.append(f"{e.name}: the heading was lost at {times} s{more}")
    return found


def _median(values: Floats) -> float:
    """Of the known values; NaN: there is none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.nan


def _of_clock(c: Clock) -> list[str]:
    """Findings on the sensor's counter and its line; both count anew after a reconnection."""
    rows = c.rows
    found = []
    for name, what in LOSSES.items():
        steps = np.diff(np.concatenate([[0], rows[name]]))
        if count := int(np.where(steps < 0, rows[name], steps).sum()):
            found.append(f"{c.name}: {count} {what}")
    judged = {"clock_residual_us": ("residual", 0.0)} | (
        {"clock_drift_ppm": ("drift", _median(rows["sigma_drift"]))} if c.has_quartz else {}
    )
    for name, (column, sigma) in judged.items():
        if is_beyond(name, value := 1e6 * _median(rows[column]), 1e6 * sigma):
            limit, (what, unit) = LIMITS[name], CLOCK[name]
            found.append(
                f"{c.name}: {what} is {value:+.0f} {unit} (median), at most {limit.most:g} is healthy: the machine was "
                "busy, or the sensor's counter is wrong"
            )
    latest = float(rows["latest"].max())
    if latest > SAMPLE_LATENCY_MAX_S:
        found.append(
            f"{c.name}: samples came up to {1e3 * latest:.0f} ms late: the machine was busy, or its USB adapter"
        )
    return found


def findings(session: Session) -> list[str]:
    """The findings, a sentence each; none: nothing looks wrong in these files."""
    found = [f"{sensor.name}: {text}" for sensor in session.sensors for text in sensor.findings]
    found += [line for clock in session.clocks for line in _of_clock(clock)]
    found += [line for innovations in session.innovations for line in _of_innovations(innovations)]
    found += [line for estimates in session.estimates for line in _of_estimates(estimates)]
    for fixes in session.fixes:
        latency = (fixes.rows["arrival_ns"] - fixes.rows["t_ns"]) * 1e-9
        if len(latency) and np.median(latency) > FIX_LATENCY_MAX_S:
            found.append(f"{fixes.name}: fixes come {np.median(latency):.2f} s late (median)")
    return found
