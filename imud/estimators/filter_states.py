"""The record of what a filter estimates beside its solution; its names are in `imud.filter_state_names`.

A filter fills a row of FILTER_STATES once a second at most, not with every sample. What it does not estimate, because
there is no such source, is NaN, and is in no output.
"""

import numpy as np

from ..filter_state_names import COVARIANCES, STATES
from ..math.arrays import Indices, Records

PERIOD_NS = 1_000_000_000  # between two rows

FILTER_STATES = np.dtype(
    [
        ("t_ns", "<i8"),
        # of the errors north, east, down of position, m, velocity, m/s, and attitude, a small rotation, rad: the upper
        # triangle, row by row, with what likely faults add to the stated sigmas; NaN where there is no position
        ("covariance", "<f8", (len(COVARIANCES),)),
        ("value", "<f8", (len(STATES),)),  # as STATES, SI units; NaN: not estimated
        ("sigma", "<f8", (len(STATES),)),  # NaN: not known
    ],
    align=True,
)


def in_triangle(n: int) -> Indices:
    """Where each element of a symmetric n x n matrix is in its packed upper triangle."""
    places = np.zeros((n, n), np.int64)
    places[np.triu_indices(n)] = np.arange(n * (n + 1) // 2)
    return np.maximum(places, places.T)


ATTITUDE_BLOCK = in_triangle(9)[6:, 6:]  # in `covariance`


class OncePerPeriod:
    """Says when a row is due: with the first solution of each period."""

    def __init__(self, period_ns: int = PERIOD_NS) -> None:
        self._period_ns, self._last = period_ns, -1

    def is_due(self, t_ns: int) -> bool:
        """At the time of the newest solution; True once in a period."""
        period, before = t_ns // self._period_ns, self._last
        self._last = period
        return period != before


def cells(rows: Records) -> dict[str, "np.ndarray[tuple[int], np.dtype[np.float64]]"]:
    """Columns by name, behind `t_s`: the covariance, and what was estimated at any time, each with its sigma (`s…`)."""
    found = {name: rows["covariance"][:, i] for i, name in enumerate(COVARIANCES)}
    for i, state in enumerate(STATES):
        for prefix, field in (("", "value"), ("s", "sigma")):
            if np.isfinite(rows[field][:, i]).any():
                found[f"{prefix}{state.column}"] = state.factor * rows[field][:, i]
    return found
