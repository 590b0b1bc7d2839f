"""A receiver's fix and its uncertainty as a solution, while there is no inertial sensor."""

import math

import numpy as np
from numpy.typing import NDArray

from ..estimators.records import HEIGHT_VALID, POSITION_VALID, SOLUTION
from ..outputs.view import NO_SOLUTION
from ..sensors.gnss import navigation_parameters, position_sigma


def solution(fix: NDArray[np.void]) -> NDArray[np.void]:
    """fix: an array of one FIX. Returns an array of one SOLUTION, with the velocity over ground and no attitude."""
    row = np.frombuffer(NO_SOLUTION, SOLUTION).copy()
    for name in ("t_ns", "lat", "lon", "height"):
        row[name] = fix[name]
    row["status"] = POSITION_VALID | (HEIGHT_VALID if math.isfinite(fix["height"][0]) else 0)
    row["sigma_p"] = position_sigma(fix[0])
    first, sigma_v = fix.view(np.recarray)[0], navigation_parameters().tuning.max_velocity_sigma
    course = first.course if first.speed > 0.0 else 0.0
    row["v"] = first.speed * math.cos(course), first.speed * math.sin(course), math.nan
    row["sigma_v"] = sigma_v, sigma_v, math.nan
    return row
