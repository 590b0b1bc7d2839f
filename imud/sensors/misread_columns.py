"""Positions and velocities of a file that agree once a column is read otherwise: radians for degrees, exchanged axes.

The displacements of the positions over pieces of the way are compared with the integrals of the velocities, as they
stand and as each other reading of the columns would have them. Where only one of these makes them agree, it is named.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ..math.arrays import Floats, Records
from ..math.earth import MEAN_RADIUS_M

_LONGEST_S, _SLOW_MPS = 3.0, 0.5  # between two fixes; below this speed many receivers hold position or course
_PIECE_M, _PIECES = 30.0, 5  # of the way, and how many are needed: positions are wrong by metres
_DISAGREE, _AGREE = 0.5, 0.2  # squares of the differences in those of the velocities' integrals
_NEAR_0_0 = 0.05  # degrees; simulated data begin at latitude and longitude 0

IN_RADIANS = "lat_deg and lon_deg in radians"
NORTH_EAST_EXCHANGED = "the velocities' north and east exchanged (or a course that counts from east)"
Displacements = tuple[NDArray[np.complex128], NDArray[np.complex128]]  # of positions and velocities, north + i east


def misread_columns(fixes: Records) -> str:
    """What is said of fixes (array of FIX, in order) whose columns have other contents than their names; or empty."""
    north, east = np.degrees(fixes["lat"]), np.degrees(fixes["lon"])
    velocity = _velocity(fixes)
    seconds = np.diff(fixes["t_ns"]) * 1e-9
    mean = 0.5 * (velocity[1:] + velocity[:-1])
    usable = (seconds > 0.0) & (seconds < _LONGEST_S) & (np.abs(mean) > _SLOW_MPS)  # not of NaN
    integrals = np.where(usable, mean * seconds, 0.0)
    pieces = (np.cumsum(np.abs(integrals)) // _PIECE_M).astype(int)

    def difference(displacements: Displacements) -> float:
        """Between positions and velocities; 0: they agree."""
        by_positions, by_velocities = (_sums(np.where(usable, one, 0.0), pieces) for one in displacements)
        return float(np.sum(np.abs(by_positions - by_velocities) ** 2) / np.sum(np.abs(by_velocities) ** 2))

    if pieces.max(initial=0) < _PIECES:
        return _radians_by_place(north, east)
    as_named = _displacements(np.radians(north), np.radians(east))
    if difference((as_named, integrals)) < _DISAGREE:
        return ""
    readings: dict[str, Displacements] = {
        IN_RADIANS: (_displacements(north, east), integrals),
        "lat_deg and lon_deg exchanged": (_displacements(np.radians(east), np.radians(north)), integrals),
        NORTH_EAST_EXCHANGED: (as_named, integrals.imag + 1j * integrals.real),
    }
    best = min(readings, key=lambda name: difference(readings[name]))
    if not difference(readings[best]) < _AGREE:
        return ""
    return f"the positions contradict the velocities, and agree with them with {best}: correct these columns"


def _radians_by_place(lat_deg: Floats, lon_deg: Floats) -> str:
    size = np.maximum(np.abs(lat_deg), np.abs(lon_deg))
    if not len(size) or np.abs(lat_deg).max() > math.pi / 2 or size.max() > math.pi or size.min() < _NEAR_0_0:
        return ""
    return f"all positions are in the Gulf of Guinea, at {lat_deg[0]:.4f}, {lon_deg[0]:.4f}: are {IN_RADIANS}?"


def _velocity(fixes: Records) -> NDArray[np.complex128]:
    """North + i east, m/s; NaN where it is not known."""
    stated = fixes["v"][:, 0] + 1j * fixes["v"][:, 1]
    by_course: NDArray[np.complex128] = fixes["speed"] * np.exp(1j * fixes["course"])
    return np.where(np.isfinite(stated), stated, by_course)


def _displacements(lat: Floats, lon: Floats) -> NDArray[np.complex128]:
    """From each position (rad) to the next, north + i east, m."""
    turn = np.diff(lon)
    east = (turn - math.tau * np.rint(turn / math.tau)) * np.cos(lat[1:])
    return np.diff(lat).astype(complex) * MEAN_RADIUS_M + 1j * MEAN_RADIUS_M * east


def _sums(steps: NDArray[np.complex128], pieces: NDArray[np.int64]) -> NDArray[np.complex128]:
    """Of the steps of each piece."""
    return np.bincount(pieces, steps.real) + 1j * np.bincount(pieces, steps.imag)
