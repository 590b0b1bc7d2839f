"""The frames of REP-105: the body in `map` by the filter, in `odom` by dead reckoning from the filter's velocity.

`map` jumps when a fix corrects the filter and does not drift; `odom` drifts and does not jump. The sensor's axes are
those of the body, as its samples are turned by the mounting, and the filter's position is that of the sensor.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..estimators.records import POSITION_VALID
from ..math.arrays import Floats, Records
from ..math.rotation import Quaternion, Vector
from ..recording.enu import LocalMap
from .reckoning import MOTION, RECKONING, follow_body

Transform = tuple[Vector, Quaternion]  # of a child in its parent: place, and the rotation of vectors into the parent
IDENTITY: Transform = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)


class Motion(NamedTuple):
    """Of the body through n solutions. Places (n x 3), m; transforms (n x 7): place and quaternion, scalar first."""

    is_placed: NDArray[np.bool_]  # whether the place in the map is known
    place: Floats
    is_known: NDArray[np.bool_]  # whether the transforms are
    map_to_odom: Floats
    odom_to_body: Floats


class Frames:
    """Follows the body through solutions in order of time."""

    def __init__(self) -> None:
        self._plane = LocalMap()
        self._state = np.zeros(1, RECKONING)
        for name in ("map_to_odom", "odom_to_body"):
            self._state["frames"][name] = IDENTITY

    def step(self, solutions: Records) -> Motion:
        """The next rows of SOLUTION."""
        is_placed = (solutions["status"] & POSITION_VALID) != 0
        motions = np.zeros(len(solutions), MOTION)
        motions["place"] = np.nan
        if is_placed.any():
            position = (solutions[name][is_placed] for name in ("lat", "lon", "height"))
            motions["place"][is_placed] = self._plane.places(*position)
        follow_body(self._state, np.ascontiguousarray(solutions), motions)
        transforms = motions["frames"].view((float, 14))
        return Motion(is_placed, motions["place"], motions["is_known"] != 0, transforms[:, :7], transforms[:, 7:])
