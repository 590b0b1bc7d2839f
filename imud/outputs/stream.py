"""Every state in binary for any number of clients: a SEQPACKET socket on which each client chooses a divisor.

One record per message (layout: `imud.client.FIELDS`). A client that does not read loses its own records, which their
numbers tell it, and is cut off after a while; nobody waits for it. Sending is compiled, connecting is not.
"""

import select
import socket

import numpy as np
from numpy.typing import NDArray

from imud.client import DIVISOR
from imud.compile.jit import kernel
from imud.compile.system import EAGAIN, errno, send
from imud.configuration.settings import Stream as StreamSettings

from .connection import SECOND_NS
from .door import Door, Poller, TurnedAwayError
from .listen import parse_path

_STUCK_NS = 60_000_000_000
_SEND_BUFFER = 256 * 1024
_FLAGS = int(socket.MSG_NOSIGNAL | socket.MSG_DONTWAIT)
CLIENT = np.dtype(
    [
        ("fd", "<i4"),
        ("divisor", "<i8"),
        ("stuck_ns", "<i8"),  # since when it takes nothing; 0: it does
    ],
    align=True,
)


@kernel
def send_all(clients: NDArray[np.void], messages: int, size: int, n: int, seq: int, now_ns: int) -> int:
    """Send to each client those of n messages of `size` bytes whose number its divisor divides; the last is `seq`.

    Returns how many were dropped. A client that is gone is left to the poll, which reports it.
    """
    dropped = 0
    for i in range(len(clients)):
        c = clients[i]
        for k in range(n):
            if (seq - n + 1 + k) % c.divisor != 0:
                continue
            if send(c.fd, messages + k * size, size, _FLAGS) >= 0:
                c.stuck_ns = 0
            elif errno() == EAGAIN:
                dropped += 1
                if c.stuck_ns == 0:
                    c.stuck_ns = now_ns
    return dropped


class StreamServer:
    """The clients of one socket. Never blocks; not thread-safe."""

    def __init__(self, settings: StreamSettings, poller: Poller, publisher: NDArray[np.void]) -> None:
        """Open; `publisher` (array of one PUBLISHER) is told of the clients.

        Raises AddressInUseError or CannotCreateError (73), PermissionDeniedError (77).
        """
        self._publisher = publisher
        self._poller = poller
        self._look_ns = 0
        self._sockets: list[socket.socket] = []
        self._clients = np.zeros(settings.max_clients, CLIENT)  # in the same order
        publisher["clients"] = self._clients.ctypes.data
        addresses = [parse_path(settings.listen)] if settings.listen else []
        self._door = Door(addresses, poller, b"", socket.SOCK_SEQPACKET)

    @property
    def clients(self) -> int:
        return len(self._sockets)

    @property
    def dropped(self) -> int:
        """Records that slow clients lost."""
        return int(self._publisher["dropped"][0])

    def _index(self, fd: int) -> int:
        """The client's place; -1 for none of ours."""
        return next((i for i, sock in enumerate(self._sockets) if sock.fileno() == fd), -1)

    def __contains__(self, fd: int) -> bool:
        return self._index(fd) >= 0 or fd in self._door

    def on_event(self, fd: int) -> None:
        """Somebody connects, asks for another divisor, or goes."""
        i = self._index(fd)
        if i < 0:
            self._accept(fd)
            return
        try:
            request = self._sockets[i].recv(64)
        except BlockingIOError:
            return
        except OSError:
            request = b""
        if len(request) == DIVISOR.size and (divisor := DIVISOR.unpack(request)[0]) > 0:
            self._clients[i]["divisor"] = divisor
        else:
            self._remove(i)

    def disconnect(self, fd: int) -> None:
        """End this client's connection; a listener instead waits until `look_after`."""
        if (i := self._index(fd)) >= 0:
            self._remove(i)
        else:
            self._door.pause(fd)

    def look_after(self, now_ns: int) -> None:
        """Cut off clients that have taken nothing for long; accept again those for whom there was no room."""
        if now_ns < self._look_ns:
            return
        self._look_ns = now_ns + SECOND_NS
        self._door.tick()
        for i in reversed(range(len(self._sockets))):
            if (stuck_ns := self._clients[i]["stuck_ns"]) and now_ns - stuck_ns > _STUCK_NS:
                self._remove(i)

    def _accept(self, fd: int) -> None:
        try:
            sock = self._door.let_in(fd)
        except TurnedAwayError:
            return
        if sock is None:
            return
        if len(self._sockets) >= len(self._clients):
            sock.close()
            return
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        self._clients[len(self._sockets)] = sock.fileno(), 1, 0
        self._sockets.append(sock)
        self._publisher["connected"] = len(self._sockets)
        self._poller.register(sock.fileno(), select.POLLIN)

    def _remove(self, i: int) -> None:
        sock = self._sockets.pop(i)
        self._clients[i:-1] = self._clients[i + 1 :].copy()
        self._publisher["connected"] = len(self._sockets)
        self._poller.unregister(sock.fileno())
        sock.close()

    def close(self) -> None:
        """End all connections and remove the socket."""
        while self._sockets:
            self._remove(0)
        self._door.close()
