"""What a search of a line finds if no driver knows a device there, in words that tell the user what to do."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import xor

CHATTER = 16  # bytes; fewer are glitches of a line that is idle, or being plugged
GARBAGE, TEXT_SHARE = 200, 0.7  # bytes after which, with less text than that, nothing will be recognised any more
SHOWN, TEXT_SHOWN = 24, 90  # bytes
FOREIGN = {  # how their messages begin
    b"\xb5\x62\x01": "a u-blox receiver",
    b"\xa0\xa2\x00": "a SiRF receiver",
}


@dataclass(frozen=True)
class Silence:
    """Nothing came."""

    bauds: tuple[int, ...]
    asked: bool

    def __str__(self) -> str:
        advice = "is it powered, and are its TX and RX the right way round?" if self.asked else "does it talk unasked?"
        return f"silent at {_speeds(self.bauds)}: {advice}"


@dataclass(frozen=True)
class Chatter:
    """Something came, but nothing known."""

    heard: bytes
    baud: int  # at which that was heard
    bauds: tuple[int, ...]

    def __str__(self) -> str:
        heard = f"{len(self.heard)} bytes heard at {self.baud} baud, {self.gist}"
        return f"{heard} (tried {_speeds(self.bauds)}): {_shown(self.heard)} …"

    @property
    def gist(self) -> str:
        """The part that stays the same from one attempt to the next."""
        return _kind(self.heard)

    @property
    def worth(self) -> tuple[bool, int]:
        """For choosing what to show: sensible bytes before garbage, many before few."""
        n = len(self.heard)
        return n >= CHATTER and (_text_share(self.heard) >= TEXT_SHARE or bool(_foreign(self.heard))), n


@dataclass(frozen=True)
class Echo:
    """What is written comes back, and nothing else."""

    baud: int

    def __str__(self) -> str:
        return "what is written comes back: are TX and RX connected with each other, or does the adapter echo?"


@dataclass(frozen=True)
class NoAnswer:
    """Nothing that is known answers on an SPI line."""

    readonly: bool

    def __str__(self) -> str:
        if self.readonly:
            return "a device on SPI says nothing unasked, and nothing may be written"
        return "nothing known answers on SPI: is it powered, wired (CS, SCLK, MOSI, MISO) and set to SPI?"


Finding = Silence | Chatter | Echo | NoAnswer


def _speeds(bauds: Sequence[int]) -> str:
    if len(bauds) == 1:
        return f"{bauds[0]} baud, as named; leave out @BAUD to have other speeds tried"
    return f"all of {', '.join(map(str, sorted(bauds)))} baud"


def _kind(heard: bytes) -> str:
    """What the bytes look like, though no driver knows them."""
    if whose := _foreign(heard):
        return f"of {whose} in its own binary format, which imud does not read: have it send NMEA"
    if _text_share(heard) < TEXT_SHARE:
        return "but nothing known: garbage, as of a line at another speed, or a device that imud does not know"
    lines = [line for line in heard.splitlines() if line.startswith(b"$") and b"*" in line]
    if any(_is_whole(line) for line in lines):
        return "NMEA sentences, but none that tells a position: no receiver's"
    if lines:
        return "NMEA sentences with wrong checksums: a disturbed line"
    return "text, but of no device that imud knows"


def _is_whole(line: bytes) -> bool:
    """Whether the checksum of an NMEA sentence is right."""
    body, _, told = line[1:].partition(b"*")
    return told[:2].upper() == b"%02X" % reduce(xor, body, 0)


def _foreign(heard: bytes) -> str:
    """The maker whose binary messages are in it; empty: none that is known."""
    return next((whose for mark, whose in FOREIGN.items() if mark in heard), "")


def _shown(heard: bytes) -> str:
    if _text_share(heard) < TEXT_SHARE:
        return heard[:SHOWN].hex(" ")
    return repr(heard[:TEXT_SHOWN].decode("ascii", "replace").strip())


def is_garbage(heard: bytes) -> bool:
    """Whether so little of it is text that nothing will be recognised any more."""
    return len(heard) >= GARBAGE and _text_share(heard) < TEXT_SHARE


def _text_share(heard: bytes) -> float:
    return sum(32 <= byte < 127 or byte in b"\r\n" for byte in heard) / len(heard)
