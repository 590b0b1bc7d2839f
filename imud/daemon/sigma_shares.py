"""How much each source contributes: its share of all by which measurements lower the sigmas of the estimate.

A measurement that is fused lowers a sigma from s to s'. The sums of ln(s / s') of the last minute are kept, one for
each source and quantity; the receiver is a source, too. A source's share of a quantity is its part of the sum of all
sources: 1 if nothing else lowers that sigma, 0 if it contributes nothing. What is assumed instead of measured (rest,
no slip) and what propagation adds is not in the sums.
"""

import math
from collections.abc import Callable
from typing import Any

from ..math.arrays import Records
from ..pipeline import Filter

QUANTITIES = ("position", "height", "velocity", "heading")
_TIME_S = 60.0
RECEIVER = "gnss"


class SigmaShares:
    """The sums. Not thread-safe; times are monotonic ns."""

    def __init__(self) -> None:
        self._sums: dict[str, list[float]] = {}
        self._last_ns = 0

    def fuse(self, source: str, filter_: Filter, act: Callable[[Records], Records], row: Records) -> Records:
        """act(row), with which the filter fuses a fix or measurement of that source, and its result."""
        if filter_.estimator.variances is None:
            return act(row)
        before = filter_.estimator.variances(filter_.state)
        innovations = act(row)
        after = filter_.estimator.variances(filter_.state)
        if before is not None and after is not None:
            self.add(source, before, after, int(row[0]["arrival_ns"]))
        return innovations

    def add(self, source: str, before: tuple[float, ...], after: tuple[float, ...], now_ns: int) -> None:
        """A measurement of that source changed these variances, of QUANTITIES."""
        self._fade(now_ns)
        sums = self._sums.setdefault(source, [0.0] * len(QUANTITIES))
        for i, (old, new) in enumerate(zip(before, after, strict=True)):
            sums[i] += 0.5 * max(math.log(old / new), 0.0)

    def _fade(self, now_ns: int) -> None:
        left = math.exp(-max(now_ns - self._last_ns, 0) * 1e-9 / _TIME_S)
        self._last_ns = max(now_ns, self._last_ns)
        for sums in self._sums.values():
            sums[:] = [left * each for each in sums]

    def table(self, source: str) -> dict[str, Any]:
        """Of a source: its share of each quantity, 0 to 1; empty: it has changed none."""
        if source not in self._sums:
            return {}
        totals = [sum(each) for each in zip(*self._sums.values(), strict=True)]
        rows = zip(QUANTITIES, self._sums[source], totals, strict=True)
        return {"share": {name: round(part / whole, 3) for name, part, whole in rows if whole > 0.0}}
