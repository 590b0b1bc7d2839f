"""The results of a search that found no known device, as messages that say what the user can do."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import xor

DATA_MIN = 16  # bytes; fewer are glitches of a line that is idle, or being plugged
GARBAGE, TEXT_SHARE = 200, 0.7  # bytes after which, with a smaller share of text, no device will be recognised
SHOWN, TEXT_SHOWN = 24, 90  # bytes
HEADERS = {  # of binary protocols, and what the data are if no driver takes them
    b"\xb5\x62\x01": "of a u-blox receiver in UBX, but no position for this driver: "
    "have it send NAV-PVT or NMEA, and name either the driver ubx or none",
    b"\x3e\x04\x00\x0d": "of an Epson sensor that says that it is not ready, for as long as it was asked: "
    "switch it off and on; if that changes nothing, it is defective",
    b"\xa0\xa2\x00": "of a SiRF receiver in its own binary format, which imud does not read: have it send NMEA",
}


@dataclass(frozen=True)
class Silence:
    """No byte was received."""

    bauds: tuple[int, ...]
    queried: bool

    def __str__(self) -> str:
        queried = "is it powered, and are its TX and RX the right way round?"
        advice = queried if self.queried else "does it send without being queried?"
        return f"silent at {_speeds(self.bauds)}: {advice}"


@dataclass(frozen=True)
class UnrecognisedData:
    """Bytes were received, but of no known device."""

    received: bytes
    baud: int  # at which they were received
    bauds: tuple[int, ...]

    def __str__(self) -> str:
        text = f"{len(self.received)} bytes received at {self.baud} baud, {self.summary}"
        return f"{text} (tried {_speeds(self.bauds)}): {_shown(self.received)} …"

    @property
    def summary(self) -> str:
        """The part that stays the same from one attempt to the next."""
        return _kind(self.received)

    @property
    def rank(self) -> tuple[bool, int]:
        """For choosing the data to show: text or a known protocol before garbage, many bytes before few."""
        n = len(self.received)
        return n >= DATA_MIN and not self._is_garbage, n

    @property
    def is_sparse(self) -> bool:
        """Whether it is a little garbage, as of a device that sends rarely, at another baud rate."""
        return self._is_garbage and len(self.received) < GARBAGE

    @property
    def _is_garbage(self) -> bool:
        return _text_share(self.received) < TEXT_SHARE and not _protocol(self.received)


@dataclass(frozen=True)
class Echo:
    """The line returns the bytes written to it, and no others."""

    baud: int

    def __str__(self) -> str:
        return "the line echoes: are TX and RX connected with each other, or is a console (login) at its other end?"


@dataclass(frozen=True)
class NoAnswer:
    """No known device answers on an SPI line."""

    readonly: bool

    def __str__(self) -> str:
        if self.readonly:
            return "a device on SPI must be queried, but readonly forbids writing"
        return "no known device answers on SPI: is it powered, wired (CS, SCLK, MOSI, MISO) and set to SPI?"


@dataclass(frozen=True)
class NoGreeting:
    """The server at the other end is no gpsd, or there is none."""

    def __str__(self) -> str:
        return "no gpsd answers there: is it another program's port, or is the host away?"


Finding = Silence | UnrecognisedData | Echo | NoAnswer | NoGreeting


def _speeds(bauds: Sequence[int]) -> str:
    if len(bauds) == 1:
        return f"{bauds[0]} baud, as named; leave out @BAUD to have other speeds tried"
    return f"all of {', '.join(map(str, sorted(bauds)))} baud"


def _kind(received: bytes) -> str:
    """The kind of data, of no known device."""
    if known := _protocol(received):
        return known
    if _text_share(received) < TEXT_SHARE:
        return "of no known device: garbage, as of a line at another baud rate, or a device that imud does not know"
    lines = [line for line in received.splitlines() if line.startswith(b"$") and b"*" in line]
    if any(_is_whole(line) for line in lines):
        return "NMEA sentences, but none with a position: not of a receiver"
    if lines:
        return "NMEA sentences with wrong checksums: a disturbed line"
    return "text, but of no device that imud knows"


def _is_whole(line: bytes) -> bool:
    """Whether the checksum of an NMEA sentence is right."""
    body, _, checksum = line[1:].partition(b"*")
    return checksum[:2].upper() == b"%02X" % reduce(xor, body, 0)


def _protocol(received: bytes) -> str:
    """What the data are if binary messages of a device are in it; empty: of none that is known."""
    return next((text for header, text in HEADERS.items() if header in received), "")


def _shown(received: bytes) -> str:
    if _text_share(received) < TEXT_SHARE:
        return received[:SHOWN].hex(" ")
    return repr(received[:TEXT_SHOWN].decode("ascii", "replace").strip())


def is_garbage(received: bytes) -> bool:
    """Whether so little of it is text that no device will be recognised."""
    return len(received) >= GARBAGE and _text_share(received) < TEXT_SHARE and not _protocol(received)


def _text_share(received: bytes) -> float:
    return sum(32 <= byte < 127 or byte in b"\r\n" for byte in received) / len(received)
