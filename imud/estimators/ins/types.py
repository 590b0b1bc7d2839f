"""The records of the navigation filter as types for mypy, written by tests/record_types.py."""

from ...math.arrays import Floats, Indices, Integers, Reals, Tensor
from ..types import Fix, Innovation, Measurement, PendingInnovations
from .tuning_types import Tuning


class StoredSample:
    t_ns: int
    w: Reals
    f: Reals
    flags: int
    outage_s: float


class Parameters:
    period: float
    gnss_lever_arm: Reals
    lever_arm_is_set: int
    lever_arm_sigma: float
    heading_boresight: float
    heading_boresight_sigma: float
    odometer_lever_arm: Reals
    track_width: float
    pose_lever_arm: Reals
    velocity_lever_arm: Reals
    velocity_mount: Reals
    magnetometer: int
    vehicle: int
    assumed_latency: float
    gyro_psd: float
    gyro_bias_psd: float
    gyro_bias_sigma: float
    gyro_bias_wide: float
    gyro_scale: float
    gyro_misalignment: float
    accel_psd: float
    accel_bias_psd: float
    accel_bias_sigma: float
    accel_scale: float
    tuning: Tuning


class Nav:
    t_ns: int
    fused_count: int
    lat: float
    lon: float
    height: float
    v_n: Reals
    q_nb: Reals
    bg: Reals
    ba: Reals
    gnss_bias: Reals
    forward: Reals
    lateral: Reals
    time_offset: float
    gyro_scale: Reals
    nhc_lever_arm: float
    velocity_time_offset: float
    odometer_scale: float
    baro_offset: float
    gnss_velocity_bias: Reals
    gnss_lever_arm: Reals
    velocity_mount: Reals


class Earth:
    lat: float
    height: float
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
    w: Reals
    f: Reals
    saturated: int
    outage_s: Reals
    held_s: float
    integration_time: float
    delta_v: Reals
    delta_theta: Reals
    deferred_rotation: Reals
    accel_n: Reals
    level_force: Reals
    rate_b: Reals
    scale_error_rate: Reals


class Covariance:
    P: Floats
    boresight: Tensor
    boresight_covariance: Tensor


class MotionClass:
    count: float
    mean: float
    variance: float


class Stationarity:
    sample_count: int
    duration: float
    sum_w: Reals
    sum_f: Reals
    delta_v: Reals
    sum_w2: float
    sum_f2: float
    sum_rate_difference2: float
    sum_force_difference2: float
    mean_w: Reals
    mean_f: Reals
    steady_f: Reals
    level_rate_change2: float
    vertical_rate_change2: float
    force_change2: float
    mean_down: Reals
    tilt_range2: float
    level_accel2: float
    turn_rate_var: float
    at_rest: int
    low_motion_count: int
    stationary_count: int
    contradiction_count: int
    contradicting_w: Reals
    changed_rate_count: int
    contradicting_turn2: float
    rest_class: MotionClass
    slow_motion_class: MotionClass
    log_likelihood_ratio: float
    gyro_noise_floor: float
    vibration_level: float
    vibration_accel_psd: float
    vibration_gyro_psd: float
    mean_vibration_gyro_psd: float
    vibration_time: float
    attitude_noise_level: float


class BiasChanges:
    averaged_force: Reals
    earlier_force: Reals
    warm_up_variance: float


class RestGap:
    turn2: float
    window_count: int
    force: Reals
    force2: float
    lat: float
    lon: float
    place2: float


class GravityMonitor:
    time: float
    angle: Reals
    mean_w: Reals
    first_f: Reals
    variance: float
    last_rest_ns: int


class TimeEvidence:
    velocity_change: Reals
    velocity_variance: float
    duration: float
    accel: Reals
    accel_noise: float
    information: float
    error_variance: float
    shown: float
    largest_variance: float
    missing_variance: float


class Nhc:
    since_update: float
    enabled: int
    velocity_scatter: Reals
    principal_axis: Reals
    ground_scatter: Reals
    down_sum: Reals
    scatter_weight: float
    mean_nis: float
    noise_scale: Reals
    innovation_sum: Tensor
    innovation_count: int
    sum_count: int
    start_variance: Reals
    disable_count: int
    disabled_ns: int
    waits_since_ns: int
    direction: float


