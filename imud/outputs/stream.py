"""Every state in binary for any number of clients: a SEQPACKET socket on which each client chooses a divisor.

One record per message (layout: `imud.client.FIELDS`). A client that does not read loses records, sees the gap in their
sequence numbers, and is disconnected after a minute; the daemon never waits for a client. Sending is compiled,
connecting is not.
"""

import select
import socket

import numpy as np

from ..client import DIVISOR
from ..compile.jit import kernel
from ..compile.system import EAGAIN, errno, send
from ..configuration.settings import Stream as StreamSettings
from ..math.arrays import Records
from .addresses import parse_path
from .connection import SECOND_NS
from .listeners import Listeners, Poller, RejectedError

_STALL_TIMEOUT_NS = 60_000_000_000
_SEND_BUFFER = 1 << 20  # 1.6 s of states at 1 kHz; where net.core.wmem_max is at its default, a third of a second
_FLAGS = int(socket.MSG_NOSIGNAL | socket.MSG_DONTWAIT)
CLIENT = np.dtype(
    [
        ("fd", "<i4"),
        ("divisor", "<i8"),
        ("stalled_ns", "<i8"),  # since when the client takes no record; 0: it takes them
    ],
    align=True,
)


@kernel
def send_all(clients: Records, messages: int, size: int, n: int, seq: int, now_ns: int) -> int:
    """Send to each client those of n messages of `size` bytes whose number its divisor divides; the last is `seq`.

    Returns how many were dropped. A client that has closed its connection is reported by poll, not here.
    """
    dropped = 0
    for i in range(len(clients)):
        c = clients[i]
        for k in range(n):
            if (seq - n + 1 + k) % c.divisor != 0:
                continue
            if send(c.fd, messages + k * size, size, _FLAGS) >= 0:
                c.stalled_ns = 0
            elif errno() == EAGAIN:
                dropped += 1
                if c.stalled_ns == 0:
                    c.stalled_ns = now_ns
    return dropped


class StreamServer:
    """The clients of one socket. Never blocks; not thread-safe."""

    def __init__(self, settings: StreamSettings, poller: Poller, publisher: Records) -> None:
        """Open; this class writes the clients into `publisher` (array of one PUBLISHER).

        Raises AddressInUseError or CannotCreateError (73), PermissionDeniedError (77).
        """
        self._publisher = publisher
        self._poller = poller
        self._tick_ns = 0
        self._sockets: list[socket.socket] = []
        self._clients = np.zeros(settings.max_clients, CLIENT)  # in the same order
        publisher["clients"] = self._clients.ctypes.data
        addresses = [parse_path(settings.listen)] if settings.listen else []
        self._listeners = Listeners(addresses, poller, b"", socket.SOCK_SEQPACKET)

    @property
    def clients(self) -> int:
        return len(self._sockets)

    @property
    def dropped(self) -> int:
        """Records that slow clients lost."""
        return int(self._publisher["dropped"][0])

    def _index(self, fd: int) -> int:
        """The client's index; -1: the descriptor belongs to no client."""
        return next((i for i, sock in enumerate(self._sockets) if sock.fileno() == fd), -1)

    def __contains__(self, fd: int) -> bool:
        return self._index(fd) >= 0 or fd in self._listeners

    def on_event(self, fd: int) -> None:
        """Handle a poll event: a client connects, sends another divisor, or disconnects."""
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
        """End this client's connection; a listener instead waits until `tick`."""
        if (i := self._index(fd)) >= 0:
            self._remove(i)
        else:
            self._listeners.pause(fd)

    def tick(self, now_ns: int) -> None:
        """Once per second: disconnect stalled clients; accept connections again after a lack of file descriptors."""
        if now_ns < self._tick_ns:
            return
        self._tick_ns = now_ns + SECOND_NS
        self._listeners.tick()
        for i in reversed(range(len(self._sockets))):
            if (stalled_ns := self._clients[i]["stalled_ns"]) and now_ns - stalled_ns > _STALL_TIMEOUT_NS:
                self._remove(i)

    def _accept(self, fd: int) -> None:
        try:
            sock = self._listeners.accept(fd)
        except RejectedError:
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
        self._listeners.close()
