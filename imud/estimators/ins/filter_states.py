"""Where the navigation filter keeps what `estimators.filter_states` names, and when it estimates it at all."""

import math

import numpy as np

from ...compile.jit import interpreted
from ...filter_state_names import PLACES
from ...math.arrays import Floats, Records
from ...math.rotation import euler_of_quat
from ..filter_states import FILTER_STATES, in_triangle
from ..records import BODY_VELOCITY_SOURCE, HEADING_SOURCE, ODOMETER_SOURCE, POSE_SOURCE, VELOCITY_SOURCE
from .state import (
    ATTITUDE,
    BARO_OFFSET,
    GNSS_BIAS,
    GNSS_LEVER_ARM,
    GNSS_VELOCITY_BIAS,
    GYRO_SCALE,
    HEADING_BORESIGHT,
    LEARNING_STATES,
    MOUNT_PITCH,
    NEVER_NS,
    NHC_LEVER_ARM,
    ODOMETER_SCALE,
    STATES,
    TIME_OFFSET,
    VELOCITY_BORESIGHT,
    VELOCITY_TIME_OFFSET,
)

_KINDS = (  # name of the first of a kind, field of NAV, first error state, how many
    ("time_offset", "time_offset", TIME_OFFSET, 1),
    ("velocity_time_offset", "velocity_time_offset", VELOCITY_TIME_OFFSET, 1),
    ("gnss_bias_n", "gnss_bias", GNSS_BIAS, 3),
    ("gnss_velocity_bias_n", "gnss_velocity_bias", GNSS_VELOCITY_BIAS, 3),
    ("gnss_lever_arm_x", "gnss_lever_arm", GNSS_LEVER_ARM, 3),
    ("nhc_lever_arm", "nhc_lever_arm", NHC_LEVER_ARM, 1),
    ("gyro_scale_xx", "gyro_scale", GYRO_SCALE, 9),
    ("odometer_scale", "odometer_scale", ODOMETER_SCALE, 1),
    ("baro_offset", "baro_offset", BARO_OFFSET, 1),
)
_NAMED = np.array([PLACES[name] + k for name, _, _, count in _KINDS for k in range(count)])
_ERROR_STATES = np.array([first + k for _, _, first, count in _KINDS for k in range(count)])
# the error states whose correlation with the motion says that one is estimated: of the velocity's offset that of the
# velocity's bias, as positions alone correlate it, too
_SHOWN_BY = np.where(_ERROR_STATES == VELOCITY_TIME_OFFSET, GNSS_VELOCITY_BIAS, _ERROR_STATES)
_AGES = {
    "age_heading": HEADING_SOURCE,
    "age_odometer": ODOMETER_SOURCE,
    "age_pose": POSE_SOURCE,
    "age_velocity": VELOCITY_SOURCE,
    "age_body_velocity": BODY_VELOCITY_SOURCE,
}
_IN_P = in_triangle(STATES)
_DIAGONAL = np.diag(_IN_P)
_ROWS, _COLUMNS = np.triu_indices(LEARNING_STATES)  # of the packed block of position, velocity and attitude
_PACKED_MOTION = _IN_P[_ROWS, _COLUMNS]
_VARIANCES = np.flatnonzero(_ROWS == _COLUMNS)


def attitude(state: Records) -> Floats:
    """See `Estimator`."""
    q_nb: Floats = state["core"][0, 0]["nav"]["q_nb"]
    return q_nb


def filter_states(state: Records) -> Records:
    """See `Estimator`. An error state is estimated once a measurement has correlated it with the motion."""
    c = state["core"][0, 0]
    rows = np.zeros(1 if c["imu"]["sample_count"] else 0, FILTER_STATES)
    for row in rows:
        P = c["cov"]["P"]
        row["t_ns"], row["value"], row["sigma"] = c["nav"]["t_ns"], math.nan, math.nan
        row["covariance"] = _covariance(c, P)
        _fill_error_states(row, c, P)
        _fill_mounting(row, c, P)
        _fill_noise(row, c)
        _fill_ages(row, state["source_ages"][0])
        if (heading_variance := c["cov"]["boresight_covariance"][HEADING_BORESIGHT, HEADING_BORESIGHT]) > 0.0:
            _set(row, "heading_boresight", c["heading_aid"]["boresight"], heading_variance)
        for name, angle, variance in velocity_mounting(c):
            _set(row, name, angle, variance)
    return rows


def _covariance(c: np.void, P: Floats) -> Floats:
    """That of position, velocity and attitude, with what the solution's sigmas have beyond P on its diagonal."""
    packed: Floats = P[_PACKED_MOTION]
    stated = c["scratch"]["stated_variances"][:LEARNING_STATES]  # P is newer if there was a fix since then
    packed[_VARIANCES] = np.maximum(packed[_VARIANCES], stated)
    if c["gnss"]["fix_count"] == 0:
        packed[_ROWS < ATTITUDE] = math.nan
    return packed