class LandEvidence:
    level_axis: Reals
    products: Reals
    weight: float
    count: float
    turn_count: float
    turn_sum: float
    turn_force_sum: float
    turn2_sum: float
    turn_times_force_sum: float
    turn_force2_sum: float
    leaky_height: float
    mean_height: float
    current_vector: Reals
    current_information: Reals
    log_likelihood: float
    heave_variance: float


class Gnss:
    last_used_ns: int
    fix_count: int
    speed: float
    bias_sigma: Reals
    reported_sigma: Reals
    noise_var: Reals
    velocity_noise_var: float
    offset_velocity: Reals
    given_lever_arm: Reals
    given_lever_arm_sigma: float
    lever_arm_is_measured: Integers
    lever_arm_inflation: Reals


class Integrity:
    rejecting: int
    reject_count: Integers
    reject_start_ns: Integers
    inconsistent_count: int
    outage_at_reject_s: float
    first_offset: Reals
    reject_offset: Reals
    reject_velocity: Reals
    rejected_velocity: Reals
    rejected_position2: Reals
    rejected_inflation: float
    divergence_count: int
    divergence_ns: int
    diverging_offset: Reals
    diverging_velocity: Reals
    last_lat: float
    last_lon: float
    last_velocity: Reals
    last_speed: float
    last_course: float
    unchanged_since_ns: int
    unchanged_lat: float
    unchanged_lon: float
    may_stand: int
    frozen: int
    epochs: int
    velocity_reject_count: int
    velocity_reject_ns: int
    position_inflation: Reals
    velocity_inflation: Reals
    reset_score: float
    position_ns: int
    position_uses: float
    position_rejects: float
    position_returns: float
    height_ns: int
    height_uses: float
    height_rejects: float


class ProcessNoise:
    psd: Reals
    log_psd: Reals
    log_psd_covariance: Reals
    first_log_psd: float
    covariances: Tensor
    estimate_sensitivity: Tensor


class FaultSensitivities:
    sensitivity: Tensor
    boresight_sensitivity: Tensor


class Drift:
    detected: int
    velocity: Reals
    since_ns: int
    noise_scale: float
    noise_scale_count: int
    pending_noise_scale: float
    onset_ns: Integers
    innovation_count: Integers
    information_vector: Tensor
    information_matrix: Tensor
    position_variance: Reals
    velocity_variance: Reals


class VelocityDrift:
    onset_ns: Integers
    gap_s: Reals
    last_ns: int
    confirmations: int
    count: Reals
    energy: Reals
    vector: Tensor
    information: Tensor
    drift: Reals
    position_variance: Reals
    velocity_variance: Reals
    heading_variance: float


class ChordPoint:
    t_ns: int
    sum: Reals
    median: Reals
    velocity: Reals
    variance: float


class VelocityDiscrepancy:
    last_ns: int
    last_lat: float
    last_lon: float
    last_velocity: Reals
    repeated: int
    sum: Reals
    sum_variance: float
    points: list[ChordPoint]
    count: int
    rate: Reals
    onset_ns: int
    verdict: int


class VelocityLag:
    last_ns: int
    repeated: int
    pairs: float
    change2: float
    cross: float
    travel2: float
    change_sum: float
    travel_sum: float
    energy: float
    lag: float
    variance: float
    late: int


class TimeOffsetStep:
    onset_ns: int
    information: float
    vector: float
    energy: float
    count: int
    epoch_ns: int
    epoch_energy: float
    largest_energy: float
    jump: Tensor


class CompassOffset:
    onset_ns: int
    last_ns: int
    turn_variance: float
    unconfirmed: int
    information: float
    vector: float
    energy: float
    count: float
    heading_variance: float


class Current:
    vector: Reals
    information: Reals
    energy: float
    count: float
    heading_variance: float


class GyroBiasStep:
    last_ns: int
    velocity_ns: int
    heading_variance: float
    onset_ns: Integers
    information: Reals
    vector: Reals
    energy: Reals
    count: Reals


class ImuBiasStep:
    attitude_variance: Reals
    proofs: int
    onset_ns: Integers
    energy: Reals
    count: Reals
    information: Tensor
    vector: Tensor


class LeverArmError:
    onset_ns: int
    vector: Reals
    information: Reals
    energy: float
    count: float
    epoch_ns: int
    epoch_energy: float
    largest_energy: float


