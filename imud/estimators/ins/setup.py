"""The initial state and covariance, before the first sample; and what a caller may ask of a state (see `Estimator`)."""

import math

import numpy as np

from ...compile.jit import interpreted
from ...configuration.settings import Initial
from ...math.arrays import Floats, Records
from ...math.kalman import packed_index
from ...sensor_errors.stored_biases import Biases
from ..tuning import Tunable
from .core import STATE
from .state import (
    ACCEL_BIAS,
    AGES,
    ATTITUDE,
    BARO_OFFSET,
    COARSE_ALIGNMENT,
    EXACT_EPOCHS,
    GNSS_BIAS,
    GNSS_LEVER_ARM,
    GNSS_VELOCITY_BIAS,
    GYRO_BIAS,
    GYRO_SCALE,
    MOUNT_PITCH,
    MOUNT_YAW,
    NAVIGATING,
    NEVER_NS,
    NO_AGE,
    ODOMETER_SCALE,
    POSITION,
    STATES,
    TIME_OFFSET,
    VELOCITY,
    VELOCITY_TIME_OFFSET,
)

_NO_ERROR_M = 100.0  # no lever arm is wrong by more: none is looked for
_NO_ODDS = 1e30  # none are as large
_NO_LAG_S = 1e3  # none is as large

TUNABLES = (
    Tunable(
        "first_tilt_sigma",
        math.radians(20.0),
        "rad",
        "Sigma of the tilt from the specific force of the first sample.",
        "Choice.",
    ),
    Tunable("initial_tilt_sigma", math.radians(2.0), "rad", "Sigma of roll and pitch that the user gives.", "Choice."),
    Tunable("initial_heading_sigma", math.radians(5.0), "rad", "Sigma of a heading that the user gives.", "Choice."),
    Tunable("initial_position_sigma", 5.0, "m", "Sigma of a position that the user gives.", "Choice."),
    Tunable("initial_velocity_sigma", 0.3, "m/s", "Sigma of a velocity that the user gives.", "Choice."),
    Tunable(
        "velocity_time_offset_sigma",
        0.05,
        "s",
        "Sigma of the age of a receiver's velocity beyond that of its position.",
        "Recorded receivers: 0.1 s.",
    ),
    Tunable("time_offset_sigma", 0.2, "s", "Sigma of the age of a fix beyond its epoch.", "Recorded receivers."),
    Tunable(
        "first_velocity_noise",
        0.1,
        "m/s",
        "White noise of a receiver's velocity before it is learned.",
        "Real receivers.",
    ),
)


NEVER = {  # records of the core: their times that begin as NEVER_NS
    "gnss": ("last_used_ns",),
    "alignment": ("level_accel_ns", "pair_start_ns", "last_match_ns", "low_motion_ns", "vector_start_ns"),
    "nhc": ("waits_since_ns",),
    "drift": ("onset_ns",),
    "time_offset_step": ("onset_ns",),
    "gyro_bias_step": ("onset_ns", "last_ns"),
    "imu_bias_step": ("onset_ns",),
    "velocity_drift": ("onset_ns",),
    "compass_offset": ("onset_ns", "last_ns"),
    "lever_arm_error": ("onset_ns",),
    "gravity_monitor": ("last_rest_ns",),
    "heading_aid": ("last_ns", "last_used_ns", "agreeing_ns", "rejecting_ns", "off_ns"),
    "barometer": ("last_ns", "last_used_ns", "changed_ns", "fix_ns"),
    "magnetometer": ("last_ns", "since_ns", "contradicted_ns"),
    "odometer": ("last_ns", "last_used_ns", "reading_ns"),
    "pose": ("last_ns", "last_used_ns", "agreeing_ns", "yaw_ns"),
    "external_velocity": ("last_ns", "last_used_ns"),
    "body_velocity": ("last_ns", "last_used_ns"),
}


def start(parameters: Records, initial: Initial) -> Records:
    """State (1 element) before the first sample; `initial`: attitude, position and velocity that the user gives."""
    p = parameters[0]
    t = p["tuning"]
    s = np.zeros(1, STATE)
    c = s["core"][0, 0]
    for record, names in NEVER.items():
        for name in names:
            c[record][name] = NEVER_NS
    for name in ("last_epoch_ns", "last_fusion_ns"):
        s[name] = NEVER_NS
    s["last_course"], s["fix"]["t_ns"] = math.nan, NEVER_NS
    s["fix_age"]["last_ns"] = s["fix_age"]["origin_ns"] = NEVER_NS
    s["velocity_lag"]["last_ns"] = NEVER_NS
    s["velocity_discrepancy"]["last_ns"] = s["velocity_discrepancy"]["onset_ns"] = NEVER_NS
    s["source_ages"]["last_ns"] = NEVER_NS
    s["source_ages"]["probability"] = t["age_prior"] / (AGES - 1)
    s["source_ages"]["probability"][..., NO_AGE] = 1.0 - t["age_prior"]
    _begin_records(c, t)
    c["nav"]["velocity_mount"] = p["velocity_mount"]
    sigmas = _unknown(p)
    _set_given(s, sigmas, initial, t)
    c["cov"]["P"] = np.diag(sigmas**2)[np.triu_indices(STATES)]
    return s


