"""Packets of the RGA300CA: bytes to samples.

A packet has the header and a right checksum. Any other byte is skipped, so that a good packet inside a bad one is
found; a packet is delivered as soon as its last byte has arrived. A sum of bytes is a weak checksum, so the values are
tested, too (`drivers/spikes.py`). The decoder changes to another convention of the checksum after `SURE` packets in
sequence that fit it while none fitted the present one. Decisions depend on the bytes alone, never on the chunks in
which they came.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import elementary
from ..jit import kernel
from ..sample import DEVICE_ERROR, SATURATED, STANDARD_GRAVITY, SUSPECT
from ..spikes import SPIKES, is_spike
from ..words import Bytes, byte, move_to_front, signed, word
from . import packet
from .packet import CHECKSUM, CONVENTIONS, HEADER, LENGTH, PITCH, RANGE_LSB, ROLL, SURE, TEMPERATURE, YAW_RATE
from .timer import TIMER, ticks_since

SPIKE_RADPS2, SPIKE_MPS3 = math.radians(2500.0), 50.0 * STANDARD_GRAVITY  # changes beyond those of a vehicle
SPIKE_PERIOD_MAX_S = 0.02  # longest time for which these hold
FAULTS = packet.ACCEL_FAILED | packet.ZERO_INVALID
ANGLE_SCALE, RATE_SCALE, ACCEL_SCALE = packet.ANGLE_SCALE, packet.RATE_SCALE, packet.ACCEL_SCALE
DEGC_SCALE = packet.VOLTS * packet.DEGC_PER_VOLT
DEGC_0 = -packet.VOLTS_0_DEGC * packet.DEGC_PER_VOLT
AXES = 4  # yaw rate, accelerations: consecutive words
H0, H1 = HEADER

STATE = np.dtype(
    [
        ("leftover", "<i8"),  # bytes kept at the front of the buffer
        ("convention", "<i8"),
        ("runs", "<i8", (len(CONVENTIONS),)),  # packets in sequence by conventions that are not the present one
        ("since", "<i8", (len(CONVENTIONS),)),  # bytes since the last of them
        ("gap", "<i8"),  # junk bytes since the last packet
        ("tick", "<i8"),
        ("timer", TIMER),
        ("spikes", SPIKES),
        ("status", "<i8"),  # the last BIT word
        ("frames", "<i8"),  # delivered
        ("junk", "<i8"),  # bytes that belong to no delivered packet
        ("bad", "<i8"),  # times that the sequence of packets broke
        ("lost", "<i8"),  # packets that the device sent and that did not arrive
        ("suspect", "<i8"),
        ("errors", "<i8"),  # packets in which the device reported a fault
    ],
    align=True,
)

WAIT, BAD, GOOD = range(3)


def new_state(rate_hz: float) -> NDArray[np.void]:
    """A decoder state (array of one `STATE`) for packets at this rate."""
    state = np.zeros(1, STATE)
    state["timer"]["spacing"] = max(1, round(1e9 / rate_hz / packet.TICK_NS))
    dt = min(1.0 / rate_hz, SPIKE_PERIOD_MAX_S)
    floor = [SPIKE_RADPS2 * dt / RATE_SCALE] + [SPIKE_MPS3 * dt / ACCEL_SCALE] * 3
    state["spikes"]["floor"] = [*floor, 1.0, 1.0]  # the last two words are always 0
    return state


@kernel
def matching_conventions(rx: Bytes, p: int) -> int:
    """Bit i: the checksum of the packet at p is right by convention i."""
    octets = words = 0
    for i in range(p + 2, p + CHECKSUM, 2):
        octets += byte(rx, i) + byte(rx, i + 1)
        words += word(rx, i)
    given = word(rx, p + CHECKSUM)
    fit = 1 if octets == given else 0
    fit |= 2 if words & 0xFFFF == given else 0
    fit |= 4 if words % 0xFFFF == given else 0
    return fit | (8 if octets & 0xFF == given else 0)


@kernel
def count_convention(s: Any, fit: int) -> None:
    """Count packets that fit only another convention, and change to it once there are enough in sequence."""
    for i in range(len(s.runs)):
        if fit >> i & 1:
            s.runs[i] = s.runs[i] + 1 if s.since[i] == LENGTH else 1
            s.since[i] = 0
            if s.runs[i] >= SURE:
                s.convention = i


@kernel
def classify(s: Any, rx: Bytes, p: int, fill: int) -> int:
    """What begins at p: GOOD, a packet; BAD, no packet; WAIT: more bytes are needed."""
    if byte(rx, p) != H0 or (p + 1 < fill and byte(rx, p + 1) != H1):
        return BAD
    if p + LENGTH > fill:
        return WAIT
    fit = matching_conventions(rx, p)
    if fit >> s.convention & 1:
        return GOOD
    count_convention(s, fit)
    return BAD


@kernel
def skip(s: Any) -> None:
    """Skip a byte at which no packet begins."""
    s.bad += s.gap == 0 and s.frames > 0
    s.junk += 1
    s.gap += 1
    for i in range(len(s.since)):
        s.since[i] += 1


@kernel
def reset_conventions(s: Any) -> None:
    """A packet fits the present convention: reset the counts of the others."""
    for i in range(len(s.runs)):
        s.runs[i] = 0
    s.gap = 0
    s.frames += 1


@kernel
def set_down(roll: float, pitch: float, down: Any) -> None:
    """The vertical in the sensor's axes from its own tilt, rad: the third column of the matrix of ZYX angles."""
    down[0] = -elementary.sin(pitch)
    down[1] = elementary.cos(pitch) * elementary.sin(roll)
    down[2] = elementary.cos(pitch) * elementary.cos(roll)


