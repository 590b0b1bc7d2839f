"""A device's serial line: bytes are sent at the baud rate, and a listener at another baud rate receives garbage.

Sans-IO: times are passed in. The queue is the device's transmit buffer.
"""

import math
from collections import deque
from collections.abc import Callable

BITS = 10  # on the wire per byte: start, 8 data, stop
_FIFO = 32  # bytes delivered at once, as from a UART's buffer
_FIFO_S = 4e-3  # the longest time that a byte waits in that buffer


Damage = Callable[[bytes, float], tuple[bytes, float]]


def _undamaged(message: bytes, _t: float) -> tuple[bytes, float]:
    return message, -math.inf


class Uart:
    """One end of a line, 8N1. `baud` may be changed at any time; queued bytes are sent at the old baud rate.

    damage: the arriving bytes of a message sent at time t, and until when it and all later ones are delayed.
    """

    def __init__(self, baud: int) -> None:
        self.baud = baud
        self.damage: Damage = _undamaged
        self._delayed_until = -math.inf  # arrival of messages
        self._free = -math.inf  # when the last queued byte will have been sent
        self._queue: deque[tuple[float, bytes, int]] = deque()  # (complete at, bytes, baud)

    def send(self, data: bytes, t: float) -> None:
        """Queue `data` for transmission from time `t` on, or after what is queued already."""
        size = max(1, min(_FIFO, int(_FIFO_S * self.baud / BITS)))
        self._free = max(t, self._free)
        data, until = self.damage(data, t)
        self._delayed_until = max(until, self._delayed_until)
        for i in range(0, len(data), size):
            chunk = data[i : i + size]
            self._free += len(chunk) * BITS / self.baud
            self._queue.append((max(self._free, self._delayed_until), chunk, self.baud))

    def backlog(self, t: float) -> float:
        """Bytes that have still to leave at time `t`."""
        return max(self._free - t, 0.0) * self.baud / BITS

    def due(self) -> float:
        """When the next bytes will have arrived at the other end; infinite when idle."""
        return self._queue[0][0] if self._queue else math.inf

    def earliest(self, t: float, size: int) -> float:
        """When `size` bytes that are sent at time `t` will have arrived, were nothing else sent before."""
        return max(t, self._free) + size * BITS / self.baud

    def take(self, t: float, listener_baud: int) -> bytes:
        """The bytes that a listener at that baud rate has received since the last call, at time `t`."""
        out = b""
        while self._queue and self._queue[0][0] <= t:
            _, chunk, baud = self._queue.popleft()
            out += chunk if baud == listener_baud else garble(chunk, baud, listener_baud)
        return out

    def receive_from(self, data: bytes, talker_baud: int) -> bytes:
        """The bytes that this end receives of bytes sent at the talker's baud rate."""
        return data if talker_baud == self.baud else garble(data, talker_baud, self.baud)

    def clear(self) -> None:
        """Clear the queue: reset of the device."""
        self._queue.clear()
        self._free = self._delayed_until = -math.inf


def garble(data: bytes, talker_baud: int, listener_baud: int) -> bytes:
    """The bytes that a listener at the wrong baud rate receives, framing errors included.

    It starts at a falling edge and samples the line in the middle of its own bits, as a UART does; a bad stop bit
    delivers the byte all the same, as Linux does without INPCK.
    """
    if talker_baud <= 0 or listener_baud <= 0:
        return b""
    level = [bit for byte in data for bit in (0, *((byte >> i) & 1 for i in range(8)), 1)]
    step = talker_baud / listener_baud  # listener's bit in bits of the talker
    received = bytearray()
    at = 0
    while at < len(level):
        if level[at] or (at and not level[at - 1]):
            at += 1
            continue
        samples = [int(at + (i + 1.5) * step) for i in range(8)]
        received.append(sum(level[s] << i if s < len(level) else 1 << i for i, s in enumerate(samples)))
        at = max(at + 1, math.ceil(at + 9.5 * step))
    return bytes(received)
