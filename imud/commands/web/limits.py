"""Bounds on what clients can make the page's server do: connections, time for a request's header, lines on stderr.

A connection beyond the limit is closed as it is accepted, so that descriptors remain for files, pages that are open and
the daemon. Of each kind of error one line (of a defect one traceback) is printed, however often it occurs.
"""

import asyncio
import logging
import resource
import sys
import traceback
from collections.abc import Callable
from typing import Any

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

HEADER_S = 10.0  # from the connection to the whole header of its first request
KEEP_ALIVE_S = 15.0  # between requests
_CONNECTIONS_MAX = 500
_OWN_DESCRIPTORS = 48  # the loop, the listener, the daemon, the standard streams, files being read
_KINDS_MAX = 100
_START_S = 0.1  # until the server lists a new connection


def connections_max() -> int:
    """The number that the descriptor limit allows: each connection may have a file of the page open as well."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return max(4, min(_CONNECTIONS_MAX, (soft - _OWN_DESCRIPTORS) // 2))


class _Rejected(asyncio.Protocol):
    """A connection beyond the limit."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        transport.abort()


class Connections:
    """Makes the protocol of each new connection. Belongs to one event loop."""

    server: web.Server | None = None  # set before the first connection

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report = report
        self._connections_max = connections_max()
        self._starting: set[Any] = set()  # protocols that the server may not list yet: connections come in bursts
        self._waiting: set[Any] = set()  # protocols whose first request has not come yet

    def has_request(self, protocol: Any) -> None:
        """The header of a request has come on this connection."""
        self._waiting.discard(protocol)

    def __call__(self) -> asyncio.BaseProtocol:
        """For `loop.create_server`."""
        assert self.server is not None
        if len(self._starting.union(self.server.connections)) >= self._connections_max:
            self._report(f"more than {self._connections_max} connections: the newest are closed")
            return _Rejected()
        protocol = self.server()
        loop = asyncio.get_running_loop()
        self._starting.add(protocol)
        loop.call_later(_START_S, self._starting.discard, protocol)
        self._waiting.add(protocol)
        loop.call_later(HEADER_S, self._end_without_request, protocol)
        return protocol

    def _end_without_request(self, protocol: Any) -> None:
        if protocol in self._waiting:
            self._waiting.remove(protocol)
            if protocol.transport is not None:
                protocol.transport.abort()


class ErrorLog(logging.Handler):
    """Prints each kind of error once."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._printed: set[tuple[str, str]] = set()

    def logger(self) -> logging.Logger:
        """A logger of its own, for aiohttp."""
        logger = logging.Logger("imud web")
        logger.addHandler(self)
        return logger

    def emit(self, record: logging.LogRecord) -> None:
        """A line of aiohttp's log."""
        error = record.exc_info[1] if record.exc_info else None
        self.report(record.getMessage(), error, kind=str(record.msg))

    def on_loop_exception(self, _: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """For `loop.set_exception_handler`."""
        self.report(context["message"], context.get("exception"))

    def report(self, text: str, error: BaseException | None = None, kind: str = "") -> None:
        """Print it, unless one of its kind was printed before. A client's mistake and a lack of descriptors are a line,
        anything else is a defect, with its traceback.
        """
        seen = kind or text, type(error).__name__
        if seen in self._printed or len(self._printed) >= _KINDS_MAX:
            return
        self._printed.add(seen)
        why = f": {' '.join(str(error).split())[:200]}" if error is not None else ""
        print(f"imud web: {text}{why} (printed once)", file=sys.stderr, flush=True)
        if error is not None and not isinstance(error, HttpProcessingError | web.RequestPayloadError | OSError):
            traceback.print_exception(error)
