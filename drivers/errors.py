"""The errors of ports, as one tree. Each message says what, where, and what to do next.

PortError
├── PortAbsentError    no such device (yet)
├── PortDeniedError    the user may not open it
├── PortBusyError      another process has it
├── NotSerialError     it exists, but is no serial line
├── PortSupportError   a package without which this kind of port cannot be used is not installed
└── PortLostError      it was open and was removed, or fails at input or output
    └── PortEndedError    it was a recording, which has ended
SpecError         a port specification with a wrong syntax
CaptureError      a file that is no recording
"""


class PortError(Exception):
    """A port cannot be used."""

    def __init__(self, path: str, message: str) -> None:
        super().__init__(message)
        self.path = path


class PortAbsentError(PortError):
    """There is no such device."""


class PortDeniedError(PortError):
    """The device exists, but this user may not open it."""


class PortBusyError(PortError):
    """Another process holds the device."""


class NotSerialError(PortError):
    """The path is not a serial line."""


class PortSupportError(PortError):
    """A Python package that this kind of port needs is missing, or of a wrong version."""


class PortLostError(PortError):
    """The device was unplugged, or its line failed."""


class PortEndedError(PortLostError):
    """A recording has been played to its end."""


class CaptureError(ValueError):
    """A file that is no recording."""


class SpecError(ValueError):
    """A port specification with a wrong syntax."""
