"""The sensors in use: one inertial sensor, one receiver, and sensors that have no positions."""

import time
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

from imud.drivers.driver import Identity

from ..outputs.view import Device
from ..sensors.inertial import Inertial
from ..sensors.receiver import Receiver
from .ports import Port

Sensor = TypeVar("Sensor", Inertial, Receiver)


class InUse(NamedTuple, Generic[Sensor]):
    """A sensor, and the port on which it streams."""

    port: Port
    sensor: Sensor


@dataclass(slots=True)
class SensorsInUse:
    """Each with the port on which it streams; spares are not among them."""

    imu: InUse[Inertial] | None = None
    gnss: InUse[Receiver] | None = None
    aiding_sensors: dict[Port, Receiver] = field(default_factory=dict)  # without positions: compasses, logs, barometers

    def by_kind(self) -> dict[str, InUse[Inertial] | InUse[Receiver]]:
        """The inertial sensor and the receiver that stream, by the kind of their drivers."""
        pairs = {"imu": self.imu, "gnss": self.gnss}
        return {kind: pair for kind, pair in pairs.items() if pair}

    def all(self) -> list[tuple[Port, Inertial | Receiver]]:
        """Everything that streams."""
        return [*self.by_kind().values(), *self.aiding_sensors.items()]

    def described(self) -> tuple[Device, ...]:
        """The inertial sensor and the receiver that stream, as the clients see them."""
        ports = [used.port for used in self.by_kind().values()]
        return tuple(_described(port.spec.path, port.configured.identity) for port in ports if port.configured)

    def receivers(self) -> list[Receiver]:
        """The receiver, and the sensors with a receiver's protocol."""
        return [*([self.gnss.sensor] if self.gnss else []), *self.aiding_sensors.values()]


def _described(path: str, identity: Identity) -> Device:
    return Device(
        path=path,
        driver=identity.driver,
        bps=identity.baud or None,
        model=identity.model,
        serial=identity.serial,
        activated_s=time.time(),
    )
