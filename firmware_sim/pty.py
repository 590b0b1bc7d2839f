"""A pseudo-terminal that stands for a serial port: raw, never blocking, with a stable link, and with a speed.

Pitfalls (tried): the line discipline must be raw before anybody can open it; without a slave
descriptor of our own every close by the host would be a hang-up; the kernel ignores the speed but shows it to us.

The kernel passes bytes on by a worker (`flush_to_ldisc`), which may wait for a processor for more than a second.
Meanwhile a serial line holds 640 KiB (TTYB_DEFAULT_MEM_LIMIT), a pseudo-terminal 8 KiB; the rest waits here. Once the
host has left 4 KiB unread, a USB adapter receives no more (`throttle`), and only its own small buffer is left.
"""

import errno
import fcntl
import os
import struct
import termios
import tty
from pathlib import Path

_SPEEDS = {getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()}
_CODES = {speed: code for code, speed in _SPEEDS.items()}
_FULL = 4095 - 128  # bytes unread from which on the kernel throttles an adapter: N_TTY_BUF_SIZE, TTY_THRESHOLD_THROTTLE
_ADAPTER = 512  # bytes in an adapter's own buffer; 256 to 4096 are usual


class Pty:
    """Context manager: the port exists inside. link: where a symbolic link to it is made, replacing an older link.

    Raises OSError with the link's name where it cannot be made, as when something else than a link is in its place.
    """

    def __init__(self, link: Path | None, baud: int, *, patient: bool = False) -> None:
        """patient: keep all bytes without room until `flush` writes them."""
        self.lost = 0  # bytes that the host read too late
        self.waiting = b""  # bytes that wait for room
        self.waits_for_kernel = False  # or, if patient, for the host
        self._in_adapter = 0  # bytes of them since the host left too many unread
        self._patient = patient
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self._set_speed(baud)
        os.set_blocking(self._master, False)
        self.device = Path(os.ttyname(self._slave))
        self.path = self.device if link is None else link
        try:
            self._publish()
        except OSError as error:
            self._close()
            raise OSError(error.errno, error.strerror, str(self.path)) from None

    def __enter__(self) -> "Pty":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Unplug: the host sees a hang-up."""
        if self.path != self.device and self.path.is_symlink() and self.path.readlink() == self.device:
            self.path.unlink()
        self._close()

    def fileno(self) -> int:
        return self._master

    def baud(self) -> int:
        """The speed that the host has set; 0 for one that has no name."""
        return _SPEEDS.get(termios.tcgetattr(self._master)[5], 0)

    def read(self) -> bytes:
        """What the host has sent."""
        try:
            return os.read(self._master, 4096)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Send to the host, after what waits. What a real line would lose, as the host reads too late, is counted."""
        before = len(self.waiting)
        try:
            sent = os.write(self._master, self.waiting + data)
        except BlockingIOError:
            sent = 0
        self.waiting = (self.waiting + data)[sent:]
        host_is_late = bool(self.waiting) and not self._patient and self._unread() >= _FULL
        self.waits_for_kernel = bool(self.waiting) and not host_is_late
        self._in_adapter = self._in_adapter + max(len(self.waiting) - before, 0) if host_is_late else 0
        lost = max(self._in_adapter - _ADAPTER, 0)
        self.waiting = self.waiting[: len(self.waiting) - lost]
        self._in_adapter -= lost
        self.lost += lost

    def _unread(self) -> int:
        """Bytes that the host could read."""
        return int(struct.unpack("i", fcntl.ioctl(self._slave, termios.FIONREAD, bytes(4)))[0])

    def flush(self) -> None:
        """Send the waiting bytes."""
        self.write(b"")

    def _set_speed(self, baud: int) -> None:
        """Set the device's own speed, so that `cat` understands it until a host sets another."""
        attributes = termios.tcgetattr(self._slave)
        attributes[4] = attributes[5] = _CODES[baud]
        termios.tcsetattr(self._slave, termios.TCSANOW, attributes)

    def _publish(self) -> None:
        if self.path == self.device:
            return
        if self.path.exists() and not self.path.is_symlink():
            raise OSError(errno.EEXIST, "exists and is not a link: choose another path")
        new = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        new.symlink_to(self.device)
        new.replace(self.path)

    def _close(self) -> None:
        os.close(self._slave)
        os.close(self._master)
