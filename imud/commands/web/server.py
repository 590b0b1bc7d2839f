"""The page's web server: files of the page, plotly from its own package, and the daemon's messages over a WebSocket.

Any page in the user's browser can reach a server on loopback. So only pages served by this server may read the
messages: a request from another site's page, or under a name that is not this machine's, is rejected.
"""

import asyncio
import contextlib
import gzip
import ipaddress
import json
import re
import signal
import socket
import sys
from collections.abc import AsyncIterator, Iterable
from pathlib import Path

from aiohttp import web
from aiohttp.typedefs import Handler

from ... import figures
from ...errors import ImudError
from ...outputs.addresses import Address, address_text, is_local, listen
from ..status import ask
from ..status.metrics import CONTENT_TYPE, prometheus
from .bridge import Bridge
from .limits import KEEP_ALIVE_S, Connections, ErrorLog

_FILES = Path(__file__).parent / "page"
_POLICY = "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; frame-ancestors 'none'"
_SHUTDOWN_S = 0.2  # for what is being sent; the pages connect again by themselves
_CONTROL = web.AppKey("control", bool)
_COMMANDS = {"record": True, "stop": False}
_BRIDGE: web.AppKey[Bridge] = web.AppKey("bridge", Bridge)
_STATUS_LOCK: web.AppKey[asyncio.Lock] = web.AppKey("status_lock", asyncio.Lock)
_CONNECTIONS: web.AppKey[Connections] = web.AppKey("connections", Connections)
_PATH_MAX = 100  # characters: a file name that is too long for the system is an error there
_HOST = re.compile(r"(?:\[(?P<v6>[0-9A-Fa-f:.]+)\]|(?P<name>[A-Za-z0-9._-]+))(?::[0-9]{1,5})?")


def is_own_name(host: str) -> bool:
    """Whether a browser that says `Host: host` means this machine: an address, or a name that it has."""
    parts = _HOST.fullmatch(host)
    if parts is None:
        return False
    name = (parts["v6"] or parts["name"]).lower()
    own = socket.gethostname().lower()
    try:
        return bool(ipaddress.ip_address(name))
    except ValueError:
        return parts["v6"] is None and name in ("localhost", own, f"{own.partition('.')[0]}.local")


def is_own_origin(origin: str | None, host: str) -> bool:
    """Whether the request's page was served under `host`. origin: of the page; None: there is no page."""
    return origin is None or origin.lower() in (f"http://{host.lower()}", f"https://{host.lower()}")


def is_plain(path: str, headers: Iterable[str]) -> bool:
    """Whether they can be of a page that this server has made: ASCII, without control characters, not long."""
    return (
        path.isascii() and path.isprintable() and len(path) <= _PATH_MAX and all(value.isascii() for value in headers)
    )


@web.middleware
async def _reject_foreign_requests(request: web.Request, handler: Handler) -> web.StreamResponse:
    request.app[_CONNECTIONS].has_request(request.protocol)
    if not is_plain(request.path, request.headers.values()):
        raise web.HTTPBadRequest(text="this server has no such page\n")
    host = request.headers.get("Host", "")
    if not is_own_name(host) or not is_own_origin(request.headers.get("Origin"), host):
        raise web.HTTPForbidden(text="open the page by this machine's address or name\n")
    response: web.StreamResponse = await handler(request)
    return response


async def _secure(_: web.Request, response: web.StreamResponse) -> None:
    response.headers["Content-Security-Policy"] = _POLICY
    response.headers.setdefault("Cache-Control", "no-cache")


async def _page(_: web.Request) -> web.FileResponse:
    return web.FileResponse(_FILES / "index.html")


async def _metrics(request: web.Request) -> web.Response:
    """The daemon's status for Prometheus. One request at a time: each is a connection to the daemon."""
    async with request.app[_STATUS_LOCK]:
        try:
            status = await asyncio.to_thread(ask, request.app[_BRIDGE].address)
        except ImudError as error:
            raise web.HTTPServiceUnavailable(text=f"{error}\n") from error
    return web.Response(body=prometheus(status).encode(), headers={"Content-Type": CONTENT_TYPE})


async def _live(request: web.Request) -> web.WebSocketResponse:
    channel = web.WebSocketResponse(heartbeat=10.0, max_msg_size=1024)
    await channel.prepare(request)
    bridge, control = request.app[_BRIDGE], request.app[_CONTROL] or _is_on_this_machine(request)
    await channel.send_str(json.dumps({"control": control}))
    sender = asyncio.create_task(_send(channel, bridge))
    try:
        async for message in channel:
            if control and message.data in _COMMANDS:
                bridge.record(_COMMANDS[message.data])
    finally:
        sender.cancel()
    return channel


def _is_on_this_machine(request: web.Request) -> bool:
    """Whether the browser is on this machine."""
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(request.remote or "").is_loopback
    return False


async def _send(channel: web.WebSocketResponse, bridge: Bridge) -> None:
    number = 0
    with contextlib.suppress(ConnectionError):
        while True:
            number, text = await bridge.newer_than(number)
            await channel.send_str(text)  # waits for a slow reader, who then gets the newest


async def _connected(app: web.Application) -> AsyncIterator[None]:
    """While the server runs, the bridge does."""
    running = asyncio.create_task(app[_BRIDGE].run())
    yield
    running.cancel()


def application(daemon: Address, control: bool, connections: Connections) -> web.Application:
    """The server for one daemon; to be started in the event loop that calls this. control: see `serve`."""
    app = web.Application(middlewares=[_reject_foreign_requests])
    app[_BRIDGE], app[_CONTROL], app[_CONNECTIONS] = Bridge(daemon), control, connections
    app[_STATUS_LOCK] = asyncio.Lock()
    plotly = gzip.compress(figures.plotly_js(), 6)

    async def plotly_js(_: web.Request) -> web.Response:
        headers = {"Content-Encoding": "gzip", "Cache-Control": "max-age=86400"}
        return web.Response(body=plotly, content_type="text/javascript", charset="utf-8", headers=headers)

    app.router.add_get("/", _page)
    app.router.add_get("/live", _live)
    app.router.add_get("/metrics", _metrics)
    app.router.add_get("/plotly.js", plotly_js)
    app.router.add_static("/page", _FILES)
    app.on_response_prepare.append(_secure)
    app.cleanup_ctx.append(_connected)
    return app


async def _serve(daemon: Address, listening: socket.socket, control: bool) -> None:
    ended, errors = asyncio.Event(), ErrorLog()
    loop = asyncio.get_running_loop()
    loop.add_signal_handler(signal.SIGTERM, ended.set)
    loop.set_exception_handler(errors.on_loop_exception)
    connections = Connections(errors.report)
    runner = web.AppRunner(
        application(daemon, control, connections),
        access_log=None,
        shutdown_timeout=_SHUTDOWN_S,
        logger=errors.logger(),
        keepalive_timeout=KEEP_ALIVE_S,
        lingering_time=_SHUTDOWN_S,
    )
    await runner.setup()
    connections.server = runner.server
    listener = await loop.create_server(connections, sock=listening)
    try:
        print(f"http://{address_text(listening)}/", flush=True)
        await ended.wait()
    finally:
        listener.close()
        await runner.cleanup()


def serve(daemon: Address, page: Address, control: bool) -> int:
    """Serve until SIGTERM. Prints the page's address on stdout. Raises what `listen` raises.

    control: browsers on other machines, too, may begin and end recordings.
    """
    with listen(page) as listening:
        if not is_local(page):
            print("imud web: other machines can see the page; there is no password", file=sys.stderr)
        asyncio.run(_serve(daemon, listening, control))
    return 0
