"""What a driver is: the two protocols behind which every device stands, and the frozen values they exchange.

A driver knows its device's data sheet. It opens no port and reads no clock: conversations are dialogues
(`dialogue.py`) that a transport runs, decoders are fed with bytes.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from .dialogue import Dialogue
from .fix import Fix, ReceiverStatus, Sky


@dataclass(frozen=True)
class Identity:
    """A recognised device. Unknown texts are empty; `baud` 0 until the detection that knows it fills it in."""

    driver: str
    model: str
    serial: str = ""
    firmware: str = ""
    baud: int = 0  # also 0 on SPI
    profile: str = ""  # name of the noise profile that fits this model
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
    """What the user wants of the device. readonly: write nothing to it, use what it sends by itself."""

    rate_hz: float = 1000.0
    readonly: bool = False
    model: str = ""  # for a device that must not be asked and whose stream does not tell its model
    polled: bool = False  # have an inertial sensor send each sample only when asked, if it can; not if readonly
    filter_taps: int = 0  # of an inertial sensor's moving average; 0: as few as the rate allows, least delay
    self_test: bool = False  # have an inertial sensor test itself first; it must be at rest
    unchecked: bool = False  # a receiver's messages may lack checksums
    fix_rate_hz: float = 0.0  # a receiver may be set up for so many fixes per second; 0: it is left as it is


@dataclass(frozen=True)
class Request:
    """What is to be sent, and how often, to a sensor that speaks only when asked."""

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
    still_powered: bool = False  # its stream shows that it has not been switched off since somebody set it up


@dataclass(frozen=True)
class GnssConfigured:
    """A receiver that streams."""

    identity: Identity
    warnings: tuple[str, ...] = ()


class Driver(Protocol):
    """What imu and gnss drivers have in common."""

    @property
    def name(self) -> str:
        """As the user writes it, and the name of its folder."""

    @property
    def bauds(self) -> Sequence[int]:
        """Speeds its devices use, likeliest first."""

    @property
    def patience_s(self) -> float:
        """Within this time a healthy device that speaks by itself has said something recognisable."""

    @property
    def interrupts(self) -> bool:
        """Whether `identify` may be run on a device that streams. If not, the bytes sent would do harm, or nothing."""

    def recognise(self, heard: bytes) -> Identity | Unsupported | None:
        """The device, if `heard` is what it says by itself at the right speed."""

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
        """A fresh decoder state, an array of one record, for `decode`.

        Every state has the fields leftover, frames, junk, bad, lost, suspect and errors (counters, i8), and status
        (i8): the word with which the device reports its faults, as last heard.
        """

    @property
    def complaints(self) -> Mapping[int, str]:
        """What the bits of the device's status word mean, by mask; one bit each."""

    @property
    def decode(self) -> Callable[[NDArray[np.uint8], int, NDArray[np.void], NDArray[np.void]], int]:
        """Kernel (rx, fill, state, samples) -> n.

        Decodes the complete frames of rx[:fill] into rows of `samples` (SAMPLE) and moves what is left to
        rx[:state.leftover]; with `samples` full it stops and keeps the rest. Any chunking gives the same samples.
        """


class GnssDecoder(Protocol):
    """Bytes of one receiver to fixes. Not thread-safe."""

    @property
    def counters(self) -> Mapping[str, int]:
        """Sentences and epochs taken and refused, by reason."""

    @property
    def status(self) -> ReceiverStatus:
        """What the receiver last said of itself: quality and satellites, with or without a fix."""

    @property
    def sky(self) -> Sky:
        """What it last said of the satellites."""

    @property
    def whole(self) -> int:
        """Messages that came undamaged, whatever they say: without any, the device or its speed is another."""

    @property
    def pending(self) -> bool:
        """Whether an epoch is open that `flush` may end."""

    def feed(self, data: bytes, arrival_ns: int) -> list[Fix]:
        """Take bytes that arrived at `arrival_ns` (monotonic); returns the fixes they complete."""

    def flush(self, now_ns: int) -> list[Fix]:
        """The fix of an epoch whose end did not come, once the line has been quiet."""


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
    """What a driver offers in addition if its devices speak SPI, too. `configure` then goes by `Identity.spi`."""

    def identify_spi(self) -> Dialogue[Identity | Unsupported | None]:
        """Ask on an SPI line, as `identify` does on a serial one."""


@dataclass(frozen=True)
class Done:
    """How a service ended, in words."""

    ok: bool
    told: str


@dataclass(frozen=True)
class Service:
    """Something that a device does once, because a user asks for it, and that outlasts the connection."""

    what: str  # what it does and what the user must see to, shown before the user agrees; {} is the value
    unit: str  # of the value; s means that the service takes that long
    values: Sequence[int]
    usual: int | None  # the default value; None: the user must name one
    act: Callable[[int], Dialogue[Done]]  # does it, then asks the device whether it worked


@runtime_checkable
class ServiceDriver(Protocol):
    """What a driver offers in addition if its devices do more than stream."""

    @property
    def services(self) -> Mapping[str, Service]:
        """By the names that users give them, each the same for all drivers."""


AnyDriver = ImuDriver | GnssDriver
