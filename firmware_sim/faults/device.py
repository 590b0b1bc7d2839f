"""Faults of a device as a whole, at set times: it restarts, or its counter jumps."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from ..device import Device
from .spec import Fault


@runtime_checkable
class HasCounter(Protocol):
    """A device with a counter in its messages."""

    def jump_count(self, by: int) -> None:
        """Let the counter miss so many."""
        ...


class FaultyDevice:
    """A device with the faults of the layer "device"."""

    def __init__(self, device: Device, faults: Sequence[Fault]) -> None:
        self.uart = device.uart
        self._device, self._faults = device, faults
        self._applied = [0] * len(faults)

    def receive(self, data: bytes, t: float) -> None:
        self.advance(t)
        self._device.receive(data, t)

    def advance(self, t: float) -> None:
        """Do what was due until time `t`, the faults in their places."""
        while (due := self._due()) <= t:
            self._device.advance(due)
            for i, fault in enumerate(self._faults):
                if fault.span.beginnings(due) > self._applied[i]:
                    self._applied[i] = fault.span.beginnings(due)
                    self._apply(fault, due)
        self._device.advance(t)

    def deadline(self) -> float:
        return min(self._device.deadline(), self._due())

    def prepare(self) -> None:
        self._device.prepare()

    def restart(self, t: float) -> None:
        self._device.restart(t)

    def _due(self) -> float:
        return min(fault.span.nth(n) for fault, n in zip(self._faults, self._applied, strict=True))

    def _apply(self, fault: Fault, t: float) -> None:
        if fault.name == "reset":
            self._device.restart(t)
        elif isinstance(self._device, HasCounter):
            self._device.jump_count(round(fault.value))
