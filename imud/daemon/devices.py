"""The daemon's ports and what streams on them: which is the inertial sensor, which the receiver, who reads their bytes.

This is the `PortOwner` of the ports and owns their descriptors; it does not know what becomes of solutions and fixes.
"""

import math
import select
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from imud.drivers.driver import AnyDriver, Identity, ImuConfigured
from imud.drivers.errors import PortEndedError, PortLostError
from imud.drivers.transport.line import Known

from ..configuration.settings import Settings
from ..errors import ImudError, UsageError
from ..math.arrays import Records
from ..outputs.view import Device
from ..pipeline import NOTHING_STORED, Stored
from ..process import garbage
from ..process.contained import ContainedErrors
from ..process.log import get_logger
from ..recording.control import Recordings
from ..sensor_errors import calibration
from ..sensors.estimator_selection import EstimatorSelection
from ..sensors.inertial import Inertial
from ..sensors.rate import ALIKE
from ..sensors.receiver import Receiver
from ..setup import choices
from .fast_loop import FastLoop
from .ports import Configured, Port
from .state_store import StateStore

if TYPE_CHECKING:
    from .corrections import Corrections

_PARTS = {"imu": "inertial sensor", "gnss": "receiver"}
_SLEPT_NS = 500_000_000  # between two looks: this process did not run, and silence then says nothing of a device
_ABSENCE_S = 5.0  # after which a spare takes over: one that comes back sooner finds its filter as it left it