def _begin_records(c: np.void, t: np.void) -> None:
    """What does not begin with zero in the records of the core `c`; t: the tunables."""
    c["nav"]["forward"], c["nav"]["lateral"] = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    c["alignment"]["mode"] = COARSE_ALIGNMENT
    c["alignment"]["heading_phasor"] = (1.0, 0.0)
    c["gnss"]["speed"] = c["gnss"]["given_lever_arm"] = c["gnss"]["given_lever_arm_sigma"] = math.nan
    c["gnss"]["velocity_noise_var"] = t["first_velocity_noise"] ** 2
    c["drift"]["noise_scale"] = t["first_drift_noise_scale"]
    c["nhc"]["noise_scale"] = math.sqrt(t["nhc_min_noise_scale"] * t["nhc_max_noise_scale"])
    c["odometer"]["resolution"] = np.inf
    c["odometer"]["used_share"] = t["odometer_min_used_share"]
    for name in ("pose", "external_velocity", "body_velocity"):
        c[name]["last_value"] = math.nan
    psd = np.array((t["vibration_vrw"], t["vibration_arw"])) ** 2
    scale = np.array((t["velocity_noise_scale"], t["attitude_noise_scale"]))
    c["process_noise"]["psd"], c["process_noise"]["log_psd"] = psd, np.log(psd + scale**2)
    c["process_noise"]["log_psd_covariance"] = np.array((1.0, 0.0, 1.0)) * t["process_noise_prior"] ** 2


def _unknown(p: np.void) -> Floats:
    """Sigmas of the error states of which the user gives nothing; p: the parameters."""
    t = p["tuning"]
    sigmas = np.zeros(STATES)
    sigmas[POSITION : POSITION + 3] = 1e4
    sigmas[VELOCITY : VELOCITY + 3] = 10.0
    sigmas[ATTITUDE : ATTITUDE + 2] = t["first_tilt_sigma"]
    sigmas[ATTITUDE + 2] = math.pi
    sigmas[GYRO_BIAS : GYRO_BIAS + 3] = p["gyro_bias_sigma"]
    sigmas[ACCEL_BIAS : ACCEL_BIAS + 3] = p["accel_bias_sigma"]
    sigmas[GNSS_BIAS : GNSS_BIAS + 3] = 2.0
    sigmas[GNSS_VELOCITY_BIAS : GNSS_VELOCITY_BIAS + 3] = t["gnss_velocity_bias_sigma"]
    sigmas[GNSS_VELOCITY_BIAS + 2] *= t["vertical_ratio"]
    sigmas[TIME_OFFSET] = t["time_offset_sigma"]
    sigmas[VELOCITY_TIME_OFFSET] = t["velocity_time_offset_sigma"]
    sigmas[BARO_OFFSET] = t["baro_offset_sigma"]
    sigmas[ODOMETER_SCALE] = t["odometer_scale_sigma"]
    sigmas[MOUNT_PITCH] = sigmas[MOUNT_YAW] = t["unknown_mount_sigma"]
    sigmas[GYRO_SCALE : GYRO_SCALE + 9] = p["gyro_scale"]
    return sigmas


def _set_given(s: Records, sigmas: Floats, initial: Initial, t: np.void) -> None:
    """Begin the state `s` with what the user gives, and lower its sigmas; t: the tunables."""
    c = s["core"][0, 0]
    angles = (initial.roll_deg, initial.pitch_deg, initial.yaw_deg)
    s["initial_rpy"] = [math.nan if a is None else math.radians(a) for a in angles]
    if initial.yaw_deg is not None:
        sigmas[ATTITUDE + 2] = c["alignment"]["heading_sigma"] = t["initial_heading_sigma"]
    if initial.roll_deg is not None and initial.pitch_deg is not None:
        sigmas[ATTITUDE : ATTITUDE + 2] = t["initial_tilt_sigma"]
    if initial.lat_deg is not None and initial.lon_deg is not None:
        c["nav"]["lat"], c["nav"]["lon"] = math.radians(initial.lat_deg), math.radians(initial.lon_deg)
        c["nav"]["height"] = initial.height_m or 0.0
        c["gnss"]["fix_count"] = 1
        sigmas[POSITION : POSITION + 2] = t["initial_position_sigma"]
        sigmas[POSITION + 2] = t["initial_position_sigma"] if initial.height_m is not None else t["unknown_height"]
    for i, v in enumerate((initial.vn_mps, initial.ve_mps, initial.vd_mps)):
        if v is not None:
            c["nav"]["v_n"][i] = v
            sigmas[VELOCITY + i] = t["initial_velocity_sigma"]


