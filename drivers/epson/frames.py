"""Automatic frames of the flat dialect: bytes to samples, without a checksum to lean on.

    0     1-2   3-4   5-10        11-16        17-18  [19-20]  last
    0x20  FLAG  TEMP  GYRO x y z  ACCL x y z   GPIO   COUNT    0x0D       words big endian; 20 bytes, or 22 with COUNT

A frame has header and CR at its ends, and the bits that do not change (reserved bits of FLAG, GPIO) as they were. Two
neighbours that agree with each other begin the lock, and renew it when those bits have changed. Whatever is not a
frame is left by one byte only, so that a good frame inside a bad one is found, and is delivered with its last byte. A
frame that its successor does not confirm may have been put together by a loss of bytes: it has been delivered, but is
searched again for the frame it may hide. `counting.py` turns COUNT into ticks, `drivers/spikes.py` judges the values.

Every decision is a function of the bytes alone, never of the chunks in which they came.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..jit import kernel
from ..sample import DEVICE_ERROR, SATURATED, SUSPECT
from ..spikes import SPIKES, is_spike
from ..words import signed, word
from .counting import COUNTING, ticks_since
from .models import Model
from .registers import CR, HEADER

SHORT, LONG = 20, 22
CONSTANT = 0x01FE_FFFF  # FLAG bits 8 to 1 and the GPIO word, as `constants` packs them
FORGET = 1000  # junk bytes after which the other frame length is tried as well
GYRO, ACCL, GPIO, COUNT = 5, 11, 17, 19  # offsets in the frame

STATE = np.dtype(
    [
        ("gyro_scale", "<f8"),  # rad/s per LSB
        ("accel_scale", "<f8"),  # m/s^2 per LSB
        ("temperature_scale", "<f8"),  # degC per LSB
        ("temperature_raw_25", "<f8"),
        ("range_lsb", "<i8"),
        ("leftover", "<i8"),  # bytes kept at the front of the buffer
        ("scanned", "<i8"),  # of which so many are only kept to look back at
        ("length", "<i8"),
        ("locked", "<i8"),
        ("constants", "<i8"),
        ("mask", "<i8"),  # bits of `constants` that never changed
        ("unconfirmed", "<i8"),  # the bytes before the scan are a delivered frame
        ("covered", "<i8"),  # bytes from here on that belong to one
        ("gap", "<i8"),  # junk bytes since the last frame
        ("tick", "<i8"),
        ("counting", COUNTING),
        ("spikes", SPIKES),
        ("frames", "<i8"),  # delivered
        ("junk", "<i8"),  # bytes that belong to no delivered frame
        ("bad", "<i8"),  # times that the sequence of frames broke
        ("lost", "<i8"),  # samples that the device took and that did not arrive
        ("suspect", "<i8"),
        ("errors", "<i8"),  # frames in which the device reported a fault
    ],
    align=True,
)

WAIT, BAD, GOOD, LOCK = range(4)


def new_state(model: Model, gyro_floor: float, accel_floor: float) -> NDArray[np.void]:
    """A decoder state (array of one `STATE`); the floors are what motion may make in one sample, LSB."""
    state = np.zeros(1, STATE)
    state["gyro_scale"], state["accel_scale"] = model.gyro_scale, model.accel_scale
    state["temperature_scale"], state["temperature_raw_25"] = model.temperature_degc, model.temperature_raw_25
    state["range_lsb"] = model.range_lsb
    state["length"], state["mask"] = SHORT, CONSTANT
    state["spikes"]["floor"] = [gyro_floor] * 3 + [accel_floor] * 3
    return state


@kernel
def constants(rx: Any, p: int) -> int:
    """FLAG and GPIO of the frame at p."""
    return (word(rx, p + 1) << 16) | word(rx, p + GPIO)


@kernel
def is_framed(rx: Any, p: int, length: int) -> bool:
    """Whether header and CR stand at the ends."""
    return bool(rx[p] == HEADER and rx[p + length - 1] == CR)


@kernel
def is_pair(rx: Any, p: int, length: int) -> bool:
    """Whether the bytes before p and those from p on are two frames that agree with each other."""
    return (
        is_framed(rx, p, length)
        and is_framed(rx, p - length, length)
        and (constants(rx, p) ^ constants(rx, p - length)) & CONSTANT == 0
    )


@kernel
def lock(s: Any, seen: int, length: int) -> None:
    """Begin or renew the lock; bits that changed since the last one are not relied on any more."""
    if s.locked:
        s.mask &= ~(s.constants ^ seen)
    s.constants, s.length, s.locked = seen, length, 1


@kernel
def examine(s: Any, rx: Any, p: int, fill: int) -> int:
    """What begins at p: GOOD, a frame; LOCK, the second of two; BAD, none; WAIT, too early to say."""
    if rx[p] != HEADER:
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
    """Leave a byte that begins no frame, or go back into the unconfirmed frame before it; returns where to go on."""
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
def emit(s: Any, rx: Any, p: int, sample: Any) -> None:
    """The frame at p as a sample."""
    missing = (s.gap + s.length // 2) // s.length
    count = word(rx, p + COUNT) if s.length == LONG else -1
    advance = ticks_since(s.counting, count, missing, s.frames == 0)
    if s.frames > 0:
        s.lost += advance - 1
    s.tick += advance
    raw = s.spikes.raw
    saturated = False
    for i in range(6):
        raw[i] = signed(rx, p + GYRO + 2 * i)
        saturated |= abs(raw[i]) >= s.range_lsb
    flags = 0
    if is_spike(s.spikes, advance):
        flags = SUSPECT
        s.suspect += 1
    elif saturated:
        flags = SATURATED
    if rx[p + 2] & 1:
        flags |= DEVICE_ERROR
        s.errors += 1
    w, f = sample.w, sample.f
    for i in range(3):
        w[i] = raw[i] * s.gyro_scale
        f[i] = raw[i + 3] * s.accel_scale
    sample.temperature = 25.0 + s.temperature_scale * (signed(rx, p + 3) - s.temperature_raw_25)
    sample.tick, sample.flags = s.tick, flags
    s.frames += 1
    s.unconfirmed, s.covered, s.gap = 1, 0, 0


@kernel
def decode(rx: NDArray[np.uint8], fill: int, state: NDArray[np.void], samples: NDArray[np.void]) -> int:
    """See `ImuDriver.decode`. rx must hold 64 bytes more than one read brings; samples at least one row."""
    s: Any = state[0]
    p, n = s.scanned, 0
    while n < len(samples) and p < fill:
        found = examine(s, rx, p, fill)
        if found == WAIT:
            break
        if found == BAD:
            p = skip(s, p)
        elif found == GOOD:
            emit(s, rx, p, samples[n])
            n += 1
            p += s.length
        else:  # p itself is examined again, and good
            s.gap -= s.length
            s.junk -= s.length
            emit(s, rx, p - s.length, samples[n])
            n += 1
    start = max(p - LONG, 0)
    s.leftover, s.scanned = fill - start, p - start
    if start > 0:
        for i in range(s.leftover):
            rx[i] = rx[start + i]
    return n
