"""The records of the navigation filter as types for mypy, written by tests/record_types.py."""

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


class StoredSample:
    t_ns: int
    w: Floats
    f: Floats
    flags: int
    outage_s: float


class Fix:
    t_ns: int
    arrival_ns: int
    lat: float
    lon: float
    height: float
    sigma: Floats
    hdop: float
    v: Floats
    speed: float
    course: float
    quality: int
    satellites: int


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


class Innovation:
    t_ns: int
    kind: int
    value: float
    variance: float
    used: int


class Tuning:
    bias_walk_time_s: float
    covariance_interval_s: float
    gnss_bias_time_s: float
    accel_scale_time_s: float
    gyro_scale_time_s: float
    vibration_vrw: float
    vibration_bias_walk: float
    mount_psd: float
    nhc_lever_arm_psd: float
    second_order_time_s: float
    min_scaled_turn: float
    nonlinear_scale_share: float
    misalignment_over_scale: float
    turn_scale_psd: float
    alignment_accel: float
    alignment_accel_time_s: float
    min_rotated_tilt: float
    gap_step_s: float
    gap_periods: float
    gap_s: float
    gap_accel: float
    gap_turn: float
    rate_of_change_time_s: float
    longest_gap_s: float
    rate_hold_s: float
    max_gyro_outage_s: float
    near_range: float
    over_range: float
    smoothing_s: float
    power_on_force_sigma: float
    reconnect_turn_rate: float
    power_on_tilt_gate: float
    rest_window_s: float
    max_gyro_ratio: float
    low_motion_accel: float
    stationary_accel: float
    rate_of_change_decay: float
    noise_floor_growth: float
    vibration_noise_share: float
    moving_vibration_accel: float
    fresh_fix_s: float
    rest_speed: float
    long_rest_windows: int
    long_rest_variance: float
    rest_variance: float
    rest_rate: float
    rest_accel: float
    slow_motion_min_speed: float
    slow_motion_max_speed: float
    class_memory: float
    class_min_windows: float
    class_min_sigma: float
    evidence_weight: float
    rest_log_likelihood: float
    uere: float
    vertical_ratio: float
    unknown_hdop: float
    rtk_fixed: float
    rtk_float: float
    min_bias_share: float
    min_velocity_sigma: float
    max_velocity_sigma: float
    noise_gain: float
    second_order_heading: float
    gnss_lever_arm_sigma: float
    time_offset_floor: float
    constant_error_share: float
    bias_free_gate: float
    late_fix_accel: float
    turn_between_fixes_s: float
    min_course_speed: float
    gnss_velocity_gate: float
    gnss_position_gate: float
    gnss_return_gate: float
    reset_count: int
    reset_s: float
    consistency_gate: float
    drift_reset_s: float
    max_reject_s: float
    max_drift_speed: float
    frozen_min_speed: float
    frozen_min_s: float
    inertial_velocity_error: float
    inertial_heading_error: float
    max_velocity_rejects: int
    max_reset_score: float
    reset_score_decay: float
    time_tag_tolerance_s: float
    reported_epoch_sigma: float
    survey_sigma: float
    survey_epoch_sigma: float
    confirmed_epoch_sigma: float
    epoch_mistake_s: float
    zupt_sigma: float
    zupt_sigma_unconfirmed: float
    standstill_sigma: float
    zaru_sigma: float
    rest_gate: float
    nhc_interval_s: float
    nhc_min_speed: float
    nhc_sigma: float
    nhc_lever_arm_sigma: float
    turn_sideslip: float
    tyre_sideslip: float
    suspension_pitch: float
    suspension_time_s: float
    nhc_gate: float
    nhc_max_mean_nis: float
    nhc_retry_s: float
    nhc_mean_nis_gain: float
    mount_sigma: float
    typical_lever_arm: float
    direction_sigmas: float
    scatter_decay: float
    axis_windows: float
    axis_across: float
    axis_across_growth: float
    axis_ground: float
    axis_windows_land: float
    axis_across_land: float
    power_iterations: int
    nhc_sum_length: int
    nhc_sum_gain: float
    nhc_first_sums: float
    nhc_max_sum_nis: float
    nhc_max_noise_scale: float
    nhc_min_noise_scale: float
    unknown_height: float
    unknown_speed: float
    unknown_vertical_speed: float
    first_velocity_sigma: float
    max_start_velocity_sigma: float
    speed_sigmas: float
    max_start_heading_positions: float
    max_start_heading: float
    heading_horizon_s: float
    min_heading_sigma: float
    moving_tilt: float
    lost_tilt: float
    level_rest_sigma: float
    level_gnss_sigma: float
    level_pair_age_s: float
    level_vertical_sigma: float
    level_motion_sigma: float
    level_turn_speed: float
    pair_min_s: float
    pair_max_s: float
    pair_velocity_sigma: float
    match_gate: float
    match_min_duration_s: float
    match_max_duration_s: float
    match_rotation: float
    match_outage_share: float
    levelled_sigma: float
    unmodelled_accel_psd: float
    whitening_position_sigma: float
    whitening_speed_sigma: float
    drift_rate_step: float
    max_corrected_tilt: float
    min_events: float
    min_events_unknown_drift: float
    correlation_factor: float
    unknown_tilt_accel: float
    heading_fault_angle: float
    heading_fault_gate: float
    heading_faults: int
    realigned_tilt: float
    max_heading_sigma: float
    onset_interval_s: float
    min_drift_s: float
    min_drift_fixes: int
    min_drift_speed: float
    drift_chi2: float
    min_drift_noise_scale: float
    first_drift_noise_scale: float
    max_drift_noise_scale: float
    drift_noise_scale_prior: float
    drift_noise_scale_gain: float
    unknown_accel: float
    max_ahead_s: float
    max_age_s: float
    max_rewind_miss_s: float
    heading_sigma: float
    heading_gate: float
    heading_min_level: float
    first_tilt_sigma: float
    given_tilt_sigma: float
    given_heading_sigma: float
    given_position_sigma: float
    given_velocity_sigma: float
    velocity_time_offset_sigma: float
    time_offset_sigma: float
    first_velocity_noise: float
    coasting_s: float
    max_valid_tilt_sigma: float
    max_valid_heading_sigma: float


