"""The driver of SparkFun's Serial Accelerometer V5 (SerAccel) and its successor, the Serial Accelerometer Dongle."""

import math
from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..dialogue import Dialogue
from ..driver import Identity, ImuConfigured, Options
from ..sample import STANDARD_GRAVITY
from .protocol import TIMEOUT_S, measure_rate, probe, reach_stream
from .ranges import FULL_COUNT, LOW_PASS_NS, MODEL, RANGES, range_of
from .signatures import StreamedSamples, firmware_in, menu_in, range_in, stream_in

PROFILE = "mma7260"


class SerAccel:
    """The driver."""

    name = "seraccel"
    bauds = (57600, 38400, 19200, 9600)
    timeout_s = TIMEOUT_S
    interrupts = False
    fault_texts = MappingProxyType[int, str]({})

    @property
    def kind(self) -> Literal["imu"]:
        """The kind of device."""
        return "imu"

    def recognise(self, received: bytes) -> Identity | None:
        """A stream in any mode, or the menu."""
        if stream_in(received) is None and not menu_in(received):
            return None
        return Identity(self.name, MODEL, firmware=firmware_in(received), profile=PROFILE)

    def identify(self) -> Dialogue[Identity | None]:
        """Request the menu on a silent line."""
        return self.recognise((yield from probe()))

    def configure(self, identity: Identity, options: Options) -> Dialogue[ImuConfigured | None]:
        """Leave the menu if the board is there, and listen. Rate and range stay as the user chose them in the menu."""
        streaming, received = yield from reach_stream(options.readonly)
        if not streaming:
            return None
        rate_hz, newest = yield from measure_rate()
        stream = stream_in(newest)
        if stream is None:
            return None
        identity = replace(identity, firmware=firmware_in(received) or identity.firmware)
        range_g, warnings = range_in(received), tuple[str, ...]()
        if range_g is None and stream.counts:
            range_g, warnings = range_from_gravity(stream)
        model = next((row.model for row in RANGES if row.g == range_g), MODEL)
        wire_ns = round(stream.bytes_each * 10 / (identity.baud or self.bauds[0]) * 1e9)
        return ImuConfigured(
            replace(identity, model=model),
            rate_hz,
            round(1e9 / rate_hz),
            LOW_PASS_NS + wire_ns,
            round(stream.bytes_each),
            warnings,
            gyro_axes=(False, False, False),
            accel_range=range_of(model).end_g * STANDARD_GRAVITY,
        )

    def new_state(self, configured: ImuConfigured) -> NDArray[np.void]:
        """See `ImuDriver`."""
        from .lines import new_state

        return new_state(range_of(configured.identity.model))

    @property
    def decode(self) -> Callable[[NDArray[np.uint8], int, NDArray[np.void], NDArray[np.void]], int]:
        """See `ImuDriver`."""
        from .lines import decode

        return decode


def range_from_gravity(stream: StreamedSamples) -> tuple[float, tuple[str, ...]]:
    """The range in which the counts are nearest to 1 g, and a warning: only the menu states the range."""
    mean = [sum(axis) / len(stream.samples) - FULL_COUNT / 2.0 for axis in zip(*stream.samples, strict=True)]
    force = {row.g: math.hypot(*mean) * row.scale / STANDARD_GRAVITY for row in RANGES}
    range_g = min(force, key=lambda g: abs(math.log(max(force[g], 1e-3))))
    why = f"raw counts: taken as range ±{range_g:g} g, in which the force is {force[range_g]:.2f} g now"
    return range_g, (f"{why}; choose the output of gravity values in the board's menu to be sure",)


DRIVER = SerAccel()
