"""The door of a server: its listening sockets, who comes in, and who is sent away for lack of a descriptor."""

import contextlib
import errno
import os
import select
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from .listen import Address, listen, shown_address

_EXHAUSTED = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)  # nobody can be let in now


class Poller(Protocol):
    """What the server needs of the loop's poll object; `select.poll()` and level-triggered `select.epoll()` have it."""

    def register(self, fd: int, eventmask: int, /) -> None: ...
    def modify(self, fd: int, eventmask: int, /) -> None: ...
    def unregister(self, fd: int, /) -> None: ...


class TurnedAwayError(Exception):
    """Who waited was sent away."""


class Door:
    """Listening sockets that a loop polls. Never blocks; not thread-safe."""

    def __init__(
        self,
        addresses: Sequence[Address],
        poller: Poller,
        farewell: bytes,
        kind: socket.SocketKind = socket.SOCK_STREAM,
    ) -> None:
        """Open all of them, or none. farewell: the last words to who is sent away. Raises as `listen`."""
        self._poller, self._farewell = poller, farewell
        self._listeners: dict[int, socket.socket] = {}
        self._reserve = Reserve()
        try:
            for address in addresses:
                sock = listen(address, kind)
                self._listeners[sock.fileno()] = sock
                poller.register(sock.fileno(), select.POLLIN)
        except BaseException:
            self.close()
            raise

    def __contains__(self, fd: int) -> bool:
        return fd in self._listeners

    @property
    def addresses(self) -> tuple[str, ...]:
        """Where it listens, with real port numbers."""
        return tuple(shown_address(sock) for sock in self._listeners.values())

    def let_in(self, fd: int) -> socket.socket | None:
        """Who waits at this socket; None: nobody, or nothing can be done before `tick`. Raises TurnedAwayError."""
        listener = self._listeners[fd]
        try:
            return listener.accept()[0]
        except OSError as error:
            if error.errno not in _EXHAUSTED:
                return None
        if self._reserve.turn_away(listener, self._farewell):
            raise TurnedAwayError
        self.pause(fd)  # poll would say it again at once
        return None

    def pause(self, fd: int) -> None:
        """Accept nobody at this socket until `tick`."""
        if fd in self._listeners:
            self._poller.modify(fd, 0)

    def tick(self) -> None:
        """Call once per second."""
        for fd in self._listeners:
            self._poller.modify(fd, select.POLLIN)

    def close(self) -> None:
        """Stop listening."""
        for fd, sock in self._listeners.items():
            self._poller.unregister(fd)
            if sock.family == socket.AF_UNIX:
                with contextlib.suppress(OSError):
                    Path(sock.getsockname()).unlink()
            sock.close()
        self._listeners.clear()
        self._reserve.close()


class Reserve:
    """A descriptor kept back. Once none is left, it lets in who would wait for an answer, and sends them away."""

    def __init__(self) -> None:
        self._fd = -1
        self._keep()

    def _keep(self) -> None:
        with contextlib.suppress(OSError):
            self._fd = os.open("/dev/null", os.O_RDONLY | os.O_CLOEXEC)

    def turn_away(self, listener: socket.socket, farewell: bytes) -> bool:
        """End the connection of who waits first, with these last words; False: not even that is possible."""
        self.close()
        try:
            sock, _ = listener.accept()
        except OSError:
            return False
        else:
            with sock, contextlib.suppress(OSError):
                sock.send(farewell, socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
            return True
        finally:
            self._keep()

    def close(self) -> None:
        """Give it up."""
        if self._fd >= 0:
            os.close(self._fd)
        self._fd = -1
