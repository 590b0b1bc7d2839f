"""Where the reduced inertial estimator keeps what `estimators.filter_states` names, and what it knows of the wheels."""

import math

import numpy as np

from ...filter_state_names import PLACES
from ...math.arrays import Records
from ..filter_states import FILTER_STATES, in_triangle
from ..records import ODOMETER_SOURCE
from .state import FIX_NORTH, GYRO_SCALE, NORTH, STATES, TIME_OFFSET, WHEEL_SCALE

_IN_P = in_triangle(STATES)
_DIAGONAL = np.diag(_IN_P)
_POSITION = slice(NORTH, NORTH + 3)
_POSITION_BLOCK = in_triangle(9)[:3, :3]  # in `covariance`
_OF_FIXES = [PLACES[f"gnss_bias_{axis}"] for axis in "ned"]
_NOISE = [PLACES[name] for name in ("gnss_noise_horizontal", "gnss_velocity_noise", "gnss_noise_vertical")]


def filter_states(state: Records) -> Records:
    """See `Estimator`. The wheels' scale is estimated once there was a reading, the gyro's with the heading."""
    s = state[0]
    rows = np.zeros(1 if s["started"] else 0, FILTER_STATES)
    for row in rows:
        row["t_ns"] = s["step_ns"]
        for name in ("covariance", "value", "sigma"):
            row[name] = math.nan
        if s["fix_count"]:
            row["covariance"][_POSITION_BLOCK] = s["P"][_IN_P[_POSITION, _POSITION]]
            row["value"][_OF_FIXES] = s["x"][FIX_NORTH : FIX_NORTH + 3]
            row["sigma"][_OF_FIXES] = np.sqrt(s["P"][_DIAGONAL[FIX_NORTH : FIX_NORTH + 3]])
            row["value"][_NOISE] = np.sqrt(s["white_var"])
        for name, i, known in (
            ("gyro_scale_zz", GYRO_SCALE, s["aligned"]),
            ("odometer_scale", WHEEL_SCALE, s["wheel_ns"]),
            ("time_offset", TIME_OFFSET, s["fix_count"]),
        ):
            if known:
                row["value"][PLACES[name]], row["sigma"][PLACES[name]] = s["x"][i], math.sqrt(s["P"][_DIAGONAL[i]])
    return rows


def source_estimates(state: Records) -> dict[int, dict[str, float | str]]:
    """See `Estimator`."""
    s = state[0]
    if not s["wheel_ns"]:
        return {}
    scale, sigma = 1.0 + float(s["x"][WHEEL_SCALE]), math.sqrt(s["P"][_DIAGONAL[WHEEL_SCALE]])
    return {ODOMETER_SOURCE: {"scale": round(scale, 5), "sscale": sigma}}
