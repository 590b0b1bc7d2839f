"""The listening sockets of a server. A connection is accepted, or rejected while too few file descriptors are free.

Some are kept for ports, files and recordings: clients, however many, do not keep a sensor from being opened again.
"""

import contextlib
import errno
import os
import resource
import select
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from .addresses import Address, address_text, listen

TOO_MANY, NO_DESCRIPTORS = "too many clients", "no descriptor left for another client"  # the reasons, as sent
_EXHAUSTED = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)  # accept() fails with one of these
_RESERVED_MAX = 32  # descriptors that no client may use; at most a quarter of all


class Poller(Protocol):
    """What the server needs of the loop's poll object; `select.poll()` and level-triggered `select.epoll()` have it."""

    def register(self, fd: int, eventmask: int, /) -> None: ...
    def modify(self, fd: int, eventmask: int, /) -> None: ...
    def unregister(self, fd: int, /) -> None: ...


class RejectedError(Exception):
    """The server rejected the connection: no file descriptor is left for it."""


class Listeners:
    """Listening sockets that a loop polls. Never blocks; not thread-safe."""

    def __init__(
        self,
        addresses: Sequence[Address],
        poller: Poller,
        rejection: bytes,
        kind: socket.SocketKind = socket.SOCK_STREAM,
    ) -> None:
        """Open all addresses, or none. rejection: the bytes that a rejected client receives. Raises as `listen`."""
        self._poller, self._rejection = poller, rejection
        self._sockets: dict[int, socket.socket] = {}
        self._spare = SpareDescriptor()
        try:
            for address in addresses:
                sock = listen(address, kind)
                self._sockets[sock.fileno()] = sock
                poller.register(sock.fileno(), select.POLLIN)
        except BaseException:
            self.close()
            raise

    def __contains__(self, fd: int) -> bool:
        return fd in self._sockets

    @property
    def addresses(self) -> tuple[str, ...]:
        """The addresses, with the port numbers that the system assigned."""
        return tuple(address_text(sock) for sock in self._sockets.values())

    def accept(self, fd: int) -> socket.socket | None:
        """The next connection; None: no client waits, or none can be accepted before `tick`. Raises RejectedError."""
        listener = self._sockets[fd]
        try:
            sock = listener.accept()[0]
        except OSError as error:
            if error.errno not in _EXHAUSTED:
                return None
        else:
            if sock.fileno() < _client_limit():
                return sock
            _reject(sock, self._rejection)
            raise RejectedError
        if self._spare.reject(listener, self._rejection):
            raise RejectedError
        self.pause(fd)  # poll would report the same client again at once
        return None

    def pause(self, fd: int) -> None:
        """Accept no connection at this socket until `tick`."""
        if fd in self._sockets:
            self._poller.modify(fd, 0)

    def tick(self) -> None:
        """Call once per second."""
        for fd in self._sockets:
            self._poller.modify(fd, select.POLLIN)

    def close(self) -> None:
        """Stop listening."""
        for fd, sock in self._sockets.items():
            self._poller.unregister(fd)
            if sock.family == socket.AF_UNIX:
                with contextlib.suppress(OSError):
                    Path(sock.getsockname()).unlink()
            sock.close()
        self._sockets.clear()
        self._spare.close()


def _client_limit() -> int:
    """A client's descriptor is below this number: the system gives out the lowest one that is free."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return limit - min(_RESERVED_MAX, limit // 4)


def _reject(sock: socket.socket, rejection: bytes) -> None:
    """Send the client `rejection`, and disconnect it."""
    with sock, contextlib.suppress(OSError):
        sock.send(rejection, socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)


class SpareDescriptor:
    """An open file descriptor. Once no other is free, the server closes it to accept and reject a waiting client."""

    def __init__(self) -> None:
        self._fd = -1
        self._reopen()

    def _reopen(self) -> None:
        with contextlib.suppress(OSError):
            self._fd = os.open("/dev/null", os.O_RDONLY | os.O_CLOEXEC)

    def reject(self, listener: socket.socket, rejection: bytes) -> bool:
        """Accept the first waiting client, send it `rejection`, disconnect it; False: accept() fails even so."""
        self.close()
        try:
            sock, _ = listener.accept()
        except OSError:
            return False
        else:
            _reject(sock, rejection)
            return True
        finally:
            self._reopen()

    def close(self) -> None:
        """Close the descriptor."""
        if self._fd >= 0:
            os.close(self._fd)
        self._fd = -1
