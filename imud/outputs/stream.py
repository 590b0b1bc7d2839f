"""Every state to whoever wants it, in binary: a SEQPACKET socket whose clients each choose a divisor.

One record per message (layout: `imud.client.FIELDS`). A client that does not read loses its own records, which their
numbers tell it, and is cut off after a while; nobody waits for it.
"""

import contextlib
import select
import socket
from dataclasses import dataclass
from pathlib import Path

from imud.client import DIVISOR, RECORD
from imud.settings import Stream as StreamSettings

from .gpsd import Poller
from .listen import listen, parse_path

_STUCK_NS = 60_000_000_000
_SEND_BUFFER = 256 * 1024


@dataclass(slots=True)
class _Client:
    sock: socket.socket
    divisor: int = 1
    stuck_ns: int | None = None


class StreamServer:
    """Records to the clients of one socket. Never blocks; not thread-safe."""

    def __init__(self, settings: StreamSettings, poller: Poller) -> None:
        """Open. Raises AddressInUseError or CannotCreateError (73), PermissionDeniedError (77)."""
        self.dropped = 0  # records that slow clients lost
        self._poller = poller
        self._max_clients = settings.max_clients
        self._clients: dict[int, _Client] = {}
        self._listener = listen(parse_path(settings.listen), socket.SOCK_SEQPACKET) if settings.listen else None
        if self._listener:
            poller.register(self._listener.fileno(), select.POLLIN)

    @property
    def clients(self) -> int:
        return len(self._clients)

    def __contains__(self, fd: int) -> bool:
        return fd in self._clients or (self._listener is not None and fd == self._listener.fileno())

    def on_event(self, fd: int) -> None:
        """Somebody connects, asks for another divisor, or goes."""
        client = self._clients.get(fd)
        if client is None:
            self._accept()
            return
        try:
            request = client.sock.recv(64)
        except BlockingIOError:
            return
        except OSError:
            request = b""
        if len(request) == DIVISOR.size and (divisor := DIVISOR.unpack(request)[0]) > 0:
            client.divisor = divisor
        else:
            self._remove(fd)

    def publish(self, records: memoryview, first_seq: int, now_ns: int) -> None:
        """`records` holds whole records, the first of them numbered `first_seq`, each client gets those it divides."""
        for fd, client in list(self._clients.items()):
            first = -first_seq % client.divisor
            for at in range(first * RECORD.size, len(records), client.divisor * RECORD.size):
                self._send(fd, client, records[at : at + RECORD.size], now_ns)

    def _send(self, fd: int, client: _Client, record: memoryview, now_ns: int) -> None:
        try:
            client.sock.send(record, socket.MSG_NOSIGNAL)
            client.stuck_ns = None
        except BlockingIOError:
            self.dropped += 1
            if client.stuck_ns is None:
                client.stuck_ns = now_ns
            if now_ns - client.stuck_ns > _STUCK_NS:
                self._remove(fd)
        except OSError:
            self._remove(fd)

    def _accept(self) -> None:
        assert self._listener is not None
        try:
            sock, _ = self._listener.accept()
        except OSError:
            return
        if len(self._clients) >= self._max_clients:
            sock.close()
            return
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        self._clients[sock.fileno()] = _Client(sock)
        self._poller.register(sock.fileno(), select.POLLIN)

    def _remove(self, fd: int) -> None:
        if client := self._clients.pop(fd, None):
            self._poller.unregister(fd)
            client.sock.close()

    def close(self) -> None:
        """End all connections and remove the socket."""
        for fd in list(self._clients):
            self._remove(fd)
        if self._listener:
            self._poller.unregister(self._listener.fileno())
            with contextlib.suppress(OSError):
                Path(self._listener.getsockname()).unlink()
            self._listener.close()
            self._listener = None
