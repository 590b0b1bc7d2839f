"""The records of the reduced inertial estimator as types for mypy, written by tests/record_types.py."""

from ...math.arrays import Floats, Indices, Integers, Reals, Tensor


class Tuning:
    step_s: float
    lean: float
    lean_sigma: float
    squat: float
    squat_sigma: float
    accel_sigma: float
    accel_time_s: float
    tilt_walk: float
    lateral_sigma: float
    force_sigma: float
    sink_walk: float
    fix_sigma: float
    fix_time_s: float
    fix_white_sigma: float
    velocity_sigma: float
    learning_fixes: float
    align_speed: float
    course_speed: float
    rest_speed: float
    rest_rate: float
    rest_force: float
    rest_s: float
    gate: float
    rejected_limit: int
    max_late_s: float
    max_heading_sigma: float
    max_tilt_sigma: float
    coasting_s: float


class RissParameters:
    tuning: Tuning
    gyro_psd: float
    gyro_bias_var: float
    gyro_bias_psd: float
    gyro_scale_var: float
    accel_psd: float
    accel_bias_var: float
    accel_bias_psd: float
    lever: Reals


class RissState:
    t_ns: int
    step_ns: int
    started: int
    levelled: int
    aligned: int
    fixes: int
    fix_ns: int
    rejected: int
    resting: int
    rest_since_ns: int
    rest_f: Reals
    slow_ns: int
    gravity: float
    lat: float
    lon: float
    height: float
    has_height: int
    v: Reals
    yaw_rate: float
    given_yaw: float
    count: int
    w_sum: float
    f_sum: Reals
    down_sum: Reals
    forces: int
    rates: int
    outage_s: float
    f_last: Reals
    scatter: float
    white: Reals
    fix_var: Reals
    x: Floats
    P: Floats
    dx: Floats
    d: Floats
    columns: Indices
    row: Floats
    travel: Reals
    ring: Tensor
    ring_ns: Integers
    ring_at: int
