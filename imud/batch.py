"""Whole arrays of samples, fixes and measurements through a filter: what `imud replay` of tables and the library do."""

import itertools
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from .estimators.filter_states import PERIOD_NS
from .estimators.records import MEASUREMENT, SOLUTION
from .math.arrays import Records
from .pipeline import Filter, innovation_buffer

BLOCK = 4096  # samples: each costs some 20 us of Python
RATE_SAMPLES = 1000  # whose mean period is compared with the median one
MEDIAN_RATIO = 0.6, 1.2  # of the median period over that mean; else samples come in packets
LONGEST_PACKET = 1.5  # over the median one; between longer ones whole packets are missing
WHOLE_QUANTILE = 0.99  # of the numbers of samples in packets
SUMMED, LEAST_SUMS = 16, 4  # packets in a sum of their samples; sums
LEAST_DISPERSION = 0.5  # of the variance of such sums, over that of random losses
LARGEST_VARIATION = 0.02  # of the time from packet to packet, over its mean: a poll may be late
NO_MEASUREMENT = np.zeros(0, MEASUREMENT)


def ignore(_: int) -> None:
    pass


def rate_hz_of(samples: Records) -> float:
    """The nominal rate: that of the median period, or where samples come in packets, several at once, of the packets'.

    samples: array of SAMPLE, two at least.
    """
    t_ns = samples["t_ns"]
    span = min(RATE_SAMPLES, len(t_ns) - 1)
    median, mean = np.median(np.diff(t_ns)), np.median(t_ns[span:] - t_ns[:-span]) / span
    least, most = MEDIAN_RATIO
    return 1e9 / float(median if least < median / mean < most else period_in_packets(t_ns, mean))


def period_in_packets(t_ns: NDArray[np.int64], mean_ns: float) -> float:
    """The period of a sensor whose samples come in packets, ns; mean_ns: the mean one of the samples that came.

    Where all packets have one size and lack single samples at random, the largest ones are whole (some larger one may
    have a sample twice), and the numbers of samples in them are independent, with a binomial distribution, so that the
    variance of a sum of them grows with their number. Else it is the mean one: polls find what the sensor has by then,
    which is bound to the time, and how many samples that were is not known.
    """
    newest = np.flatnonzero(np.diff(t_ns) > 0.5 * mean_ns)
    lengths, counts = np.diff(t_ns[newest]), np.diff(newest)
    if len(counts) == 0:
        return mean_ns
    single = lengths < LONGEST_PACKET * np.median(lengths)
    lengths, counts = lengths[single], counts[single]
    size, mean = np.quantile(counts, WHOLE_QUANTILE, method="higher"), np.mean(counts)
    surplus = np.cumsum(counts - lengths * (np.sum(counts) / np.sum(lengths)))
    sums = np.diff(surplus[::SUMMED])
    if len(sums) < LEAST_SUMS or np.std(lengths) > LARGEST_VARIATION * np.mean(lengths):
        return mean_ns
    binomial = SUMMED * mean * (1.0 - mean / size)
    return float(np.mean(lengths) / size) if np.mean(sums**2) >= LEAST_DISPERSION * binomial else mean_ns


def in_order_of_arrival(parts: Iterable[Records]) -> Records:
    """The measurements (MEASUREMENT) of all parts."""
    rows = np.concatenate([NO_MEASUREMENT, *parts])
    return rows[np.argsort(rows["arrival_ns"], kind="stable")]


def play(
    filter_: Filter,
    samples: Records,
    fixes: Records,
    on_solutions: Callable[[Records], object],
    *,
    on_innovations: Callable[[Records], object] | None = None,
    aiding: Records = NO_MEASUREMENT,
    on_progress: Callable[[int], None] = ignore,
    each_second: Callable[[int], None] | None = None,
) -> int:
    """Feed everything in the order in which it became known: a fix goes in before the first sample not older than its
    arrival.

    samples: array of SAMPLE, turned to body axes in place. fixes, aiding: arrays of FIX and MEASUREMENT, in order of
    arrival. on_solutions: given the solutions of each block, in rows that the next block overwrites. on_innovations:
    given copies. on_progress: given the number of samples done. each_second: called behind the first sample of each
    second, and perhaps of others, with its time. Returns the number of fixes fed.
    """
    out = np.zeros(min(BLOCK, len(samples)), SOLUTION)
    t_ns = samples["t_ns"].copy()  # one behind the other
    fixes, fix_before = _with_insertion_points(t_ns, fixes, first=1)
    aiding, measurement_before = _with_insertion_points(t_ns, aiding, first=0)
    prepared = measurement_before[filter_.needing_place(aiding)]  # from the state then: each begins a block
    seconds = np.flatnonzero(np.diff(t_ns // PERIOD_NS, prepend=-1))[: None if each_second else 0] + 1
    edges = np.unique(np.concatenate([np.arange(0, len(samples), BLOCK), prepared, seconds, [len(samples)]]))
    fix_edges, measurement_edges = np.searchsorted(fix_before, edges), np.searchsorted(measurement_before, edges)
    buffer = innovation_buffer(int(np.max(np.diff(fix_edges) + np.diff(measurement_edges), initial=0)))
    blocks = zip(*(itertools.pairwise(at.tolist()) for at in (edges, fix_edges, measurement_edges)), strict=True)
    for (start, stop), (fix, next_fix), (measurement, next_measurement) in blocks:
        rows = out[: stop - start]
        innovations = filter_.feed(
            samples[start:stop],
            rows,
            fixes[fix:next_fix],
            fix_before[fix:next_fix] - start,
            buffer,
            aiding[measurement:next_measurement],
            measurement_before[measurement:next_measurement] - start,
        )
        on_solutions(rows)
        on_progress(stop)
        if each_second is not None:
            each_second(int(t_ns[stop - 1]))
        if on_innovations is not None:
            on_innovations(innovations.copy())  # a view would keep the whole buffer in memory
            on_innovations(filter_.pending_innovations().copy())
    return len(fixes)


def _with_insertion_points(t_ns: NDArray[np.int64], rows: Records, first: int) -> tuple[Records, Records]:
    """Fixes or measurements, and the index of the sample before which each is fused; without those before `first`."""
    before = np.maximum.accumulate(np.searchsorted(t_ns, rows["arrival_ns"], side="left"))
    within = (before >= first) & (before < len(t_ns))
    return rows[within], before[within]
