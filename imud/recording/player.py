"""Plays a recording through the code that runs live: bytes through decoder, clock and filter, in their first order.

With the same version and settings the solutions are those of the daemon, bit for bit.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec

from imud.drivers.capture_messages import CONNECTIONS, READS, Connection, Entry, Raw, Reads
from imud.drivers.fix import Fix
from imud.drivers.registry import by_name

from ..configuration.settings import Initial, Settings
from ..errors import BadDataError
from ..math.arrays import Records
from ..pipeline import Filter, Stored
from ..sensor_errors.calibration import Calibration
from ..sensor_errors.stored_biases import Biases
from ..sensors.byte_sink import READ_BYTES
from ..sensors.estimator_selection import EstimatorSelection
from ..sensors.inertial import Inertial
from ..sensors.receiver import Receiver
from ..setup.choices import settings_for
from .measurements import measurement_row
from .messages import AIDING, SETTINGS
from .steps import Steps


@dataclass
class Replayed:
    """The line of a recorded sensor, whose bytes go to the pipeline without it."""

    warning: str = ""
    counters: dict[str, int] = field(default_factory=dict)
    fd: int = -1
    plain: bool = False

    def receive(self, room: memoryview, now_ns: int) -> tuple[int, int]:
        """See `imud.drivers.transport.line.Line`."""
        return 0, now_ns

    def set_baud(self, baud: int) -> None:
        """Of no meaning here."""

    def discard(self) -> None:
        """Nothing waits."""

    def write(self, data: bytes) -> int:
        """Nobody listens."""
        return 0

    def read(self) -> bytes:
        """Nothing waits."""
        return b""

    def close(self) -> None:
        """Nothing is open."""


@dataclass
class ReplayedPulse:
    """A receiver's pulse per second, as it was recorded with its bytes."""

    pulse_ns: int | None = None

    def newest_ns(self) -> int | None:
        """See `imud.drivers.transport.pps`."""
        return self.pulse_ns


def ignore(*_: Any) -> None:
    """Take no notice."""


@dataclass(frozen=True)
class Handlers:
    """What is called during a replay.

    step: with rows of SAMPLE and SOLUTION, valid until the next message. update: with a fix (array of one FIX) that the
    filter was given, and its innovations. fix: with every fix that is used, also before there is an inertial sensor.
    aid: with a measurement (array of one MEASUREMENT) and its innovations. warn: with warnings for the user.
    """

    step: Callable[[Records, Records], None] = ignore
    update: Callable[[Records, Records], None] = ignore
    fix: Callable[[Records], None] = ignore
    aid: Callable[[Records, Records], None] = ignore
    warn: Callable[[str], None] = ignore