class Devices:
    """At most one sensor of each kind streams; any other of that kind is a spare. Not thread-safe."""

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
        self._fast_loop, self._recordings, self._errors = fast_loop, recordings, errors
        self._log = get_logger()
        self.selection = EstimatorSelection(settings, self._log.warning)
        self.ports = [Port(spec, options, self, wait) for spec, options in choices.ports(settings)]
        self.imu: tuple[Port, Inertial] | None = None
        self.gnss: tuple[Port, Receiver] | None = None
        self.described: tuple[Device, ...] = ()  # those that stream, for the clients
        self._pulse = choices.pulse(settings)
        self.corrections = _corrections(settings.gnss.rtcm) if settings.gnss.rtcm else None
        self._insisted: float | None = None  # share of the agreed rate for which the sensor was set up anew
        self._known = calibration.Calibration("")  # of the inertial sensor
        self._by_fd: dict[int, Port] = {}
        self._store = StateStore()
        self._looked_ns = self._awake_ns = 0  # of `tick`: when last; since when without a long pause between two
        self._spares: dict[str, set[Port]] = {kind: set() for kind in _PARTS}
        recordings.on_begin, recordings.on_end = self._introduce, self._read_directly

    def check(self) -> None:
        """Find out early that there is no point in waiting. Raises ImudError as `on_time`."""
        for port in self.ports:
            port.check()

    def configure(self, settings: Settings) -> None:
        """Take over the hot keys of new settings."""
        self._settings = settings
        if self.gnss:
            self.gnss[1].settings = settings.gnss
        if self.imu and self.imu[0].configured:
            own = choices.settings_for(settings, self.imu[0].configured.identity, self.ports.index(self.imu[0]))
            self.imu[1].stream.filter.configure(own)

    @property
    def deadline_s(self) -> float:
        """When `on_time` has something to do."""
        return min([port.deadline_s for port in self.ports])

    def on_time(self, now_s: float) -> None:
        """Do what is due on the ports: try again, or end a listening. Raises ImudError as `Port` does."""
        for port in self.ports:
            try:
                port.on_time(now_s)
            except ImudError:
                raise
            except Exception as error:
                self._give_up(port, error)

    def __contains__(self, fd: int) -> bool:
        return fd in self._by_fd

    def on_event(self, fd: int, now_ns: int) -> tuple[int, list[Records]]:
        """Read a port that has bytes; returns the number of new solutions, and the new fixes."""
        port = self._by_fd[fd]
        try:
            if self.imu and port is self.imu[0]:
                return self.imu[1].read(now_ns), []
            if self.gnss and port is self.gnss[0]:
                return 0, self.gnss[1].read(port.line, now_ns)
            port.on_event()
        except PortLostError as error:
            (port.release if isinstance(error, PortEndedError) else port.lost)(str(error))
        except ImudError:
            raise
        except Exception as error:
            self._give_up(port, error)
        return 0, []

    def _give_up(self, port: Port, error: Exception) -> None:
        """End the connection in which a defect of imud showed; it is tried again."""
        self._errors.report(f"the connection on {port.spec.path}", error)
        port.lost("internal error")

    def tick(self, now_ns: int) -> None:
        """Call now and then: looks for streams that fell silent, complaints of lines, and a sensor at a wrong rate."""
        if now_ns - self._looked_ns > _SLEPT_NS:
            self._awake_ns = now_ns
        self._looked_ns = now_ns
        for port, sensor in self.streaming().values():
            silent = now_ns - max(sensor.last_data_ns, self._awake_ns) > sensor.silence_ns
            if silent and not isinstance(port.line, Known):  # a recording may have gaps, and goes on by itself
                port.lost("the device sends nothing more of use")
        if self.imu and (share := self.imu[1].rate_ratio()):
            self._insist(*self.imu, share)
        if self.corrections is not None and (data := self.corrections.read(now_ns)):
            self._forward(data)
        for port in self.ports:
            port.log_line_warning()
        if self._recordings.current and self.imu:
            self._recordings.current.record_clock(self.ports.index(self.imu[0]), self.imu[1], now_ns)
        if self.imu and isinstance(configured := self.imu[0].configured, ImuConfigured):
            self._store.save_when_due(configured, self.imu[0].spec.path, self.imu[1], now_ns)

    def _forward(self, corrections: bytes) -> None:
        """Write a base's data to the receiver, if it may be written to."""
        if self.gnss is None:
            return
        port = self.gnss[0]
        if not port.options.readonly and port.spec.server is None:
            try:
                port.line.write(corrections)
            except PortLostError as error:
                port.lost(str(error))

    def _insist(self, port: Port, sensor: Inertial, share: float) -> None:
        """Set up anew a sensor that streams at another rate than agreed; once only, if that does not help."""
        if share == 1.0:
            self._insisted = None
        elif self._insisted is None or abs(share / self._insisted - 1.0) > ALIKE:
            self._insisted = share
            agreed_hz = 1.0 / sensor.period_s
            port.lost(f"about {share * agreed_hz:.3g} samples/s come, {agreed_hz:g} were agreed: set up anew")

    def streaming(self) -> dict[str, tuple[Port, Inertial] | tuple[Port, Receiver]]:
        """The port and the sensor that stream, by kind."""
        pairs = {"imu": self.imu, "gnss": self.gnss}
        return {kind: pair for kind, pair in pairs.items() if pair}

    def watch(self, port: Port, fd: int) -> None:
        """A port opened its device."""
        self._by_fd[fd] = port
        self._fast_loop.others.register(fd, select.POLLIN)

    def unwatch(self, fd: int) -> None:
        """A port closes its device."""
        del self._by_fd[fd]
        if fd == self._fast_loop.fd:
            self._fast_loop.detach()
        else:
            self._fast_loop.others.unregister(fd)

    def connected(self, port: Port, driver: AnyDriver, configured: Configured) -> None:
        """A device streams."""
        if other := self.streaming().get(driver.kind):
            self._spares[driver.kind].add(port)
            port.release(f"a spare, for when {other[0].spec.path}, the {_PARTS[driver.kind]}, is away")
            return
        identity = configured.identity
        properties: dict[str, Any] = {
            "port": port.spec.path,
            "device": identity.model or driver.name,
            "baud": identity.baud,
        }
        now_ns = time.monotonic_ns()
        if isinstance(configured, ImuConfigured) and driver.kind == "imu":
            known = self._calibration_of(identity)
            stored = self._load(configured, port.spec.path, known)
            try:
                inertial = self.selection.connect(
                    port.line, driver, configured, known, self._settings, now_ns, self.ports.index(port), stored
                )
            except UsageError as error:
                if self.selection.inertial is None:
                    raise
                port.reject(str(error))  # who served once does not end because of what is plugged in later
                return
            self.imu, self._known = (port, inertial), known
            if stored.checkpoint and self.selection.resumed:
                self._log.info("the filter goes on where an earlier run of the daemon ended")
            self._record(port, inertial, now_ns, stored)
            self._read_directly()
            properties |= {
                "serial": identity.serial,
                "firmware": identity.firmware,
                "rate_hz": round(configured.rate_hz, 3),
            }
        elif driver.kind == "gnss":
            self.gnss = (port, Receiver(driver, self._settings.gnss, now_ns, self._pulse))
            self._record(*self.gnss, now_ns)
        self._spares[driver.kind].discard(port)
        self._wake_spares(driver.kind, math.inf)
        self._log.info("streaming", **{name: value for name, value in properties.items() if value})
        if self.imu is None and all(port.configured for port in self.ports):
            self._log.warning("there is no inertial sensor on any port: only the receiver's fixes are passed on")
        self._describe()
        garbage.set_aside()

    def disconnected(self, port: Port) -> None:
        """A device streams no more."""
        if self._recordings.current:
            self._recordings.current.disconnected(self.ports.index(port), port.spec.path)
        for kind, (held, _) in self.streaming().items():
            if held is port:
                self._wake_spares(kind, time.monotonic() + _ABSENCE_S)
        if self.imu and self.imu[0] is port:
            self.imu = None
        if self.gnss and self.gnss[0] is port:
            self._log.info("receiver ended", port=port.spec.path, **self.gnss[1].counters())
            self.gnss = None
        self._describe()

    def _wake_spares(self, kind: str, at_s: float) -> None:
        for port in self._spares[kind]:
            port.schedule_retry(at_s)

    def close(self) -> None:
        """Close all ports."""
        if self.imu and isinstance(configured := self.imu[0].configured, ImuConfigured):
            self._store.close(configured, self.imu[0].spec.path, self.imu[1])
        for port in self.ports:
            port.close()
        if self.corrections is not None:
            self.corrections.close()
        if self.selection.inertial is not None:
            self._log.info("ended", samples=self.selection.inertial.samples, **self.selection.inertial.totals())

    def _describe(self) -> None:
        self.described = tuple(
            _described(port, port.configured) for port, _ in self.streaming().values() if port.configured
        )

    def _calibration_of(self, identity: Identity) -> calibration.Calibration:
        """The stored calibration of this very sensor; an empty one if there is none that can be read."""
        try:
            found = calibration.of(identity)
        except ImudError as error:
            self._log.warning(f"uncalibrated: {error}")
            return calibration.Calibration("")
        if parts := found.parts:
            self._log.info("calibrated", sensor=found.serial, **parts)
        return found

    def _load(self, configured: ImuConfigured, path: str, known: calibration.Calibration) -> Stored:
        """What an earlier run of the daemon knew; a checkpoint only for the first filter of this run."""
        number = [port.spec.path for port in self.ports].index(path)
        own = choices.settings_for(self._settings, configured.identity, number)
        stored = self._store.load(configured, path, known, own)
        return stored if self.selection.inertial is None else replace(stored, checkpoint=b"")

    def _read_directly(self) -> None:
        """Let the inertial sensor's line be read in compiled code, if nobody else wants to see its bytes."""
        if self._recordings.current is None:
            for _, sensor in self.streaming().values():
                sensor.byte_sink = None
        if self.imu and self.imu[0].line.plain and self.imu[1].byte_sink is None and self._fast_loop.fd < 0:
            port, inertial = self.imu
            self._fast_loop.others.unregister(port.fd)
            self._fast_loop.attach(port.fd, inertial.stream)

    def _introduce(self) -> None:
        """Have a recording that begins take the sensors that stream already: from now on Python reads their bytes."""
        if self.imu and self.imu[0].fd == self._fast_loop.fd:
            self._fast_loop.detach()
            self._fast_loop.others.register(self.imu[0].fd, select.POLLIN)
        for port, sensor in self.streaming().values():
            self._record(port, sensor, time.monotonic_ns())

    def _record(self, port: Port, sensor: Inertial | Receiver, now_ns: int, stored: Stored = NOTHING_STORED) -> None:
        """Have the sensor's bytes recorded from now on, if a recording is being made."""
        recorder = self._recordings.current
        if recorder and port.configured:
            number = self.ports.index(port)
            known = self._known if isinstance(sensor, Inertial) else None
            recorder.connected(number, port.spec.path, port.configured, known, now_ns, stored)
            sensor.byte_sink = recorder.byte_sink(number)


def _corrections(source: str) -> "Corrections":
    from .corrections import Corrections  # what few use costs the others no memory

    return Corrections(source)


def _described(port: Port, configured: Configured) -> Device:
    identity = configured.identity
    return Device(
        path=port.spec.path,
        driver=identity.driver,
        bps=identity.baud or None,
        model=identity.model,
        serial=identity.serial,
        activated_s=time.time(),
    )
