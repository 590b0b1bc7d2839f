"""The daemon's ports and what streams on them: which is the inertial sensor, which the receiver, which a spare.

This is the `PortOwner` of the ports; it does not know what becomes of solutions and fixes.
"""

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from imud.drivers.driver import AnyDriver, GnssConfigured, GnssDriver, ImuConfigured, ImuDriver
from imud.drivers.errors import PortEndedError, PortLostError
from imud.drivers.registry import by_name
from imud.drivers.transport.line import KnownDevice

from ..configuration.settings import Settings
from ..errors import ImudError, UsageError
from ..math.arrays import Records
from ..outputs.connection import NEVER_NS
from ..outputs.view import Device
from ..process import garbage
from ..process.contained import ContainedErrors
from ..process.log import get_logger
from ..recording.control import Recordings
from ..sensors.estimator_selection import EstimatorSelection
from ..sensors.inertial import Inertial
from ..sensors.receiver import Receiver
from ..setup import choices
from .byte_routes import ByteRoutes
from .descriptors import Descriptors
from .fast_loop import FastLoop
from .in_use import InUse, SensorsInUse
from .ports import Configured, Port
from .spares import SPARE_ESTIMATOR, Spares
from .state_store import StateStore, calibration_of
from .stream_check import StreamCheck

if TYPE_CHECKING:
    from .corrections import Corrections

_PARTS = {"imu": "inertial sensor", "gnss": "receiver"}
_ABSENCE_S = 5.0  # after which a spare takes over; a sensor that comes back sooner continues with its filter


