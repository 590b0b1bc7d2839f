"""The interface of every emulated device: something on a serial line to which the time is passed in."""

from typing import Protocol

from .uart import Uart

RECEIVERS = ("nmea", "ubx", "m8")  # as `imud sim` calls them
OTHERS = ("wheel", "baro", "compass")  # sensors beside them
PROGRAMS = ("pose", "velocity", "body_velocity", "wheels")  # programs, which send datagrams
POLLED = ("bmp280", "ak8975")  # the same behind the kernel, as `iio_polled` has them; the rest are inertial sensors


class Device(Protocol):
    """Sans-IO. Times are seconds since the emulation's start and never decrease."""

    uart: Uart  # with the transmit buffer

    def receive(self, data: bytes, t: float) -> None:
        """Process bytes that arrived at time `t`."""
        ...

    def advance(self, t: float) -> None:
        """Do everything that is due until time `t`."""
        ...

    def deadline(self) -> float:
        """When the device will next send by itself; infinite when it only answers."""
        ...

    def restart(self, t: float) -> None:
        """The power came back at time `t`, or a reset."""
        ...

    def prepare(self) -> None:
        """Use idle time to compute ahead."""
        ...