def _variance(core: np.void, i: int) -> float:
    """Of one error state."""
    return float(core["cov"]["P"][interpreted(packed_index)(STATES, i, i)])


def backward_tuning(parameters: np.void, state: Records, solution: np.void, factor: float) -> dict[str, float]:
    """See `Estimator`. What was exact, or measured, forward is so backward: epochs of a survey, a lever arm.

    A lag of velocities is found forward: backward, one is a lead.
    """
    c, tuning = state["core"][0, 0], parameters["tuning"]
    late = factor * math.sqrt(_variance(c, TIME_OFFSET) + float(c["time_evidence"]["missing_variance"]))
    of_epochs = ("time_offset_sigma", "reported_epoch_sigma", "survey_epoch_sigma", "averaging_delay_sigma")
    known = {name: min(late, float(tuning[name])) for name in of_epochs}
    if c["integrity"]["epochs"] != EXACT_EPOCHS:
        known["epoch_mistake_s"] = 0.0
    if _variance(c, GNSS_LEVER_ARM) == 0.0:
        known["min_lever_arm_error"] = _NO_ERROR_M
    if c["gnss"]["lever_arm_is_measured"].all():
        known["lever_arm_odds"] = _NO_ODDS
    return known | {
        "max_lag_s": _NO_LAG_S,
        "initial_tilt_sigma": factor * float(np.max(solution["sigma_rpy"][:2])),
        "initial_heading_sigma": factor * float(solution["sigma_rpy"][2]),
        "initial_position_sigma": factor * float(np.max(solution["sigma_p"])),
        "initial_velocity_sigma": factor * float(np.max(solution["sigma_v"])),
    }


def fix_delay_s(state: Records) -> float:
    """See `Estimator`."""
    return float(state["core"][0, 0]["nav"]["time_offset"])


def backward_fixes(parameters: Records, state: Records, fixes: Records) -> Records:
    """See `Estimator`: without courses that a slow receiver holds, and without any velocities if these are late."""
    g, t, rows = state["velocity_lag"][0], parameters["tuning"][0], fixes.copy()
    changed = np.append(True, fixes["course"][1:] != fixes["course"][:-1])
    n = np.arange(len(fixes))
    repeats = n - np.maximum.accumulate(np.where(changed[: len(fixes)], n, 0))
    slow = (fixes["speed"] < t["max_held_course_speed"]) & ~np.isfinite(fixes["v"][:, 0])
    rows["course"][slow & (repeats >= t["held_course_repeats"])] = np.nan
    certain = abs(g["lag"]) - t["lag_sigmas"] * math.sqrt(g["variance"])
    if g["late"] or (g["variance"] > 0.0 and certain > t["max_lag_s"]):
        for name in ("v", "sigma_v", "speed", "course"):
            rows[name] = np.nan
    return rows


def source_ages_s(state: Records) -> Floats:
    """See `Estimator`."""
    ages: Floats = state["source_ages"][0]["age"]
    return ages


def place(state: Records) -> tuple[float, float, float] | None:
    """See `Estimator`."""
    c = state["core"][0, 0]
    nav = c["nav"]
    return (float(nav["lat"]), float(nav["lon"]), float(nav["height"])) if c["gnss"]["fix_count"] else None


def variances(state: Records) -> tuple[float, float, float, float] | None:
    """See `Estimator`."""
    c = state["core"][0, 0]
    if c["alignment"]["mode"] != NAVIGATING:
        return None
    north, east, down, v_north, v_east, heading = (
        _variance(c, i) for i in (*range(POSITION, POSITION + 3), VELOCITY, VELOCITY + 1, ATTITUDE + 2)
    )
    return north + east, down, v_north + v_east, heading


_DIAGONAL = [interpreted(packed_index)(STATES, i, i) for i in range(STATES)]


def is_valid(state: Records) -> bool:
    """See `Estimator`: no variance is negative or not a number."""
    return bool((state["core"][0, 0]["cov"]["P"][_DIAGONAL] >= 0.0).all())


def restore_biases(state: Records, biases: Biases) -> None:
    """Before the first sample: begin with these biases."""
    c = state["core"][0, 0]
    c["nav"]["bg"], c["nav"]["ba"] = biases.gyro_radps, biases.accel_mps2
    for first, sigmas in ((GYRO_BIAS, biases.gyro_sigma_radps), (ACCEL_BIAS, biases.accel_sigma_mps2)):
        for i, sigma in enumerate(sigmas, first):
            c["cov"]["P"][interpreted(packed_index)(STATES, i, i)] = sigma**2
