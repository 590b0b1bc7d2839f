"""Faults of the sensing elements, whatever device they are in: axes that freeze or saturate, biases that change."""

from collections.abc import Sequence

import numpy as np

from ..ellipsoid import Array
from ..noise import DEG, Grade, ImuErrors, Signal
from .spec import Fault


class FaultyErrors(ImuErrors):
    """The errors of one specimen, and its faults."""

    def __init__(
        self,
        grade: Grade,
        rng: np.random.Generator,
        tick_hz: float,
        gyro_bias: tuple[float, float, float] | None = None,
        accel_bias: tuple[float, float, float] | None = None,
        gyro_slope: tuple[float, float, float] = (0.0, 0.0, 0.0),
        faults: Sequence[Fault] = (),
    ) -> None:
        """See ImuErrors; faults: those of the layer "sensor"."""
        super().__init__(grade, rng, tick_hz, gyro_bias, accel_bias, gyro_slope)
        self._faults = [(fault, list(fault.axes)) for fault in faults]
        self._held: dict[int, Array] = {}  # what a frozen fault's axes show, by its place in `_faults`

    def measure(self, signal: Signal, t: Array) -> Array:
        values = super().measure(signal, t)
        for place, (fault, axes) in enumerate(self._faults):
            inside = np.array([fault.span.holds(instant) for instant in t.tolist()], dtype=bool)
            if fault.name == "frozen":
                self._freeze(place, values, axes, inside)
            elif fault.name == "bias":
                values[inside, :3] += fault.value * DEG
            else:
                for axis in axes:
                    values[inside, axis] = self.limit[axis] if fault.name == "saturated" else 0.0
        return values

    def _freeze(self, place: int, values: Array, axes: list[int], inside: np.ndarray) -> None:
        for row, frozen in enumerate(inside.tolist()):
            if not frozen:
                self._held.pop(place, None)
            else:
                values[row, axes] = self._held.setdefault(place, values[row, axes].copy())
