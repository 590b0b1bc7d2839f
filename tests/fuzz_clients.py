"""What programs beside the daemon read from it, or from another program in its place: live clients, `imud status`;
and what browsers send to `imud web`."""

import asyncio
import importlib
import json
import socket
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np

from imud import client
from imud.commands import status
from imud.commands.foxglove.server import Channels
from imud.commands.live import _Fixes, _States
from imud.errors import ImudError
from imud.outputs.addresses import Address, parse_address
from imud.recording.enu import LocalMap
from imud.ros2.converter import Converter

_ANSWER_S = 5.0


class Foxglove(Channels):
    """The topics as if every one were watched, without a server."""

    def __init__(self) -> None:
        self._plane, self._channels = LocalMap(), {"all": _Watched()}

    def _send(self, topic: str, unix_ns: int, make: Callable[[], bytes | None]) -> None:
        make()


class _Watched:
    def has_sinks(self) -> bool:
        return True


class Ros2:
    """What the node makes of the data."""

    def __init__(self) -> None:
        self._converter, self._node = Converter(), _node()

    def on_solution(self, solution: np.void, unix_ns: int) -> None:
        list(self._converter.of_sample(self._node.sample_of(solution), unix_ns))
        list(self._converter.of_solution(solution, unix_ns))

    def on_fix(self, fix: np.void, unix_ns: int, utc_ns: int | None) -> None:
        list(self._converter.of_fix(fix, unix_ns, utc_ns))

    def on_status(self, status: dict, unix_ns: int) -> None:
        self._converter.sigmas = self._node.sigmas_of(status) or self._converter.sigmas
        self._converter.static(self._node.antenna_of(status), unix_ns)
        list(self._converter.of_diagnoses(self._node.diagnoses_of(status), unix_ns))


@cache
def _node():
    """The node's module, with a stand-in for rclpy while it is imported."""
    sys.path.insert(0, str(Path(__file__).parent / "fake_ros2"))
    try:
        return importlib.import_module("imud.commands.ros2.node")
    finally:
        del sys.path[0]


def live_states(data: bytes) -> None:
    """A record of the stream, as the servers for Foxglove and ROS 2 take it."""
    with suppress(client.ProtocolError):
        state = client.decode(data)
        for listener in (Foxglove(), Ros2()):
            states = _States("/nowhere", 1e9, listener)
            with suppress(ConnectionError):
                states.take(state)
                states.take(state._replace(t_ns=state.t_ns + 1))


def live_fixes(data: bytes) -> None:
    """Lines of the gpsd socket, as the servers for Foxglove and ROS 2 take them."""
    for listener in (Foxglove(), Ros2()):
        states = _States("/nowhere", 10.0, listener)
        reader = _Fixes(parse_address("/nowhere", 2947), states, listener)
        for line in data.splitlines():
            with suppress(ConnectionError):
                reader.take(line)


def answered(data: bytes) -> None:
    """What answers `imud status`, in all its forms."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        theirs.sendall(data)
        theirs.shutdown(socket.SHUT_WR)
        try:
            found = status._answer(ours, Address("x", socket.AF_UNIX, "x"))
        except ImudError:
            return
    for form in ("screen", "json", "prometheus"):
        with suppress(ImudError):
            status.text_of(found, form)


@cache
def _web() -> tuple[tuple[str, int], list[str]]:
    """Address of a page's server in a thread, and what it has logged."""
    from aiohttp import web

    from imud.commands.web.limits import Connections, ErrorLog
    from imud.commands.web.server import application

    started, reports = threading.Event(), []
    found: list[tuple[str, int]] = []

    async def serve() -> None:
        errors = ErrorLog()
        connections = Connections(reports.append)
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: reports.append(str(context)))
        app = application(parse_address("/nowhere", 2947), False, connections)
        runner = web.AppRunner(app, access_log=None, logger=errors.logger(), lingering_time=0.0)
        await runner.setup()
        connections.server = runner.server
        listener = await loop.create_server(connections, "127.0.0.1", 0)
        found.append(listener.sockets[0].getsockname())
        started.set()
        await asyncio.Event().wait()

    threading.Thread(target=lambda: asyncio.run(serve()), daemon=True).start()
    assert started.wait(60.0)
    return found[0], reports


def web_request(data: bytes) -> None:
    """Bytes of a browser: never the answer that something inside failed."""
    address, reports = _web()
    received = b""
    with suppress(ConnectionError), socket.create_connection(address, timeout=_ANSWER_S) as browser:
        browser.sendall(data)
        browser.shutdown(socket.SHUT_WR)
        while more := browser.recv(65536):
            received += more
    assert b"HTTP/1.1 500" not in received, received[:200]
    assert not reports, reports


REQUESTS = (
    b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    b"GET /page/../page/page.js HTTP/1.1\r\nHost: [::1]:80\r\nOrigin: http://[::1]:80\r\nRange: bytes=0-9\r\n\r\n",
    b"GET /live HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n\x81\x86\0\0\0\0record",
    b"POST /metrics HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nhello\r\n0\r\n\r\n",
)
FIXES = (
    json.dumps(
        {"class": "FIX", "t_mono_ns": 10**9, "arrival_mono_ns": 10**9, "lat_deg": 48.0, "lon_deg": 11.0, "quality": 1}
        | {"uSat": 9, "height_m": 500.0, "hdop": 1.0, "sn_m": 1.0, "time": "2026-11-23T01:10:07.000Z"}
    ).encode(),
    b'{"class":"STATUS","filter.estimator":"navigation","filter.sample.rate_radps.x":0.1,"filter.antenna_x_m":1.0,'
    b'"ports.0.path":"/dev/a","ports.0.streaming":false,"ports.0.description":"waits"}',
)
STATES = (client.RECORD.pack(client.MAGIC, client.VERSION, client.RECORD.size, 1, 10**18, 10**9, 135, *[0.5] * 37),)
STATUSES = (b'{"class":"VERSION"}\n', FIXES[1] + b"\n", b'{"class":"ERROR","message":"x"}\n')
