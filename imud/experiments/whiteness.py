"""Is a sequence white, and standard normal? Statistics with their 99 % limits."""

import math

import numpy as np

from ..math.arrays import Floats

LAGS = 20
CHI2_99 = 37.57  # 99 % of chi-square with LAGS degrees of freedom
KS_99 = 1.63  # times 1/sqrt(n): 99 % of Kolmogorov and Smirnov's distance


def autocorrelation(x: Floats) -> Floats:
    """At lags 1 to LAGS."""
    centred = x - x.mean()
    rho: Floats = np.array([centred[k:] @ centred[:-k] for k in range(1, LAGS + 1)]) / (centred @ centred)
    return rho


def ljung_box(x: Floats) -> float:
    """Ljung and Box's statistic: chi-square with LAGS degrees of freedom if x is white."""
    n, rho = len(x), autocorrelation(x)
    return float(n * (n + 2) * np.sum(rho**2 / (n - np.arange(1, LAGS + 1))))


def normal_distance(x: Floats) -> float:
    """Kolmogorov and Smirnov's distance between x and N(0, 1)."""
    ordered = np.sort(x)
    normal = np.array([0.5 * (1.0 + math.erf(v / math.sqrt(2.0))) for v in ordered])
    steps = np.arange(len(x) + 1) / len(x)
    return float(max(np.max(steps[1:] - normal), np.max(normal - steps[:-1])))