class Alignment:
    mode: int
    heading_sigma: float
    heading_bias_gain: float
    integrals: Tensor
    double_integrals: Tensor
    heading_phasor: Reals
    frame_azimuth: float
    corrected_rotation: float
    bias_correction: float
    applied_corrections: Tensor
    corrections: Tensor
    velocity_known_ns: int
    known_integral: Reals
    added_velocity_variance: float
    level_accel_ns: int
    pair_start_ns: int
    pair_velocity: Reals
    pair_lat: float
    pair_lon: float
    pair_accel: Reals
    pair_integrals: Tensor
    pair_double_integrals: Tensor
    mean_velocity: Reals
    mean_velocity_s: float
    mean_integrals: Tensor
    low_motion_lat: float
    low_motion_lon: float
    low_motion_ns: int
    origin_ns: int
    origin_lat: float
    origin_lon: float
    last_match_ns: int
    vector_start_ns: int
    vector_velocity: Reals
    vector_arm_velocity: Reals
    vector_q: Reals
    vector_bias: Reals
    vector_force: Reals
    vector_rotation: Tensor
    vector_sensitivity: Tensor
    reject_count: int
    heading_fault_count: int


class Barometer:
    last_ns: int
    last_used_ns: int
    rejected_ns: int
    height: float
    speed2: float
    reading: float
    changed_ns: int
    ratio_ns: int
    ratio_reading: float
    ratio_height: float
    reading2: float
    reading_height: float
    fix_ns: int
    mean_fix_height: float
    mean_reading: float
    scale_error2_by_fixes: float


class ExternalAid:
    last_ns: int
    last_used_ns: int
    rejected: int
    distrusted: int
    agreeing_ns: int
    yaw_ns: int
    used_share: float
    shown: Reals
    expected: Reals
    shown_noise: Reals
    offset_variance: Reals
    last_value: Reals


class SourceAge:
    last_ns: int
    probability: Reals
    mean: Tensor
    known_s: Reals
    age: float
    variance: float


class HeadingAid:
    last_ns: int
    last_used_ns: int
    distrusted: int
    agreeing_ns: int
    rejecting_ns: int
    boresight: float
    boresight_prior: float
    yaw_corrections: float
    off_ns: int
    last_off: float
    off_changed: float
    gyros_turned: float
    expected_variance: float
    mean_excess: float
    deviation_variance: float
    opened_variance: float
    turn_ns: int
    turn_count: int
    turn_heading: float
    turn_rate: float
    turn: float
    turn_shown: float
    last_turn: float
    last_turn_shown: float
    turn_xx: float
    turn_xy: float
    turn_noise: float


class Magnetometer:
    last_ns: int
    since_ns: int
    contradicted_ns: int
    strength: float
    dip: float
    variation: float
    heading_variance: float
    unused: int


class Odometer:
    last_ns: int
    last_used_ns: int
    reverses: int
    direction: float
    residual: float
    corrections: Reals
    used_corrections: Reals
    step: float
    step_speed: float
    inflation: float
    used_share: float
    unused: int
    reading: float
    reading_ns: int
    predicted: float
    reading_corrections: Reals
    changed_ns: int
    longest_repetition: float
    frozen: int
    resolution: float


class WheelCheck:
    onset_ns: int
    count: float
    z_n: float
    z_e: float
    z2: float
    cross_sum: float
    v2: float
    agreements: int
    rejecting: int


class Transition:
    interval: float
    delta_v: Reals
    C_nb: Reals
    turn_angle: float
    scaled_angle: Reals
    gnss_bias_decay: float
    gnss_velocity_bias_decay: float
    velocity_psd: float
    attitude_psd: float


class VelocityEpoch:
    acceleration: Reals
    second_order: Reals
    change: Reals
    by_lever_arm: Tensor


class Scratch:
    x: Floats
    d: Floats
    gain: Floats
    columns: Indices
    values: Floats
    transition: Transition
    boresight_row: Reals
    boresight_e: Reals
    boresight_gain: Reals
    fault_innovation: Reals
    learning_columns: Indices
    learning_values: Floats
    learning_d: Tensor
    learning_gain: Tensor
    position_innovation: Reals
    velocity_epoch: VelocityEpoch
    integral_change: Tensor
    innovations: list[Innovation]
    innovation_count: int
    age_variance: float
    fix_age_probability: float
    fix_age_error2: float
    drift: Reals
    discrepancy2: Reals
    discrepancy_onset_ns: int
    stated_variances: Reals
    exp_arguments: Reals
    exponentials: Reals
    stated_sigmas: Reals


