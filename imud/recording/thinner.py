"""Fewer rows for tables and viewers: the first of each period."""

import numpy as np

from ..math.arrays import Records


class Thinner:
    """Thins rows to a rate: keeps the first of each period since `begin_ns`; at 0 Hz all of them."""

    def __init__(self, rate_hz: float, begin_ns: int = 0) -> None:
        self._rate_hz, self._begin_ns, self._slot = rate_hz, begin_ns, -1

    def kept(self, rows: Records) -> Records:
        """Of these, which follow those before."""
        if not (self._rate_hz and len(rows)):
            return rows
        slots = np.floor((rows["t_ns"] - self._begin_ns) * (1e-9 * self._rate_hz) + 1e-6).astype(np.int64)
        new = slots != np.concatenate([[self._slot], slots[:-1]])
        self._slot = int(slots[-1])
        kept: Records = rows[new]
        return kept
