"""The records of the attitude filter as types for mypy, written by tests/record_types.py."""

from ...math.arrays import Floats, Indices, Integers, Reals, Tensor


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
    stamp_time_s: float
    clipping_error: float
    clipping_slope_kept: float
    flat_step: float
    saturation_noise: float
    initial_tilt_rad: float
    initial_angle_sigma_rad: float
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
    travel_evidence_at_start: float
    hidden_speed_mps: float
    steady_turn_time_s: float
    hypothesis_tilt_rad: float
    hypothesis_noise_per_rate: float
    hypothesis_speed_noise_mps: float
    hypothesis_speed_noise_share: float
    hypothesis_carried_time_s: float
    hypothesis_evidence: float
    hypothesis_weight_evidence: float
    hypothesis_weight_time_s: float
    hypothesis_hand_odds: float
    hypothesis_max_odds: float
    vibration_time_s: float
    road_slope: float
    reset_velocity_var: float
    reset_position_var: float
    zero_velocity_noise: float
    zero_velocity_noise_per_scatter: float
    shared_scatter: float
    unseen_velocity_var: float
    unseen_velocity_time_s: float
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
    force_change_gate: float
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
    even_motion_probability: float
    even_acceleration_mps2: float
    moving_vibration_ratio: float
    turn_ratio: float
    standing_vibration_ratio: float
    moving_log_odds: float
    converged_tilt_rad: float
    lost_tilt_rad: float
    max_velocity_gain_mps: float
    common_velocity_gain: float
    velocity_gain_time_s: float
    gain_time_s: float
    usual_gain_time_s: float
    usual_gain_sigmas: float
    min_gain_mps: float
    rise_gain_sigmas: float
    rise_gain_mps: float
    rise_time_s: float
    rise_angle_rad: float
    rise_slip_probability: float
    step_gain_sigmas: float
    step_gain_mps: float
    min_step_s: float
    steady_share: float
    hand_time_s: float
    hand_rate_radps: float
    min_hand_probability: float
    lively_acceleration_mps2: float
    lively_rate_radps: float
    vehicle_acceleration_mps2: float
    travel_proof_s: float
    vehicle_time_s: float
    correction_time_s: float
    correction_memory_s: float
    correction_gate: float
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
    period_s: float
    gyro_psd: float
    gyro_bias_var: float
    gyro_bias_inflation: float
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
    sensor_axes: Reals
    tuning: Tuning


class Nav:
    q_nb: Reals
    v_n: Reals
    p_n: Reals
    bg: Reals
    ba: Reals
    gyro_matrix: Reals
    accel_scale: Reals
    accel_delay: float
    gravity: float


class Covariance:
    P: Floats
    sigma_tilt: float
    sigma_rpy: Reals
    sigma_bg: Reals
    sigma_ba: Reals
    unseen_tilt: float
    unseen_yaw: float


class Imu:
    w: Reals
    f: Reals
    f_change: Reals
    gap_w: Reals
    gap_f: Reals
    outage_s: float
    fault_s: float
    rate2: float


class Stamps:
    period: float
    ahead: float
    waiting: int
    late: int
    returns: int
    misfits: int
    unobserved: float
    queued: int
    block_samples: int
    block_s: float
    last_dt: float
    rate_change: Reals
    count: float
    squares: float
    taught: float
    offset_offset: float
    offset_reading: float
    reading_reading: float
    scatter: float
    gain: float
    slope: float
    slope_variance: float


class Integrals:
    time: float
    c: Reals
    delta_v: Reals
    c_outer_w: Reals
    c_diag_f: Reals
    c_f_cross_w: Reals
    a_outer_a: Reals
    w2: float
    attitude_noise: float
    velocity_noise: float


class Levelling:
    initialised: int
    coarse: int
    true_heading: int
    initial_rpy: Reals
    duration: float
    delta_v: Reals
    force2: float


class Motion:
    v_mean: Reals
    v_scatter: Reals
    p_scatter: Reals
    travel_speed2: Reals
    mean_force: Reals
    mean_force_change: Reals
    moving_s: float
    turn_rate: float
    turn_rate2: float
    hidden_tilt: float
    vibration_level: float
    travel_vibration_level: float


class Stationarity:
    w_mean: Reals
    f_mean: Reals
    w_start: Reals
    f_start: Reals
    force_psd: float
    f_at_rest: Reals
    low_motion_s: float
    bias_mismatch_s: float
    stationary: int
    since_first_s: float
    bg_before: Reals
    since_rest_s: float
    possible_tilt: float
    least_force_psd: float
    hidden_tilt: float
    hidden_turn: Reals
    hidden_angle: float
    unmeasured_s: float
    gravity_checked: int


class Divergence:
    velocity_gain: Reals
    gain_duration: float
    converged: int


class AttitudeStep:
    delta_v: Reals
    span: float
    mean_gain: Reals
    mean_force: Reals
    usual_s: float
    usual_gain2: float
    usual_mean2: float
    window_delta_v: Reals
    window_mean_v: Reals
    window_s: float
    rise_delta_v: Reals
    rise_s: float
    clipping_variance: float
    hand_held_s: float
    travel_s: float
    levelled_angle: float
    likely_hand_s: float
    possible_tilt_error: float


class Clipping:
    time: Reals
    slope: Reals
    last_slope: Reals
    flat: Reals
    w: Reals
    last_w: Reals
    missing_angle: float


class VarianceFactor:
    correction: Reals
    expected2: Reals
    squares: float
    expectations: float
    tilt_scale: Reals


class VelocityHypotheses:
    x: Tensor
    P: Tensor
    log_likelihood: Reals
    log_weight: Reals
    v: Reals
    displacement: Reals
    time: float
    tilt_by_bias: Tensor
    velocity_by_bias: Tensor
    force: float
    turn: float
    turn_by_bias: Reals
    shift: Reals
    attitude_noise: float
    velocity_noise: Reals
    ph: Floats
    hand: float
    mean: Reals
    covariance: Tensor
    yaw_correction: float
    leading: int
    due: int
    possible_tilt_error: float


class Quantization:
    last_reading: Reals
    lsb: Reals
    offset: Reals
    truncation_log_odds: float
    max_error: Reals
    error: Reals
    error_var: Reals
    log_likelihood_ratio: Reals
    last_side: Reals
    crossing_count: Reals
    crossing_histogram: Reals
    rest_histogram: Reals
    rest_step2: Reals
    rest_samples: int
    rest_blocks: int


class History:
    enabled: int
    intervals: int
    coarse: int
    restart_ns: int
    possible_tilt_var: float
    wrong_tilt_s: float
    left_yaw: float
    yaw_corrected: int
    q_before: Reals
    time: float
    c: Reals
    delta_v: Reals
    c_outer_w: Reals
    c_diag_f: Reals
    c_f_cross_w: Reals
    count: int
    reset_states: Integers
    state: Integers
    innovation: Reals
    innovation_var: Reals
    ph: Floats
    age: Reals


class Scratch:
    x: Floats
    ph: Floats
    columns: Indices
    values: Floats
    dv_n: Reals
    a_n: Reals


class State:
    t_ns: int
    sample_count: int
    nav: Nav
    cov: Covariance
    imu: Imu
    stamps: Stamps
    integrals: Integrals
    levelling: Levelling
    motion: Motion
    stationarity: Stationarity
    divergence: Divergence
    attitude_step: AttitudeStep
    hypotheses: VelocityHypotheses
    variance_factor: VarianceFactor
    clipping: Clipping
    quantization: Quantization
    history: History
    scratch: Scratch
