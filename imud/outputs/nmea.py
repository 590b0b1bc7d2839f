"""NMEA sentences to a UDP address and to a pseudo-terminal, for programs that read receivers only.

The output never blocks: sentences that a reader does not take are discarded, the oldest first, so that no reader gets
outdated sentences.
"""

import contextlib
import errno
import fcntl
import os
import socket
import struct
import termios
import tty
from pathlib import Path

from ..configuration.settings import Nmea
from ..errors import CannotCreateError, ConfigError, PermissionDeniedError
from .addresses import Address, is_local, parse_address
from .connection import NEVER_NS, RateLimiter
from .nmea_sentences import sentences
from .view import View

PORT = 10110  # IANA: nmea-0183
_PTY_BACKLOG = 2048  # bytes that may wait for the reader of the pseudo-terminal: a second or two of sentences


class NmeaOutput:
    """The configured outputs of sentences. Not thread-safe."""

    def __init__(self, settings: Nmea) -> None:
        """Open. Raises ConfigError (78), CannotCreateError (73), PermissionDeniedError (77)."""
        self._rate_limiter = RateLimiter(settings.rate_hz)
        self._udp: socket.socket | None = None
        self._master = self._slave = -1
        self._link: Path | None = None
        try:
            if settings.udp:
                self._udp = _connected(udp_address(settings))
            if settings.pty:
                self._open_pty(Path(settings.pty))
        except BaseException:
            self.close()
            raise
        self._enabled = self._udp is not None or self._link is not None

    def _open_pty(self, link: Path) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        path = os.ttyname(self._slave)
        with contextlib.suppress(OSError):  # some mounts forbid it; then only our user may read
            Path(path).chmod(0o666)
        if _is_locked_by_another(link):
            raise CannotCreateError(f"cannot make {link} (nmea.pty): another instance uses it")
        fcntl.lockf(self._slave, fcntl.LOCK_EX)
        try:
            if link.is_symlink():
                link.unlink()  # an earlier run's
            link.symlink_to(path)
        except PermissionError as error:
            raise PermissionDeniedError(f"cannot make {link} (nmea.pty): permission denied") from error
        except OSError as error:
            raise CannotCreateError(f"cannot make {link} (nmea.pty): {error.strerror}") from error
        self._link = link

    @property
    def due_ns(self) -> int:
        """When the next view is due."""
        return self._rate_limiter.due_ns if self._enabled else NEVER_NS

    def publish(self, view: View, now_ns: int) -> None:
        """Send the sentences of the view, if they are due."""
        if not self._enabled or not self._rate_limiter.try_acquire(now_ns):
            return
        data = sentences(view)
        if self._udp is not None:
            with contextlib.suppress(OSError):  # no receiver, or no room in the socket buffer
                self._udp.send(data)
        if self._link is not None:
            self._write_pty(data)

    def _write_pty(self, data: bytes) -> None:
        unread = struct.unpack("i", fcntl.ioctl(self._slave, termios.FIONREAD, bytes(4)))[0]
        if unread > _PTY_BACKLOG:
            termios.tcflush(self._slave, termios.TCIFLUSH)
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)
        with contextlib.suppress(BlockingIOError):
            os.read(self._master, 4096)  # what the reader writes to its "receiver"

    def close(self) -> None:
        """Close the pseudo-terminal and remove its link. May be called twice."""
        if self._udp is not None:
            self._udp.close()
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link = None
        for fd in (self._master, self._slave):
            if fd >= 0:
                os.close(fd)
        self._master = self._slave = -1
        self._enabled = False


def _is_locked_by_another(link: Path) -> bool:
    """Whether the link leads to a pseudo-terminal of another instance, which holds a record lock (readers use none)."""
    try:
        fd = os.open(link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        fcntl.lockf(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno in (errno.EACCES, errno.EAGAIN)
    finally:
        os.close(fd)
    return False


def udp_address(settings: Nmea) -> Address:
    """Where to send. Raises ConfigError, also for another machine that the settings do not allow."""
    address = parse_address(settings.udp, PORT)
    if isinstance(address.where, str):
        raise ConfigError(f"nmea.udp: {address.text!r} is no HOST:PORT")
    if not settings.allow_remote and not is_local(address):
        raise ConfigError(f"nmea.udp: {address.text} is another machine: set nmea.allow_remote = true if you mean it")
    return address


def _connected(address: Address) -> socket.socket:
    sock = socket.socket(address.family, socket.SOCK_DGRAM)
    try:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        sock.connect(address.where)
    except OSError as error:
        sock.close()
        reason = "no route to it" if error.errno == errno.ENETUNREACH else error.strerror
        raise CannotCreateError(f"nmea.udp: cannot send to {address.text}: {reason}") from error
    return sock
