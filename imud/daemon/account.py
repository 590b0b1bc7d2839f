"""What the daemon reports of itself: changes to the log, health to clients, and the answer to `imud status`."""

import time

from ..estimators.records import ATTITUDE_VALID
from ..outputs.all import Outputs
from ..outputs.view import Health
from ..process.contained import ContainedErrors
from ..process.log import get_logger
from ..sensors.inertial import Inertial
from ..sensors.readings import ClockFit
from ..sensors.receiver import Receiver
from . import vitals
from .announce import Announcer
from .delivery import Delivery
from .devices import Devices
from .load import Load

_UPSIDE_DOWN = "the sensor is upside down; if it is not, its axes are others: imu.mount_rpy_deg = [180, 0, 0]"


class Account:
    """One per daemon, from its start. All times are monotonic nanoseconds; not thread-safe."""

    def __init__(self, devices: Devices, errors: ContainedErrors) -> None:
        self._devices, self._errors = devices, errors
        self._log = get_logger()
        self._announcer = Announcer(self._log)
        self._troubles: dict[str, tuple[str, ...] | None] = {"imu": None, "gnss": None}  # None: no such sensor
        self._started_ns = time.monotonic_ns()

    def tick(self, load: Load, now_ns: int) -> None:
        """Call now and then: logs what has changed."""
        inertial = self._devices.fitting.inertial
        newest = inertial.newest if inertial else None
        status = 0 if newest is None else int(newest["status"])
        if self._announcer.status(status, now_ns) & ATTITUDE_VALID:
            self._doubt_the_axes()
        if self._devices.gnss and (news := self._devices.gnss[1].news):
            self._log.warning(news)
            self._devices.gnss[1].news = ""
        streaming = self._devices.streaming()
        for kind in self._troubles:
            pair = streaming.get(kind)
            self._troubles[kind] = self._look_at(kind, pair[1], now_ns) if pair else None
        for text in load.news(inertial.lost if inertial else 0, now_ns):
            self._log.warning(text)

    def _look_at(self, kind: str, sensor: Inertial | Receiver, now_ns: int) -> tuple[str, ...]:
        troubles = sensor.troubles(now_ns)
        sensor.look(now_ns)
        self._announcer.troubles(kind, troubles, now_ns)
        return troubles

    def _doubt_the_axes(self) -> None:
        """Warn of a sensor that seems upside down: its axes may be others than ours, which the wire cannot tell."""
        inertial = self._devices.fitting.inertial
        if inertial is not None and inertial.stream.samples[0]["f"][2] > 0.0:
            self._log.warning(_UPSIDE_DOWN)

    def health(self) -> Health:
        """What is wrong with the sensors, as last looked at."""
        imu = self._devices.imu
        return Health(**self._troubles, clock=imu[1].clock_fit() if imu else ClockFit())

    def status(self, delivery: Delivery, outputs: Outputs) -> str:
        """The answer to `imud status`."""
        now_ns = time.monotonic_ns()
        devices = self._devices
        parts = {port: (sensor, self._troubles[kind]) for kind, (port, sensor) in devices.streaming().items()}
        return vitals.status_object(
            {
                **vitals.of_process(self._started_ns),
                "internal_errors": {"count": self._errors.count, "last": self._errors.last},
                "load": vitals.of_load(delivery.load),
                "filter": vitals.of_filter(devices.fitting.inertial, devices.fitting.estimator.name),
                "innovations": delivery.innovations.told(),
                "ports": {
                    str(i): vitals.of_port(port, now_ns, *parts.get(port, (None, None)))
                    for i, port in enumerate(devices.ports)
                },
                "outputs": vitals.of_outputs(outputs.gpsd, outputs.binary),
            }
        )
