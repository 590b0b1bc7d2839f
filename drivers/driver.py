"""The protocols that every driver implements, and the frozen values that they exchange.

A driver implements its device's data sheet. It opens no port and reads no clock: a transport runs its dialogues
(`dialogue.py`) and feeds its decoders with bytes.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from .dialogue import Dialogue
from .fix import Fix, Reading, ReceiverStatus, Sky


@dataclass(frozen=True)
class Identity:
    """A recognised device. Unknown texts are empty; `baud` 0 until the detection that knows it fills it in."""

    driver: str
    model: str
    serial: str = ""
    firmware: str = ""
    baud: int = 0  # also 0 on SPI
    profile: str = ""  # name of the noise profile that fits this model; else that of an unknown sensor is used
    spi: bool = False  # how it is connected
    streaming: bool = False  # it sent samples by itself when it was found


@dataclass(frozen=True)
class Unsupported:
    """A device that a driver knows but cannot serve, or not as the user wants it."""

    driver: str
    model: str
    why: str
    baud: int = 0

    def __str__(self) -> str:
        at = f" at {self.baud} baud" if self.baud else ""
        return f"found {self.model}{at}, but it cannot be used: {self.why}"


@dataclass(frozen=True)
class Options:
    """The user's options for the device. readonly: write nothing to it, use what it sends by itself."""

    rate_hz: float = 1000.0
    readonly: bool = False
    model: str = ""  # for a device that must not be written to and whose stream does not identify its model
    polled: bool = False  # have an inertial sensor send each sample only when asked, if it can; not if readonly
    filter_taps: int = 0  # of an inertial sensor's moving average; 0: as few as the rate allows, least delay
    self_test: bool = False  # have an inertial sensor test itself first; it must be at rest
    unchecked: bool = False  # a receiver's messages may lack checksums
    fix_rate_hz: float = 5.0  # of a receiver that is set up
    set_up_nmea: bool = False  # a receiver of sentences is set up, too, which streams as it is; others always are
    device: str = ""  # of those that a gpsd has; empty: any
    keep_baud: bool = False  # the user named the baud rate: it is not changed


@dataclass(frozen=True)
class Request:
    """The command, and its period, for a sensor that is polled."""

    command: bytes
    period_ns: int


@dataclass(frozen=True)
class ImuConfigured:
    """An inertial sensor that streams. Shareable."""

    identity: Identity
    rate_hz: float  # samples per second, nominal
    period_ns: int  # between ticks, nominal
    delay_ns: int  # from a sample's instant to its arrival at best: the sensor's filter, and the wire up to the last
    # byte; on SPI to the moment when it may be fetched
    frame_bytes: int  # on the wire per sample
    warnings: tuple[str, ...] = ()
    gyro_axes: tuple[bool, bool, bool] = (True, True, True)  # which exist; `w` of the others is 0 and means nothing
    gyro_range: float = math.inf  # rad/s, where readings end; infinite: not known
    accel_range: float = math.inf  # m/s^2
    request: Request | None = None  # None: it sends by itself
    layout: str = ""  # what `new_state` needs besides, as the driver wrote it
    has_quartz: bool = False  # its rate is that of a quartz, so it is near the nominal one
    still_powered: bool = False  # its stream shows that it has not been switched off since somebody set it up


@dataclass(frozen=True)
class GnssConfigured:
    """A receiver that streams, or another sensor that speaks a receiver's protocol."""

    identity: Identity
    warnings: tuple[str, ...] = ()
    positions: bool = True  # it sends any


class Driver(Protocol):
    """The interface that imu and gnss drivers share."""

    @property
    def name(self) -> str:
        """As the user writes it, and the name of its folder."""

    @property
    def bauds(self) -> Sequence[int]:
        """Speeds its devices use, likeliest first."""

    @property
    def timeout_s(self) -> float:
        """A device that streams is recognised within this time."""

    @property
    def interrupts(self) -> bool:
        """Whether `identify` may be run on a device that streams. If not, the bytes sent do harm or have no effect."""

    def recognise(self, received: bytes) -> Identity | Unsupported | None:
        """The device, if it streams `received` at the right baud rate."""

    def identify(self) -> Dialogue[Identity | Unsupported | None]:
        """Ask a silent line. Never writes flash; harmless for other devices. None: no such device, or no answer."""


