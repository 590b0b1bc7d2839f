"""Scans of IIO devices: bytes to samples.

The number of its device precedes each scan. With one device each scan is a sample. With two, a scan of the gyros is a
sample, whose force is interpolated between the accelerometers' scans before and after it, which arrive first. A tick is
1 ns of the kernel's stamp; without stamps, or if one does not advance, the nominal period is added. A longer step means
that scans are missing.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..jit import kernel
from ..sample import SATURATED, SUSPECT
from ..words import Bytes, byte, move_to_front
from .layout import Channel, Layout

DEVICES, CHANNELS, GYROS, FORCES, TEMPERATURE = 2, 7, 0, 3, 6
GAP_PERIODS = 3  # longest time between two forces, in periods, over which they are interpolated
LONGEST_NS = 1 << 40  # 18 minutes; a longer step of the stamp means that the clock was set
STAMP_BYTES = 8

CHANNEL = np.dtype(
    [
        ("device", "<i8"),  # -1: there is none
        ("at", "<i8"),
        ("size", "<i8"),
        ("bits", "<i8"),
        ("shift", "<i8"),
        ("twos_complement", "<i8"),
        ("big", "<i8"),
        ("offset", "<f8"),
        ("scale", "<f8"),
    ],
    align=True,
)
STATE = np.dtype(
    [
        ("channels", CHANNEL, (CHANNELS,)),  # gyros, forces, temperature
        ("gyro_rotation", "<f8", (3, 3)),
        ("force_rotation", "<f8", (3, 3)),
        ("devices", "<i8"),
        ("sizes", "<i8", (DEVICES,)),  # of scans
        ("stamps", "<i8", (DEVICES,)),  # where they are in a scan; -1: nowhere
        ("periods", "<i8", (DEVICES,)),  # ns
        ("ticks", "<i8"),  # in a period: 1 ns each, or the period itself without stamps
        ("values", "<f8", (3,)),  # of a vector, chip axes
        ("force", "<f8", (3,)),  # the newest of the second device, FRD
        ("force_before", "<f8", (3,)),
        ("force_ns", "<i8"),
        ("force_before_ns", "<i8"),
        ("forces_known", "<i8"),
        ("force_flags", "<i8"),  # of the newest, and of the one before
        ("force_before_flags", "<i8"),
        ("stamp_ns", "<i8"),  # of the last sample
        ("tick", "<i8"),
        ("leftover", "<i8"),  # bytes kept at the front of the buffer
        ("frames", "<i8"),  # delivered
        ("junk", "<i8"),  # bytes that belong to no scan
        ("bad", "<i8"),  # stamps that did not advance
        ("lost", "<i8"),  # scans that the buffer had no room for
        ("suspect", "<i8"),
        ("errors", "<i8"),  # always 0: the kernel reports no faults here
        ("status", "<i8"),  # likewise
    ],
    align=True,
)


def new_state(layout: Layout) -> NDArray[np.void]:
    """A decoder state (array of one `STATE`)."""
    state = np.zeros(1, STATE)
    channels: list[Channel | None] = [*layout.gyros, *layout.forces, layout.temperature]
    for row, one in zip(state["channels"][0], channels, strict=True):
        row["device"] = -1
        if one is not None:
            for name in CHANNEL.names or ():
                row[name] = getattr(one, name)
    state["gyro_rotation"], state["force_rotation"] = layout.gyro_rotation, layout.force_rotation
    state["devices"], state["ticks"] = len(layout.sizes), 1
    for name in ("sizes", "stamps", "periods"):
        values = getattr(layout, "periods_ns" if name == "periods" else name)
        state[name][0, : len(values)] = values
    return state


@kernel
def number(rx: Bytes, p: int, c: Any) -> int:
    """The number of a channel in the scan at p."""
    value = 0
    for i in range(c.size):
        value = value << 8 | byte(rx, p + c.at + (i if c.big else c.size - 1 - i))
    value = value >> c.shift & (1 << c.bits) - 1
    if c.twos_complement:
        half = 1 << c.bits - 1
        value = (value ^ half) - half
    return int(value)


@kernel
def read_vector(s: Any, rx: Bytes, p: int, first: int) -> int:
    """The vector whose channels begin at `first`, in the scan at p, into s.values; returns flags."""
    flags = 0
    for i in range(3):
        s.values[i] = 0.0
        if s.channels[first + i].device >= 0:
            raw = number(rx, p, s.channels[first + i])
            most = (1 << s.channels[first + i].bits - s.channels[first + i].twos_complement) - 1
            if raw >= most or (s.channels[first + i].twos_complement and raw <= -most):
                flags = SATURATED
            s.values[i] = (raw + s.channels[first + i].offset) * s.channels[first + i].scale
    return flags


@kernel
def stamp_at(rx: Bytes, p: int) -> int:
    """The 64-bit stamp at p, in this machine's order: that of all machines that imud runs on, lowest byte first."""
    value = 0
    for i in range(STAMP_BYTES):
        value = value << 8 | byte(rx, p + STAMP_BYTES - 1 - i)
    return value


