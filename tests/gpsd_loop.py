"""The daemon's loop around a gpsd server, turned by hand on a clock of its own, and clients over real sockets."""

import contextlib
import json
import select
import socket

from gpsd_synthetic import view
from hypothesis import strategies as st

from imud.configuration.settings import Gpsd
from imud.outputs.gpsd import GpsdServer

MS, SECOND = 1_000_000, 1_000_000_000
WATCH = b'?WATCH={"enable":true,"json":true};\n'


pieces = st.sampled_from(
    [b"?WATCH=", b'{"enable":', b"true", b"}", b";", b"\r\n", b"\n", b"?POLL", b"?", b"=", b"{", b"\xff"]
)
noise = st.lists(pieces | st.binary(max_size=8), max_size=40).map(b"".join)


class Loop:
    """The daemon's loop around a server, turned by hand."""

    def __init__(self, queries=None, commands=None, **changes) -> None:
        self.poller = select.poll()
        self.server = GpsdServer(Gpsd(**{"listen": "127.0.0.1:0"} | changes), self.poller, queries, commands)
        self.now, self.seq = 10 * SECOND, 0
        self.sockets = []

    def turn(self, until_quiet: bool = True, step: int = MS) -> int:
        """Wake up for what poll reports, time going on by `step`; returns the number of wake-ups."""
        for count in range(100_000):
            events = self.poller.poll(0)
            if not events:
                return count
            self.now += step
            for fd, mask in events:
                self.server.on_event(fd, mask, self.now)
            if not until_quiet:
                return 1
        raise AssertionError("never quiet")

    def publish(self, advance: int = 0, **changes) -> None:
        self.now += advance
        self.seq += 1
        self.server.publish(view(self.now / SECOND, self.now / SECOND, self.seq)._replace(**changes), self.now)

    def connect(self, *requests: bytes, buffer: int | None = None) -> "Client":
        """A client that has sent requests; `buffer` bounds what the kernel holds for it in bytes."""
        host, _, port = self.server.addresses[0].rpartition(":")
        sock = socket.socket()
        if buffer is not None:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        sock.connect((host, int(port)))
        client = Client(sock)
        self.sockets.append(sock)
        self.turn()
        for request in requests:
            client.send(request)
            self.turn()
        return client

    def close(self) -> None:
        for sock in self.sockets:
            sock.close()
        self.server.close()


class Client:
    """The other end: what it receives, as objects; every line has to be whole."""

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self.rest = b""

    def send(self, data: bytes) -> None:
        self.sock.sendall(data)

    def receive(self) -> list[dict]:
        """Everything that has come so far, without waiting."""
        with contextlib.suppress(BlockingIOError, ConnectionResetError):
            while data := self.sock.recv(1 << 20, socket.MSG_DONTWAIT):
                self.rest += data
        *lines, self.rest = self.rest.split(b"\r\n")
        return [json.loads(text) for text in lines]

    def classes(self) -> list[str]:
        return [message["class"] for message in self.receive()]

    def closed(self) -> bool:
        try:
            return self.sock.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) == b""
        except BlockingIOError:
            return False
        except ConnectionResetError:
            return True
