"""A serial line: opened, locked and set raw by pyserial, then used through its descriptor.

Reading never blocks. A line that went away shows itself as EIO, ENODEV, EBADF or ENXIO, or as an end of file (VMIN is
1, so that no data is EAGAIN and nothing else): all of them are `PortLostError`.
"""

import contextlib
import fcntl
import grp
import os
import pwd
import stat
import termios
from collections.abc import Mapping
from pathlib import Path
from typing import NoReturn

import serial

from ..errors import NotSerialError, PortAbsentError, PortBusyError, PortDeniedError, PortError, PortLostError
from .descriptor import DescriptorPort
from .holders import holders, is_pty
from .portspec import PortSpec
from .reasons import ABSENT, BUSY, DENIED, UNFIT, reason

PATTERNS = ("serial/by-id/*", "ttyUSB*", "ttyACM*", "ttyAMA*")
DEFAULT_BAUD = 460800
FLUSH_READS = 16  # at most: a device may send without pause


class SerialPort(DescriptorPort):
    """An open line. Not thread-safe. Raises the errors of `imud.drivers.errors` on opening and PortLostError in use."""

    plain, chunk = True, 4096

    def __init__(self, spec: PortSpec) -> None:
        path = self.path = spec.path
        status = present(path)
        try:
            self._serial = serial.Serial(path, spec.baud or DEFAULT_BAUD, timeout=0, write_timeout=0, exclusive=True)
        except (OSError, ValueError) as error:  # SerialException is an OSError
            _raise_port_error(path, status, error)
        self.fd: int = self._serial.fileno()
        try:
            self._claim(status)
            self._make_raw()
            self.discard()
        except (OSError, termios.error) as error:
            self.close()
            _raise_port_error(path, status, error)
        except PortError:
            self.close()
            raise

    def _claim(self, status: os.stat_result) -> None:
        """Refuse a line that others read without a lock; keep others from opening it while it is ours."""
        others = holders(status)
        if others:
            raise PortBusyError(self.path, f"{self.path} is in use by {', '.join(map(str, others))}: stop it first")
        if not is_pty(status):  # a pseudo-terminal would stay closed to others after a crash of ours
            fcntl.ioctl(self.fd, termios.TIOCEXCL)
        # an FTDI adapter otherwise holds bytes back for 16 ms; pseudo-terminals and some drivers refuse
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            self._serial.set_low_latency_mode(True)

    def _make_raw(self) -> None:
        attributes = termios.tcgetattr(self.fd)
        attributes[0] &= ~(termios.BRKINT | termios.PARMRK | termios.ISTRIP | termios.INPCK)
        attributes[6][termios.VMIN], attributes[6][termios.VTIME] = 1, 0
        termios.tcsetattr(self.fd, termios.TCSANOW, attributes)

    @property
    def warning(self) -> str:
        """See `Line`: a UART has none."""
        return ""

    @property
    def counters(self) -> Mapping[str, int]:
        """See `Line`: a UART has none."""
        return {}

    @property
    def baud(self) -> int:
        """Speed of the line."""
        return int(self._serial.baudrate)

    def set_baud(self, baud: int) -> None:
        """Change the speed of the line."""
        if baud == self.baud:
            return
        try:
            self._serial.baudrate = baud
            self._make_raw()
        except (OSError, ValueError, termios.error) as error:
            raise self._lost(error) from error

    def write(self, data: bytes) -> int:
        """Send a command. Bytes for which the line has no room are dropped: then the answer is missing."""
        try:
            return os.write(self.fd, data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise self._lost(error) from error

    def discard(self) -> None:
        """Throw away what has been received and not read."""
        try:
            termios.tcflush(self.fd, termios.TCIFLUSH)
        except (OSError, termios.error) as error:
            raise self._lost(error) from error
        for _ in range(FLUSH_READS):  # a pseudo-terminal keeps some behind the flush
            if not self.read():
                return

    def close(self) -> None:
        """Close the line. May be called twice, also on a line that was lost."""
        with contextlib.suppress(OSError):
            self._serial.close()

    def _lost(self, error: Exception | None) -> PortLostError:
        return PortLostError(self.path, f"{self.path} went away: {reason(error) if error else 'end of file'}")


def present(path: str) -> os.stat_result:
    """What is at the path. Raises PortAbsentError, PortDeniedError, NotSerialError."""
    try:
        status = Path(path).stat()
    except OSError as error:
        if error.errno in DENIED:
            raise PortDeniedError(path, f"no permission to read {path}: may you enter its folder?") from error
        raise PortAbsentError(path, _absent(path)) from error
    if not stat.S_ISCHR(status.st_mode):
        raise NotSerialError(path, f"{path} is not a serial device, but {_kind(status.st_mode)}")
    return status


def _kind(mode: int) -> str:
    kinds = {stat.S_IFREG: "a file", stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
    return kinds.get(stat.S_IFMT(mode), "another kind of device")


def _absent(path: str) -> str:
    present = sorted(str(found) for pattern in PATTERNS for found in Path("/dev").glob(pattern))
    return f"there is no {path}; serial devices present: {', '.join(present) or 'none'}"


def _raise_port_error(path: str, status: os.stat_result, error: Exception) -> NoReturn:
    """Raise the typed error for a failure of opening `path`."""
    cause = error.__context__ if getattr(error, "errno", None) is None and error.__context__ else error
    number = cause.args[0] if cause.args and isinstance(cause.args[0], int) else None
    if number in ABSENT:
        raise PortAbsentError(path, f"{path} has no device behind it") from error
    if number in DENIED:
        raise PortDeniedError(path, _denied(path, status)) from error
    if number in BUSY:
        others = ", ".join(map(str, holders(status))) or "a process that this user may not see, or this one"
        raise PortBusyError(path, f"{path} is in use by {others}: stop it first") from error
    if number in UNFIT:
        raise NotSerialError(path, f"{path} is not a serial device") from error
    raise PortLostError(path, f"{path} cannot be opened: {reason(cause)}") from error


def _denied(path: str, status: os.stat_result) -> str:
    owner, group = str(status.st_uid), str(status.st_gid)
    with contextlib.suppress(KeyError):
        owner = pwd.getpwuid(status.st_uid).pw_name
    with contextlib.suppress(KeyError):
        group = grp.getgrgid(status.st_gid).gr_name
    message = f"no permission to open {path} ({stat.filemode(status.st_mode)} {owner}:{group})"
    if status.st_mode & stat.S_IRGRP and status.st_mode & stat.S_IWGRP and status.st_gid != 0:
        return f"{message}: join group {group} (sudo usermod -aG {group} $USER) and log in again"
    return f"{message}: only {owner} may"
