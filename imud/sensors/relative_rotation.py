"""The rotation between the axes of two inertial sensors on one body, from what both sense (Wahba's problem, by SVD).

F. L. Markley, "Attitude determination using vector observations and the singular value decomposition", J. Astronautical
Sciences 36 (1988). Two pairs of vectors come from means over windows of time, for rates and forces each: the mean of
all windows, known as well as the biases are, and the deviations from it, in which the biases do not appear. At rest
gravity alone is seen, which leaves the turn about the vertical unknown: then the sigma is infinite.
"""

import math
from typing import NamedTuple

import numpy as np

from ..math.arrays import Floats

KEPT = 0.995  # of what is known, for each window: a sensor may be moved
FITS = 4.0  # mean squared deviation over its variance up to which the two sense the same but for the rotation
_LEAST_WINDOWS = 5


class Rotation(NamedTuple):
    """Turns vectors of the second sensor's axes to the first one's."""

    matrix: Floats
    sigma: float  # rad, of the axis about which it is known worst

    @property
    def angle(self) -> float:
        """By how much it turns, rad."""
        return math.acos(min(max(0.5 * (float(np.trace(self.matrix)) - 1.0), -1.0), 1.0))


class _Vectors:
    """Weighted sums of pairs of vectors of one quantity; bias2: variance of the difference of the biases."""

    def __init__(self, bias2: float) -> None:
        self._bias2 = bias2
        self._count = self._weight = self._a2 = self._b2 = 0.0
        self._a, self._b, self._ab, self._aa = np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))

    def add(self, a: Floats, b: Floats, variance: float) -> None:
        """A pair of means over one window, and the variance of a component of their difference, biases apart."""
        for name in ("_count", "_weight", "_a2", "_b2", "_a", "_b", "_ab", "_aa"):
            setattr(self, name, KEPT * getattr(self, name))
        weight = 1.0 / variance
        self._count += 1.0
        self._weight += weight
        self._a, self._b = self._a + weight * a, self._b + weight * b
        self._a2, self._b2 = self._a2 + weight * float(a @ a), self._b2 + weight * float(b @ b)
        self._ab, self._aa = self._ab + weight * np.outer(b, a), self._aa + weight * np.outer(a, a)

    def profile(self) -> Floats:
        """Attitude profile matrix: the sum of b a^T over the variances, of the deviations and of the mean."""
        return self._deviations(self._b, self._a, self._ab) + np.outer(self._b, self._a) * self._of_mean

    def information(self) -> Floats:
        """Of the rotation, in the first sensor's axes, less what noise alone would seem to tell."""
        values, vectors = np.linalg.eigh(self._deviations(self._a, self._a, self._aa))
        known = vectors @ np.diag(np.maximum(values - self._count, 0.0)) @ vectors.T
        known += np.outer(self._a, self._a) * self._of_mean
        return np.asarray(np.eye(3) * np.trace(known) - known)

    def residual(self, turn: Floats) -> float:
        """Squared deviations over their variances that `turn`, from the first to the second axes, leaves."""
        left = self._a2 + self._b2 - 2.0 * float((turn * self._ab).sum())
        mean = self._b - turn @ self._a
        return left - float(mean @ mean) / self._weight + float(mean @ mean) * self._of_mean

    @property
    def _of_mean(self) -> float:
        """Weight of the product of two sums: 1 / variance of a component of the mean, per weight squared."""
        return 1.0 / (self._weight**2 * (self._bias2 + 1.0 / self._weight))

    def _deviations(self, b: Floats, a: Floats, products: Floats) -> Floats:
        return np.asarray(products - np.outer(b, a) / self._weight)


class RelativeRotation:
    """Estimates it from windows. bias2: variances of the difference of two sensors' biases, of each quantity."""

    def __init__(self, bias2: tuple[float, ...]) -> None:
        self._quantities = [_Vectors(each) for each in bias2]
        self._windows = 0

    def add(self, pairs: list[tuple[Floats, Floats, float]]) -> None:
        """Of one window, for each quantity the means of the first and the second sensor, and as `_Vectors.add`."""
        self._windows += 1
        for vectors, pair in zip(self._quantities, pairs, strict=True):
            vectors.add(*pair)

    def solve(self) -> Rotation | None:
        """The rotation; None while there are too few windows, and where none explains what the sensors sense."""
        if self._windows < _LEAST_WINDOWS:
            return None
        u, _, vt = np.linalg.svd(sum(each.profile() for each in self._quantities))
        turn = u @ np.diag((1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt))) @ vt
        kept = (1.0 - KEPT**self._windows) / (1.0 - KEPT)
        if sum(each.residual(turn) for each in self._quantities) > FITS * 3.0 * kept * len(self._quantities):
            return None
        least = float(np.linalg.eigvalsh(sum(each.information() for each in self._quantities))[0])
        return Rotation(turn.T, 1.0 / math.sqrt(least) if least > 0.0 else math.inf)