@kernel
def store_force(s: Any, rx: Bytes, p: int) -> None:
    """Store the force of a scan of the second device, and keep the one before."""
    s.force_before_ns, s.force_before_flags = s.force_ns, s.force_flags
    s.force_ns = stamp_at(rx, p + s.stamps[1])
    s.force_flags = read_vector(s, rx, p, FORCES)
    s.forces_known = min(s.forces_known + 1, 2)
    for i in range(3):
        s.force_before[i] = s.force[i]
        s.force[i] = (
            s.force_rotation[i, 0] * s.values[0]
            + s.force_rotation[i, 1] * s.values[1]
            + s.force_rotation[i, 2] * s.values[2]
        )


@kernel
def interpolate(s: Any, stamp_ns: int, f: Any) -> int:
    """The second device's force at that time; returns flags."""
    span = s.force_ns - s.force_before_ns
    share = 1.0
    flags = s.force_flags | s.force_before_flags
    if s.forces_known == 2 and 0 < span <= GAP_PERIODS * s.periods[1] and 0 <= s.force_ns - stamp_ns <= span:
        share = (stamp_ns - s.force_before_ns) / span
    elif stamp_ns != s.force_ns:
        flags = SUSPECT
    for i in range(3):
        f[i] = s.force_before[i] + share * (s.force[i] - s.force_before[i])
    return int(flags)


@kernel
def count(s: Any, stamp_ns: int) -> None:
    """Advance the tick to a sample with this stamp."""
    step = s.periods[0]
    if s.stamps[0] >= 0 and s.frames > 0:
        elapsed = stamp_ns - s.stamp_ns
        if 0 < elapsed < LONGEST_NS:
            step = elapsed
        else:
            s.bad += 1
        s.lost += max(0, (step + s.periods[0] // 2) // s.periods[0] - 1)
    if s.frames > 0:
        s.tick += step
    s.stamp_ns = stamp_ns


@kernel
def emit(s: Any, rx: Bytes, p: int, sample: Any) -> None:
    """The scan of the first device at p as a sample."""
    stamp_ns = stamp_at(rx, p + s.stamps[0]) if s.stamps[0] >= 0 else 0
    count(s, stamp_ns)
    flags = read_vector(s, rx, p, GYROS)
    w, f, down = sample.w, sample.f, sample.down
    for i in range(3):
        w[i] = (
            s.gyro_rotation[i, 0] * s.values[0]
            + s.gyro_rotation[i, 1] * s.values[1]
            + s.gyro_rotation[i, 2] * s.values[2]
        )
        down[i] = 0.0
    if s.devices == 1:
        flags |= read_vector(s, rx, p, FORCES)
        for i in range(3):
            f[i] = (
                s.force_rotation[i, 0] * s.values[0]
                + s.force_rotation[i, 1] * s.values[1]
                + s.force_rotation[i, 2] * s.values[2]
            )
    else:
        flags |= interpolate(s, stamp_ns, f)
    s.suspect += flags & SUSPECT
    sample.temperature = math.nan
    if s.channels[TEMPERATURE].device >= 0:
        raw = number(rx, p, s.channels[TEMPERATURE])
        sample.temperature = (raw + s.channels[TEMPERATURE].offset) * s.channels[TEMPERATURE].scale
    sample.tick, sample.flags = s.tick, flags
    s.frames += 1


@kernel
def decode(rx: NDArray[np.uint8], fill: int, state: NDArray[np.void], samples: NDArray[np.void]) -> int:
    """See `ImuDriver.decode`. rx must hold 64 bytes more than one read brings; samples at least one row."""
    s: Any = state[0]
    p, n = 0, 0
    while n < len(samples) and p < fill:
        device = byte(rx, p)
        if device >= s.devices:
            s.junk += 1
            p += 1
            continue
        if p + 1 + s.sizes[device] > fill:
            break
        if device == 0:
            emit(s, rx, p + 1, samples[n])
            n += 1
        else:
            store_force(s, rx, p + 1)
        p += 1 + s.sizes[device]
    s.leftover = fill - p
    move_to_front(rx, p, s.leftover)
    return n
