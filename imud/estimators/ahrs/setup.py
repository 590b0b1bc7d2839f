"""Parameters from the sensor's noise profile, and the state before the first sample."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...compile.jit import interpreted
from ...configuration.settings import Initial, Settings
from ...math.arrays import Records
from ...math.earth import STANDARD_GRAVITY, gravity
from ...math.kalman import packed_index
from ...math.rotation import UNKNOWN_ANGLE
from ...sensor_errors.profiles import PROFILES, Profile, profile_of
from ...sensor_errors.stored_biases import Biases
from ..tuning import values_of
from .parameters import TUNABLES
from .stamps import PRIOR_VARIANCE
from .state import ACCEL_BIAS, ACCEL_DELAY, ACCEL_SCALE, ATTITUDE, GYRO_BIAS, GYRO_MATRIX, PARAMETERS, STATE, STATES


def configure(settings: Settings, rate_hz: float) -> Records:
    """Parameters (PARAMETERS) from the sensor's profile and the tunables; rate_hz is nominal.

    Raises KeyError when there is no such profile.
    """
    profile = profile_of(settings)
    assumed = _well_calibrated(profile) if settings.imu.profile == "auto" else profile
    p = np.zeros(1, PARAMETERS)
    p["tuning"] = values_of(TUNABLES, settings.attitude.tuning)
    tuning = p["tuning"][0]
    p["period_s"] = 1.0 / rate_hz
    p["gyro_psd"] = profile.gyro_noise**2
    p["gyro_bias_var"] = profile.gyro_bias_initial**2
    p["gyro_bias_inflation"] = profile.gyro_bias_wide**2 - p["gyro_bias_var"]
    p["gyro_bias_psd"] = profile.gyro_bias_instability**2
    p["gyro_matrix_var"] = assumed.gyro_scale**2
    p["accel_psd"] = profile.accel_noise**2
    p["accel_bias_var"] = assumed.accel_bias_initial**2
    p["accel_bias_psd"] = profile.accel_bias_instability**2 / tuning["accel_bias_time_s"]
    p["accel_scale_var"] = assumed.accel_scale**2
    p["gyro_matrix_inflation"] = profile.gyro_scale**2 - p["gyro_matrix_var"]
    p["accel_bias_inflation"] = profile.accel_bias_initial**2 - p["accel_bias_var"]
    p["accel_scale_inflation"] = profile.accel_scale**2 - p["accel_scale_var"]
    p["sensor_axes"] = np.eye(3).ravel()
    p["mean_rate_psd"] = (float(tuning["mean_rate_noise"]) * profile.gyro_noise) ** 2
    return p


def _well_calibrated(profile: Profile) -> Profile:
    """The profile of a sensor that nobody named, as good as boards that their makers calibrated (M-G350 data sheet).

    Bare parts are several times worse. The filter returns to the profile's figures when the magnitude of the force at
    the first rest contradicts the better ones.
    """
    board = PROFILES["m-g350"]
    return replace(
        profile,
        gyro_scale=min(profile.gyro_scale, board.gyro_scale),
        accel_bias_initial=min(profile.accel_bias_initial, board.accel_bias_initial),
        accel_scale=min(profile.accel_scale, board.accel_scale),
    )


def start(parameters: Records, initial: Initial) -> Records:
    """A state (STATE) that waits for its first sample. A latitude makes gravity known; given angles are kept."""
    tuning = parameters["tuning"][0]
    known = initial.lat_deg is not None
    lat = math.radians(initial.lat_deg or 0.0)
    angles = (initial.roll_deg, initial.pitch_deg, initial.yaw_deg)
    s = np.zeros(1, STATE)
    s["nav"]["gravity"] = interpreted(gravity)(lat, initial.height_m or 0.0) if known else STANDARD_GRAVITY
    s["nav"]["q_nb"] = (1.0, 0.0, 0.0, 0.0)
    s["quantization"]["last_reading"] = math.nan
    s["quantization"]["lsb"] = tuning["max_lsb_radps"]
    s["quantization"]["truncation_log_odds"] = tuning["truncation_prior"]
    s["levelling"]["initial_rpy"] = [math.nan if angle is None else math.radians(angle) for angle in angles]
    s["levelling"]["true_heading"] = initial.yaw_deg is not None
    s["variance_factor"]["tilt_scale"] = 1.0
    s["stamps"]["period"] = parameters["period_s"]
    s["stamps"]["gain"] = 1.0
    s["stamps"]["slope"], s["stamps"]["slope_variance"] = 0.5, PRIOR_VARIANCE
    s["cov"]["sigma_tilt"] = s["cov"]["sigma_rpy"] = UNKNOWN_ANGLE
    s["cov"]["P"][0] = _covariance(parameters, known)[np.triu_indices(STATES)]
    return s


def _covariance(parameters: Records, gravity_known: bool) -> NDArray[np.float64]:
    tuning = parameters["tuning"][0]
    P = np.zeros((STATES, STATES))
    for first, count, name in (
        (GYRO_BIAS, 3, "gyro_bias_var"),
        (ACCEL_BIAS, 3, "accel_bias_var"),
        (GYRO_MATRIX, 9, "gyro_matrix_var"),
        (ACCEL_SCALE, 3, "accel_scale_var"),
    ):
        each = range(first, first + count)
        P[each, each] = parameters[name][0]
    P[[ATTITUDE, ATTITUDE + 1], [ATTITUDE, ATTITUDE + 1]] = UNKNOWN_ANGLE**2  # yaw is counted from the start
    P[ACCEL_DELAY, ACCEL_DELAY] = float(tuning["accel_delay_sigma_s"]) ** 2
    if not gravity_known:  # looks like the same scale error on every axis
        P[ACCEL_SCALE : ACCEL_SCALE + 3, ACCEL_SCALE : ACCEL_SCALE + 3] += float(tuning["gravity_spread"]) ** 2
    return P


def backward_tuning(_parameters: np.void, _state: Records, solution: np.void, factor: float) -> dict[str, float]:
    """See `Estimator`: of a SOLUTION."""
    return {"initial_angle_sigma_rad": factor * float(np.max(solution["sigma_rpy"][:2]))}


def restore_biases(state: Records, biases: Biases) -> None:
    """Before the first sample: begin with these biases."""
    s = state[0]
    s["nav"]["bg"], s["nav"]["ba"] = biases.gyro_radps, biases.accel_mps2
    for first, sigmas in ((GYRO_BIAS, biases.gyro_sigma_radps), (ACCEL_BIAS, biases.accel_sigma_mps2)):
        for i, sigma in enumerate(sigmas, first):
            s["cov"]["P"][interpreted(packed_index)(STATES, i, i)] = sigma**2


def checkpoint(state: Records) -> Records:
    """What `resume` needs: all of it."""
    return state


def resume(state: Records, saved: Records) -> None:
    """Before the first sample: go on from a checkpoint."""
    state[:] = saved
