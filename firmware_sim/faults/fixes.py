"""Faults of a receiver's fixes: none, or beside the truth by a jump or a ramp."""

import math
from collections.abc import Sequence
from dataclasses import replace

from ..fixes import Fix, FixSource
from .spec import Fault

_EARTH_M = 6.371e6  # good enough for an error


class FaultyFixes:
    """A source of fixes behind faults of the layer "fixes"."""

    def __init__(self, source: FixSource, faults: Sequence[Fault]) -> None:
        self._source, self._faults = source, faults

    def after(self, t: float, interval: float) -> Fix | None:
        """See FixSource."""
        fix = self._source.after(t, interval)
        for fault in self._faults:
            if fix is not None and fault.span.holds(fix.t):
                fix = _with_fault(fix, fault)
        return fix


def _with_fault(fix: Fix, fault: Fault) -> Fix:
    if fault.name == "loss":
        return replace(fix, valid=False)
    distance = fault.value * (fault.span.since(fix.t) if fault.name == "ramp" else 1.0)
    bearing = math.radians(fault.second)
    north, east = distance * math.cos(bearing) / _EARTH_M, distance * math.sin(bearing) / _EARTH_M
    lon = fix.lon_deg + math.degrees(east / math.cos(math.radians(fix.lat_deg)))
    return replace(fix, lat_deg=fix.lat_deg + math.degrees(north), lon_deg=lon)