class Parameters:
    period: float
    gnss_lever_arm: Floats
    vehicle: int
    assumed_latency: float
    gyro_psd: float
    gyro_bias_psd: float
    gyro_bias_sigma: float
    gyro_scale: float
    gyro_range: float
    accel_psd: float
    accel_bias_psd: float
    accel_bias_sigma: float
    accel_scale: float
    accel_range: float
    tuning: Tuning


class Nav:
    t_ns: int
    fused_count: int
    lat: float
    lon: float
    height: float
    v_n: Floats
    q_nb: Floats
    bg: Floats
    ba: Floats
    gnss_bias: Floats
    forward: Floats
    lateral: Floats
    time_offset: float
    turn_scale: Floats
    nhc_lever_arm: float
    velocity_time_offset: float


class Earth:
    position: Floats
    sin_lat: float
    cos_lat: float
    tan_lat: float
    lat_per_m: float
    transverse_per_m: float
    lon_per_m: float
    gravity: float


class Imu:
    sample_count: int
    sample_ns: int
    w: Floats
    f: Floats
    saturated: int
    outage_s: Floats
    integration_time: float
    delta_v: Floats
    delta_theta: Floats
    deferred_rotation: float
    accel_n: Floats
    rate_b: Floats
    scale_error_rate: Floats


class Covariance:
    P: NDArray[np.float64]


class Stationarity:
    sample_count: int
    duration: float
    sum_w: Floats
    sum_f: Floats
    delta_v: Floats
    sum_w2: float
    sum_f2: float
    sum_difference2: Floats
    mean_w: Floats
    mean_f: Floats
    max_rate_of_change: Floats
    at_rest: int
    low_motion_count: int
    stationary_count: int
    motion_class: Any
    log_likelihood_ratio: float
    gyro_noise_floor: float
    vibration_level: float
    vibration_accel_psd: float
    vibration_gyro_psd: float


