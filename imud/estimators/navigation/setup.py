"""From settings to the parameter record, from what the user knows to the first state record."""

import math

import numpy as np

from imud.configuration.settings import Initial, Settings
from imud.sensor_errors.profiles import profile_of

from .. import Record
from .acquisition import UNKNOWN_HEIGHT
from .creep import RESTLESS
from .looseness import UNKNOWN
from .state import (
    ACCEL_BIAS,
    ATTITUDE,
    AUTO,
    FREE,
    GYRO_BIAS,
    LAG,
    LAND,
    LATENCY,
    LEVELLING,
    NEVER_NS,
    PARAMETERS,
    POSITION,
    STATE,
    STATES,
    TURN_SCALE,
    VELOCITY,
    WANDER,
)

WALK_S = 100.0  # s in which a bias walks by its instability: Allan's K^2 tau / 3 = B^2 where it is flat, at 300 s
TILT_SIGMA = math.radians(20.0)  # of the first sample taken for gravity
GIVEN_TILT = math.radians(2.0)
GIVEN_HEADING = math.radians(5.0)
GIVEN_POSITION, GIVEN_VELOCITY = 5.0, 0.3  # m, m/s
LATENCY_SIGMA = 0.2  # s
LAG_SIGMA = 0.05  # s, of a receiver's velocity behind its position
SPEED_SIGMA = 0.1  # m/s, of a receiver's velocity, before its innovations tell
VEHICLES = {"free": FREE, "auto": AUTO, "land": LAND}


def configure(settings: Settings, rate_hz: float) -> Record:
    """Parameters (1 element) for a sensor of `rate_hz`; profile "auto" is consumer-mems."""
    profile = profile_of(settings)
    p = np.zeros(1, PARAMETERS)
    r = p[0]
    r["period"] = 1.0 / rate_hz
    r["lever"] = settings.navigation.lever_arm_m
    r["vehicle"] = VEHICLES[settings.navigation.vehicle]
    r["latency"] = settings.gnss.latency_s
    r["gyro_psd"] = profile.gyro_noise**2
    r["gyro_walk"] = profile.gyro_bias_instability**2 / WALK_S
    r["gyro_initial"] = profile.gyro_bias_initial
    r["gyro_scale"] = profile.gyro_scale
    r["gyro_range"] = profile.gyro_range
    r["accel_psd"] = profile.accel_noise**2
    r["accel_walk"] = profile.accel_bias_instability**2 / WALK_S
    r["accel_initial"] = profile.accel_bias_initial
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
    sigmas[ATTITUDE : ATTITUDE + 2] = TILT_SIGMA
    sigmas[ATTITUDE + 2] = math.pi
    sigmas[GYRO_BIAS : GYRO_BIAS + 3] = p["gyro_initial"]
    sigmas[ACCEL_BIAS : ACCEL_BIAS + 3] = p["accel_initial"]
    sigmas[WANDER : WANDER + 3] = 2.0
    sigmas[LATENCY] = LATENCY_SIGMA
    sigmas[LAG] = LAG_SIGMA
    sigmas[TURN_SCALE : TURN_SCALE + 3] = p["gyro_scale"]
    c["phase"] = LEVELLING
    c["forward"] = (1.0, 0.0, 0.0)
    c["lateral"] = (0.0, 1.0, 0.0)
    c["fix_speed"] = math.nan
    c["swing"] = (1.0, 0.0)
    c["restless"] = RESTLESS[1]
    c["since_ns"] = NEVER_NS
    c["white_speed"] = SPEED_SIGMA**2
    c["loose"] = UNKNOWN
    c["fix_ns"] = c["mark_ns"] = c["matched_ns"] = c["calm_ns"] = s["stamp_ns"] = s["fused_ns"] = NEVER_NS
    angles = (initial.roll_deg, initial.pitch_deg, initial.yaw_deg)
    s["initial_rpy"] = [math.nan if a is None else math.radians(a) for a in angles]
    if initial.yaw_deg is not None:
        sigmas[ATTITUDE + 2] = GIVEN_HEADING
        c["heading_sigma"] = GIVEN_HEADING
    if initial.roll_deg is not None and initial.pitch_deg is not None:
        sigmas[ATTITUDE : ATTITUDE + 2] = GIVEN_TILT
    if initial.lat_deg is not None and initial.lon_deg is not None:
        c["lat"], c["lon"] = math.radians(initial.lat_deg), math.radians(initial.lon_deg)
        c["height"] = initial.height_m or 0.0
        c["fixes"] = 1
        sigmas[POSITION : POSITION + 2] = GIVEN_POSITION
        sigmas[POSITION + 2] = GIVEN_POSITION if initial.height_m is not None else UNKNOWN_HEIGHT
    velocity = (initial.vn_mps, initial.ve_mps, initial.vd_mps)
    for i, v in enumerate(velocity):
        if v is not None:
            c["v"][i] = v
            sigmas[VELOCITY + i] = GIVEN_VELOCITY
    c["P"] = np.diag(sigmas**2)[np.triu_indices(STATES)]
    return s
