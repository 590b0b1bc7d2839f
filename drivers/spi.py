"""The properties of a device on SPI that its port needs: the bus setup, and how a sample is fetched. Values only."""

from collections.abc import Callable
from dataclasses import dataclass

WORD_BITS = 16


@dataclass(frozen=True)
class Bus:
    """How words are exchanged, until another `Bus` is set."""

    mode: int  # clock polarity and phase, 0 to 3
    clock_hz: int
    stall_us: int  # least pause after every word


@dataclass(frozen=True)
class Cycle:
    """One 16-bit word on the bus, a transfer of its own, and the least pause after it."""

    word: bytes
    stall_us: int


@dataclass(frozen=True)
class Fetch:
    """How one sample is fetched. From the moment a port is given this, it fetches a sample whenever one is due.

    `frame` turns the answers to `cycles`, two bytes each, into bytes for `ImuDriver.decode`; into none if the answers
    do not belong to one sample.
    """

    clock_hz: int
    cycles: tuple[Cycle, ...]
    gate: int  # index of the cycle whose answer shows whether there is a new sample; if not, the rest are left out
    is_new: Callable[[bytes], bool]  # of that answer
    capture: int  # index of the cycle at which the device latches the sample
    frame: Callable[[bytes], bytes]
    period_ns: int  # between samples, nominal

    def bus_ns(self) -> int:
        """Time of the cycles on the bus."""
        wire_ns = WORD_BITS * 1_000_000_000 // self.clock_hz
        return sum(wire_ns + 1000 * cycle.stall_us for cycle in self.cycles)
