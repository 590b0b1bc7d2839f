"""UBX frames: two sync bytes, class, id, length (little endian), payload, Fletcher's checksum of class to payload.

Other protocols may share the line (NMEA sentences, RTCM): what is in no frame is skipped. Sync bytes may be found in
such data by chance. So every pair of sync bytes may begin a frame, and of the frames with a right checksum the one that
ends first is taken: a false sync costs nothing but itself, and decisions depend on bytes, never on where a read ended.
Source: u-blox F9 HPG 1.32 interface description, 3.2 and 3.4.
"""

import struct
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate

SYNC = b"\xb5\x62"
OVERHEAD = 8  # bytes of a frame around its payload
LENGTH_MAX = 8192  # bytes of a payload; the longest are raw measurements of all satellites
CLASSES = frozenset((0x01, 0x02, 0x04, 0x05, 0x06, 0x09, 0x0A, 0x0B, 0x0D, 0x10, 0x13, 0x21, 0x27, 0x28, 0x29, 0x2A))
_HEADER = struct.Struct("<2sBBH")


@dataclass(frozen=True)
class Frame:
    """A frame whose checksum is right."""

    kind: tuple[int, int]  # class and id
    payload: bytes
    arrival_ns: int  # of its first byte


def checksum(data: bytes) -> bytes:
    """Fletcher's, of 8 bits: the sum of the bytes, and the sum of its running values."""
    return bytes((sum(data) & 0xFF, sum(accumulate(data)) & 0xFF))


def frame(kind: tuple[int, int], payload: bytes = b"") -> bytes:
    """The bytes of a frame."""
    body = bytes(kind) + struct.pack("<H", len(payload)) + payload
    return SYNC + body + checksum(body)


class Framer:
    """Bytes to frames. Counts `wrong checksum` and `noise bytes`. Not thread-safe."""

    def __init__(self, counters: Counter[str]) -> None:
        self._counters = counters
        self._buffer = bytearray()
        self._ends: list[int] = []  # where each read ended in the buffer
        self._arrivals: list[int] = []
        self._failed: set[int] = set()  # where frames with a wrong checksum began

    def feed(self, data: bytes, arrival_ns: int) -> Iterator[Frame]:
        """Yield the frames that `data` completes."""
        self._buffer += data
        self._ends.append(len(self._buffer))
        self._arrivals.append(arrival_ns)
        while (found := self._first_to_end()) is not None:
            start, end = found
            payload = bytes(self._buffer[start + OVERHEAD - 2 : end - 2])
            arrival = self._arrivals[bisect_right(self._ends, start)]
            kind = self._buffer[start + 2], self._buffer[start + 3]
            self._drop(end, start)
            yield Frame(kind, payload, arrival)

    def _first_to_end(self) -> tuple[int, int] | None:
        """Start and end of the whole frame that ends first; without one, drop what can belong to none."""
        buffer = self._buffer
        best: tuple[int, int] | None = None
        needed = len(buffer) - (1 if buffer[-1:] == SYNC[:1] else 0)  # from here on, bytes may belong to a frame
        start = buffer.find(SYNC)
        while start >= 0:
            end = self._end(start)
            if end is None or end > len(buffer):
                needed = min(needed, start)
            elif end > 0 and (best is None or end < best[1]) and self._is_whole(start, end):
                best = start, end
            start = buffer.find(SYNC, start + 1)
        if best is None:
            self._drop(needed, needed)
        return best

    def _end(self, start: int) -> int | None:
        """Where a frame that begins there ends; None: its header is not complete; 0: it is no frame."""
        if len(self._buffer) - start < _HEADER.size:
            return None
        _, group, _, length = _HEADER.unpack_from(self._buffer, start)
        return start + length + OVERHEAD if group in CLASSES and length <= LENGTH_MAX else 0

    def _is_whole(self, start: int, end: int) -> bool:
        if start in self._failed:
            return False
        if checksum(bytes(self._buffer[start + 2 : end - 2])) == self._buffer[end - 2 : end]:
            return True
        self._failed.add(start)
        self._counters["wrong checksum"] += 1
        return False

    def _drop(self, end: int, other: int) -> None:
        """Drop the bytes before `end`, of which the first `other` are in no frame."""
        if other:
            self._counters["noise bytes"] += other
        del self._buffer[:end]
        gone = bisect_right(self._ends, end) if self._buffer else len(self._ends)
        self._ends = [at - end for at in self._ends[gone:]]
        del self._arrivals[:gone]
        self._failed = {at - end for at in self._failed if at >= end}
