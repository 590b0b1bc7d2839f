"""A receiver's fix as a solution, while there is no inertial sensor: what the receiver says, and its uncertainty."""

import math

import numpy as np
from numpy.typing import NDArray

from ..compile.jit import interpreted
from ..estimators.ins.aiding.gnss_noise import VELOCITY_SIGMA_RANGE, VERTICAL_RATIO, horizontal_sigma
from ..estimators.records import POSITION_VALID, SOLUTION
from ..outputs.view import NO_SOLUTION


def solution(fix: NDArray[np.void]) -> NDArray[np.void]:
    """fix: an array of one FIX. Returns an array of one SOLUTION, with the velocity over ground and no attitude."""
    row = np.frombuffer(NO_SOLUTION, SOLUTION).copy()
    for name in ("t_ns", "lat", "lon", "height"):
        row[name] = fix[name]
    row["status"] = POSITION_VALID
    told = fix.view(np.recarray)[0]
    horizontal = interpreted(horizontal_sigma)(told)
    row["sigma_p"] = (
        horizontal,
        horizontal,
        told.sigma[2] if math.isfinite(told.sigma[2]) else VERTICAL_RATIO * horizontal,
    )
    course = told.course if told.speed > 0.0 else 0.0
    row["v"] = told.speed * math.cos(course), told.speed * math.sin(course), math.nan
    row["sigma_v"] = VELOCITY_SIGMA_RANGE[1], VELOCITY_SIGMA_RANGE[1], math.nan
    return row
