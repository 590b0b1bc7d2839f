"""Runs a dialogue on a port: step by step inside an event loop, or blocking."""

import select
import time
from collections.abc import Callable
from typing import Generic, Protocol, runtime_checkable

from ..dialogue import Dialogue, Exchange, Result
from ..spi import Bus, Fetch

WAIT_S = 0.25  # at most, between two looks at the clock


class Port(Protocol):
    """What a dialogue needs of a line."""

    @property
    def fd(self) -> int:
        """To wait on."""

    def set_baud(self, baud: int) -> None:
        """Change the speed."""

    def discard(self) -> None:
        """Throw away what is waiting."""

    def write(self, data: bytes) -> None:
        """Send."""

    def read(self) -> bytes:
        """What is waiting, without blocking."""


@runtime_checkable
class SpiTarget(Protocol):
    """What it needs in addition of an SPI line."""

    def set_spi(self, setup: Bus | Fetch) -> None:
        """Set the bus up, or begin to fetch samples."""


class Conversation(Generic[Result]):
    """One dialogue on one port. The loop waits until `fd` is readable or `deadline_s` has come, and says so.

    Once `finished`, `result` is the dialogue's finding. Errors of the port come out of `start` and the `on_` methods.
    """

    def __init__(self, port: Port, dialogue: Dialogue[Result], now: Callable[[], float] = time.monotonic) -> None:
        self.fd = port.fd
        self.deadline_s = 0.0  # on the clock of `now`
        self.finished = False
        self.result: Result
        self._port = port
        self._dialogue = dialogue
        self._now = now
        self._heard = bytearray()
        self._exchange = Exchange()

    def start(self) -> None:
        """Begin the first exchange."""
        self._advance(None)

    def on_readable(self) -> None:
        """Bytes are waiting."""
        self._heard += self._port.read()
        enough = self._exchange.enough
        if enough is not None and enough(bytes(self._heard)):
            self._advance(bytes(self._heard))

    def on_deadline(self) -> None:
        """The time to listen is over."""
        self._advance(bytes(self._heard))

    def _advance(self, heard: bytes | None) -> None:
        """Hand the dialogue what was heard and begin the next exchange that takes time."""
        try:
            while True:
                exchange = self._dialogue.send(heard) if heard is not None else next(self._dialogue)
                self._begin(exchange)
                if exchange.listen_s > 0.0:
                    return
                heard = b""
        except StopIteration as finding:
            self.result, self.finished = finding.value, True

    def _begin(self, exchange: Exchange) -> None:
        if exchange.baud is not None:
            self._port.set_baud(exchange.baud)
        if exchange.spi is not None and isinstance(self._port, SpiTarget):
            self._port.set_spi(exchange.spi)
        if exchange.discard:
            self._port.discard()
        if exchange.send:
            self._port.write(exchange.send)
        self._exchange = exchange
        self._heard.clear()
        self.deadline_s = self._now() + exchange.listen_s


def run_dialogue(port: Port, dialogue: Dialogue[Result], on_wait: Callable[[], None] = lambda: None) -> Result:
    """Run `dialogue` to its end and return its finding; `on_wait` is called before each wait, of a quarter second."""
    conversation = Conversation(port, dialogue)
    conversation.start()
    poller = select.poll()
    poller.register(conversation.fd, select.POLLIN)
    while not conversation.finished:
        on_wait()
        left = conversation.deadline_s - time.monotonic()
        if poller.poll(min(max(0.0, left), WAIT_S) * 1e3):
            conversation.on_readable()
        if not conversation.finished and time.monotonic() >= conversation.deadline_s:
            conversation.on_deadline()
    return conversation.result
