"""The records of all estimators, and of `tilt` as types for mypy, written by tests/record_types.py."""

from ..math.arrays import Integers, Reals


class Sample:
    t_ns: int
    tick: int
    w: Reals
    f: Reals
    down: Reals
    temperature: float
    flags: int
    outage_s: float


class Fix:
    t_ns: int
    arrival_ns: int
    lat: float
    lon: float
    height: float
    sigma: Reals
    hdop: float
    v: Reals
    speed: float
    course: float
    quality: int
    satellites: int
    sigma_v: Reals
    flags: int


class Measurement:
    t_ns: int
    arrival_ns: int
    kind: int
    value: Reals
    sigma: Reals


class Solution:
    t_ns: int
    status: int
    lat: float
    lon: float
    height: float
    v: Reals
    q_nb: Reals
    w: Reals
    f: Reals
    bg: Reals
    ba: Reals
    sigma_p: Reals
    sigma_v: Reals
    sigma_rpy: Reals
    sigma_bg: Reals
    sigma_ba: Reals


class Innovation:
    t_ns: int
    kind: int
    value: float
    variance: float
    used: int


class PendingInnovations:
    rows: list[Innovation]
    count: int


class TiltParameters:
    sample_var: float
    bias_var: float
    scale_var: float
    gyro_psd: float
    gyro_bias_var: float


class TiltState:
    gravity: float
    gravity_var: float
    t_ns: int
    last_good_ns: int
    sample_count: int
    f_mean: Reals
    f_slow_mean: Reals
    noise_var: float
    vibration_var: float
    motion_var: float
    has_gyro: Integers
    w: Reals
    true_heading: int
    yaw: float
    yaw_var: float
    yaw_per_bias: float
    tilt_var: float
    roll_pitch: Reals
    roll_pitch_var: Reals
