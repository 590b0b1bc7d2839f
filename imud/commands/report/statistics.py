"""Tests of innovations: zero mean, unit variance after normalising, whiteness.

Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 5.4.
"""

import math

import numpy as np

from ...math.arrays import Floats

LAGS = 20
COUNT_MIN = 20  # innovations; no test is made with fewer


def autocorrelation(z: Floats, lags: int = LAGS) -> Floats:
    """Of z about its mean, at lags 0 to `lags` or as many as there are; a constant correlates with nothing."""
    d = z - z.mean()
    power = float(np.sum(d * d))
    lags = min(lags, len(z) - 1)
    if power == 0.0:
        return np.concatenate([[1.0], np.zeros(lags)])
    return np.array([float(np.sum(d[: len(d) - k] * d[k:])) / power for k in range(lags + 1)])


def effective_number(z: Floats) -> float:
    """Effective sample size of correlated values, as of a first-order Markov sequence."""
    if len(z) < 3:
        return float(len(z))
    rho = float(np.clip(autocorrelation(z, 1)[1], 0.0, 0.99))
    return max(1.0, len(z) * (1.0 - rho) / (1.0 + rho))


def chi2_bounds(degrees: float, z: float = 1.96) -> tuple[float, float]:
    """Quantiles of chi-square / degrees at +-z of the normal distribution (Wilson and Hilferty, 1931)."""
    a = 2.0 / (9.0 * degrees)
    low, high = (max(0.0, 1.0 - a + side * z * math.sqrt(a)) ** 3 for side in (-1.0, 1.0))
    return low, high


def moving_mean(values: Floats, n: int) -> Floats:
    """Over n values, ending at each from the n-th on."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray((total[n:] - total[:-n]) / n)