class ImuDriver(Driver, Protocol):
    """An inertial sensor."""

    @property
    def kind(self) -> Literal["imu"]:
        """The kind of device."""

    def configure(self, identity: Identity, options: Options) -> Dialogue[ImuConfigured | Unsupported | None]:
        """Set the device up and start its stream. None: it stopped answering, or sends nothing."""

    def new_state(self, configured: ImuConfigured) -> NDArray[np.void]:
        """A fresh decoder state, an array of one record, for `decode`. It has DECODER_FIELDS, each <i8, and its own.

        leftover: bytes kept at the front of the buffer. Counted since the connection: good frames; junk, bytes of no
        frame; bad, damaged frames; lost and suspect samples; errors, samples that the device flags. status: the
        device's last status word.
        """

    @property
    def fault_texts(self) -> Mapping[int, str]:
        """The texts of the faults in the device's status word, by mask; one bit each."""

    @property
    def decode(self) -> Callable[[NDArray[np.uint8], int, NDArray[np.void], NDArray[np.void]], int]:
        """Kernel (rx, fill, state, samples) -> n.

        Decodes the complete frames of rx[:fill] into rows of `samples` (SAMPLE) and moves the remaining bytes to
        rx[:state.leftover]; with `samples` full it stops and keeps the rest. Any chunking gives the same samples.
        """


class GnssDecoder(Protocol):
    """Bytes of one receiver to fixes. Not thread-safe."""

    @property
    def counters(self) -> Mapping[str, int]:
        """Counts of sentences and epochs, used and rejected, by reason."""

    @property
    def status(self) -> ReceiverStatus:
        """The receiver's last report of itself: quality and satellites, with or without a fix."""

    @property
    def sky(self) -> Sky:
        """Its last report of the satellites."""

    @property
    def whole(self) -> int:
        """The number of undamaged messages: 0 means that it is another device or another baud rate."""

    @property
    def pending(self) -> bool:
        """Whether an epoch is open that `flush` may end."""

    def feed(self, data: bytes, arrival_ns: int) -> list[Fix]:
        """Decode bytes that arrived at `arrival_ns` (monotonic); returns the fixes that they complete."""

    def flush(self, now_ns: int) -> list[Fix]:
        """The fix of an epoch whose end did not arrive, once the line has been silent."""


@runtime_checkable
class ReadingDecoder(Protocol):
    """A decoder of receivers, compasses, logs or barometers that report such readings, beside fixes or alone."""

    def take_readings(self) -> list[Reading]:
        """Those that came since the last call."""


class GnssDriver(Driver, Protocol):
    """A satellite receiver."""

    @property
    def kind(self) -> Literal["gnss"]:
        """The kind of device."""

    def configure(self, identity: Identity, options: Options) -> Dialogue[GnssConfigured | Unsupported | None]:
        """Set the receiver up as far as its driver can. None: it stopped answering."""

    def new_decoder(self, unchecked: bool = False) -> GnssDecoder:
        """A fresh decoder. unchecked: messages may lack the checksum that their protocol has."""


@runtime_checkable
class SpiDriver(Protocol):
    """The additional interface of a driver whose devices have SPI, too. `configure` then checks `Identity.spi`."""

    def identify_spi(self) -> Dialogue[Identity | Unsupported | None]:
        """Ask on an SPI line, as `identify` does on a serial one."""


@dataclass(frozen=True)
class Done:
    """The outcome of a service."""

    ok: bool
    message: str


@dataclass(frozen=True)
class Service:
    """A command that a user has a device run once, and whose effect outlasts the connection."""

    description: str  # of the effect and of the user's part, printed before the user confirms; {} is the value
    unit: str  # of the value; s means that the service takes that long
    values: Sequence[int]
    default: int | None  # None: the user must name a value
    run: Callable[[int], Dialogue[Done]]  # runs the command, then reads back whether it worked


@runtime_checkable
class ServiceDriver(Protocol):
    """The additional interface of a driver whose devices have services."""

    @property
    def services(self) -> Mapping[str, Service]:
        """By the names that users give them, each the same for all drivers."""


@runtime_checkable
class NativeProtocol(Protocol):
    """The additional interface of a driver for receivers that also speak another driver's protocol.

    A line recognised by that driver is listened to for this one's protocol, too. It queries a line only if the user
    named it, or its protocol comes there: a device that needs another driver is left alone.
    """

    @property
    def also_speaks(self) -> str:
        """The name of the other driver."""

    def sends_fixes(self, received: bytes) -> bool:
        """Whether there are fixes in `received` in this driver's protocol."""


DECODER_FIELDS = ("leftover", "frames", "junk", "bad", "lost", "suspect", "errors", "status")  # see ImuDriver.new_state
AnyDriver = ImuDriver | GnssDriver
