"""The daemon's state: changes go to the log, faults of the sensors to clients, a table answers `imud status`."""

import time
from typing import TYPE_CHECKING, Any

from ..estimators.filter_states import OncePerPeriod, cells
from ..estimators.records import ATTITUDE_VALID
from ..outputs.all import Outputs
from ..outputs.view import Health
from ..process.contained import ContainedErrors
from ..process.log import get_logger
from ..sensors.aiding import SourceCounter
from ..sensors.inertial import Inertial
from ..sensors.readings import ClockFit
from ..sensors.receiver import Receiver
from . import status_tables
from .change_logger import ChangeLogger
from .devices import Devices
from .load import Load
from .ports import Port
from .publisher import Publisher
from .utc import Utc

if TYPE_CHECKING:
    from .aiding_input import AidingInput

_FRESH_NS = 100_000_000  # largest age of the health that clients get
_UPSIDE_DOWN = "the sensor is upside down; if it is not, its axes are others: imu.mount_rpy_deg = [180, 0, 0]"
_LEVER_ARM_UNSET = (
    "the receiver's positions are of centimetres, and the lever arm of its antenna is not set, so it is estimated: "
    "set navigation.lever_arm_m, [0, 0, 0] if the antenna is at the sensor"
)
_CLOCK_DIFFERS = (
    "the receiver's time and this machine's clock differ by more than a second: above half a minute gpsd's clients "
    "and NMEA get the receiver's; the binary stream and recordings always have the machine's"
)


