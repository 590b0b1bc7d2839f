"""The run of the attitude filter again, forward, with a record of what became of its errors in each interval."""

import numpy as np

from ..estimators.ahrs.state import COVARIANCE, HISTORY
from ..estimators.records import SOLUTION
from ..math.arrays import Records
from ..pipeline import Filter
from .rows import Rows

INTERVAL = np.dtype(  # a covariance interval
    [
        ("sample", "<i8"),  # the last one in it
        ("t_ns", "<i8"),
        ("q_nb", "<f8", (4,)),  # at its end, after all corrections
        ("history", HISTORY),
        ("P", COVARIANCE["P"]),
    ],
    align=True,
)
BLOCK = 1024  # samples
_JUST_BEFORE = 1.0 - 1e-6


def record_intervals(filter_: Filter, samples: Records, solutions: Rows, intervals: Rows) -> None:
    """Run the filter over the samples (SAMPLE, in body axes); write SOLUTION of each, INTERVAL of each interval."""
    state, history = filter_.state[0], filter_.state["history"]
    interval_ns = 1e9 * _JUST_BEFORE * filter_.parameters["tuning"]["covariance_interval_s"][0]
    out, row = np.zeros(BLOCK, SOLUTION), np.zeros(1, INTERVAL)
    begin = 0
    _clear(history)
    while begin < len(samples):
        block = samples[begin : begin + BLOCK].copy()
        left_ns = interval_ns - 1e9 * state["integrals"]["time"]
        count = max(int(np.searchsorted(block["t_ns"], state["t_ns"] + left_ns)), 1)
        if state["stamps"]["ahead"] != 0.0 or 4e9 * state["stamps"]["period"] > interval_ns:
            count = 1  # what is integrated is not what is stamped
        filter_.run(block[:count], out[:count])
        assert history["intervals"][0] <= 1
        solutions.append(out[:count])
        begin += count
        if history["intervals"][0]:
            row["sample"], row["t_ns"], row["q_nb"] = begin - 1, state["t_ns"], state["nav"]["q_nb"]
            row["history"], row["P"] = history, state["cov"]["P"]
            intervals.append(row)
            _clear(history)


def _clear(history: Records) -> None:
    history[:] = np.zeros(1, HISTORY)
    history["enabled"], history["count"] = 1, -1
