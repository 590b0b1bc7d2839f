"""The records of the attitude filter as types for mypy, written by tests/record_types.py."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class Floats(Protocol):
    """A one-dimensional array of numbers."""

    def __getitem__(self, i: int) -> float: ...
    def __setitem__(self, i: Any, value: float) -> None: ...
    def __len__(self) -> int: ...


class Integers(Protocol):
    """A one-dimensional array of integers."""

    def __getitem__(self, i: int) -> int: ...
    def __setitem__(self, i: Any, value: int) -> None: ...
    def __len__(self) -> int: ...


class Sample:
    t_ns: int
    tick: int
    w: Floats
    f: Floats
    down: Floats
    temperature: float
    flags: int
    outage_s: float


class Solution:
    t_ns: int
    status: int
    lat: float
    lon: float
    height: float
    v: Floats
    q_nb: Floats
    w: Floats
    f: Floats
    bg: Floats
    ba: Floats
    sigma_p: Floats
    sigma_v: Floats
    sigma_rpy: Floats
    sigma_bg: Floats
    sigma_ba: Floats


class Tuning:
    covariance_interval_s: float
    long_gap_s: float
    valid_tilt_rad: float
    valid_heading_rad: float
    gap_periods: float
    gravity_spread: float
    accel_bias_time_s: float
    accel_delay_sigma_s: float
    mean_rate_noise: float
    gyro_noise_per_rate: float
    gyro_bias_walk_per_acceleration: float
    accel_noise_per_acceleration: float
    shock_rotation: float
    gap_rate_psd: float
    gap_force_psd: float
    fault_rate_radps: float
    fault_force_psd: float
    saturation_noise: float
    initial_tilt_rad: float
    given_angle_rad: float
    levelling_time_s: float
    acceleration_time_s: float
    initial_velocity_var: float
    initial_velocity_scatter: float
    min_gravity_ratio: float
    max_gravity_ratio: float
    velocity_scatter_time_s: float
    position_decay_time_s: float
    position_scatter_time_s: float
    travel_speed_mps: float
    travel_time_s: float
    travel_evidence: float
    vibration_time_s: float
    road_slope: float
    reset_velocity_var: float
    reset_position_var: float
    zero_velocity_noise: float
    zero_velocity_noise_per_scatter: float
    shared_scatter: float
    stationary_velocity_noise: float
    velocity_reset_gate: float
    zero_position_noise: float
    zero_position_noise_per_scatter: float
    mean_time_s: float
    stationary_time_s: float
    max_rate_deviation_radps: float
    max_force_deviation_mps2: float
    max_force_change_mps2: float
    rate_change_gate: float
    acceleration_gate: float
    bias_gate: float
    max_bias_sigma: float
    min_bias_sigma_radps: float
    min_force_sigma_mps2: float
    gravity_magnitude_gate: float
    relevel_tilt_rad: float
    min_rate_across_gravity: float
    fixed_gravity_gate: float
    confirmation_time_s: float
    max_curve_time_s: float
    standing_vibration_ratio: float
    moving_log_odds: float
    converged_tilt_rad: float
    lost_tilt_rad: float
    max_velocity_gain_mps: float
    common_velocity_gain: float
    velocity_gain_time_s: float
    max_lsb_radps: float
    min_lsb_radps: float
    min_step_radps: float
    max_code_error: float
    truncation_prior: float
    max_log_odds: float
    block_samples: int
    max_blocks: int
    min_noise_lsb: float
    max_noise_lsb: float
    min_whiteness: float
    histogram_reach: float
    outlier_probability: float


class Parameters:
    gap_s: float
    gyro_psd: float
    gyro_bias_var: float
    gyro_bias_psd: float
    gyro_matrix_var: float
    accel_psd: float
    accel_bias_var: float
    accel_bias_psd: float
    accel_scale_var: float
    gyro_matrix_inflation: float
    accel_bias_inflation: float
    accel_scale_inflation: float
    mean_rate_psd: float
    tuning: Tuning


class Nav:
    q_nb: Floats
    v_n: Floats
    p_n: Floats
    bg: Floats
    ba: Floats
    gyro_matrix: Floats
    accel_scale: Floats
    accel_delay: float
    gravity: float


class Covariance:
    P: NDArray[np.float64]
    sigma_tilt: float
    sigma_rpy: Floats
    sigma_bg: Floats
    sigma_ba: Floats


class Imu:
    w: Floats
    f: Floats
    f_change: Floats
    outage_s: float


class Integrals:
    time: float
    c: Floats
    delta_v: Floats
    c_outer_w: Floats
    c_diag_f: Floats
    c_f_cross_w: Floats
    a_outer_a: Floats
    w2: float
    attitude_noise: float
    velocity_noise: float


class Levelling:
    initialised: int
    coarse: int
    true_heading: int
    initial_rpy: Floats
    duration: float
    delta_v: Floats
    force2: float


class Motion:
    v_mean: Floats
    v_scatter: Floats
    p_scatter: Floats
    travel_speed2: Floats
    mean_force: Floats
    mean_force_change: Floats
    vibration_level: float
    travel_vibration_level: float


class Stationarity:
    w_mean: Floats
    f_mean: Floats
    w_start: Floats
    f_start: Floats
    force_psd: float
    f_at_rest: Floats
    low_motion_s: float
    bias_mismatch_s: float
    stationary: int
    gravity_checked: int


class Divergence:
    velocity_gain: Floats
    gain_duration: float
    converged: int


class Quantization:
    last_reading: Floats
    lsb: Floats
    offset: Floats
    truncation_log_odds: float
    max_error: Floats
    error: Floats
    error_var: Floats
    log_likelihood_ratio: Floats
    last_side: Floats
    crossing_count: Floats
    crossing_histogram: Floats
    rest_histogram: Floats
    rest_step2: Floats
    rest_samples: int
    rest_blocks: int


class Scratch:
    x: NDArray[np.float64]
    ph: NDArray[np.float64]
    columns: NDArray[np.int64]
    values: NDArray[np.float64]
    dv_n: Floats
    a_n: Floats


class State:
    t_ns: int
    sample_count: int
    nav: Nav
    cov: Covariance
    imu: Imu
    integrals: Integrals
    levelling: Levelling
    motion: Motion
    stationarity: Stationarity
    divergence: Divergence
    quantization: Quantization
    scratch: Scratch
