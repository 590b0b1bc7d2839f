"""The axis of a curve with a sigma: without that of the start, with which all that comes later is a flat line."""

from collections.abc import Iterable

import numpy as np

from ...figures import Trace

SETTLED = 5.0  # of the median of sigma: more is the start, or an outage
CROWDED, MARGIN = 1.5, 0.05  # of the settled signal's range


def settled_range(traces: Iterable[Trace]) -> tuple[float, float] | None:
    """The range of y that shows the settled signals; None: an axis of everything shows them as well.

    A trace is settled where its sigma is at most SETTLED times its median. With the sigma of the start on the axis, all
    that comes later is a flat line.
    """
    every, settled = [], []
    for trace in traces:
        if trace.sigma is None:
            continue
        known = np.isfinite(trace.y) & np.isfinite(trace.sigma)
        y, sigma = trace.y[known], trace.sigma[known]
        if len(y):
            late = sigma <= SETTLED * np.median(sigma)
            every += [y - sigma, y + sigma]
            settled += [(y - sigma)[late], (y + sigma)[late]]
    if not settled:
        return None
    low, high = float(np.min(np.concatenate(settled))), float(np.max(np.concatenate(settled)))
    whole = float(np.max(np.concatenate(every))) - float(np.min(np.concatenate(every)))
    margin = MARGIN * (high - low)
    return (low - margin, high + margin) if whole > CROWDED * (high - low) else None
