"""Automatic frames of the windowed dialect: bytes to samples.

          0     1-2   TEMP  GYRO x y z  ACCL x y z  COUNT  CHECKSUM  last
    16    0x80  FLAG  3-4   5-10        11-16       17-18  19-20     0x0D
    32    0x80  FLAG  3-6   7-18        19-30       31-32  33-34     0x0D       bits of the sensors' words; big endian

This is what the driver sets up. A stream that another host set up may have GPIO before COUNT, or neither of the two.

A frame is good when header and CR are at its ends and the checksum fits: the sum of the 16-bit words between header and
checksum. Any other byte is skipped, so that no good frame after or inside a damaged one is lost. Two flipped
bits can cancel in the sum, high bits too, so the values are tested as well (`drivers/spikes.py`).
"""

from typing import Any

from ..jit import kernel
from ..words import Bytes, byte, move_to_front, signed, word
from .counting import ticks_since
from .dialects import WINDOWED
from .registers import CR
from .state import deliver, is_repeated

HEADER = WINDOWED.header
READABLE = {20: 2, 22: 2, 24: 2, 34: 4, 36: 4, 38: 4}  # length of a frame: size of its words; with 0 to 2 more words
NUMBERED = (22, 24, 36, 38)  # may have a COUNT
FLAG, TEMP = 1, 3  # offsets in the frame; those of COUNT and CHECKSUM count from its end
COUNT, CHECKSUM = 5, 3


@kernel
def is_good(rx: Bytes, p: int, length: int) -> bool:
    """Whether a frame of `length` is at p and undamaged."""
    if byte(rx, p) != HEADER or byte(rx, p + length - 1) != CR:
        return False
    total = 0
    for i in range(p + FLAG, p + length - CHECKSUM, 2):
        total += word(rx, i)
    return total & 0xFFFF == word(rx, p + length - CHECKSUM)


@kernel
def number(rx: Bytes, i: int, size: int) -> int:
    """Two's complement value of `size` bytes, 2 or 4, at i."""
    return signed(rx, i) if size == 2 else signed(rx, i) * 65536 + word(rx, i + 2)


@kernel
def emit(s: Any, rx: Bytes, p: int, sample: Any) -> int:
    """The frame at p as a sample; returns how many that are."""
    missing = (s.gap + s.length // 2) // s.length if s.gap > 0 else 0
    count = word(rx, p + s.length - COUNT) if s.numbered else -1
    s.gap = 0
    if is_repeated(s, word(rx, p + FLAG), count):
        return 0
    advance = ticks_since(s.counting, count, missing, s.frames == 0, True)
    if s.frames > 0:
        s.lost += advance - 1
    s.tick += advance
    for i in range(6):
        s.spikes.raw[i] = number(rx, p + TEMP + (i + 1) * s.size, s.size)
    deliver(s, word(rx, p + FLAG), number(rx, p + TEMP, s.size), advance, sample)
    return 1


@kernel
def decode_windowed(rx: Bytes, fill: int, s: Any, samples: Any) -> int:
    """The frames of rx[:fill] into `samples`, as `ImuDriver.decode` does it; s is a record of STATE."""
    p, n = 0, 0
    while n < len(samples) and p < fill:
        if byte(rx, p) == HEADER:
            if p + s.length > fill:
                break
            if is_good(rx, p, s.length):
                n += emit(s, rx, p, samples[n])
                p += s.length
                continue
        if s.gap == 0 and s.frames > 0:
            s.bad += 1
        s.junk += 1
        s.gap += 1
        p += 1
    s.leftover = fill - p
    move_to_front(rx, p, s.leftover)
    return n
