"""Faults of what a sensor beside GNSS reads: held, shifted, scaled."""

import math
from collections.abc import Sequence

from .spec import Fault


class FaultyReadings:
    """A function of time and reading, with the faults of the layer "reading". Times never decrease."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        self._faults = faults
        self._held = math.nan

    def __call__(self, t: float, value: float) -> float:
        """What the sensor says at time `t` instead of `value`."""
        active = {fault.name: fault.value for fault in self._faults if fault.span.holds(t)}
        value = active.get("scale", 1.0) * value + active.get("offset", 0.0)
        if "held" not in active or math.isnan(self._held):
            self._held = value
        return self._held
