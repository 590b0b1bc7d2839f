"""The records of the sensor monitor as types for mypy, written by tests/record_types.py."""

from ..math.arrays import Integers, Reals, Tensor


class Clipping:
    floor: Reals
    range: Tensor
    plateau: Tensor
    largest: Tensor
    rising: Integers
    steep: Reals
    rise: Reals
    flat: Integers
    smooth: Integers
    single: Integers
    single_samples: int


class Spikes:
    floor: float
    lone_floor: float
    decay: float
    shock_decay: float
    gap_ns: int
    t_ns: int
    last: Reals
    step: Reals
    mean_step: Reals
    mean_bend: Reals
    reading: Reals
    deviation: Reals
    recent: Reals
    recent_force: float
    recent_shock: float
    begun: int
    elapsed: int
    count: int
    axes: int
    seen: Reals
    jump: Reals
    replaced: int
    withheld: Reals


class RateUnits:
    period: float
    window: int
    samples: int
    force: Reals
    covariance: float
    expected2: float
    measured2: float
    axes: Reals
    sums: Reals
    force2: float
    turn: float
    count: int
    evidence: float
    degrees: int
    unconfirmed: int
    trust: float
    confirming_windows: int
    brisk_s: float


class Health:
    clipping: Clipping
    spikes: Spikes
    units: RateUnits
    range: Reals
    profile_noise: Reals
    min_repeats: int
    all_repeats: int
    unchanged_repeats: Integers
    far_samples: int
    near_samples: int
    samples: int
    last_ns: int
    reading: Reals
    suspicious: Integers
    value: Reals
    difference: Reals
    second_difference: Reals
    resolution: Reals
    sign_changes: Integers
    second_difference_sum: Reals
    second_difference_max: Reals
    difference_sum: Reals
    block_invalid: Integers
    noise: Reals
    noise_is_pure: Integers
    repeats: Integers
    hold: Integers
    repeats_start_ns: Integers
    whole_repeats: int
    whole_start_ns: int
    whole_repeat_count: int
    min_whole_repeats: int
    has_held: int
    longest_hold: Integers
    zero_count: int
    bad_temperature_count: int
    far_count: int
    near_count: int
    far_start_ns: int
    far_force: Reals
    informative_ns: Integers
    found_ns: Integers
    found_count: Integers
