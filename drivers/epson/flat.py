"""Automatic frames of the flat dialect, which have no checksum: bytes to samples.

    0     1-2   3-4   5-10        11-16        17-18  [19-20]  last
    0x20  FLAG  TEMP  GYRO x y z  ACCL x y z   GPIO   COUNT    0x0D       words big endian; 20 bytes, or 22 with COUNT

A frame has header and CR at its ends, and the bits that stay constant (reserved bits of FLAG, GPIO) as they were
before. Two neighbours that agree with each other begin the lock on a stream, and renew it when those bits have changed.
Bytes that are not a frame are skipped one at a time, so that a good frame inside a bad one is found; a frame is
delivered as soon as its last byte has arrived. If no frame follows it directly, it may consist of parts of two frames
with lost bytes between them: it has been delivered, but is searched again for a frame inside. `counting.py` turns COUNT
into ticks, `drivers/spikes.py` tests the values.

Every decision is a function of the bytes alone, never of the chunks in which they came.
"""

from typing import Any

from ..jit import kernel
from ..spikes import count_frame
from ..words import Bytes, byte, move_to_front, signed, word
from .counting import ticks_since
from .dialects import FLAT
from .registers import CR
from .state import deliver, is_repeated

HEADER = FLAT.header
LONG, SHORT = FLAT.layouts[0].length, FLAT.layouts[1].length
CONSTANT = 0x01FE_FFFF  # FLAG bits 8 to 1 and the GPIO word, as `constants` packs them
FORGET = 1000  # junk bytes after which the other frame length is tried as well
TEMP, GYRO, GPIO, COUNT = 3, 5, 17, 19  # offsets in the frame

WAIT, BAD, GOOD, LOCK = range(4)


@kernel
def constants(rx: Bytes, p: int) -> int:
    """FLAG and GPIO of the frame at p."""
    return (word(rx, p + 1) << 16) | word(rx, p + GPIO)


@kernel
def is_framed(rx: Bytes, p: int, length: int) -> bool:
    """Whether header and CR are at the ends."""
    return bool(byte(rx, p) == HEADER and byte(rx, p + length - 1) == CR)


@kernel
def is_pair(rx: Bytes, p: int, length: int) -> bool:
    """Whether the bytes before p and those from p on are two frames that agree with each other."""
    return (
        is_framed(rx, p, length)
        and is_framed(rx, p - length, length)
        and (constants(rx, p) ^ constants(rx, p - length)) & CONSTANT == 0
    )


@kernel
def lock(s: Any, seen: int, length: int) -> None:
    """Begin or renew the lock; bits that have changed since the last lock are no longer compared."""
    if s.locked:
        s.mask &= ~(s.constants ^ seen)
    s.constants, s.length, s.locked = seen, length, 1


@kernel
def classify(s: Any, rx: Bytes, p: int, fill: int) -> int:
    """What begins at p: GOOD, a frame; LOCK, the second of two; BAD, no frame; WAIT: more bytes are needed."""
    if byte(rx, p) != HEADER:
        return BAD
    length = s.length
    if p + length > fill:
        return WAIT
    if s.locked and is_framed(rx, p, length) and (constants(rx, p) ^ s.constants) & s.mask == 0:
        return GOOD
    if s.gap >= length and is_pair(rx, p, length):
        lock(s, constants(rx, p), length)
        return LOCK
    if s.locked and s.gap < FORGET:
        return BAD
    other = SHORT + LONG - length
    if p + other > fill:
        return WAIT
    if s.gap >= other and is_pair(rx, p, other):
        lock(s, constants(rx, p), other)
        return LOCK
    return BAD


@kernel
def skip(s: Any, p: int) -> int:
    """Skip a byte at which no frame begins, or go back into the unconfirmed frame before; returns the next position."""
    if s.unconfirmed:
        s.unconfirmed = 0
        s.covered = s.length - 1
        s.bad += 1
        return p - int(s.length) + 1
    if s.covered > 0:
        s.covered -= 1
    else:
        s.junk += 1
        s.gap += 1
    return p + 1


@kernel
def emit(s: Any, rx: Bytes, p: int, sample: Any) -> int:
    """The frame at p as a sample; returns how many that are."""
    missing = (s.gap + s.length // 2) // s.length if s.gap > 0 else 0
    count = word(rx, p + COUNT) if s.length == LONG else -1
    count_frame(s.spikes, s.gap > 0 and s.frames > 0)
    s.unconfirmed, s.covered, s.gap = 1, 0, 0
    if is_repeated(s, word(rx, p + 1), count):
        return 0
    advance = ticks_since(s.counting, count, missing, s.frames == 0, False)
    if s.frames > 0:
        s.lost += advance - 1
    s.tick += advance
    for i in range(6):
        s.spikes.raw[i] = signed(rx, p + GYRO + 2 * i)
    deliver(s, word(rx, p + 1), signed(rx, p + TEMP), advance, sample)
    return 1


@kernel
def decode_flat(rx: Bytes, fill: int, s: Any, samples: Any) -> int:
    """The frames of rx[:fill] into `samples`, as `ImuDriver.decode` does it; s is a record of STATE."""
    p, n = s.scanned, 0
    while n < len(samples) and p < fill:
        found = classify(s, rx, p, fill)
        if found == WAIT:
            break
        if found == BAD:
            p = skip(s, p)
        elif found == GOOD:
            n += emit(s, rx, p, samples[n])
            p += s.length
        else:  # the frame at p is classified again, now as GOOD
            s.gap -= s.length
            s.junk -= s.length
            n += emit(s, rx, p - s.length, samples[n])
    start = max(p - LONG, 0)
    s.leftover, s.scanned = fill - start, p - start
    move_to_front(rx, start, s.leftover)
    return n