class StatusReporter:
    """One per daemon, from its start. All times are monotonic nanoseconds; not thread-safe."""

    def __init__(self, devices: Devices, errors: ContainedErrors, utc: Utc) -> None:
        self._devices, self._errors, self._utc = devices, errors, utc
        self._log = get_logger()
        self._change_logger = ChangeLogger(self._log)
        self._faults: dict[str, tuple[str, ...] | None] = {"imu": None, "gnss": None}  # None: no such sensor
        self._faults_of_others: dict[Port, tuple[str, ...]] = {}
        self._out_of_limits: tuple[str, ...] = ()
        self._received_on_ports: dict[str, SourceCounter] = {}  # by aiding source, of the port that had it last
        self._checked_ns = 0
        self._started_ns = time.monotonic_ns()
        self._lever_arm_period, self._lever_arm_warned = OncePerPeriod(), False

    @property
    def is_settled(self) -> bool:
        """Whether no change waits to be logged, for which `tick` has to be called ten times a second."""
        return self._change_logger.is_settled

    def tick(self, load: Load, gap_ns: int, now_ns: int) -> None:
        """Log what has changed. gap_ns: time since the fast loop's last check."""
        inertial = self._devices.selection.inertial
        newest = inertial.newest if inertial else None
        status = 0 if newest is None else int(newest["status"])
        if self._change_logger.status(status, now_ns) & ATTITUDE_VALID:
            self._warn_if_upside_down()
        self._warn_if_lever_arm_is_unset(now_ns)
        if self._devices.in_use.gnss and (message := self._devices.in_use.gnss.sensor.message):
            self._log.warning(message)
            self._devices.in_use.gnss.sensor.message = ""
        self._check_all(now_ns)
        for text in load.messages(inertial.lost if inertial else 0, gap_ns, now_ns):
            self._log.warning(text)

    def _check_all(self, now_ns: int) -> None:
        """Check the health of everything that streams."""
        self._checked_ns = now_ns
        streaming = self._devices.in_use.by_kind()
        for kind in self._faults:
            self._faults[kind] = self._check(kind, pair[0], pair[1], now_ns) if (pair := streaming.get(kind)) else None
        self._out_of_limits = self._beyond_limits(now_ns)
        for receiver in self._devices.in_use.receivers():
            self._received_on_ports |= receiver.received
            for received in receiver.received.values():
                if received.message:
                    self._log.warning(received.message)
                    received.message = ""
        inertial = self._devices.selection.inertial
        self._change_logger.faults("clock", [_CLOCK_DIFFERS] if self._utc.machine_differs() else [], now_ns)
        self._change_logger.faults("filter", inertial.pipeline.filter.findings() if inertial else (), now_ns)
        self._faults_of_others = {
            port: self._check(port.spec.path, port, sensor, now_ns) for port, sensor in self._others().items()
        }

    def _others(self) -> dict[Port, Inertial | Receiver]:
        """What streams beside the inertial sensor and the receiver in use: spares, and sensors without positions."""
        return {**self._devices.spares.sensors, **self._devices.in_use.aiding_sensors}

    def _check(self, name: str, port: Port, sensor: Inertial | Receiver, now_ns: int) -> tuple[str, ...]:
        faults = (*sensor.faults(now_ns), *self._devices.spares.findings(port))
        sensor.update(now_ns)
        self._change_logger.faults(name, [_named(name, fault) for fault in faults], now_ns)
        return faults

    def _beyond_limits(self, now_ns: int) -> tuple[str, ...]:
        imu, gnss = self._devices.in_use.imu, self._devices.in_use.gnss
        return (*(imu.sensor.out_of_limits() if imu else ()), *(gnss.sensor.out_of_limits(now_ns) if gnss else ()))

    def _warn_if_upside_down(self) -> None:
        """Warn of a sensor that seems upside down: perhaps its axes are not FRD, which its protocol does not say."""
        inertial = self._devices.selection.inertial
        if inertial is not None and inertial.pipeline.samples[0]["f"][2] > 0.0:
            self._log.warning(_UPSIDE_DOWN)

    def _warn_if_lever_arm_is_unset(self, now_ns: int) -> None:
        """Warn, once, of a lever arm that the filter estimates because it is not set."""
        inertial = self._devices.selection.inertial
        if self._lever_arm_warned or inertial is None or self._devices.in_use.gnss is None:
            return
        if not self._lever_arm_period.is_due(now_ns):
            return
        given = inertial.pipeline.filter.settings.navigation
        if not given.lever_arm_m == given.lever_arm_sigma_m == "auto":
            return
        if not self._devices.in_use.gnss.sensor.is_precise:
            return
        if "gnss_lever_arm_x_m" in cells(inertial.pipeline.filter.filter_states()):
            self._log.warning(_LEVER_ARM_UNSET)
            self._lever_arm_warned = True

    def health(self, now_ns: int) -> Health:
        """The faults of the sensors."""
        if now_ns - self._checked_ns >= _FRESH_NS:
            self._check_all(now_ns)
        imu = self._devices.in_use.imu
        clock = imu.sensor.clock_fit() if imu else ClockFit()
        return Health(**self._faults, clock=clock, out_of_limits=self._out_of_limits)

    def _aiding_table(self, publisher: Publisher, aiding: "AidingInput | None", now_ns: int) -> dict[str, Any]:
        """The sources of measurements beside fixes, on ports and of other programs; empty: there are none."""
        table = aiding.properties(now_ns) if aiding else {}
        received_by_source = dict(table.get("sources", {}))
        for name, source in self._received_on_ports.items():  # also of ports that are away: silent, not forgotten
            of_port = source.table(now_ns)
            if name not in received_by_source or of_port["age_s"] < received_by_source[name]["age_s"]:
                received_by_source[name] = of_port
        if received_by_source:
            known = self._devices.selection.estimator.sources
            table["sources"] = status_tables.of_sources(
                received_by_source, publisher.innovations, publisher.shares, known
            )
            inertial = self._devices.selection.inertial
            if inertial is not None:
                status_tables.add_estimates(table["sources"], inertial.pipeline.filter)
        return table

    def status(self, publisher: Publisher, outputs: Outputs, aiding: "AidingInput | None") -> str:
        """The answer to `imud status`."""
        now_ns = time.monotonic_ns()
        self._check_all(now_ns)
        devices = self._devices
        parts: dict[Port, tuple[Inertial | Receiver, tuple[str, ...] | None]]
        parts = {port: (sensor, self._faults[kind]) for kind, (port, sensor) in devices.in_use.by_kind().items()}
        parts |= {port: (sensor, self._faults_of_others.get(port)) for port, sensor in self._others().items()}
        return status_tables.status_object(
            {
                **status_tables.of_process(self._started_ns),
                "internal_errors": {"count": self._errors.count, "last": self._errors.last},
                "load": status_tables.of_load(publisher.load),
                "filter": status_tables.of_filter(devices.selection.inertial, devices.selection.estimator.name, now_ns),
                "states": status_tables.of_filter_states(devices.selection.inertial),
                "totals": status_tables.of_all_connections(devices.selection.inertial),
                "innovations": publisher.innovations.table(),
                "aiding": self._aiding_table(publisher, aiding, now_ns),
                "corrections": devices.corrections.properties(now_ns) if devices.corrections else {},
                "ports": {
                    str(i): status_tables.of_port(port, now_ns, *parts.get(port, (None, None)))
                    for i, port in enumerate(devices.ports)
                },
                "outputs": status_tables.of_outputs(outputs.gpsd, outputs.binary),
            }
        )


def _named(name: str, fault: str) -> str:
    """A fault for the log: of a sensor beside the one in use with its port's name."""
    return fault if name in ("imu", "gnss") or name in fault else f"{name}: {fault}"
