"""RTCM 3 frames, with which a base station's data come: 0xD3, six zero bits, ten bits of length, payload, CRC-24Q.

Source: RTCM 10403.3, 4; the CRC is Qualcomm's, polynomial 0x1864CFB.
"""

from collections import Counter
from collections.abc import Iterator

PREAMBLE = 0xD3
OVERHEAD = 6  # bytes of a frame around its payload
_POLYNOMIAL = 0x1864CFB


def _entry(byte: int) -> int:
    crc = byte << 16
    for _ in range(8):
        crc = crc << 1 ^ (_POLYNOMIAL if crc & 0x800000 else 0)
    return crc & 0xFFFFFF


_TABLE = [_entry(byte) for byte in range(256)]


def crc24q(data: bytes) -> int:
    """The remainder; 0 of a whole frame with its CRC."""
    crc = 0
    for byte in data:
        crc = crc << 8 & 0xFFFFFF ^ _TABLE[crc >> 16 ^ byte]
    return crc


class RtcmFramer:
    """Bytes to whole frames. Counts `noise bytes`. Any chunking gives the same frames. Not thread-safe."""

    def __init__(self, counters: Counter[str]) -> None:
        self._counters = counters
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield the frames that `data` completes, as they are."""
        self._buffer += data
        while True:
            start = self._buffer.find(PREAMBLE)
            self._skip(len(self._buffer) if start < 0 else start)
            if len(self._buffer) < OVERHEAD // 2:
                return
            length = int.from_bytes(self._buffer[1:3], "big")
            end = length + OVERHEAD
            if length >> 10:
                self._skip(1)
            elif len(self._buffer) < end:
                return
            elif crc24q(bytes(self._buffer[:end])):
                self._skip(1)
            else:
                frame = bytes(self._buffer[:end])
                del self._buffer[:end]
                yield frame

    def _skip(self, n: int) -> None:
        if n:
            self._counters["noise bytes"] += n
            del self._buffer[:n]
