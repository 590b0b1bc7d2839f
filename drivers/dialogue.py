"""A dialogue with a device as a generator: it yields exchanges (send, then listen), and is sent the bytes received.

Drivers know their device's dialogue but no port; a transport runs the generator, blocking or inside an event loop.
A dialogue never raises for the device's answers: it returns its result, or `None` when the device did not answer.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import TypeVar

from .spi import Bus, Fetch


@dataclass(frozen=True)
class Exchange:
    """Send, then listen. The transport answers with the bytes received meanwhile.

    baud: change the line's speed first. discard: throw away what is waiting in the input first. listen_s: longest time
    to listen. enough: stop earlier when this is true of the bytes so far. optional: a caller in a hurry may skip this
    exchange, as if no byte had been received. spi: on an SPI line, set the bus up first, or begin to fetch samples;
    there `send` holds 16-bit words, and their answers are received.
    answer_bytes: up to the end of the answer; the detection listens longer by the time that they take at its speed.
    """

    send: bytes = b""
    listen_s: float = 0.0
    enough: Callable[[bytes], bool] | None = None
    baud: int | None = None
    discard: bool = False
    spi: Bus | Fetch | None = None
    optional: bool = False
    answer_bytes: int = 0


Result = TypeVar("Result")
Dialogue = Generator[Exchange, bytes, Result]