class Snapshot:
    nav: Nav
    earth: Earth
    imu: Imu
    cov: Covariance
    stationarity: Stationarity
    bias_changes: BiasChanges
    rest_gap: RestGap
    gravity_monitor: GravityMonitor
    nhc: Nhc
    land_evidence: LandEvidence
    gnss: Gnss
    time_evidence: TimeEvidence
    integrity: Integrity
    process_noise: ProcessNoise
    faults: FaultSensitivities
    drift: Drift
    time_offset_step: TimeOffsetStep
    gyro_bias_step: GyroBiasStep
    imu_bias_step: ImuBiasStep
    velocity_drift: VelocityDrift
    compass_offset: CompassOffset
    current: Current
    lever_arm_error: LeverArmError
    alignment: Alignment
    barometer: Barometer
    heading_aid: HeadingAid
    magnetometer: Magnetometer
    pose: ExternalAid
    external_velocity: ExternalAid
    body_velocity: ExternalAid
    odometer: Odometer
    wheel_check: WheelCheck


class Core:
    nav: Nav
    earth: Earth
    imu: Imu
    cov: Covariance
    stationarity: Stationarity
    bias_changes: BiasChanges
    rest_gap: RestGap
    gravity_monitor: GravityMonitor
    nhc: Nhc
    land_evidence: LandEvidence
    gnss: Gnss
    time_evidence: TimeEvidence
    integrity: Integrity
    process_noise: ProcessNoise
    faults: FaultSensitivities
    drift: Drift
    time_offset_step: TimeOffsetStep
    gyro_bias_step: GyroBiasStep
    imu_bias_step: ImuBiasStep
    velocity_drift: VelocityDrift
    compass_offset: CompassOffset
    current: Current
    lever_arm_error: LeverArmError
    alignment: Alignment
    barometer: Barometer
    heading_aid: HeadingAid
    magnetometer: Magnetometer
    pose: ExternalAid
    external_velocity: ExternalAid
    body_velocity: ExternalAid
    odometer: Odometer
    wheel_check: WheelCheck
    scratch: Scratch


class FixAge:
    last_ns: int
    origin_ns: int
    lat: float
    lon: float
    velocity: Reals
    integrals: Tensor
    products: Tensor
    counts: Tensor
    corrections: Tensor
    prior: Tensor
    probability: float
    age: float
    variance: float
    around: Tensor
    pair: Tensor
    inverse: Tensor
    gain: Tensor
    undone: Tensor


class VectorPair:
    gnss: Reals
    force: Reals
    sensitivity: Tensor
    level_variance: float
    down_variance: float


class HypothesisBank:
    integrals: Tensor
    double_integrals: Tensor
    whitening_state: Tensor
    whitening_P: Tensor
    products: Tensor
    weight: float
    energy2: float
    energy_age: float
    last_integrals: Tensor
    last_double_integrals: Tensor
    vector_count: int
    vectors: list[VectorPair]
    vector_normal: Tensor
    vector_product: Tensor
    innovations: Tensor
    prior: Tensor
    inverse: Tensor
    gain: Tensor
    headings: Tensor


class StoredMeasurement:
    t_ns: int
    kind: int
    fix: Fix
    measurement: Measurement
    age_variance: float
    velocity_epoch: VelocityEpoch
    restarts: int
    discrepancy: Reals
    discrepancy_s: float
    discrepancy_open: int
    velocity_lost: int
    discrepancy_lasts: int
    bank: int
    last_epoch_ns: int
    last_time_offset: float
    last_fusion_ns: int


class State:
    core: list[Core]
    bank: list[HypothesisBank]
    banks: list[HypothesisBank]
    bank_count: int
    snapshots: list[Snapshot]
    source_ages: list[SourceAge]
    fix_age: FixAge
    velocity_discrepancy: VelocityDiscrepancy
    velocity_lag: VelocityLag
    imu_ring: list[StoredSample]
    aiding_ring: list[StoredMeasurement]
    aiding_start: int
    aiding_count: int
    snapshot_count: int
    sample_count: int
    fix: Fix
    last_course: float
    course_repeats: int
    usual_ahead: float
    last_epoch_ns: int
    last_time_offset: float
    last_fusion_ns: int
    initial_rpy: Reals
    last_w: Reals
    last_f: Reals
    pending: PendingInnovations
    interpolated_w: Reals
    interpolated_f: Reals
