"""An accelerometer's bias, scale and misalignment from positions at rest, in each of which it measures only gravity."""

import math

import numpy as np

from ..math.arrays import Floats, Records
from .rest import Estimate, UnfitError, rest_intervals

FULL = 9  # positions that determine the misalignment, too
_SAME_DEG = 10.0  # positions closer than this are one
_FACE_DEG = 30.0
_ERROR_MAX = 0.2  # bias in g, and scale error: more is another fault


def positions(samples: Records, rate_hz: float) -> Floats:
    """Mean forces (k x 3) in m/s^2 of positions that differ."""
    found: list[Floats] = []
    for interval in rest_intervals(samples, rate_hz):
        force = samples["f"][interval.start : interval.stop].mean(axis=0)
        direction = force / np.linalg.norm(force)
        if all(direction @ other / np.linalg.norm(other) < math.cos(math.radians(_SAME_DEG)) for other in found):
            found.append(force)
    return np.array(found)


def accelerometer(forces: Floats, gravity: float) -> tuple[Estimate, Floats, float]:
    """Bias (3) in m/s^2 and upper triangular matrix (3 x 3) that make |matrix (f - bias)| gravity for `forces` (k x 3).

    Also the root mean square of the residual. Six faces give bias and scale; from nine positions on, the misalignment
    of the axes against each other, too (the sensor's z axis stays where it is). Gauss-Newton on the square. Raises
    UnfitError naming the faces that are missing.
    """
    directions = forces / np.linalg.norm(forces, axis=1, keepdims=True)
    near = math.cos(math.radians(_FACE_DEG))
    faces = [
        (f"{sign}{axis}", s * directions[:, i]) for i, axis in enumerate("xyz") for sign, s in (("+", 1), ("-", -1))
    ]
    if missing := [face for face, cosine in faces if (cosine < near).all()]:
        raise UnfitError(
            f"no position has {', '.join(missing)} up or down within {_FACE_DEG:.0f} deg: put the sensor on "
            "each of its six sides, two seconds or more"
        )
    free = [(0, 0), (1, 1), (2, 2), *([(0, 1), (0, 2), (1, 2)] if len(forces) >= FULL else [])]
    bias, matrix = np.zeros(3), np.eye(3)
    for _ in range(20):
        centred = forces - bias
        corrected = centred @ matrix.T
        residual = (corrected * corrected).sum(axis=1) - gravity**2
        J = np.empty((len(forces), 3 + len(free)))
        J[:, :3] = -2.0 * corrected @ matrix
        for column, (i, j) in enumerate(free):
            J[:, 3 + column] = 2.0 * corrected[:, i] * centred[:, j]
        step = np.linalg.lstsq(J, -residual, rcond=None)[0]
        bias = bias + step[:3]
        for value, (i, j) in zip(step[3:], free, strict=True):
            matrix[i, j] += value
        if np.abs(step).max() < 1e-12:
            break
    residual = np.linalg.norm((forces - bias) @ matrix.T, axis=1) - gravity
    redundancy = max(1, len(forces) - 3 - len(free))
    noise = float(np.sqrt((residual @ residual) / redundancy))
    covariance = np.linalg.pinv(J.T @ J) * (2.0 * gravity * noise) ** 2
    if np.abs(bias).max() > _ERROR_MAX * gravity or np.abs(np.diag(matrix) - 1.0).max() > _ERROR_MAX:
        raise UnfitError("bias or scale are off by more than 20 %: was it at rest every time, and is the unit m/s^2?")
    return Estimate(bias, np.sqrt(np.diag(covariance)[:3])), matrix, float(np.sqrt(np.mean(residual * residual)))
