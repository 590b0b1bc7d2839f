"""What looks wrong in a run, in words. A finding names the file, the quantity, the number and what to look at."""

import math

import numpy as np
from numpy.typing import NDArray

from imud.estimators.records import ASSUMED, ATTITUDE_VALID, REJECTING, SATURATED
from imud.health import examine, new_health, words
from imud.kernels.jit import kernel
from imud.profiles import PROFILES
from imud.tables import INNOVATION_KINDS

from .session import Estimates, Innovations, Samples, Session
from .statistics import autocorrelation, chi2_bounds, effective_number

LEAST = 20  # innovations from which anything is said
BIAS = 0.3  # of a sigma; less harms nobody
CERTAIN = 3.3  # sigmas: one false finding in a thousand
ALIKE = 0.5  # correlation of neighbours
REJECTED = 0.05  # share
CAUTIOUS = 0.5  # of the variance that was claimed
LATE_S = 1.0
ASSUMPTIONS = {INNOVATION_KINDS[kind] for kind in ASSUMED}  # weak on purpose: what disturbs them lasts


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
        return [*found, f"{where}: {len(z)} innovations were used, too few to judge the filter by"]
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


def _of_estimates(e: Estimates) -> list[str]:
    status = e.columns["status"].astype(np.int64)
    found = []
    for bit, what in ((REJECTING, "fixes contradict the estimate"), (SATURATED, "the sensor is saturated")):
        share = np.count_nonzero(status & bit) / len(status)
        if share > 0.0:
            found.append(f"{e.name}: {what} in {100 * share:.2g} % of the time")
    if not (status & ATTITUDE_VALID).any():
        found.append(f"{e.name}: roll and pitch never became valid")
    return found


@kernel
def _examine(health: NDArray[np.void], samples: NDArray[np.void]) -> None:
    for i in range(len(samples)):
        examine(health[0], samples[i])


def _of_samples(s: Samples) -> list[str]:
    """The daemon's own judgement of the sensor, over the whole recording."""
    health = new_health(PROFILES["consumer-mems"], s.rate_hz)
    health["range"] = math.inf  # not known from a table
    _examine(health, s.rows.copy())
    counts = health["found"][0]
    found = [
        f"{s.name}: {text} ({count} samples)"
        for bit, count in enumerate(counts.tolist())
        if count
        for text in words(1 << bit)
    ]
    gaps = np.diff(s.rows["t_ns"]) * 1e-9
    missing = gaps > 2.5 / s.rate_hz
    if missing.any():
        found.append(
            f"{s.name}: {np.count_nonzero(missing)} gaps between samples, the longest {gaps.max():.3g} s "
            f"at {s.rows['t_ns'][int(np.argmax(gaps))] * 1e-9:.1f} s"
        )
    return found


def findings(session: Session) -> list[str]:
    """Sentences; none: nothing looks wrong, as far as these files tell."""
    found = [line for samples in session.samples for line in _of_samples(samples)]
    found += [line for innovations in session.innovations for line in _of_innovations(innovations)]
    found += [line for estimates in session.estimates for line in _of_estimates(estimates)]
    for fixes in session.fixes:
        latency = (fixes.rows["arrival_ns"] - fixes.rows["t_ns"]) * 1e-9
        if len(latency) and np.median(latency) > LATE_S:
            found.append(f"{fixes.name}: fixes come {np.median(latency):.2f} s late (median)")
    return found
