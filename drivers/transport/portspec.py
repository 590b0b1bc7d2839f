"""Parses `DEV[:DRIVER[@BAUD]]`, `gpsd://HOST[:PORT][/DEVICE]` and `iio:NAME`.

Paths such as /dev/serial/by-path/…-usb-0:1.0-port0 have colons of their own.
"""

import os
import re
from collections.abc import Collection
from dataclasses import dataclass

from ..errors import SpecError
from ..registry import names

SUFFIX = re.compile(r"(?P<driver>[A-Za-z][\w-]*)?(?:@(?P<baud>.*))?")
SCHEME = re.compile(r"(?:spi|replay|sim):")
KINDS = ("imu", "gnss")  # a device in a recording may also be named by its kind
SERVER_DRIVER, SERVER_PORT = "gpsd", 2947
ADDRESS = re.compile(r"gpsd://(?P<host>\[[0-9a-fA-F:.%]+\]|[\w.-]+)(?::(?P<port>\d{1,5}))?(?P<device>/.+)?")
IIO_DRIVER = "iio"
IIO = re.compile(r"iio:(.+)")
SPI = re.compile(r"spi:(\d+)\.(\d+)")
MISWRITTEN_BAUD = re.compile(r"(?P<path>.+?):?(?P<driver>(?<=:)[A-Za-z][\w-]*)?[:@](?P<baud>\d{3,})")
BAUDS = range(50, 4_000_001)


@dataclass(frozen=True)
class PortSpec:
    """A port as the user named it."""

    path: str  # or spi:BUS.DEV, replay:FILE, sim:SCENARIO, gpsd://HOST, iio:NAME
    driver: str | None = None
    baud: int | None = None
    data_ready: str | None = None  # CHIP:LINE of the line on which an SPI device says that a sample is there

    def __str__(self) -> str:
        if self.server or self.iio:
            return self.path
        baud = "" if self.baud is None else f"@{self.baud}"
        return f"{self.path}:{self.driver or ''}{baud}" if self.driver or baud else self.path

    @property
    def spi(self) -> tuple[int, int] | None:
        """Bus and device (chip select), if this is an SPI port."""
        numbers = SPI.fullmatch(self.path)
        return (int(numbers[1]), int(numbers[2])) if numbers else None

    @property
    def server(self) -> tuple[str, int, str] | None:
        """Host, port and device (empty: any) of a gpsd, if this port is one."""
        parts = ADDRESS.fullmatch(self.path)
        if not parts:
            return None
        return parts["host"].strip("[]"), int(parts["port"] or SERVER_PORT), parts["device"] or ""

    @property
    def iio(self) -> str | None:
        """Name of a device of Linux's Industrial I/O, if this port is one."""
        name = IIO.fullmatch(self.path)
        return name[1] if name else None

    @classmethod
    def parse(cls, text: str, drivers: Collection[str] | None = None) -> "PortSpec":
        """The parts of `text`; `drivers` are the names that count, by default all. Raises SpecError."""
        if text.startswith(f"{SERVER_DRIVER}:"):
            return _server(text)
        if text.startswith(f"{IIO_DRIVER}:"):
            return _iio(text)
        spec = cls._split(text, drivers)
        if spec.driver == SERVER_DRIVER and not spec.path.startswith("replay:"):
            raise SpecError(f"port {text!r}: a gpsd is no driver of a line; write gpsd://HOST:PORT")
        if spec.driver == IIO_DRIVER and not spec.path.startswith(("replay:", "sim:")):
            raise SpecError(f"port {text!r}: iio is no driver of a line; write iio:NAME")
        if spec.path.startswith("spi:") and (spec.spi is None or spec.baud is not None):
            raise SpecError(f"port {text!r}: write spi:BUS.DEVICE[:DRIVER], for example spi:0.0 for /dev/spidev0.0")
        return spec

    @classmethod
    def _split(cls, text: str, drivers: Collection[str] | None) -> "PortSpec":
        scheme = SCHEME.match(text)
        known = names() if drivers is None else drivers
        if scheme and scheme[0] == "replay:":
            known = (*known, *KINDS)
        start = scheme.end() if scheme else 0
        path, _, suffix = text[start:].rpartition(":")
        parts = SUFFIX.fullmatch(suffix)
        if not path or not suffix or not parts:
            return _whole(text, start)
        driver, baud = parts["driver"], parts["baud"]
        if driver is not None and driver not in known:
            if os.path.exists(text[start:]):  # noqa: PTH110 - False for what is too long for a name
                return _whole(text, start)
            raise SpecError(f"port {text!r}: no driver {driver!r}; there are: {', '.join(known)}")
        return cls(text[:start] + path, driver, None if baud is None else _baud(text, baud))


def _server(text: str) -> PortSpec:
    spec = PortSpec(text, SERVER_DRIVER)
    if spec.server is None or not 0 < spec.server[1] < 65536:
        raise SpecError(f"port {text!r}: write gpsd://HOST[:PORT][/DEVICE], for example gpsd://localhost:2947")
    return spec


def _iio(text: str) -> PortSpec:
    spec = PortSpec(text, IIO_DRIVER)
    if spec.iio is None or "/" in spec.iio:
        raise SpecError(
            f"port {text!r}: write iio:NAME, for example iio:bmi160 or iio:device0 (`imud probe` lists them)"
        )
    return spec


def _whole(text: str, start: int) -> PortSpec:
    if len(text) == start or text.startswith(":"):
        raise SpecError(f"port {text!r}: no device; write DEV[:DRIVER[@BAUD]]")
    if not start and (meant := _miswritten(text)) and not os.path.exists(text):  # noqa: PTH110
        raise SpecError(f"port {text!r}: write {meant}")
    return PortSpec(text)


def _miswritten(text: str) -> str:
    """How to write what is probably meant by a path of which no device can be waited for; empty: it may be one."""
    if "://" in text:
        return f"{SERVER_DRIVER}://HOST[:PORT][/DEVICE] for a server; there are no others"
    if parts := MISWRITTEN_BAUD.fullmatch(text):
        return f"{parts['path']}:{parts['driver'] or ''}@{parts['baud']}"
    return f"/dev/{text}" if text.startswith("tty") else ""


def _baud(text: str, baud: str) -> int:
    if not (baud.isascii() and baud.isdecimal() and int(baud) in BAUDS):
        raise SpecError(f"port {text!r}: {baud!r} is no baud rate")
    return int(baud)