def _fill_error_states(row: np.void, c: np.void, P: Floats) -> None:
    estimated = (P[_IN_P[_SHOWN_BY, :LEARNING_STATES]] != 0.0).any(axis=1)
    if not c["nhc"]["enabled"]:
        estimated &= _ERROR_STATES != NHC_LEVER_ARM
    values = np.hstack([c["nav"][field] for _, field, _, _ in _KINDS])
    places = _NAMED[estimated]
    row["value"][places] = values[estimated]
    row["sigma"][places] = np.sqrt(np.maximum(P[_DIAGONAL[_ERROR_STATES[estimated]]], 0.0))
    if np.isfinite(row["value"][PLACES["gnss_velocity_bias_n"]]):
        row["value"][PLACES["gnss_velocity_noise"]] = math.sqrt(c["gnss"]["velocity_noise_var"])


def _fill_mounting(row: np.void, c: np.void, P: Floats) -> None:
    """Pitch and yaw of the forward axis, from that axis and its errors: rotations about the lateral and vertical."""
    (fx, fy, fz), (lx, ly, lz) = c["nav"]["forward"].tolist(), c["nav"]["lateral"].tolist()
    level2 = fx * fx + fy * fy
    if not (c["nhc"]["enabled"] or c["odometer"]["last_used_ns"] != NEVER_NS) or level2 == 0.0:
        return
    ux, uy, uz = fy * lz - fz * ly, fz * lx - fx * lz, fx * ly - fy * lx  # vertical
    pitch = uz / math.sqrt(level2), -lz / math.sqrt(level2)  # by the errors MOUNT_PITCH and MOUNT_YAW
    yaw = (fy * ux - fx * uy) / level2, (fx * ly - fy * lx) / level2
    pp, py, yy = (P[_IN_P[MOUNT_PITCH + i, MOUNT_PITCH + k]] for i, k in ((0, 0), (0, 1), (1, 1)))
    angles = math.atan2(-fz, math.sqrt(level2)), math.atan2(fy, fx)
    for name, angle, (a, b) in zip(("mount_pitch", "mount_yaw"), angles, (pitch, yaw), strict=True):
        _set(row, name, angle, a * a * pp + 2.0 * a * b * py + b * b * yy)


def velocity_mounting(c: np.void) -> list[tuple[str, float, float]]:
    """Roll, pitch and yaw of the velocity sensor in the body: name, rad, variance; none while it is not estimated."""
    M = c["cov"]["boresight_covariance"][VELOCITY_BORESIGHT:, VELOCITY_BORESIGHT:]
    if not M[0, 0] > 0.0:
        return []
    roll, pitch, yaw = interpreted(euler_of_quat)(tuple(c["nav"]["velocity_mount"]))
    s, k, level = math.sin(roll), math.cos(roll), max(math.cos(pitch), 1e-6)
    J = np.array([[1.0, math.tan(pitch) * s, math.tan(pitch) * k], [0.0, k, -s], [0.0, s / level, k / level]])
    variances = np.einsum("ij,jk,ik->i", J, M, J)
    names = ("velocity_mount_roll", "velocity_mount_pitch", "velocity_mount_yaw")
    return list(zip(names, (roll, pitch, yaw), variances.tolist(), strict=True))


def _fill_noise(row: np.void, c: np.void) -> None:
    """What was learned of the receiver's noise, whose sigma is not known, and of the process noise."""
    if c["gnss"]["last_used_ns"] != NEVER_NS:
        first = PLACES["gnss_noise_horizontal"]
        row["value"][first : first + 2] = np.sqrt(c["gnss"]["noise_var"])
    noise = c["process_noise"]
    if noise["log_psd_covariance"][1] != 0.0:  # an innovation has correlated them
        for i, name in enumerate(("velocity_noise", "attitude_noise")):
            deviation = math.sqrt(noise["psd"][i])
            by_logarithm = 0.5 * math.exp(noise["log_psd"][i]) / deviation
            _set(row, name, deviation, by_logarithm**2 * noise["log_psd_covariance"][2 * i])


def _fill_ages(row: np.void, ages: Records) -> None:
    for name, kind in _AGES.items():
        if ages["last_ns"][kind] != NEVER_NS:
            _set(row, name, ages["age"][kind], ages["variance"][kind])


def _set(row: np.void, name: str, value: float, variance: float) -> None:
    row["value"][PLACES[name]], row["sigma"][PLACES[name]] = value, math.sqrt(max(variance, 0.0))
