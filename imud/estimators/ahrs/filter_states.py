"""Where the attitude filter keeps what `estimators.filter_states` names: scale factors, the accelerometer's delay."""

import math

import numpy as np

from ...filter_state_names import PLACES
from ...math.arrays import Floats, Records
from ...math.rotation import UNKNOWN_ANGLE
from ..filter_states import ATTITUDE_BLOCK, FILTER_STATES, in_triangle
from .state import ACCEL_DELAY, ACCEL_SCALE, ATTITUDE, GYRO_MATRIX, STATES, VELOCITY

_AXES = "xyz"
_ERROR_STATES = np.r_[GYRO_MATRIX : GYRO_MATRIX + 9, ACCEL_SCALE : ACCEL_SCALE + 3, ACCEL_DELAY]
_NAMES = (  # of these; the gyro's matrix is kept by rows
    *(f"gyro_scale_{row}{column}" for row in _AXES for column in _AXES),
    *(f"accel_scale_{axis}" for axis in _AXES),
    "accel_delay",
)
_NAMED = np.array([PLACES[name] for name in _NAMES])
_IN_P = in_triangle(STATES)
_ATTITUDE = slice(ATTITUDE, ATTITUDE + 3)
_MOTION = np.r_[_ATTITUDE, VELOCITY : VELOCITY + 3]


def attitude(state: Records) -> Floats:
    """See `Estimator`."""
    q_nb: Floats = state[0]["nav"]["q_nb"]
    return q_nb


def filter_states(state: Records) -> Records:
    """See `Estimator`. An error state is estimated once the motion has correlated it with attitude or velocity."""
    s = state[0]
    rows = np.zeros(1 if s["sample_count"] else 0, FILTER_STATES)
    for row in rows:
        P, nav = s["cov"]["P"], s["nav"]
        row["t_ns"] = s["t_ns"]
        for name in ("covariance", "value", "sigma"):
            row[name] = math.nan
        scale = np.append(s["variance_factor"]["tilt_scale"], 1.0)
        attitude_covariance = np.outer(scale, scale) * P[_IN_P[_ATTITUDE, _ATTITUDE]]
        row["covariance"][ATTITUDE_BLOCK] = attitude_covariance + np.diag(_beyond(s["cov"], attitude_covariance))
        estimated = (P[_IN_P[_ERROR_STATES[:, None], _MOTION]] != 0.0).any(axis=1)
        values = np.hstack([nav["gyro_matrix"], nav["accel_scale"], nav["accel_delay"]])
        row["value"][_NAMED[estimated]] = values[estimated]
        variances = P[np.diag(_IN_P)[_ERROR_STATES[estimated]]]
        row["sigma"][_NAMED[estimated]] = np.sqrt(np.maximum(variances, 0.0))
    return rows


def _beyond(cov: np.void, attitude_covariance: Floats) -> Floats:
    """What the solution's sigmas have beyond P, rad^2 about north, east, down; in all no more than unknown."""
    unseen = np.array([cov["unseen_tilt"], cov["unseen_tilt"], cov["unseen_yaw"]])
    return np.clip(UNKNOWN_ANGLE**2 - np.diag(attitude_covariance), 0.0, unseen**2)