@kernel
def emit(s: Any, rx: Bytes, p: int, sample: Any) -> None:
    """The packet at p as a sample. The device shows gravity, +1 g on z when level: specific force is its negative."""
    missing = (s.gap + LENGTH // 2) // LENGTH
    ticks = ticks_since(s.timer, word(rx, p + packet.TIMER), missing, s.frames == 0)
    periods = (ticks + s.timer.spacing // 2) // s.timer.spacing
    s.lost += max(0, periods - 1)
    s.tick += ticks
    raw = s.spikes.raw
    saturated = False
    for i in range(AXES):
        raw[i] = signed(rx, p + YAW_RATE + 2 * i)
        saturated |= abs(raw[i]) >= RANGE_LSB
    flags = 0
    if is_spike(s.spikes, max(1, periods)):
        flags = SUSPECT
        s.suspect += 1
    elif saturated:
        flags = SATURATED
    s.status = word(rx, p + packet.BIT)
    if s.status & FAULTS != 0:
        flags |= DEVICE_ERROR
        s.errors += 1
    w, f = sample.w, sample.f
    w[0], w[1], w[2] = 0.0, 0.0, raw[0] * RATE_SCALE
    for i in range(3):
        f[i] = -raw[i + 1] * ACCEL_SCALE
    set_down(signed(rx, p + ROLL) * ANGLE_SCALE, signed(rx, p + PITCH) * ANGLE_SCALE, sample.down)
    sample.temperature = word(rx, p + TEMPERATURE) * DEGC_SCALE + DEGC_0
    sample.tick, sample.flags = s.tick, flags
    reset_conventions(s)


@kernel
def decode(rx: NDArray[np.uint8], fill: int, state: NDArray[np.void], samples: NDArray[np.void]) -> int:
    """See `ImuDriver.decode`. rx must hold 64 bytes more than one read brings; samples at least one row."""
    s: Any = state[0]
    p, n = 0, 0
    while n < len(samples) and p < fill:
        found = classify(s, rx, p, fill)
        if found == WAIT:
            break
        if found == GOOD:
            emit(s, rx, p, samples[n])
            n += 1
            p += LENGTH
        else:
            skip(s)
            p += 1
    s.leftover = fill - p
    move_to_front(rx, p, s.leftover)
    return n
