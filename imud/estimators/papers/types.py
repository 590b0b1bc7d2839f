"""The records of the papers' estimators as types for mypy, written by tests/record_types.py."""

from ...math.arrays import Floats, Indices, Reals
from ..types import PendingInnovations


class StationaryParameters:
    bias_rate: float
    accel_psd: float
    bias_psd: float
    bias_var: float
    position_var: float
    interval_ns: int
    sample_var: float
    P0: Reals
    initial_bias: Reals


class StationaryState:
    t_ns: int
    samples: int
    gravity: float
    initial_rpy: Reals
    q: Reals
    tilt_var: float
    u: Reals
    p: Reals
    v: Reals
    b: Reals
    P: Floats
    x: Floats
    d: Floats
    column: Indices
    one: Floats
    measurement_ns: int
    measurement_count: int
    residual: Reals
    variance: float
    rejected: int
    origin: Reals
    origin_var: Reals
    pending: PendingInnovations


class SuhParameters:
    mode: int
    literal: int
    rule: int
    half_ns: int


class SuhState:
    t_ns: int
    step_ns: int
    started: int
    initialised: int
    steps: int
    gravity: float
    initial_rpy: Reals
    count: int
    w_sum: Reals
    f_sum: Reals
    x: Floats
    yaw: float
    P: Floats
    r: Reals
    external_acceleration: int
    innovation: Reals
    d: Floats
    columns: Indices
    jacobian: Floats


class TrackParameters:
    acceleration_var: float
    position_var: float


class TrackState:
    fixes: int
    fix_ns: int
    lat: float
    lon: float
    v: Reals
    P: Floats
    predicted_P: Floats
    x: Floats
    d: Floats
    column: Indices
    one: Floats


class Ins9Parameters:
    acceleration_walk: float
    distance_var: float
    gyro_psd: float
    accel_psd: float
    accel_bias_var: float
    accel_bias_psd: float
    gyro_bias_psd: float
    gyro_scale_var: float
    accel_scale_var: float


class Ins9State:
    t_ns: int
    samples: int
    first_sample_ns: int
    rest_s: float
    moving_s: float
    w_sum: Reals
    f_sum: Reals
    initial_yaw: float
    q: Reals
    bg: Reals
    gravity: float
    w: Reals
    f: Reals
    C_rest: Reals
    rotation_from_rest: float
    tilt_by: Reals
    velocity_by: Reals
    distance_by: Reals
    velocity_by_bias: Reals
    distance_by_bias: Reals
    reckoned_v: Reals
    reckoned_p: Reals
    p: Reals
    v: Reals
    a: Reals
    predicted: Reals
    P: Floats
    x: Floats
    d: Floats
    column: Indices
    one: Floats
    innovation: Reals
    variance: float
    origin: Reals
    origin_var: Reals
