"""Keeps the daemon's newest messages for the page. Knows gpsd's protocol, and that a daemon comes and goes.

Any number of readers wait for what is newer than they have seen: a slow one misses messages and delays nobody.
"""

import asyncio
import json
import os
from typing import Any, NamedTuple

from ...outputs.addresses import Address
from ..status.notable_states import notable_states

RATE_HZ = 20
_WATCH = {"enable": True, "json": True, "rate": RATE_HZ, "class": "ATT,EST,SKY,TPV"}
_STATES = "states."
_SHOWN = ("ports.", "aiding.sources.", "aiding.refused.", "aiding.last_refused")
_LINE_MAX = 1 << 20  # bytes
_RETRY_S = 1.0
_REQUEST_S = 1.0  # between requests of what the daemon does not send by itself: recordings, status


def _shown(status: dict[str, Any]) -> dict[str, Any]:
    """What the page shows of the flat status: ports, aiding sources, and in words what the filter has found."""
    states = {key.removeprefix(_STATES): value for key, value in status.items() if key.startswith(_STATES)}
    shown = {key: value for key, value in status.items() if key.startswith(_SHOWN)}
    return {"class": "STATUS", "found": notable_states(states), **shown}


class Snapshot(NamedTuple):
    """The newest message of each class as one JSON object, and the number of the snapshot."""

    number: int
    text: str


class NotADaemonError(Exception):
    """The server at the address does not speak gpsd's protocol."""


class Bridge:
    """Keeps a connection to the daemon and its newest messages. Belongs to one event loop."""

    def __init__(self, address: Address) -> None:
        self.address = address
        self._messages: dict[str, Any] = {}
        self._snapshot = Snapshot(0, "")
        self._waiting = asyncio.Event()
        self._writer: asyncio.StreamWriter | None = None  # to the daemon, while there is one
        self._publish("not yet connected")

    async def newer_than(self, number: int) -> Snapshot:
        """The newest snapshot, as soon as its number differs."""
        while self._snapshot.number == number:
            await self._waiting.wait()
        return self._snapshot

    def record(self, enable: bool) -> None:
        """Have the daemon begin or end a recording; the outcome is in the next snapshot."""
        if self._writer is not None:
            self._writer.write(b"?RECORD=" + json.dumps({"enable": enable}).encode() + b"\n")

    async def run(self) -> None:
        """Connect, read, and connect again after an error; never returns."""
        while True:
            try:
                await self._session()
                why = "it ended the connection"
            except OSError as error:
                why = (os.strerror(error.errno) if error.errno else str(error)).lower()  # asyncio's has a tuple in it
            except NotADaemonError as error:
                why = str(error)
            self._messages.clear()
            self._publish(why)
            await asyncio.sleep(_RETRY_S)

    async def _session(self) -> None:
        where = self.address.where
        opened = asyncio.open_unix_connection(where) if isinstance(where, str) else asyncio.open_connection(*where)
        reader, writer = await opened
        requests = asyncio.create_task(self._send_requests(writer))
        self._writer = writer
        try:
            await self._read(reader)
        finally:
            self._writer = None
            requests.cancel()
            writer.close()

    async def _send_requests(self, writer: asyncio.StreamWriter) -> None:
        writer.write(b"?WATCH=" + json.dumps(_WATCH).encode() + b"\n")
        while True:
            writer.write(b"?RECORD\n?STATUS\n")
            await asyncio.sleep(_REQUEST_S)

    async def _read(self, reader: asyncio.StreamReader) -> None:
        rest = b""
        while data := await reader.read(65536):
            *lines, rest = (rest + data).split(b"\n")
            if len(rest) > _LINE_MAX:
                raise NotADaemonError("it does not send gpsd's protocol")
            for line in lines:
                self._store(line)
            if lines:
                self._publish(None)

    def _store(self, line: bytes) -> None:
        try:
            message = json.loads(line)
            if message["class"] == "STATUS":  # most of it is for `imud status`
                message = _shown(message)
            self._messages[message["class"]] = message
        except (ValueError, TypeError, KeyError, RecursionError):
            raise NotADaemonError("it does not send gpsd's protocol") from None

    def _publish(self, why: str | None) -> None:
        """Publish a snapshot to all readers. why: the reason that there is no connection; None: there is one."""
        known = {"daemon": self.address.text, "connected": why is None, "why": why, **self._messages}
        self._snapshot = Snapshot(self._snapshot.number + 1, json.dumps(known))
        self._waiting.set()
        self._waiting = asyncio.Event()
