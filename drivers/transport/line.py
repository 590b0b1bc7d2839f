"""Which class opens a port, by the scheme of its name, and the one small interface that all of them have."""

from collections.abc import Callable, Mapping
from typing import Protocol, runtime_checkable

from ..driver import GnssConfigured, ImuConfigured
from .dialogue_runner import DialoguePort
from .portspec import PortSpec
from .serial import SerialPort, present
from .spi import SpiPort


class Line(DialoguePort, Protocol):
    """An open port. Reading never blocks; whatever fails in use is PortLostError."""

    @property
    def plain(self) -> bool:
        """Whether `receive` does no more than read `fd`, so that compiled code may read it directly."""

    @property
    def counters(self) -> Mapping[str, int]:
        """How often things went wrong below the level of frames, by name."""

    @property
    def warning(self) -> str:
        """A problem that the user should solve although the line works; empty: none."""

    def receive(self, buffer: memoryview, now_ns: int) -> tuple[int, int]:
        """Read into `buffer` at the time `now_ns`; returns how many bytes, and when the last of them was there."""

    def close(self) -> None:
        """Close the port. May be called twice."""


@runtime_checkable
class KnownDevice(Protocol):
    """The additional interface of a line whose device is known and needs no configuration."""

    @property
    def configured(self) -> ImuConfigured | GnssConfigured:
        """The device as it streams."""


def _replay(spec: PortSpec) -> Line:
    from .replay import ReplayPort  # needs a package that not everybody has

    return ReplayPort(spec)


def _server(spec: PortSpec) -> Line:
    from .tcp import TcpPort

    return TcpPort(spec)


def _iio(spec: PortSpec) -> Line:
    from .iio import IioPort

    return IioPort(spec)


_OPENERS: dict[str, Callable[[PortSpec], Line]] = {"spi": SpiPort, "replay": _replay, "gpsd": _server, "iio": _iio}


def check_port(spec: PortSpec) -> None:
    """Check a port without opening it; waits for a server's address. Raises the errors of `imud.drivers.errors`."""
    if spec.server is not None:
        from .tcp import look_up

        look_up(*spec.server[:2])
    elif spec.path.partition(":")[0] not in _OPENERS:
        present(spec.path)


def open_line(spec: PortSpec) -> Line:
    """Open the port. Raises the errors of `imud.drivers.errors`."""
    return _OPENERS.get(spec.path.partition(":")[0], SerialPort)(spec)
