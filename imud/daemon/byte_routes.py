"""Where the bytes of a sensor go: the fast loop reads the inertial sensor, unless Python needs its data.

Python needs them for a recording, and where spares are compared with the sensor in use.
"""

import time

from ..pipeline import NOTHING_STORED, Stored
from ..recording.control import Recordings
from ..sensor_errors.calibration import Calibration
from ..sensors.inertial import Inertial
from ..sensors.receiver import Receiver
from .descriptors import Descriptors
from .in_use import SensorsInUse
from .ports import Port
from .spares import Spares


class ByteRoutes:
    """Routes the bytes of the sensors in use when a recording or a comparison begins or ends. Not thread-safe."""

    def __init__(
        self, ports: list[Port], in_use: SensorsInUse, spares: Spares, recordings: Recordings, descriptors: Descriptors
    ) -> None:
        self.calibration = Calibration("")  # of the inertial sensor
        self._ports, self._in_use, self._spares = ports, in_use, spares
        self._recordings, self._descriptors = recordings, descriptors
        recordings.on_begin, recordings.on_end = self._record_all, self.read_directly

    def read_directly(self) -> None:
        """Let the fast loop read the inertial sensor, if neither a recording nor a comparison needs its data."""
        if self._recordings.current is None:
            for _, sensor in self._in_use.all():
                sensor.byte_sink = None
        imu = self._in_use.imu
        if imu and imu.port.line.plain and imu.sensor.byte_sink is None and not self._spares.sensors:
            self._descriptors.attach(imu.port.fd, imu.sensor.pipeline, imu.sensor.stale_ns)

    def read_through_python(self) -> None:
        """Let Python read the inertial sensor: a recording or a comparison needs its data."""
        if self._in_use.imu:
            self._descriptors.detach(self._in_use.imu.port.fd)

    def _record_all(self) -> None:
        """Record what streams already: a recording has begun."""
        self.read_through_python()
        for port, sensor in self._in_use.all():
            self.record(port, sensor, time.monotonic_ns())

    def record(self, port: Port, sensor: Inertial | Receiver, now_ns: int, stored: Stored = NOTHING_STORED) -> None:
        """Have the sensor's bytes recorded from now on, if a recording is being made."""
        recorder = self._recordings.current
        if recorder and port.configured:
            number = self._ports.index(port)
            known = self.calibration if isinstance(sensor, Inertial) else None
            recorder.connected(number, port.spec.path, port.configured, known, now_ns, stored)
            sensor.byte_sink = recorder.byte_sink(number)

    def record_clock(self, now_ns: int) -> None:
        """Record the fit of the inertial sensor's clock, if a recording is being made."""
        if self._recordings.current and (imu := self._in_use.imu):
            self._recordings.current.record_clock(self._ports.index(imu.port), imu.sensor, now_ns)

    def disconnected(self, port: Port) -> None:
        """A port streams no more: the recording says so, if the sensor on it was in use."""
        if self._recordings.current and any(port is used for used, _ in self._in_use.all()):
            self._recordings.current.disconnected(self._ports.index(port), port.spec.path)
