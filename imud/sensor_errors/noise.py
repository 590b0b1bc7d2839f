"""The noise coefficients of an Allan deviation: random walk N, bias instability B, rate random walk K.

The model is sigma^2(tau) = N^2/tau + (2 ln 2/pi) B^2 + K^2 tau/3 (IEEE Std 952-2020, annex C.1), fitted by generalised
least squares with coefficients that are not negative. The covariance of the overlapping estimates at two times follows
from the spectrum of the model itself, so that their correlation is counted. A coefficient that is not two sigma above
zero is an upper bound: the recording is too short, or another noise hides it.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..compile.entry import entry
from ..math.allan import allan_variance, integrated
from ..math.arrays import Floats

PER_OCTAVE = 4  # points of the curve; every fourth is fitted
_CLUSTERS_MIN = 9  # of the longest time
_FLICKER = 2.0 * math.log(2.0) / math.pi
_ROUNDS = 6  # of weighting anew by the fitted model
_SIGNIFICANT = 2.0  # sigma
_FREQUENCIES = 4000  # of the integrals over the spectrum


@dataclass(frozen=True)
class Coefficient:
    """A value with its 1 sigma, or an upper bound (95 %) if `bound`."""

    value: float
    sigma: float
    bound: bool


@dataclass(frozen=True)
class AllanDeviation:
    """Of one axis: tau (n) in s; deviation (n) and its 1 sigma (n) in the rate's unit; N, B, K and their curve (n)."""

    tau: Floats
    deviation: Floats
    sigma: Floats
    random_walk: Coefficient  # unit/sqrt(Hz)
    instability: Coefficient  # unit
    rate_walk: Coefficient  # unit/sqrt(s)
    fitted: Floats


@entry
def allan_variances(rate: Floats, angle: Floats, sizes: NDArray[np.int64], out: Floats) -> None:
    """Allan variances of `rate` for clusters of `sizes` samples; angle: room for one value more than `rate` has."""
    integrated(rate, angle)
    for i in range(len(sizes)):
        out[i] = allan_variance(angle, sizes[i])


def allan_deviation(rate: Floats, rate_hz: float) -> AllanDeviation:
    """The overlapping Allan deviation of `rate` (n), sampled `rate_hz` times a second. Raises ValueError if n < 64."""
    n = len(rate)
    if n < 64:
        raise ValueError(f"{n} samples; an Allan deviation needs at least 64")
    octaves = math.floor(math.log2(n / _CLUSTERS_MIN) * PER_OCTAVE)
    sizes = np.unique(np.rint(2.0 ** (np.arange(octaves + 1) / PER_OCTAVE)).astype(np.int64))
    variance = np.empty(len(sizes))
    allan_variances(np.require(rate, float, ["C", "W"]), np.empty(n + 1), sizes, variance)
    fitted = [int(np.argmin(np.abs(sizes - 2**k))) for k in range(int(math.log2(sizes[-1])) + 1)]
    values, covariance = _fit(sizes[fitted], variance[fitted], n, rate_hz)
    tau, deviation = sizes / rate_hz, np.sqrt(variance)
    sigma = np.sqrt(np.diag(_covariance(sizes, _gains(sizes, n, rate_hz), values, n, rate_hz))) / (2.0 * deviation)
    n_, b, k = (_coefficient(values[i], math.sqrt(covariance[i, i])) for i in range(3))
    return AllanDeviation(tau, deviation, sigma, n_, b, k, np.sqrt(_terms(tau) @ values))


def _terms(tau: Floats) -> Floats:
    """The factors of N^2, B^2 and K^2 in the model (n x 3)."""
    return np.stack([1.0 / tau, np.full_like(tau, _FLICKER), tau / 3.0], axis=1)


def _frequencies(n: int, rate_hz: float) -> Floats:
    return np.geomspace(0.1 * rate_hz / n, 0.5 * rate_hz, _FREQUENCIES)


def _gains(sizes: NDArray[np.int64], n: int, rate_hz: float) -> Floats:
    """Half the squared gains, at `_frequencies`, of the filters whose mean squares the Allan variances are."""
    x = math.pi * _frequencies(n, rate_hz) / rate_hz
    return np.asarray((np.sin(np.outer(sizes, x)) ** 2 / (sizes[:, None] * np.sin(x))) ** 2)


def _covariance(sizes: NDArray[np.int64], gains: Floats, values: Floats, n: int, rate_hz: float) -> Floats:
    """Of overlapping Allan variances over clusters of `sizes`, from `n` samples of noise with N^2, B^2, K^2 `values`.

    A squared Gaussian process of one-sided spectrum G, averaged over T, has the variance (1/T) integral of G^2 df; here
    G is the noise's spectrum behind the filter whose mean square the Allan variance is, of `gains`.
    """
    f = _frequencies(n, rate_hz)
    noise = 2.0 * values[0] + values[1] / (math.pi * f) + values[2] / (2.0 * math.pi**2 * f * f)
    filtered = noise * np.sqrt(np.gradient(f)) * 2.0 * gains
    duration = (n + 1 - 2 * sizes) / rate_hz
    return np.asarray(filtered @ filtered.T / np.sqrt(np.outer(duration, duration)))


def _fit(sizes: NDArray[np.int64], variance: Floats, n: int, rate_hz: float) -> tuple[Floats, Floats]:
    """N^2, B^2, K^2, none negative, and their covariance."""
    terms, gains = _terms(sizes / rate_hz), _gains(sizes, n, rate_hz)
    values = np.array([variance[0] * sizes[0] / rate_hz, 0.0, 0.0])  # white, to begin with
    for _ in range(_ROUNDS):
        whiten = np.linalg.inv(np.linalg.cholesky(_covariance(sizes, gains, values, n, rate_hz)))
        values = _not_negative(whiten @ terms, whiten @ variance)
    scaled = whiten @ terms
    size = np.sqrt((scaled * scaled).sum(axis=0))
    return values, np.linalg.inv((scaled / size).T @ (scaled / size)) / np.outer(size, size)


def _not_negative(A: Floats, b: Floats) -> Floats:
    """argmin |A x - b| with x >= 0, for three unknowns: the best of all subsets that fulfil it."""
    best, least = np.zeros(3), float(b @ b)
    size = np.sqrt((A * A).sum(axis=0))
    for count in (1, 2, 3):
        for chosen in itertools.combinations(range(3), count):
            part = list(chosen)
            x = np.linalg.lstsq(A[:, part] / size[part], b, rcond=None)[0] / size[part]
            residual = A[:, part] @ x - b
            if (x >= 0.0).all() and float(residual @ residual) < least:
                best, least = np.zeros(3), float(residual @ residual)
                best[part] = x
    return best


def _coefficient(square: float, sigma: float) -> Coefficient:
    """The root of a fitted square with its 1 sigma; an upper bound if the square may be zero."""
    if square < _SIGNIFICANT * sigma:
        return Coefficient(math.sqrt(square + _SIGNIFICANT * sigma), math.nan, True)
    return Coefficient(math.sqrt(square), 0.5 * sigma / math.sqrt(square), False)
