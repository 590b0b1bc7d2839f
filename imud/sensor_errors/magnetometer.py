"""Hard and soft iron of a magnetometer where it is mounted: the ellipsoid on which its readings lie is made a sphere.

field = A (measured - b), with b the hard iron and A, symmetric, the soft iron and the sensor's scale and misalignment:
the readings of all directions have the strength of the earth's field. A rotation of the sensor against the vehicle's
axes leaves no trace in strengths, and is not found.

b and A minimize the sum of (|A (measured - b)| - strength)^2, by Gauss and Newton, beginning at the sphere that fits
best. Source: Gebre-Egziabher et al., Calibration of strapdown magnetometers in magnetic field domain, J. Aerosp. Eng.
19 (2006); the sphere: Coope, Circle fitting by linear and nonlinear least squares, JOTA 76 (1993).
"""

from typing import NamedTuple

import numpy as np

from ..math.arrays import Floats
from .rest import UnfitError

REMAINING_T = 1.5e-6  # what a calibration leaves at least: iron moves, and warms up
LEAST_READINGS = 100
LEAST_COVERAGE = 0.8  # of all directions
NEAR_DEG = 30.0  # a direction is covered by a reading that is so near
MOST_RESIDUAL = 0.05  # of the strength
_DIRECTIONS, _ROUNDS = 300, 50
_ADVICE = "turn the vehicle, or what the sensor is mounted on, slowly about all its axes, each side down once"


class Iron(NamedTuple):
    """What was found. bias: hard iron, T; matrix: A; residual: of the strengths, T, root mean square.

    sigma: of a component of the corrected field, T: the residual and the uncertainty of the bias.
    """

    bias: Floats
    matrix: Floats
    residual: float
    sigma: float
    coverage: float


def directions(n: int = _DIRECTIONS) -> Floats:
    """n unit vectors [n, 3], evenly spread: a Fibonacci lattice."""
    k = np.arange(n) + 0.5
    z, azimuth = 1.0 - 2.0 * k / n, np.pi * (1.0 + np.sqrt(5.0)) * k
    level = np.sqrt(1.0 - z * z)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), z], axis=1)


def coverage(vectors: Floats) -> float:
    """Share of all directions that are within `NEAR_DEG` of one of the vectors [n, 3]."""
    units = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    nearest = [(units @ direction).max() for direction in directions()]
    return float(np.mean(np.array(nearest) > np.cos(np.radians(NEAR_DEG))))


def sphere(fields: Floats) -> tuple[Floats, float]:
    """Centre and radius of the sphere that fits points [n, 3] best, by linear least squares."""
    middle, scale = fields.mean(axis=0), float(fields.std()) or 1.0
    points = (fields - middle) / scale
    solution = np.linalg.lstsq(np.column_stack([2.0 * points, np.ones(len(points))]), (points**2).sum(axis=1))[0]
    centre = solution[:3]
    return middle + scale * centre, scale * float(np.sqrt(max(solution[3] + centre @ centre, 0.0)))


def _symmetric(six: Floats) -> Floats:
    xx, yy, zz, xy, xz, yz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _residuals(x: Floats, points: Floats) -> tuple[Floats, Floats]:
    """|A (p - b)| - 1, and its derivatives [n, 9] by b and the six elements of A."""
    d, matrix = points - x[:3], _symmetric(x[3:])
    v = d @ matrix
    length = np.linalg.norm(v, axis=1)
    u = v / length[:, None]
    by_matrix = np.stack(
        [u[:, i] * d[:, j] + (u[:, j] * d[:, i] if i != j else 0.0) for i, j in _PAIRS],
        axis=1,
    )
    return length - 1.0, np.column_stack([-u @ matrix, by_matrix])


_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def iron(fields: Floats, strength: float | None = None) -> Iron:
    """Hard and soft iron from readings [n, 3], T. strength: of the earth's field, T; None: the mean scale is right.

    Raises UnfitError for readings that do not suffice.
    """
    fields = fields[np.isfinite(fields).all(axis=1)]
    if len(fields) < LEAST_READINGS:
        raise UnfitError(f"{len(fields)} readings of a magnetometer; {LEAST_READINGS} are needed: {_ADVICE}")
    centre, radius = sphere(fields)
    if not radius > 0.0:
        raise UnfitError(f"all readings of the magnetometer are the same: {_ADVICE}")
    _check_coverage(fields - centre)
    points = (fields - centre) / radius
    x = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    for _ in range(_ROUNDS):
        residuals, jacobian = _residuals(x, points)
        step = np.linalg.lstsq(jacobian, -residuals)[0]
        x = x + step
        if not np.abs(x).max() < 10.0:
            raise UnfitError(f"no ellipsoid fits the readings of the magnetometer: {_ADVICE}")
        if np.abs(step).max() < 1e-10:
            break
    residuals, jacobian = _residuals(x, points)
    covered = _check_coverage((points - x[:3]) @ _symmetric(x[3:]))
    share = float(np.sqrt(np.mean(residuals**2)))
    if share > MOST_RESIDUAL:
        raise UnfitError(
            f"the strengths differ by {100.0 * share:.1f} % still, at most {100.0 * MOST_RESIDUAL:.0f} % are allowed: "
            "keep away from iron and running motors, or calibrate with the motors as they run"
        )
    # neighbouring readings err alike: so many know something of their own as directions within NEAR_DEG differ
    independent = min(len(fields), round(2.0 / (1.0 - np.cos(np.radians(NEAR_DEG)))))
    covariance = np.linalg.inv(jacobian.T @ jacobian) * (len(fields) / independent) * share**2
    matrix = _symmetric(x[3:])
    mean_scale = float(np.cbrt(np.linalg.det(matrix)))
    found = strength if strength is not None else radius / mean_scale  # of the points: 1
    residual = share * found
    bias_sigma = radius * float(np.sqrt(np.mean(np.diag(covariance)[:3])))
    return Iron(
        centre + radius * x[:3], matrix * (found / radius), residual, float(np.hypot(residual, bias_sigma)), covered
    )


def _check_coverage(vectors: Floats) -> float:
    covered = coverage(vectors)
    if covered < LEAST_COVERAGE:
        raise UnfitError(
            f"the readings cover {100.0 * covered:.0f} % of all directions, {100.0 * LEAST_COVERAGE:.0f} % are needed: "
            f"{_ADVICE}"
        )
    return covered
