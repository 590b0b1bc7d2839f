"""From settings to the parameter record, from what the user knows to the first state record."""

import math

import numpy as np

from imud.configuration.settings import Initial, Settings
from imud.sensor_errors.profiles import profile_of

from .. import Record
from .aiding.nhc_noise import INITIAL_NOISE_SCALE
from .alignment.in_motion import UNKNOWN_HEIGHT
from .observers.gnss_drift import NOISE_SCALE_RANGE
from .state import (
    ACCEL_BIAS,
    ATTITUDE,
    AUTO,
    COARSE_ALIGNMENT,
    FREE,
    GNSS_BIAS,
    GYRO_BIAS,
    LAND,
    NEVER_NS,
    PARAMETERS,
    POSITION,
    STATE,
    STATES,
    TIME_OFFSET,
    TURN_SCALE,
    VELOCITY,
    VELOCITY_TIME_OFFSET,
)

BIAS_WALK_TIME_S = (
    100.0  # s in which a bias walks by its instability: Allan's K^2 tau / 3 = B^2 where it is flat, at 300 s
)
FIRST_TILT_SIGMA = math.radians(20.0)  # of the first sample taken for gravity
GIVEN_TILT_SIGMA = math.radians(2.0)
GIVEN_HEADING_SIGMA = math.radians(5.0)
GIVEN_POSITION_SIGMA, GIVEN_VELOCITY_SIGMA = 5.0, 0.3  # m, m/s
TIME_OFFSET_SIGMA = 0.2  # s
VELOCITY_TIME_OFFSET_SIGMA = 0.05  # s, of a receiver's velocity behind its position
VELOCITY_SIGMA = 0.1  # m/s, of a receiver's velocity, before its innovations tell
VEHICLES = {"free": FREE, "auto": AUTO, "land": LAND}


def configure(settings: Settings, rate_hz: float) -> Record:
    """Parameters (1 element) for a sensor of `rate_hz`; profile "auto" is consumer-mems."""
    profile = profile_of(settings)
    p = np.zeros(1, PARAMETERS)
    r = p[0]
    r["period"] = 1.0 / rate_hz
    r["gnss_lever_arm"] = settings.navigation.lever_arm_m
    r["vehicle"] = VEHICLES[settings.navigation.vehicle]
    r["assumed_latency"] = settings.gnss.latency_s
    r["gyro_psd"] = profile.gyro_noise**2
    r["gyro_bias_psd"] = profile.gyro_bias_instability**2 / BIAS_WALK_TIME_S
    r["gyro_bias_sigma"] = profile.gyro_bias_initial
    r["gyro_scale"] = profile.gyro_scale
    r["gyro_range"] = profile.gyro_range
    r["accel_psd"] = profile.accel_noise**2
    r["accel_bias_psd"] = profile.accel_bias_instability**2 / BIAS_WALK_TIME_S
    r["accel_bias_sigma"] = profile.accel_bias_initial
    r["accel_scale"] = profile.accel_scale
    r["accel_range"] = profile.accel_range
    return p


def start(parameters: Record, initial: Initial) -> Record:
    """State (1 element) before the first sample, with what `initial` tells."""
    p = parameters[0]
    s = np.zeros(1, STATE)
    c = s["core"][0, 0]
    sigmas = np.zeros(STATES)
    sigmas[POSITION : POSITION + 3] = 1e4
    sigmas[VELOCITY : VELOCITY + 3] = 10.0
    sigmas[ATTITUDE : ATTITUDE + 2] = FIRST_TILT_SIGMA
    sigmas[ATTITUDE + 2] = math.pi
    sigmas[GYRO_BIAS : GYRO_BIAS + 3] = p["gyro_bias_sigma"]
    sigmas[ACCEL_BIAS : ACCEL_BIAS + 3] = p["accel_bias_sigma"]
    sigmas[GNSS_BIAS : GNSS_BIAS + 3] = 2.0
    sigmas[TIME_OFFSET] = TIME_OFFSET_SIGMA
    sigmas[VELOCITY_TIME_OFFSET] = VELOCITY_TIME_OFFSET_SIGMA
    sigmas[TURN_SCALE : TURN_SCALE + 3] = p["gyro_scale"]
    c["alignment"]["mode"] = COARSE_ALIGNMENT
    c["nav"]["forward"] = (1.0, 0.0, 0.0)
    c["nav"]["lateral"] = (0.0, 1.0, 0.0)
    c["gnss"]["speed"] = math.nan
    c["alignment"]["heading_phasor"] = (1.0, 0.0)
    c["drift"]["noise_scale"] = NOISE_SCALE_RANGE[1]
    c["drift"]["onset_ns"] = NEVER_NS
    c["gnss"]["velocity_noise_var"] = VELOCITY_SIGMA**2
    c["nhc"]["noise_scale"] = INITIAL_NOISE_SCALE
    c["gnss"]["last_used_ns"] = s["last_epoch_ns"] = s["last_fusion_ns"] = NEVER_NS
    for name in ("pair_start_ns", "last_match_ns", "low_motion_ns"):
        c["alignment"][name] = NEVER_NS
    angles = (initial.roll_deg, initial.pitch_deg, initial.yaw_deg)
    s["initial_rpy"] = [math.nan if a is None else math.radians(a) for a in angles]
    if initial.yaw_deg is not None:
        sigmas[ATTITUDE + 2] = GIVEN_HEADING_SIGMA
        c["alignment"]["heading_sigma"] = GIVEN_HEADING_SIGMA
    if initial.roll_deg is not None and initial.pitch_deg is not None:
        sigmas[ATTITUDE : ATTITUDE + 2] = GIVEN_TILT_SIGMA
    if initial.lat_deg is not None and initial.lon_deg is not None:
        c["nav"]["lat"], c["nav"]["lon"] = math.radians(initial.lat_deg), math.radians(initial.lon_deg)
        c["nav"]["height"] = initial.height_m or 0.0
        c["gnss"]["fix_count"] = 1
        sigmas[POSITION : POSITION + 2] = GIVEN_POSITION_SIGMA
        sigmas[POSITION + 2] = GIVEN_POSITION_SIGMA if initial.height_m is not None else UNKNOWN_HEIGHT
    velocity = (initial.vn_mps, initial.ve_mps, initial.vd_mps)
    for i, v in enumerate(velocity):
        if v is not None:
            c["nav"]["v_n"][i] = v
            sigmas[VELOCITY + i] = GIVEN_VELOCITY_SIGMA
    c["cov"]["P"] = np.diag(sigmas**2)[np.triu_indices(STATES)]
    return s
