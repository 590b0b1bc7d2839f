"""The server: the topics and schemas are those of a recording, so that a layout made for one shows the other."""

import argparse
import functools
import sys
from collections.abc import Callable, Mapping
from typing import Any

import foxglove
import numpy as np

from ...errors import CannotCreateError
from ...outputs.addresses import Address, is_local, listen
from ...process.signals import caught, endings
from ...recording.enu import LocalMap
from ...recording.foxglove import encoded_location, encoded_transform, location, receiver_location, transform
from ...recording.messages import (
    ESTIMATE_TABLE,
    ESTIMATES,
    FIX_TABLE,
    FIXES,
    LOCATION,
    POSE,
    RECEIVER_LOCATION,
    SCHEMAS,
)
from ...sensors.gnss import position_sigma
from ..live import follow

_BACKLOG = 256  # messages that wait for a slow client; beyond that it loses the oldest


class Channels:
    """The topics of one server. Nothing is made for a topic that nobody watches."""

    def __init__(self) -> None:
        self.context = foxglove.Context()
        self._plane = LocalMap()
        self._channels = {
            topic: foxglove.Channel(
                topic,
                message_encoding=SCHEMAS[topic].encoding,
                schema=foxglove.Schema(
                    name=SCHEMAS[topic].name, encoding=SCHEMAS[topic].schema_encoding, data=SCHEMAS[topic].data
                ),
                context=self.context,
            )
            for topic in (ESTIMATES, LOCATION, POSE, FIXES, RECEIVER_LOCATION)
        }

    def _send(self, topic: str, unix_ns: int, make: Callable[[], bytes | None]) -> None:
        channel = self._channels[topic]
        if channel.has_sinks() and (message := make()) is not None:
            channel.log(message, log_time=unix_ns)

    def on_solution(self, solution: np.void, unix_ns: int) -> None:
        """A row of SOLUTION."""
        if not any(channel.has_sinks() for channel in self._channels.values()):
            return
        rows = np.array([solution])
        (estimate,) = ESTIMATE_TABLE.objects(rows)
        self._send(ESTIMATES, unix_ns, lambda: ESTIMATE_TABLE.encode(rows)[0])
        self._send(LOCATION, unix_ns, lambda: encoded_location(location(estimate, unix_ns)))
        self._send(POSE, unix_ns, lambda: encoded_transform(transform(estimate, unix_ns, self._plane)))

    def on_fix(self, fix: np.void, unix_ns: int, utc_ns: int | None) -> None:
        """A row of FIX."""
        rows = np.array([fix])
        (reported,) = FIX_TABLE.objects(rows)
        self._send(FIXES, unix_ns, lambda: FIX_TABLE.encode(rows)[0])
        place = functools.partial(receiver_location, reported, position_sigma(fix), unix_ns)
        self._send(RECEIVER_LOCATION, unix_ns, lambda: encoded_location(place()))

    def on_status(self, status: Mapping[str, Any], unix_ns: int) -> None:
        """Nothing of it is sent."""


def serve(args: argparse.Namespace, address: Address) -> int:
    """Serve at a TCP address until SIGTERM or SIGINT. Prints the server's URL on stdout. Raises ImudError."""
    assert not isinstance(address.where, str)
    host, port = address.where
    listen(address).close()  # it says who is there already, which the library does not
    channels, ended = Channels(), False

    def end() -> None:
        nonlocal ended
        ended = True

    with caught(dict.fromkeys(endings(), end)) as wake:
        try:
            server = foxglove.start_server(
                name="imud", host=host, port=port, context=channels.context, message_backlog_size=_BACKLOG
            )
        except (RuntimeError, OSError) as error:
            raise CannotCreateError(f"cannot listen on {address.text}: {error}") from error
        if not is_local(address):
            print("imud foxglove: other machines can connect; there is no password", file=sys.stderr)
        try:
            print(f"ws://{host}:{server.port}", flush=True)
            follow("foxglove", args, args.rate, channels, wake)
        finally:
            server.stop()
    return 0
