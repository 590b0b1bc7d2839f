"""The driver of Epson's M-G350 and M-V340 on a UART."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..dialogue import Dialogue
from ..driver import Identity, ImuConfigured, Options, Unsupported
from . import registers
from .hearing import ENOUGH_FRAMES, flat_frames, is_windowed
from .models import MODELS, STANDARD_GRAVITY, Model
from .setup import fastest, listen, program, start, to_configuration
from .talk import ask, describe, reach, windowed

SPIKE_RADPS, SPIKE_MPS2 = math.radians(20.0), 0.25 * STANDARD_GRAVITY  # per ms: more than motion makes within 140 Hz
NUMBERED = 22  # bytes of a frame with COUNT


class Epson:
    """The driver."""

    name = "epson"
    bauds = (460800, 230400, 115200, 19200, 9600)
    patience_s = 0.5  # four frames at the lowest rate take 0.26 s

    @property
    def kind(self) -> Literal["imu"]:
        """The kind of device."""
        return "imu"

    def recognise(self, heard: bytes) -> Identity | Unsupported | None:
        """An automatic stream. Which flat model it is only `configure` can ask."""
        if flat_frames(heard)[0] >= ENOUGH_FRAMES:
            return Identity(self.name, MODELS[0].name, profile=MODELS[0].profile)
        return windowed("") if is_windowed(heard) else None

    def identify(self) -> Dialogue[Identity | Unsupported | None]:
        """Stop whatever runs, and ask. Leaves the sensor in configuration mode."""
        return (yield from describe()) if (yield from reach()) else None

    def configure(self, identity: Identity, options: Options) -> Dialogue[ImuConfigured | None]:
        """The nearest possible rate, the shortest filter, COUNT, automatic frames."""
        model = named(identity.model)
        if options.readonly:
            rate, frame_bytes = yield from listen(model)
            return configured(identity, model, rate, frame_bytes, ()) if frame_bytes else None
        if not (yield from reach()):
            return None
        described = yield from describe()
        if isinstance(described, Unsupported):
            return None
        identity = replace(described, baud=identity.baud)
        model = named(identity.model)
        warnings = yield from to_configuration()
        diagnosis = (yield from ask(registers.DIAG_STAT)) or 0
        if diagnosis & registers.HARD_ERROR:
            warnings.append(f"the sensor reports a hardware error (DIAG_STAT {diagnosis:#06x})")
        baud = identity.baud or self.bauds[0]
        code, rate = fastest(model, options.rate_hz, baud, NUMBERED)
        if rate != options.rate_hz:
            warnings.append(f"{options.rate_hz:g} samples/s wanted, {rate:g} is the nearest possible at {baud} baud")
        rate, refused = yield from program(model, code)
        frame_bytes = yield from start()
        if not frame_bytes:
            return None
        return configured(identity, model, rate, frame_bytes, (*warnings, *refused))

    def new_state(self, configured: ImuConfigured) -> NDArray[np.void]:
        """See `ImuDriver`."""
        from .frames import new_state

        model = named(configured.identity.model)
        per_ms = configured.period_ns * 1e-6
        floor_gyro, floor_accel = SPIKE_RADPS * per_ms / model.gyro_scale, SPIKE_MPS2 * per_ms / model.accel_scale
        return new_state(model, floor_gyro, floor_accel)

    @property
    def decode(self) -> Callable[[NDArray[np.uint8], int, NDArray[np.void], NDArray[np.void]], int]:
        """See `ImuDriver`."""
        from .frames import decode

        return decode


def named(name: str) -> Model:
    """The model called `name`."""
    return next((model for model in MODELS if model.name == name), MODELS[0])


def configured(
    identity: Identity, model: Model, rate_hz: float, frame_bytes: int, warnings: tuple[str, ...]
) -> ImuConfigured:
    """The finding of `configure`."""
    wire_ns = round(frame_bytes * 10 / (identity.baud or Epson.bauds[0]) * 1e9)
    return ImuConfigured(
        identity, rate_hz, round(1e9 / rate_hz), model.delay_ns(rate_hz) + wire_ns, frame_bytes, warnings
    )


DRIVER = Epson()
