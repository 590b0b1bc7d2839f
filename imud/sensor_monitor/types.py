"""The records of the sensor monitor as types for mypy, written by tests/record_types.py."""

from ..math.arrays import Integers, Reals, Tensor


class Clipping:
    floor: Reals
    range: Tensor
    plateau: Tensor
    largest: Reals
    rising: Integers
    steep: Reals
    rise: Reals
    flat: Integers
    single: Integers
    single_samples: int


class Spikes:
    floor: float
    keep: float
    gap_ns: int
    t_ns: int
    good: Reals
    recent: Reals
    withheld: Reals
    force: Reals
    withheld_force: Reals
    push: float
    recent_push: float
    spike: int
    shock: int


class RateUnits:
    period: float
    window: int
    samples: int
    force: Reals
    covariance: float
    expected2: float
    seen2: float
    degrees: int


class Health:
    clipping: Clipping
    spikes: Spikes
    units: RateUnits
    range: Reals
    promised: Reals
    least_run: int
    far_samples: int
    near_samples: int
    samples: int
    last_ns: int
    fresh: Reals
    value: Reals
    step: Reals
    curve: Reals
    finest: Reals
    turns: Integers
    bend: Reals
    spoilt: Integers
    quietest: Reals
    run: Integers
    held: Integers
    run_ns: Integers
    longest: Integers
    zeros: int
    fever: int
    far: int
    near: int
    far_ns: int
    far_force: Reals
    informative_ns: Integers
    found_ns: Integers
    found: Integers
