"""The state of the decoders of both dialects, and how they output a sample."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..jit import kernel
from ..sample import DEVICE_ERROR, POWER_ON, SATURATED, SUSPECT
from ..spikes import SPIKES, is_spike
from .counting import COUNTING
from .models import Model

ALL_NEW = 0xFE00  # bits of FLAG: temperature, gyros, accelerometers that were not read yet

STATE = np.dtype(
    [
        ("gyro_scale", "<f8"),  # rad/s per LSB
        ("accel_scale", "<f8"),  # m/s^2 per LSB
        ("temperature_scale", "<f8"),  # degC per LSB
        ("temperature_raw_25", "<f8"),
        ("gyro_end", "<i8"),  # |LSB| at the end of the range
        ("accel_end", "<i8"),
        ("windowed", "<i8"),  # which dialect; below, fields that only the flat one needs are marked with *
        ("size", "<i8"),  # bytes of a gyro, accelerometer or temperature word
        ("leftover", "<i8"),  # bytes kept at the front of the buffer
        ("scanned", "<i8"),  # * of these, bytes that were scanned before and are kept to compare with
        ("length", "<i8"),  # of a frame
        ("locked", "<i8"),  # * 1: the constant bits are known
        ("constants", "<i8"),  # * FLAG and GPIO of the last frames
        ("mask", "<i8"),  # * bits of `constants` that never changed
        ("unconfirmed", "<i8"),  # * the bytes before the scan are a delivered frame
        ("covered", "<i8"),  # * bytes from here on that belong to a delivered frame
        ("numbered", "<i8"),  # 1: there is a word that may be COUNT
        ("polled", "<i8"),  # 1: frames are answers, so that one may repeat the sample before
        ("count", "<i8"),  # of the last frame
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
        ("status", "<i8"),  # 1: the last frame did
    ],
    align=True,
)


def new_state(model: Model, size: int) -> NDArray[np.void]:
    """A decoder state (array of one `STATE`) for words of `size` bytes."""
    state = np.zeros(1, STATE)
    finer = 1 << (8 * size - 16)
    state["size"] = size
    state["gyro_scale"], state["accel_scale"] = model.gyro_scale / finer, model.accel_scale / finer
    state["temperature_scale"] = model.temperature_degc / finer
    state["temperature_raw_25"] = model.temperature_raw_25 * finer
    state["gyro_end"], state["accel_end"] = (end * finer for end in model.range_lsb)
    return state


@kernel
def is_saturated(s: Any) -> bool:
    """Whether an axis of the sample in s.spikes.raw is at the end of its range."""
    raw = s.spikes.raw
    worst_gyro = max(abs(raw[0]), abs(raw[1]), abs(raw[2]))
    worst_accel = max(abs(raw[3]), abs(raw[4]), abs(raw[5]))
    return bool(worst_gyro >= s.gyro_end or worst_accel >= s.accel_end)


@kernel
def is_repeated(s: Any, flag: int, count: int) -> bool:
    """Whether an answer holds the same sample as the one before: by COUNT, or without it (-1) by the new-data bits."""
    same = flag & ALL_NEW == 0 if count < 0 else count == s.count
    s.count = count
    return bool(s.polled and s.frames > 0 and same)


@kernel
def deliver(s: Any, flag: int, temperature: int, ticks: int, sample: Any) -> None:
    """The words of a frame (those in s.spikes.raw, FLAG and the temperature) as a sample in SI units.

    ticks: since the one before.
    """
    flags = 0
    if is_spike(s.spikes, ticks):
        flags = SUSPECT
        s.suspect += 1
    elif is_saturated(s):
        flags = SATURATED
    s.status = flag & 1  # EA: any error
    if s.status:
        flags |= DEVICE_ERROR
        s.errors += 1
    if s.counting.begun_anew:
        flags |= POWER_ON
    raw, w, f = s.spikes.raw, sample.w, sample.f
    for i in range(3):
        w[i] = raw[i] * s.gyro_scale
        f[i] = raw[i + 3] * s.accel_scale
    sample.temperature = 25.0 + s.temperature_scale * (temperature - s.temperature_raw_25)
    sample.tick, sample.flags = s.tick, flags
    s.frames += 1
