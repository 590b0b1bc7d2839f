"""The record of a clock as types for mypy, written by tests/record_types.py."""

from ..math.arrays import Integers, Reals


class Clock:
    period_ns: float
    delay_ns: float
    started: int
    fitted: int
    base_tick: int
    base_ns: int
    uncounted_ticks: float
    slope: float
    sigma_slope: float
    offset: float
    slew_ns: float
    last_tick: int
    last_ns: int
    lowered_ns: float
    sound_count: int
    last_missed: float
    last_window: float
    window_ns: float
    window_start: int
    window_x: float
    window_arrival: float
    window_residual: float
    window_samples: int
    window_mean_x: float
    window_mean: float
    watch_start: float
    watch_samples: int
    watch_min_lateness: float
    last_watch_lateness: float
    late_watches: int
    count: int
    ticks: Reals
    arrivals: Reals
    mean_ticks: Reals
    mean_arrivals: Reals
    hull: Integers
    heights: Reals
    residual_ns: float
    corrections: int
    late_ns: float
    latest_ns: float