class Devices:
    """One sensor of each kind is in use; any other of that kind is a spare. Not thread-safe.

    A spare receiver is closed; a spare inertial sensor streams, too, and is compared with the one in use.
    """

    def __init__(
        self,
        settings: Settings,
        wait: bool,
        fast_loop: FastLoop,
        recordings: Recordings,
        errors: ContainedErrors,
    ) -> None:
        """wait: for devices that are absent at the start. Raises UsageError, DeviceAbsentError."""
        self._settings = settings
        self._errors = errors
        self._descriptors = Descriptors(fast_loop)
        self._stream_check = StreamCheck()
        self._log = get_logger()
        self.selection = EstimatorSelection(settings, self._log.warning)
        self.ports = [Port(spec, options, self, wait) for spec, options in choices.ports(settings)]
        self.in_use = SensorsInUse()
        self.described: tuple[Device, ...] = ()  # the devices that stream, for the clients
        self._pulse = choices.pulse(settings)
        self.corrections = _corrections(settings.gnss.rtcm) if settings.gnss.rtcm else None
        self._store = StateStore()
        self._has_warned_without_imu = False
        self._closed_spares: dict[str, set[Port]] = {kind: set() for kind in _PARTS}
        self.spares = Spares(self._log.warning, settings)  # inertial sensors
        self._routes = ByteRoutes(self.ports, self.in_use, self.spares, recordings, self._descriptors)

    def check(self) -> None:
        """Find out early that there is no point in waiting. Raises ImudError as `on_time`."""
        for port in self.ports:
            port.check()

    def possible_estimators(self) -> list[str]:
        """The names of those that may run: for the sensor in use, and for spares."""
        return [*self.selection.choice.possible, *([SPARE_ESTIMATOR] if len(self.ports) > 1 else [])]

    def configure(self, settings: Settings) -> None:
        """Take over the hot keys of new settings."""
        self._settings = settings
        for receiver in self.in_use.receivers():
            receiver.settings, receiver.aiding = settings.gnss, settings.aiding
        if imu := self.in_use.imu:
            imu.sensor.pipeline.filter.configure(self._settings_of(imu.port, imu.sensor.configured))

    def _settings_of(self, port: Port, configured: Configured) -> Settings:
        """With the profile and the mounting of the sensor on that port."""
        return choices.settings_for(self._settings, configured.identity, self.ports.index(port))

    @property
    def deadline_s(self) -> float:
        """When `on_time` has something to do."""
        return min([self.spares.takeover_s, *[port.deadline_s for port in self.ports]])

    def on_time(self, now_s: float) -> None:
        """Do what is due: open ports, end waits for answers, let a spare take over. Raises ImudError as `Port` does."""
        for port in self.ports:
            try:
                port.on_time(now_s)
            except ImudError:
                raise
            except Exception as error:
                self._end_connection(port, error)
        if now_s >= self.spares.takeover_s:
            self._take_over()

    def __contains__(self, fd: int) -> bool:
        return fd in self._descriptors

    def on_event(self, fd: int, now_ns: int) -> tuple[int, list[Records]]:
        """Read a port that has bytes; returns the number of new solutions, and the new fixes."""
        port = self._descriptors[fd]
        try:
            if self.in_use.imu and port is self.in_use.imu.port:
                n = self.in_use.imu.sensor.read(now_ns)
                self.spares.add_samples(port, self.in_use.imu.sensor, n)
                return n, []
            if spare := self.spares.sensors.get(port):
                self.spares.add_samples(port, spare, spare.read(now_ns))
                return 0, []
            if self.in_use.gnss and port is self.in_use.gnss.port:
                return 0, self.in_use.gnss.sensor.read(port.line, now_ns)
            if sensor := self.in_use.aiding_sensors.get(port):
                sensor.read(port.line, now_ns)
                return 0, []
            port.on_event()
        except PortLostError as error:
            (port.release if isinstance(error, PortEndedError) else port.lost)(str(error))
        except ImudError:
            raise
        except Exception as error:
            self._end_connection(port, error)
        return 0, []

    def _end_connection(self, port: Port, error: Exception) -> None:
        """End the connection after a defect of imud in its handling; the port is tried again."""
        self._errors.report(f"the connection on {port.spec.path}", error)
        port.lost("internal error")

    @property
    def is_settled(self) -> bool:
        """Whether nothing needs `tick` ten times a second: no line that Python reads, no corrections to forward."""
        return self._descriptors.fast and self.corrections is None

    def tick(self, gap_ns: int, now_ns: int) -> int:
        """Check streams, compare spares, forward corrections, save the state.

        gap_ns: time since the fast loop's last check. Returns when a receiver will have been silent for too long; the
        fast loop notices the silence of what it reads.
        """
        self._stream_check.tick(gap_ns, now_ns)
        for port, sensor in [*self.in_use.all(), *self.spares.sensors.items()]:
            silent = now_ns > self._stream_check.silent_from_ns(sensor)
            if silent and not isinstance(port.line, KnownDevice):  # a recording may have gaps, after which it continues
                port.lost("the device sends nothing more of use")
            elif isinstance(sensor, Inertial) and sensor.is_ahead(now_ns) and not isinstance(port.line, KnownDevice):
                port.lost("more samples than the agreed rate allows: their times are ahead of the clock: set up anew")
        for port in [port for port, sensor in self.in_use.aiding_sensors.items() if sensor.decoder.status.arrival_ns]:
            port.lost("it sends positions, too: it is a receiver")
        if self.in_use.imu and (why := self._stream_check.wrong_rate(self.in_use.imu.sensor)):
            self.in_use.imu.port.lost(why)
        if self.in_use.imu and self.spares.sensors:
            self._compare(*self.in_use.imu)
        if self.corrections is not None:
            self.corrections.forward(now_ns, self.in_use.gnss.port.forward if self.in_use.gnss else None)
        for port in [port for ports in self._closed_spares.values() for port in ports]:
            port.notice_absence()
        for port in self.ports:
            port.log_line_warning()
        self._routes.record_clock(now_ns)
        if self.in_use.imu:
            port, sensor = self.in_use.imu
            self._store.save_when_due(sensor.configured, sensor, self.spares.to_store(port), now_ns)
        receivers = self.in_use.receivers()
        return min([self._stream_check.silent_from_ns(each) + 1 for each in receivers], default=NEVER_NS)

    def _compare(self, port: Port, sensor: Inertial) -> None:
        """Compare all inertial sensors, and replace the one in use if it is wrong.

        Where it is not known which one is wrong, the filter continues as after a power-on: the biases of the sensor in
        use may have changed.
        """
        disagreed = self.spares.disagrees(port)
        self.spares.update(port, sensor)
        if self.spares.should_replace(port):
            port.lost(self.spares.findings(port)[0])
            self._take_over()
        elif self.spares.disagrees(port) and not disagreed:
            driver = by_name(sensor.configured.identity.driver)
            if driver.kind == "imu":
                self._use(port, driver, replace(sensor.configured, still_powered=False))

    def _take_over(self) -> None:
        """A spare becomes the sensor in use."""
        self.spares.takeover_s = math.inf
        port = self.spares.successor()
        if self.in_use.imu is None and port is not None and port.configured:
            self.spares.remove(port)
            self.connected(port, by_name(port.configured.identity.driver), port.configured)

    def watch(self, port: Port, fd: int) -> None:
        """A port opened its device."""
        self._forget_closed_spare(port)
        self._descriptors.add(port, fd)

    def unwatch(self, fd: int) -> None:
        """A port closes its device."""
        self._descriptors.remove(fd)

    def connected(self, port: Port, driver: AnyDriver, configured: Configured) -> None:
        """A device streams."""
        if driver.kind == "gnss" and isinstance(configured, GnssConfigured) and not configured.positions:
            self._use_aiding_sensor(port, driver, configured)
            return
        if other := self.in_use.by_kind().get(driver.kind):
            self._keep_as_spare(port, driver, configured, other[0])
            return
        identity = configured.identity
        properties: dict[str, Any] = {
            "port": port.spec.path,
            "device": identity.model or driver.name,
            "baud": identity.baud,
        }
        if isinstance(configured, ImuConfigured) and driver.kind == "imu":
            if not self._use(port, driver, configured):
                return
            properties |= {
                "serial": identity.serial,
                "firmware": identity.firmware,
                "rate_hz": round(configured.rate_hz, 3),
            }
        elif driver.kind == "gnss":
            now_ns = time.monotonic_ns()
            gnss, aiding = self._settings.gnss, self._settings.aiding
            recorded = port.spec.path.startswith(choices.RECORDED)
            receiver = Receiver(driver, gnss, now_ns, self._pulse, aiding, baud=identity.baud, recorded=recorded)
            self.in_use.gnss = InUse(port, receiver)
            self._routes.record(port, receiver, now_ns)
        self._schedule_spares(driver.kind, math.inf)
        self._log.info("streaming", **{name: value for name, value in properties.items() if value})
        self._warn_without_imu()
        self.described = self.in_use.described()
        garbage.set_aside()

    def not_connected(self, port: Port) -> None:
        """An attempt has found no device that can be used."""
        self._forget_closed_spare(port)
        self._warn_without_imu()

    def _forget_closed_spare(self, port: Port) -> None:
        """A port was tried: what was there is a closed spare no more, and what is there now may be another device."""
        for ports in self._closed_spares.values():
            ports.discard(port)

    def _warn_without_imu(self) -> None:
        """Say once what becomes of a receiver alone, as soon as every port has been tried."""
        if self.in_use.imu:
            self._has_warned_without_imu = False
        elif self.in_use.gnss and not self._has_warned_without_imu and not any(p.is_undecided for p in self.ports):
            self._has_warned_without_imu = True
            self._log.warning("no inertial sensor streams: only the receiver's fixes are passed on")

    def _use_aiding_sensor(self, port: Port, driver: GnssDriver, configured: GnssConfigured) -> None:
        """A sensor streams that has no positions, but perhaps a heading, a speed or a pressure."""
        now_ns, gnss, aiding = time.monotonic_ns(), self._settings.gnss, self._settings.aiding
        self.in_use.aiding_sensors[port] = Receiver(
            driver, gnss, now_ns, aiding=aiding, positions=False, baud=configured.identity.baud
        )
        self._routes.record(port, self.in_use.aiding_sensors[port], now_ns)
        identity = configured.identity
        self._log.info("streaming", port=port.spec.path, device=identity.model, baud=identity.baud)

    def _use(self, port: Port, driver: ImuDriver, configured: ImuConfigured) -> bool:
        """Use this inertial sensor from now on; returns False if the estimator needs more than it measures."""
        now_ns = time.monotonic_ns()
        own, number = self._settings_of(port, configured), self.ports.index(port)
        known = self.spares.calibration(port, configured, calibration_of(configured.identity), own, now_ns)
        stored = self._store.load(configured, port.spec.path, known, own)
        if self.selection.inertial is not None:  # a checkpoint is only for the first filter of this run
            stored = replace(stored, checkpoint=b"")
        try:
            inertial = self.selection.connect(
                port.line, driver, configured, known, self._settings, now_ns, number, stored
            )
        except UsageError as error:
            if self.selection.inertial is None and not port.has_failed:
                raise
            port.reject(str(error))  # it was plugged in later, and does not end the daemon
            return False
        self.in_use.imu, self._routes.calibration = InUse(port, inertial), known
        if stored.checkpoint and self.selection.resumed:
            self._log.info("the filter goes on where an earlier run of the daemon ended")
        self._routes.record(port, inertial, now_ns, stored)
        self._routes.read_directly()
        return True

    def _keep_as_spare(self, port: Port, driver: AnyDriver, configured: Configured, used: Port) -> None:
        """A device of a kind of which one is in use: an inertial sensor is compared with it, any other is closed."""
        what = f"a spare, for when {used.spec.path}, the {_PARTS[driver.kind]}, is away"
        imu, is_replayed = self.in_use.imu, isinstance(port.line, KnownDevice)
        if is_replayed or not imu or driver.kind != "imu" or not isinstance(configured, ImuConfigured):
            self._closed_spares[driver.kind].add(port)
            port.release(what)
            self._warn_without_imu()
            return
        own, known = self._settings_of(port, configured), calibration_of(configured.identity)
        self.spares.add(port, driver, configured, known, own, imu, time.monotonic_ns())
        self._routes.read_through_python()
        self._log.info(f"{what}; until then compared with it", port=port.spec.path)

    def disconnected(self, port: Port) -> None:
        """A device streams no more."""
        self.spares.remove(port)
        self._routes.disconnected(port)
        for kind, (held, _) in self.in_use.by_kind().items():
            if held is port:
                self._schedule_spares(kind, time.monotonic() + _ABSENCE_S)
        if self.in_use.imu and self.in_use.imu.port is port:
            self.in_use.imu = None
        if self.in_use.gnss and self.in_use.gnss.port is port:
            self._log.info("receiver ended", port=port.spec.path, **self.in_use.gnss.sensor.counters())
            self.in_use.gnss = None
        if sensor := self.in_use.aiding_sensors.pop(port, None):
            self._log.info("sensor ended", port=port.spec.path, **sensor.counters())
        if self.in_use.imu:
            self._routes.read_directly()  # what disconnected may have been the last spare
        self.described = self.in_use.described()

    def _schedule_spares(self, kind: str, at_s: float) -> None:
        """Have the spares of that kind take over at that time; infinite: never."""
        if kind == "imu":
            self.spares.takeover_s = at_s
        for port in self._closed_spares[kind]:
            port.schedule_retry(at_s)

    def close(self) -> None:
        """Close all ports."""
        if self.in_use.imu:
            port, sensor = self.in_use.imu
            self._store.close(sensor.configured, sensor, self.spares.to_store(port))
        for port in self.ports:
            port.close()
        if self.corrections is not None:
            self.corrections.close()
        if self.selection.inertial is not None:
            self._log.info("ended", samples=self.selection.inertial.samples, **self.selection.inertial.totals())


def _corrections(source: str) -> "Corrections":
    from .corrections import Corrections  # here, as few users need it: it would cost the others memory

    return Corrections(source)
