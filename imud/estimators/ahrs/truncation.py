"""Whether the gyro's readings are truncated toward zero, as a plain cast to an integer in C does it.

Such a reading is half an LSB too small in size whichever way the body turns, so that the bias seen at rest is not the
bias in motion: with 16 bits for 2000 deg/s the heading then drifts by 1.8 deg/min. It shows in the readings alone: two
intervals are truncated to zero, one to every other code. `quantization` and `rest_histogram` gather how much likelier
the readings are if one code is so wide than if none is; the axes of a gyro are truncated alike, and readings are
compensated as far as the odds go.

Readings that are whole numbers of LSB were truncated at zero if at all. Where a bias was removed after the cast, as
calibrations do, they are whole numbers but for a common offset, and zero may have been at any of them.

Source: Bayes' rule for two hypotheses, as in Wald, Sequential tests of statistical hypotheses (1945).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from .mechanization import shift_gyro_bias
from .sensor_axes import to_body_axes
from .state import BINS, WINDOW

if TYPE_CHECKING:
    from .types import Parameters, State


@kernel
def compensate_truncation(s: State, x: float, i: int) -> float:
    """Reading x of axis i with its expected truncation error added."""
    z = s.quantization
    largest = float(z.max_error[i])
    if largest == 0.0:
        return x
    if abs(x) > (WINDOW + 1) * z.lsb[i]:
        return x + math.copysign(largest, x)
    k = math.floor(x / z.lsb[i] - z.offset[i] + 0.5)
    if k < -WINDOW:
        return x - largest
    if k > WINDOW:
        return x + largest
    return float(x + z.error[i * BINS + WINDOW + k])


@kernel
def add_evidence(s: State, k: int, log_ratio: float) -> None:
    """Log likelihood ratio of new readings, that bin k is the wide one, against that none is."""
    s.quantization.log_likelihood_ratio[k] += log_ratio


@kernel
def reset_evidence(s: State, i: int) -> bool:
    """Start again with axis i; returns whether anything was known of it."""
    known = False
    for k in range(i * BINS, (i + 1) * BINS):
        known |= s.quantization.log_likelihood_ratio[k] != 0.0
        s.quantization.log_likelihood_ratio[k] = 0.0
    return known


@kernel
def first_candidate(p: Parameters, s: State, i: int) -> int:
    """The first bin of axis i that may be the wide one."""
    return i * BINS + WINDOW if abs(s.quantization.offset[i]) < p.tuning.max_code_error else i * BINS


@kernel
def last_candidate(p: Parameters, s: State, i: int) -> int:
    """The last bin of axis i that may be the wide one."""
    return i * BINS + WINDOW if abs(s.quantization.offset[i]) < p.tuning.max_code_error else (i + 1) * BINS - 1


@kernel
def update_truncation(p: Parameters, s: State) -> None:
    """Expect as much truncation as the readings show; the bias that was seen at rest had it, too."""
    c, z = p.tuning, s.quantization
    odds = c.truncation_prior
    for i in range(3):
        odds += mean_likelihood_ratio(p, s, i)
    z.truncation_log_odds = min(max(odds, -c.max_log_odds), c.max_log_odds)
    share = 0.5 / (1.0 + elementary.exp(-z.truncation_log_odds))
    for i in range(3):
        z.max_error[i] = share * z.lsb[i]
    change = to_body_axes(p, (update_errors(p, s, 0), update_errors(p, s, 1), update_errors(p, s, 2)))
    for i in range(3):
        shift_gyro_bias(s, i, change[i])


@kernel
def mean_likelihood_ratio(p: Parameters, s: State, i: int) -> float:
    """Logarithm of the mean likelihood ratio of all bins of axis i that may be the wide one."""
    ratio = s.quantization.log_likelihood_ratio
    first, end = first_candidate(p, s, i), last_candidate(p, s, i) + 1
    top, total = ratio[first], 0.0
    for k in range(first, end):
        top = max(top, ratio[k])
    for k in range(first, end):
        total += elementary.exp(ratio[k] - top)
    return float(top + elementary.log(total / (end - first)))


@kernel
def update_errors(p: Parameters, s: State, i: int) -> float:
    """The expected truncation error of each code of axis i: `max_error` toward the side of zero that it is on.

    Returns by how much the mean of the readings at rest has changed by it, and keeps the variance of that mean.
    """
    z = s.quantization
    first, end = first_candidate(p, s, i), last_candidate(p, s, i) + 1
    mean = mean_likelihood_ratio(p, s, i)
    rest_count = 0.0
    for k in range(i * BINS, (i + 1) * BINS):
        rest_count += z.rest_histogram[k]
    below, rest_below, change, side_mean, side_square = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(i * BINS, (i + 1) * BINS):
        here = elementary.exp(z.log_likelihood_ratio[k] - mean) / (end - first) if first <= k < end else 0.0
        error = z.max_error[i] * (2.0 * below + here - 1.0)
        change += z.rest_histogram[k] * (error - z.error[k])
        z.error[k] = error
        below += here
        side = rest_count - z.rest_histogram[k] - 2.0 * rest_below  # readings above this bin less those below it
        side_mean += here * side
        side_square += here * side * side
        rest_below += z.rest_histogram[k]
    if rest_count == 0.0:
        return 0.0
    largest = z.max_error[i]
    spread = 0.5 * z.lsb[i] * largest * side_square - (largest * side_mean) ** 2
    z.error_var[i] = max(spread, 0.0) / rest_count**2
    return change / rest_count
