"""A receiver's fix and its uncertainty as a solution, while there is no inertial sensor."""

import math

import numpy as np
from numpy.typing import NDArray

from ..compile.jit import interpreted
from ..configuration.settings import Settings
from ..estimators.ins.aiding.gnss_noise import horizontal_sigma
from ..estimators.ins.parameters import configure
from ..estimators.records import HEIGHT_VALID, POSITION_VALID, SOLUTION
from ..outputs.view import NO_SOLUTION


def solution(fix: NDArray[np.void]) -> NDArray[np.void]:
    """fix: an array of one FIX. Returns an array of one SOLUTION, with the velocity over ground and no attitude."""
    row = np.frombuffer(NO_SOLUTION, SOLUTION).copy()
    for name in ("t_ns", "lat", "lon", "height"):
        row[name] = fix[name]
    row["status"] = POSITION_VALID | (HEIGHT_VALID if math.isfinite(fix["height"][0]) else 0)
    first = fix.view(np.recarray)[0]
    parameters = configure(Settings(), 1.0).view(np.recarray)[0]
    tuning = parameters.tuning
    horizontal = interpreted(horizontal_sigma)(parameters, first)
    row["sigma_p"] = (
        horizontal,
        horizontal,
        first.sigma[2] if math.isfinite(first.sigma[2]) else tuning.vertical_ratio * horizontal,
    )
    course = first.course if first.speed > 0.0 else 0.0
    row["v"] = first.speed * math.cos(course), first.speed * math.sin(course), math.nan
    row["sigma_v"] = tuning.max_velocity_sigma, tuning.max_velocity_sigma, math.nan
    return row
