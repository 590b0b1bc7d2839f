"""What the noise of a resting gyro tells of its quantization: whether one code is twice as wide as the others.

White noise is Gaussian, and one mean and one deviation must explain how often each code is read. A block is evaluated
only if its readings differ as much from one to the next as from their mean, so that they are noise and no motion; and
only some blocks are, because the same noise over hours would otherwise be counted as independent evidence.

Source: von Neumann, Distribution of the ratio of the mean square successive difference to the variance (1941).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from .state import BINS
from .truncation import add_evidence, first_candidate, last_candidate

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from .types import Parameters, State

NONE = -1  # no code is the wide one


@kernel
def start_block(s: State) -> None:
    """Start a new histogram."""
    s.quantization.rest_samples = 0
    for k in range(3 * BINS):
        s.quantization.rest_histogram[k] = 0.0
    for i in range(3):
        s.quantization.rest_step2[i] = 0.0


@kernel
def reset_blocks(p: Parameters, s: State) -> None:
    """Start again with the first histogram."""
    s.quantization.rest_samples, s.quantization.rest_blocks = p.tuning.block_samples, 0


@kernel
def count_at_rest(s: State, i: int, code: int, step: float) -> None:
    """Count a reading at rest of axis i in bin `code`, `step` LSB from the one before."""
    s.quantization.rest_histogram[code] += 1.0
    s.quantization.rest_step2[i] += step**2


@kernel
def evaluate_full_block(p: Parameters, s: State) -> bool:
    """After one sample at rest: learn from the histogram if it is full; returns whether anything was learned."""
    s.quantization.rest_samples += 1
    return s.quantization.rest_samples == p.tuning.block_samples and evaluate_block(p, s)


@kernel
def evaluate_block(p: Parameters, s: State) -> bool:
    """Learn from a full block; returns whether anything was learned."""
    if s.quantization.rest_blocks == p.tuning.max_blocks:
        return False
    s.quantization.rest_blocks += 1
    informative = False
    for i in range(3):
        informative |= evaluate_axis(p, s, i)
    return informative


@kernel
def evaluate_axis(p: Parameters, s: State, i: int) -> bool:
    """Compare the histogram of axis i with those of noise if one of the codes were wide, and if none is."""
    c, z = p.tuning, s.quantization
    deviation = math.sqrt(0.5 * z.rest_step2[i] / c.block_samples)
    reach = math.ceil(c.histogram_reach * deviation)
    middle = median_bin(z.rest_histogram, i * BINS)
    inside = i * BINS <= middle - reach and middle + reach < (i + 1) * BINS
    if not (c.min_noise_lsb < deviation < c.max_noise_lsb and inside):
        return False
    whiteness = deviation**2 / fit_gaussian(p, z.rest_histogram, middle - reach, middle + reach + 1, NONE)[1]
    if whiteness < c.min_whiteness:
        return False
    first = max(first_candidate(p, s, i), middle - reach - 1)
    end = min(last_candidate(p, s, i) + 1, middle + reach + 2)
    none_wide = log_likelihood(p, z.rest_histogram, middle, reach, NONE)
    for k in range(first, end):
        ratio = log_likelihood(p, z.rest_histogram, middle, reach, k) - none_wide
        add_evidence(s, k, min(whiteness, 1.0) * ratio)
    return bool(first < end)


@kernel
def median_bin(histogram: Reals, first: int) -> int:
    """The median of the axis whose bins begin with `first`."""
    total, below = 0.0, 0.0
    for k in range(first, first + BINS):
        total += histogram[k]
    for k in range(first, first + BINS):
        below += histogram[k]
        if 2.0 * below >= total:
            return k
    return first


@kernel
def bin_edges(k: int, wide: int) -> tuple[float, float]:
    """Between which values, in LSB, bin k lies if bin `wide` has two intervals."""
    if wide == NONE:
        return k - 0.5, k + 0.5
    return k - (1.0 if k <= wide else 0.0), k + (1.0 if k >= wide else 0.0)


@kernel
def fit_gaussian(p: Parameters, histogram: Reals, first: int, end: int, wide: int) -> tuple[float, float]:
    """Mean and variance of the readings in the bins from `first` up to `end`, less that of the bins' width."""
    n, mean, square, width2 = 0.0, 0.0, 0.0, 0.0
    for k in range(first, end):
        low, high = bin_edges(k, wide)
        x, h = 0.5 * (low + high), histogram[k]
        n += h
        mean += h * x
        square += h * x * x
        width2 += h * (high - low) ** 2
    mean /= max(n, 1.0)
    variance = (square - width2 / 12.0) / max(n, 1.0) - mean * mean
    return mean, max(variance, p.tuning.min_noise_lsb**2)


@kernel
def log_likelihood(p: Parameters, histogram: Reals, middle: int, reach: int, wide: int) -> float:
    """Log likelihood of the bins about `middle`, from Gaussian noise, if bin `wide` is the wide one."""
    outliers = p.tuning.outlier_probability
    mean, variance = fit_gaussian(p, histogram, middle - reach, middle + reach + 1, wide)
    scale = 1.0 / math.sqrt(2.0 * variance)
    total = 0.0
    below = elementary.erf((bin_edges(middle - reach, wide)[0] - mean) * scale)
    for k in range(middle - reach, middle + reach + 1):
        above = elementary.erf((bin_edges(k, wide)[1] - mean) * scale)
        total += histogram[k] * elementary.log((1.0 - outliers) * 0.5 * (above - below) + outliers / BINS)
        below = above
    return total
