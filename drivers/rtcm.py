"""RTCM 3 frames, with which a base station's data come: 0xD3, six zero bits, ten bits of length, payload, CRC-24Q.

Data that are no frames may hold a preamble in every second byte, and each may begin a frame of 1029 bytes. So no
checksum is computed for each of them, but one running sum over all bytes: the polynomial of the bits so far, modulo the
CRC's. Bytes with their right checksum are a multiple of that polynomial, so the sum is the same before and after them.
Source: RTCM 10403.3, 4; the CRC is Qualcomm's, polynomial 0x1864CFB.
"""

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

PREAMBLE = 0xD3
OVERHEAD = 6  # bytes of a frame around its payload
_HEAD = 3  # bytes of preamble and length
_LONGEST = 1023 + OVERHEAD
_AT_ONCE = 1024  # bytes taken up together
_POLYNOMIAL = 0x1864CFB


def _powers() -> Any:
    """Powers of x modulo the polynomial, one for each bit of the longest buffer, the highest first."""
    found = [1]
    for _ in range(8 * (_LONGEST + _AT_ONCE) - 1):
        power = found[-1] << 1
        found.append(power ^ _POLYNOMIAL if power >> 24 else power)
    return np.array(found[::-1], np.uint32)


_POWERS = _powers()


class RtcmFramer:
    """Bytes to whole frames. Counts `noise bytes`. Any chunking gives the same frames. Not thread-safe."""

    def __init__(self, counters: Counter[str]) -> None:
        self._counters = counters
        self._buffer = b""

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield the frames that `data` completes, as they are."""
        for at in range(0, len(data), _AT_ONCE):
            self._buffer += data[at : at + _AT_ONCE]
            yield from self._frames()

    def _frames(self) -> Iterator[bytes]:
        """Take the frames out of the buffer, and all before the first one that may be complete later."""
        buffer, at = self._buffer, 0
        sums = _running_sums(buffer)
        while (start := buffer.find(PREAMBLE, at)) >= 0:
            self._counters["noise bytes"] += start - at
            at = start
            length = int.from_bytes(buffer[start + 1 : start + _HEAD], "big")
            end = start + length + OVERHEAD
            if start + _HEAD > len(buffer) or (length < 1024 and end > len(buffer)):
                break
            if length < 1024 and sums[start] == sums[end]:
                yield buffer[start:end]
                at = end
            else:
                self._counters["noise bytes"] += 1
                at = start + 1
        else:
            self._counters["noise bytes"] += len(buffer) - at
            at = len(buffer)
        self._buffer = buffer[at:]


def _running_sums(data: bytes) -> list[int]:
    """Of the bits before each byte, and of all."""
    bits = np.unpackbits(np.frombuffer(data, np.uint8))
    return [0, *np.bitwise_xor.accumulate(bits * _POWERS[: len(bits)])[7::8].tolist()]
