"""What looks wrong in a run, in words. A finding names the file, the quantity, the number and what to look at."""

import math
from collections.abc import Iterable

import numpy as np

from imud.estimators.innovation_kinds import KINDS
from imud.estimators.records import ASSUMED, ATTITUDE_VALID, REJECTING, SATURATED

from .session import Clock, Estimates, Innovations, Session
from .statistics import LEAST, autocorrelation, chi2_bounds, effective_number

BIAS = 0.3  # of a sigma; less harms nobody
CERTAIN = 3.3  # sigmas: one false finding in a thousand
ALIKE = 0.5  # correlation of neighbours
REJECTED = 0.05  # share
CAUTIOUS = 0.5  # of the variance that was claimed
LATE_S = 1.0
LATE_SAMPLE_S = 0.1
SHOWN = 5  # times
LOSSES = {
    "lost": "samples are missing by the sensor's own counter",
    "bad": "frames were damaged on the wire",
    "errors": "frames carry the sensor's own error bit",
    "corrections": "corrections of the sensor's counter: samples were skipped without a trace",
}
ASSUMPTIONS = {KINDS[kind].column for kind in ASSUMED}  # weak on purpose: what disturbs them lasts


def _of_innovations(i: Innovations) -> list[str]:
    z = i.normalised[i.used]
    rejected = 1.0 - np.count_nonzero(i.used) / len(i.used)
    where = f"{i.name}: {i.kind}"
    found = []
    if len(i.used) >= LEAST and rejected > REJECTED:
        found.append(
            f"{where}: {100 * rejected:.0f} % of {len(i.used)} innovations were rejected: the gate is too tight, the "
            "filter is overconfident, or the receiver is worse than it says"
        )
    if len(z) < LEAST:
        return found
    n = effective_number(z)
    assumed = i.kind in ASSUMPTIONS
    spread, mean = float(np.mean(z * z)), float(np.mean(z))
    low, high = chi2_bounds(n, CERTAIN)
    if spread > high:
        found.append(
            f"{where}: overconfident: the innovations are {math.sqrt(spread):.2f} times as large as claimed "
            f"(mean square of the normalised ones {spread:.2f}, at most {high:.2f} by chance)"
        )
    elif spread < min(low, CAUTIOUS) and not assumed:
        found.append(
            f"{where}: cautious: the innovations are only {math.sqrt(spread):.2f} times as large as claimed; "
            "the measurement's sigma is too large"
        )
    if abs(mean) > max(BIAS, CERTAIN * float(np.std(z)) / math.sqrt(n)):
        found.append(f"{where}: biased: mean {mean:+.2f} sigma; look at lever arm, latency, mounting, datum of height")
    rho = float(autocorrelation(z, 1)[1])
    if not assumed and rho > ALIKE and rho * math.sqrt(len(z)) > CERTAIN:
        found.append(
            f"{where}: not white: neighbours correlate by {rho:.2f}; the receiver smooths its fixes, or a slow error "
            "is not in the model"
        )
    return found


def _too_few(innovations: Iterable[Innovations]) -> list[str]:
    """The quantities with too few innovations to judge the filter by, a sentence for each file."""
    few: dict[str, list[str]] = {}
    for i in innovations:
        if (used := np.count_nonzero(i.used)) < LEAST:
            few.setdefault(i.name, []).append(f"{i.kind} ({used})")
    return [
        f"{name}: too few innovations were used to judge the filter by {', '.join(kinds)}"
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
        times = ", ".join(f"{t:.1f}" for t in e.lost_s[:SHOWN])
        more = " and later" if len(e.lost_s) > SHOWN else ""
        found.append(f"{e.name}: the heading was lost at {times} s{more}")
    return found


def _of_clock(c: Clock) -> list[str]:
    """Findings on the sensor's counter and its line; both count anew after a reconnection."""
    rows = c.rows
    found = []
    for name, what in LOSSES.items():
        steps = np.diff(np.concatenate([[0], rows[name]]))
        if count := int(np.where(steps < 0, rows[name], steps).sum()):
            found.append(f"{c.name}: {count} {what}")
    latest = float(rows["latest"].max())
    if latest > LATE_SAMPLE_S:
        found.append(
            f"{c.name}: samples came up to {1e3 * latest:.0f} ms late: the machine was busy, or its USB adapter"
        )
    return found


def findings(session: Session) -> list[str]:
    """The findings, a sentence each; none: nothing looks wrong, as far as these files tell."""
    found = [f"{sensor.name}: {text}" for sensor in session.sensors for text in sensor.said]
    found += [line for clock in session.clocks for line in _of_clock(clock)]
    found += [line for innovations in session.innovations for line in _of_innovations(innovations)]
    found += _too_few(session.innovations)
    found += [line for estimates in session.estimates for line in _of_estimates(estimates)]
    for fixes in session.fixes:
        latency = (fixes.rows["arrival_ns"] - fixes.rows["t_ns"]) * 1e-9
        if len(latency) and np.median(latency) > LATE_S:
            found.append(f"{fixes.name}: fixes come {np.median(latency):.2f} s late (median)")
    return found
