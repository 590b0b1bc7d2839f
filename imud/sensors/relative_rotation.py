"""The rotation between the axes of two inertial sensors on one body, from what both sense (Wahba's problem, by SVD).

F. L. Markley, "Attitude determination using vector observations and the singular value decomposition", J. Astronautical
Sciences 36 (1988). Two pairs of vectors come from means over windows of time, for rates and forces each: the mean of
all windows, known as well as the biases are, and the deviations from it, in which the biases do not appear. At rest
gravity alone is seen, which leaves the turn about the vertical as it was known before: by the settings, or not at all.
"""

import math
from typing import NamedTuple

import numpy as np

from ..math.arrays import Floats
from ..math.rotation import UNKNOWN_ANGLE

KEPT = 0.995  # of what is known, for each window: a sensor may be moved
FITS = 4.0  # mean squared deviation over its variance up to which the two sense the same but for the rotation
CONTRADICTS = 2.0  # sigmas, of both; little, as the biases, which are most of them, are in both
_LEAST_WINDOWS = 5
_SEEN = 2.0  # times what noise alone adds to the deviations' sum along an axis, from which on they count as motion
_MEAN_SIGMAS = 4.0  # by which a mean exceeds what the biases alone may be, from which on it has a direction


class Rotation(NamedTuple):
    """Turns vectors of the second sensor's axes to the first one's."""

    matrix: Floats
    covariance: Floats  # [3, 3], rad^2, of a small rotation in the first sensor's axes

    @property
    def sigma(self) -> float:
        """Of the axis about which it is known worst, rad."""
        return math.sqrt(float(np.linalg.eigvalsh(self.covariance)[-1]))

    @property
    def angle(self) -> float:
        """By how much it turns, rad."""
        return math.acos(min(max(0.5 * (float(np.trace(self.matrix)) - 1.0), -1.0), 1.0))

    @property
    def inverse(self) -> "Rotation":
        """From the first sensor's axes to the second one's."""
        return Rotation(self.matrix.T, self.matrix.T @ self.covariance @ self.matrix)

    def contradicts(self, other: "Rotation") -> bool:
        """Whether the two cannot be of sensors that sit as before."""
        turn = Rotation(self.matrix @ other.matrix.T, self.covariance + other.covariance)
        if turn.angle > 0.5 * math.pi:
            return True
        m = turn.matrix
        vector = 0.5 * np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
        return float(vector @ np.linalg.solve(turn.covariance, vector)) > CONTRADICTS**2


def better_known(before: Rotation | None, now: Rotation) -> Rotation:
    """Of two estimates of one rotation the one with the lower sigma; `now` if they contradict each other."""
    keep = before is not None and before.sigma < now.sigma and not now.contradicts(before)
    return before if before is not None and keep else now


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

    def profile(self, values: Floats, vectors: Floats) -> Floats:
        """Attitude profile matrix: the sum of b a^T over the variances, of the deviations and of the mean.

        values, vectors: see `motion`.
        """
        seen = vectors[:, values > 0.0]
        of_deviations = self._deviations(self._b, self._a, self._ab) @ seen @ seen.T
        return np.asarray(of_deviations + np.outer(self._b, self._a) * self._of_direction)

    def information(self, values: Floats, vectors: Floats) -> Floats:
        """Of the rotation, in the first sensor's axes, less what noise alone would seem to give."""
        known = vectors @ np.diag(values) @ vectors.T + np.outer(self._a, self._a) * self._of_direction
        return np.asarray(np.eye(3) * np.trace(known) - known)

    def motion(self) -> tuple[Floats, Floats]:
        """Principal values of the deviations' sum, less what noise alone adds; 0 where there is no more; and axes."""
        values, vectors = np.linalg.eigh(self._deviations(self._a, self._a, self._aa))
        return np.where(values > _SEEN * self._count, values - self._count, 0.0), vectors

    def residual(self, turn: Floats) -> float:
        """Squared deviations over their variances that `turn`, from the first to the second axes, leaves."""
        left = self._a2 + self._b2 - 2.0 * float((turn * self._ab).sum())
        mean = self._b - turn @ self._a
        return left - float(mean @ mean) / self._weight + float(mean @ mean) * self._of_mean

    @property
    def _of_mean(self) -> float:
        """Weight of the product of two sums: 1 / variance of a component of the mean, per weight squared."""
        return 1.0 / (self._weight**2 * (self._bias2 + 1.0 / self._weight))

    @property
    def _of_direction(self) -> float:
        """The same; 0 where the mean may be that of the biases alone."""
        return self._of_mean if float(self._a @ self._a) * self._of_mean > _MEAN_SIGMAS**2 else 0.0

    def _deviations(self, b: Floats, a: Floats, products: Floats) -> Floats:
        return np.asarray(products - np.outer(b, a) / self._weight)


class RelativeRotation:
    """Estimates it from windows."""

    def __init__(self, bias2: tuple[float, ...], scale2: float = 0.0) -> None:
        """bias2: variances of the difference of two sensors' biases, of each quantity; scale2: of their scale factors,
        which turn directions when they are not the same on all axes.
        """
        self._quantities = [_Vectors(each) for each in bias2]
        self._scale2, self._windows = scale2, 0
        self._solved: dict[float, Rotation | None] = {}  # by prior sigma, from the windows so far

    def add(self, pairs: list[tuple[Floats, Floats, float]]) -> None:
        """Of one window, for each quantity the means of the first and the second sensor, and as `_Vectors.add`."""
        self._windows += 1
        self._solved.clear()
        for vectors, pair in zip(self._quantities, pairs, strict=True):
            vectors.add(*pair)

    def solve(self, prior_sigma: float = math.inf) -> Rotation | None:
        """The rotation; None while there are too few windows, and where none explains what the sensors sense.

        prior_sigma: rad, about each axis, of there being no rotation.
        """
        if prior_sigma not in self._solved:
            self._solved[prior_sigma] = self._solution(prior_sigma)
        return self._solved[prior_sigma]

    def _solution(self, prior_sigma: float) -> Rotation | None:
        if self._windows < _LEAST_WINDOWS:
            return None
        known_before = prior_sigma**-2
        seen = [(each, each.motion()) for each in self._quantities]
        profile = sum((each.profile(*motion) for each, motion in seen), 0.5 * known_before * np.eye(3))
        u, _, vt = np.linalg.svd(profile)
        turn = u @ np.diag((1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt))) @ vt
        kept = (1.0 - KEPT**self._windows) / (1.0 - KEPT)
        if sum(each.residual(turn) for each in self._quantities) > FITS * 3.0 * kept * len(self._quantities):
            return None
        information = sum((each.information(*motion) for each, motion in seen), known_before * np.eye(3))
        values, vectors = np.linalg.eigh(information)
        variances = 1.0 / np.maximum(values, UNKNOWN_ANGLE**-2) + self._scale2
        return Rotation(turn.T, vectors @ np.diag(variances) @ vectors.T)