class Nhc:
    since_update: float
    enabled: int
    velocity_scatter: Floats
    principal_axis: Floats
    ground_scatter: Floats
    down_sum: Floats
    scatter_weight: float
    mean_nis: float
    noise_scale: Floats
    innovation_sum: Any
    innovation_count: int
    sum_count: int
    start_variance: Floats
    disable_count: int
    disabled_ns: int


class Gnss:
    last_used_ns: int
    fix_count: int
    speed: float
    bias_sigma: Floats
    reported_sigma: Floats
    noise_var: Floats
    velocity_noise_var: float


class Integrity:
    rejecting: int
    reject_count: Integers
    reject_start_ns: Integers
    outage_at_reject_s: float
    reject_offset: Floats
    frozen_position: Floats
    frozen_since_ns: int
    survey_epochs: int
    velocity_reject_count: int
    position_inflation: Floats
    reset_score: float


class Drift:
    detected: int
    noise_scale: float
    noise_scale_count: int
    pending_noise_scale: float
    onset_ns: Integers
    innovation_count: Integers
    information_vector: Any
    information_matrix: Any
    bias_sensitivity: Any


class Alignment:
    mode: int
    heading_sigma: float
    heading_bias_gain: float
    integrals: Any
    double_integrals: Any
    heading_phasor: Floats
    wander_azimuth: float
    wander_azimuth_drift: float
    vertical_bias: float
    corrections: Any
    pair_start_ns: int
    pair_start: Floats
    pair_integrals: Any
    pair_double_integrals: Any
    mean_velocity: Floats
    mean_integrals: Any
    low_motion_position: Floats
    low_motion_ns: int
    origin_ns: int
    position_origin: Floats
    last_match_ns: int
    reject_count: int
    heading_fault_count: int


class Transition:
    interval: float
    force: Floats
    rotation: Floats
    turn: float
    scaled_turn: float
    gnss_bias: float


class Scratch:
    x: NDArray[np.float64]
    d: NDArray[np.float64]
    columns: NDArray[np.int64]
    values: NDArray[np.float64]
    phi: Transition
    position_innovation: Floats
    accel_fit: Floats
    accel_fit_error: Floats
    integral_change: Any
    innovations: list[Innovation]
    innovation_count: int


class Snapshot:
    nav: Nav
    earth: Earth
    imu: Imu
    cov: Covariance
    stationarity: Stationarity
    nhc: Nhc
    gnss: Gnss
    integrity: Integrity
    drift: Drift
    alignment: Alignment


class Core:
    nav: Nav
    earth: Earth
    imu: Imu
    cov: Covariance
    stationarity: Stationarity
    nhc: Nhc
    gnss: Gnss
    integrity: Integrity
    drift: Drift
    alignment: Alignment
    scratch: Scratch


class HypothesisBank:
    integrals: Any
    double_integrals: Any
    whitening_state: Any
    whitening_P: Any
    products: Any
    weight: float
    energy2: float
    energy_age: float
    last_integrals: Any
    last_double_integrals: Any
    innovations: Any
    prior: Any
    inverse: Any
    gain: Any
    headings: Any


class Measurement:
    t_ns: int
    arrival_ns: int
    kind: int
    value: Floats
    sigma: Floats


class StoredMeasurement:
    t_ns: int
    kind: int
    fix: Fix
    measurement: Measurement
    bank: int
    too_late: int
    last_epoch_ns: int
    last_time_offset: float
    last_fusion_ns: int


class State:
    core: list[Core]
    bank: list[HypothesisBank]
    banks: list[HypothesisBank]
    bank_count: int
    snapshots: list[Snapshot]
    imu_ring: list[StoredSample]
    aiding_ring: list[StoredMeasurement]
    aiding_start: int
    aiding_count: int
    snapshot_count: int
    sample_count: int
    last_epoch_ns: int
    last_time_offset: float
    last_fusion_ns: int
    initial_rpy: Floats
    last_w: Floats
    last_f: Floats
    pending_innovations: list[Innovation]
    pending_count: int
    interpolated_w: Floats
    interpolated_f: Floats
