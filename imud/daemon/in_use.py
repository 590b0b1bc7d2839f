"""The sensors in use: one inertial sensor, one receiver, and sensors that have no positions."""

from dataclasses import dataclass, field

from ..sensors.inertial import Inertial
from ..sensors.receiver import Receiver
from .ports import Port


@dataclass(slots=True)
class SensorsInUse:
    """Each with the port on which it streams; spares are not among them."""

    imu: tuple[Port, Inertial] | None = None
    gnss: tuple[Port, Receiver] | None = None
    sensors: dict[Port, Receiver] = field(default_factory=dict)  # without positions: compasses, logs, barometers

    def by_kind(self) -> dict[str, tuple[Port, Inertial] | tuple[Port, Receiver]]:
        """The inertial sensor and the receiver that stream, by the kind of their drivers."""
        pairs = {"imu": self.imu, "gnss": self.gnss}
        return {kind: pair for kind, pair in pairs.items() if pair}

    def all(self) -> list[tuple[Port, Inertial] | tuple[Port, Receiver]]:
        """Everything that streams."""
        return [*self.by_kind().values(), *self.sensors.items()]

    def receivers(self) -> list[Receiver]:
        """The receiver, and the sensors with a receiver's protocol."""
        return [*([self.gnss[1]] if self.gnss else []), *self.sensors.values()]
