"""`imud record`: writes what ports, and other programs on `aiding.listen`, send to a file for `imud replay`."""

import argparse
import contextlib
import os
import select
import time
from collections import Counter

import msgspec
import numpy as np

from imud.drivers.driver import AnyDriver, GnssConfigured, Identity
from imud.drivers.errors import PortEndedError, PortLostError

from ..configuration.settings import Settings
from ..daemon import simulated
from ..daemon.aiding_input import AidingInput
from ..daemon.ports import Configured, Port
from ..errors import DeviceAbsentError, ImudError
from ..estimators import registry
from ..estimators.records import INNOVATION
from ..process import log
from ..process.log import get_logger
from ..process.signals import caught, endings
from ..recording.recorder import Recorder, recording
from ..sensor_errors import calibration
from ..sensors.byte_sink import READ_BYTES, ByteSink
from ..setup import choices, config
from .arguments import above_zero, add_settings

_TICK_S = 0.02


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("ports", nargs="+", metavar="DEV[:DRIVER[@BAUD]]", help="as for `imud run --port`")
    parser.add_argument("-o", "--output", required=True, metavar="MCAP", help="the recording")
    parser.add_argument("--seconds", type=above_zero, metavar="N", help="end by itself")
    parser.add_argument("--readonly", action="store_true", help="write nothing to the devices")
    parser.add_argument("--wait", action=argparse.BooleanOptionalAction, default=True, help="for absent devices")
    add_settings(parser)


class RecordLoop:
    """The event loop: owns the ports, and gives their bytes to the recorder."""

    def __init__(self, settings: Settings, recorder: Recorder, wait: bool) -> None:
        self._recorder = recorder
        self._log = get_logger()
        self._poll = select.epoll()
        self._by_fd: dict[int, Port] = {}
        self._byte_sinks: dict[Port, ByteSink] = {}
        self._recorded = Counter[Port]()  # bytes
        self._measurement_count = 0
        self._buffer = memoryview(bytearray(READ_BYTES))
        self._ended = False
        self._pulse = choices.pulse(settings)
        self._aiding: AidingInput | None = None
        if settings.aiding.listen or settings.aiding.iio:
            self._aiding = AidingInput(settings, self._poll)
            self._sources = registry.by_name("navigation").sources  # the estimator that takes them all
        self._ports = [Port(spec, options, self, wait=wait) for spec, options in choices.ports(settings)]

    def run(self, seconds: float) -> None:
        """Until a signal, or so many seconds. Raises DeviceAbsentError if nothing came until then."""
        end_s = time.monotonic() + seconds
        with caught(dict.fromkeys(endings(), self._end)) as wakeup:
            self._poll.register(wakeup, select.POLLIN)
            while not self._ended and time.monotonic() < end_s:
                due_s = min(port.deadline_s for port in self._ports) - time.monotonic()
                for fd, _ in self._poll.poll(max(0.0, min(due_s, _TICK_S))):
                    if fd == wakeup:
                        os.read(fd, 64)
                    elif fd in self._by_fd:
                        self._read(self._by_fd[fd])
                    elif self._aiding is not None and fd in self._aiding:
                        self._record_measurements(self._aiding)
                now_s = time.monotonic()
                if self._aiding is not None:
                    self._aiding.tick(time.monotonic_ns())
                for port in self._ports:
                    port.on_time(now_s)
                for level, text in self._recorder.tick():
                    getattr(self._log, level)(text)
        if self._aiding is not None:
            self._aiding.close()
        for port in self._ports:
            port.close()
            say = self._log.info if self._recorded[port] else self._log.warning
            say(f"recorded {self._recorded[port]} bytes", port=port.spec.path)
        if not self._recorded.total() and not self._measurement_count:
            raise DeviceAbsentError("nothing was recorded: no port has sent a byte")

    def _end(self) -> None:
        self._ended = True

    def _read(self, port: Port) -> None:
        byte_sink = self._byte_sinks.get(port)
        if byte_sink is None:
            port.on_event()
            return
        now_ns = time.monotonic_ns()
        try:
            received, arrival_ns = port.line.receive(self._buffer, now_ns)
        except PortLostError as error:
            (port.release if isinstance(error, PortEndedError) else port.lost)(str(error))
        else:
            if received:
                pulse = self._pulse if isinstance(port.configured, GnssConfigured) else None
                self._recorded[port] += received
                byte_sink(self._buffer[:received], arrival_ns, pulse.newest_ns() if pulse else None)

    def _record_measurements(self, aiding: AidingInput) -> None:
        for source, measurement in aiding.measurements(self._sources):
            self._measurement_count += 1
            self._recorder.record_measurement(source.name, measurement, np.zeros(0, INNOVATION))

    def watch(self, port: Port, fd: int) -> None:
        """See `ports.PortOwner`."""
        self._by_fd[fd] = port
        self._poll.register(fd, select.POLLIN)

    def unwatch(self, fd: int) -> None:
        """See `ports.PortOwner`."""
        del self._by_fd[fd]
        self._poll.unregister(fd)

    def connected(self, port: Port, driver: AnyDriver, configured: Configured) -> None:
        """See `ports.PortOwner`."""
        number = self._ports.index(port)
        known = _calibration_of(configured.identity) if driver.kind == "imu" else None
        self._recorder.connected(number, port.spec.path, configured, known, time.monotonic_ns())
        self._byte_sinks[port] = self._recorder.byte_sink(number)
        self._log.info("streaming", port=port.spec.path, device=configured.identity.model or driver.name)

    def not_connected(self, port: Port) -> None:
        """See `ports.PortOwner`."""

    def disconnected(self, port: Port) -> None:
        """See `ports.PortOwner`."""
        self._recorder.disconnected(self._ports.index(port), port.spec.path)
        self._byte_sinks.pop(port, None)


def _calibration_of(identity: Identity) -> calibration.Calibration | None:
    """The calibration by which the daemon would correct the samples."""
    with contextlib.suppress(ImudError):
        return calibration.of(identity)
    return None


def run(args: argparse.Namespace) -> int:
    settings = config.load(args.config, args.set)
    with contextlib.ExitStack() as stack:
        settings = msgspec.structs.replace(settings, ports=tuple(args.ports))
        emulated = stack.enter_context(simulated.emulated(settings.ports, seed=1, listen=settings.aiding.listen))
        settings = simulated.settings_of(settings, emulated)
        target = msgspec.structs.replace(settings.record, path=args.output)
        settings = msgspec.structs.replace(settings, record=target, readonly=args.readonly or settings.readonly)
        recorder = stack.enter_context(recording(settings))
        assert recorder is not None
        log.configure(sink=recorder.record_event)
        RecordLoop(settings, recorder, args.wait).run(float("inf") if args.seconds is None else args.seconds)
    return 0
