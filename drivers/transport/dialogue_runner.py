"""Runs a dialogue on a port: step by step inside an event loop, or blocking."""

import select
import time
from collections.abc import Callable
from typing import Generic, Protocol, runtime_checkable

from ..dialogue import Dialogue, Exchange, Result
from ..spi import Bus, Fetch

WAIT_S = 0.25  # at most, between two readings of the clock
LONGEST = 1 << 17  # bytes of an exchange, more than the fastest line brings; what floods the line is read, not kept
ALL_JUDGED = 1 << 11  # bytes up to which each reading is judged, whether it is enough; beyond, when an eighth has come


class DialoguePort(Protocol):
    """The interface of a line that a dialogue needs."""

    @property
    def fd(self) -> int:
        """To wait on."""

    def set_baud(self, baud: int) -> None:
        """Change the speed."""

    def discard(self) -> None:
        """Throw away what is waiting."""

    def write(self, data: bytes) -> int:
        """Send; returns how many bytes the line had room for."""

    def read(self) -> bytes:
        """What is waiting, without blocking."""


@runtime_checkable
class SpiTarget(Protocol):
    """The additional interface of an SPI line."""

    def set_spi(self, setup: Bus | Fetch) -> None:
        """Set the bus up, or begin to fetch samples."""


class DialogueRunner(Generic[Result]):
    """One dialogue on one port. The loop waits until `fd` is readable or `deadline_s` has come, and says so.

    Once `finished`, `result` is the dialogue's result. `start` and the `on_` methods raise the port's errors.
    """

    def __init__(
        self, port: DialoguePort, dialogue: Dialogue[Result], now: Callable[[], float] = time.monotonic
    ) -> None:
        self.fd = port.fd
        self.deadline_s = 0.0  # on the clock of `now`
        self.finished = False
        self.result: Result
        self._port = port
        self._dialogue = dialogue
        self._now = now
        self._received = bytearray()
        self._judged = 0  # bytes that were not enough
        self._exchange = Exchange()

    def start(self) -> None:
        """Begin the first exchange."""
        self._advance(None)

    def on_readable(self) -> None:
        """Bytes are waiting."""
        self._received += self._port.read()[: LONGEST - len(self._received)]
        enough, length = self._exchange.enough, len(self._received)
        if enough is None or length - self._judged < (self._judged // 8 if length > ALL_JUDGED else 1):
            return
        self._judged = length
        if enough(bytes(self._received)):
            self._advance(bytes(self._received))

    def on_deadline(self) -> None:
        """The time to listen is over."""
        self._advance(bytes(self._received))

    def _advance(self, received: bytes | None) -> None:
        """Send the received bytes to the dialogue, and begin its next exchange that takes time."""
        try:
            while True:
                exchange = self._dialogue.send(received) if received is not None else next(self._dialogue)
                self._begin(exchange)
                if exchange.listen_s > 0.0:
                    return
                received = b""
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
        self._received.clear()
        self._judged = 0
        self.deadline_s = self._now() + exchange.listen_s


def run_dialogue(port: DialoguePort, dialogue: Dialogue[Result], on_wait: Callable[[], None] = lambda: None) -> Result:
    """Run `dialogue` to its end and return its result; `on_wait` is called before each wait, of a quarter second."""
    runner = DialogueRunner(port, dialogue)
    runner.start()
    poller = select.poll()
    poller.register(runner.fd, select.POLLIN)
    while not runner.finished:
        on_wait()
        left = runner.deadline_s - time.monotonic()
        if poller.poll(min(max(0.0, left), WAIT_S) * 1e3):
            runner.on_readable()
        if not runner.finished and time.monotonic() >= runner.deadline_s:
            runner.on_deadline()
    return runner.result