class Player:
    """Takes the messages of a recording one by one; not thread-safe."""

    TOPICS = frozenset({READS, CONNECTIONS, AIDING, SETTINGS})  # of the messages that it needs

    def __init__(
        self,
        settings: Settings,
        adapt: Callable[[Any], Settings],
        initial: Initial,
        handlers: Handlers,
        calibration: Calibration | None = None,
        with_receivers: bool = True,
    ) -> None:
        """adapt: from recorded settings to those of the replay. calibration: instead of the recorded one.

        with_receivers: else what they sent is left out, as for one who wants the samples only.
        """
        self.samples = self.fixes = 0
        self._settings = settings
        self._adapt = adapt
        self._handlers = handlers
        self._calibration = calibration
        self._with_receivers = with_receivers
        self._steps = Steps(self._step)
        self._selection = EstimatorSelection(settings, handlers.warn, initial)
        self._line = Replayed()
        self._pulse = ReplayedPulse()
        self._ports: dict[int, Inertial | Receiver] = {}
        self._connections: dict[int, Connection] = {}
        self._imu: Connection | None = None
        self.reported: Fix | None = None  # the fix that the handler gets, as its receiver reported it; None: not known
        self.now_ns = 0  # of the newest bytes

    @property
    def filter(self) -> Filter:
        """Of the inertial sensor that streams, which must be there."""
        assert self._selection.inertial is not None
        return self._selection.inertial.pipeline.filter

    @property
    def inertial(self) -> Inertial | None:
        """The inertial sensor; None before the first."""
        return self._selection.inertial

    def sensors(self) -> list[tuple[Connection, Inertial | Receiver]]:
        """Those that stream, with the messages of their connections."""
        return [(self._connections[port], sensor) for port, sensor in self._ports.items()]

    def take(self, entry: Entry) -> None:
        """The next message. Raises BadDataError if it is not what its topic promises."""
        try:
            if (reads := entry.reads()) is not None:
                self._read(reads)
            elif entry.topic == CONNECTIONS:
                self._connect(entry.connection())
            elif entry.topic == AIDING:
                self._aid(msgspec.json.decode(entry.data))
            elif entry.topic == SETTINGS:
                self._change(self._adapt(msgspec.json.decode(entry.data)["settings"]))
        except (msgspec.DecodeError, ArithmeticError, KeyError, TypeError, ValueError) as error:
            raise BadDataError(f"a message on {entry.topic} cannot be understood: {error}") from error

    def _read(self, reads: Reads) -> None:
        if (reads.size > READ_BYTES).any():
            raise ValueError(f"a reading of {reads.size.max()} bytes; no line reads more than {READ_BYTES} at once")
        self._steps.begin(reads)
        for port, first, last, first_byte in reads.runs():
            sensor = self._ports.get(port)
            if isinstance(sensor, Receiver):
                for raw in reads.part(first, last, first_byte) if self._with_receivers else ():
                    self._receive(sensor, raw)
            elif sensor is not None:
                self._steps.run(sensor.pipeline, first, last, first_byte)
                self.now_ns = int(reads.t_ns[last - 1])
        self._steps.flush()

    def _step(self, samples: Records, solutions: Records) -> None:
        self.samples += len(samples)
        self._handlers.step(samples, solutions)

    def _receive(self, receiver: Receiver, raw: Raw) -> None:
        self.now_ns, self._pulse.pulse_ns = raw.t_ns, raw.pulse_ns
        fixes = receiver.feed(raw.data, raw.t_ns) if raw.data else receiver.flush(raw.t_ns)
        if fixes or receiver.measured:
            self._steps.flush()
        for fix in fixes:
            self.reported = receiver.last_used_fix if fix is fixes[-1] else None
            self._handlers.fix(fix)
            self._update(fix)
        self._measured(receiver)

    def _update(self, fix: Records) -> None:
        if self._selection.inertial is not None:
            self.fixes += 1
            self._handlers.update(fix, self._selection.inertial.pipeline.filter.update(fix))

    def _measured(self, receiver: Receiver) -> None:
        """The readings of a receiver, as `daemon.publisher` uses them."""
        if (inertial := self._selection.inertial) is None:
            receiver.measured.clear()
            return
        filter_ = inertial.pipeline.filter
        for _, row in receiver.take_measured(filter_.estimator.sources):
            self._handlers.aid(row, filter_.aid(row))

    def _aid(self, message: dict[str, Any]) -> None:
        """A measurement of an aiding source; one that this estimator does not take is left out."""
        if (inertial := self._selection.inertial) is None:
            return
        filter_ = inertial.pipeline.filter
        if (measurement := measurement_row(message, filter_.estimator.sources)) is not None:
            self._handlers.aid(measurement, filter_.aid(measurement))

    def _connect(self, connection: Connection) -> None:
        port = connection.port
        if connection.repeated and port in self._ports and self._connections[port].t_ns == connection.t_ns:
            return
        self._ports.pop(port, None)
        if not connection.streaming:
            if self._imu and self._imu.port == port:
                self._imu = None
            return
        driver = by_name(connection.driver)
        self._connections[port] = connection
        if driver.kind == "imu":
            known = self._calibration or msgspec.convert(_known(connection.calibration), Calibration)
            biases = msgspec.convert(connection.biases, Biases) if connection.biases else None
            stored = Stored(biases, connection.checkpoint)
            self._ports[port] = self._selection.connect(
                self._line, driver, connection.imu(), known, self._settings, connection.t_ns, port, stored
            )
            self._imu = connection
        else:
            gnss, aiding, configured = self._settings.gnss, self._settings.aiding, connection.gnss()
            self._ports[port] = Receiver(
                driver, gnss, connection.t_ns, self._pulse, aiding, configured.positions, configured.identity.baud, True
            )

    def _change(self, settings: Settings) -> None:
        """As the daemon does on SIGHUP."""
        self._settings = settings
        for sensor in self._ports.values():
            if isinstance(sensor, Receiver):
                sensor.settings, sensor.aiding = settings.gnss, settings.aiding
        if self._imu is not None and self._selection.inertial is not None:
            own = settings_for(settings, self._imu.imu().identity, self._imu.port)
            self._selection.inertial.pipeline.filter.configure(own)


def _known(calibration: dict[str, Any]) -> dict[str, Any]:
    """Without the nulls that stand for NaN and for parts never found."""
    parts = {name: part for name, part in calibration.items() if part is not None}
    return {"serial": ""} | {
        name: {key: value for key, value in part.items() if value is not None} if isinstance(part, dict) else part
        for name, part in parts.items()
    }
