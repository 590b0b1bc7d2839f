"""Configuring an Epson sensor of the flat dialect, and starting its automatic stream."""

import math

from ..dialogue import Dialogue, Exchange
from . import registers
from .hearing import ENOUGH_FRAMES, flat_frames
from .models import RATES, Model
from .talk import STOP_S, STOPS, ask, tell, wait_ready

RESET_S = 0.8
STREAM_S = 1.0
WIRE_SHARE = 0.96  # of the line's capacity that a stream may take


def to_configuration() -> Dialogue[list[str]]:
    """Have configuration mode confirmed, by a reset if need be; returns warnings."""
    for attempt in range(STOPS + 1):
        mode = yield from ask(registers.MODE_CTRL)
        if mode is not None and mode & registers.CONFIGURING:
            return []
        if attempt < STOPS - 1:
            yield Exchange(registers.TO_CONFIGURATION, STOP_S)
        elif attempt == STOPS - 1:
            yield Exchange(registers.SOFT_RESET, RESET_S)
            yield from wait_ready()
    return ["the sensor does not confirm configuration mode"]


def fastest(model: Model, wanted_hz: float, baud: int, frame_bytes: int) -> tuple[int, float]:
    """Code and rate nearest to `wanted_hz` whose frames fit on the line; the slowest if none does."""
    bits = 10 * frame_bytes
    fitting = {code: hz for code, hz in model.rates.items() if hz * bits <= WIRE_SHARE * baud}
    rates = fitting or dict([min(model.rates.items(), key=lambda row: row[1])])
    return min(rates.items(), key=lambda row: abs(math.log(row[1] / wanted_hz)))


def program(model: Model, code: int) -> Dialogue[tuple[float, list[str]]]:
    """Write rate, filter, COUNT and automatic mode, and read them back; returns the true rate and warnings."""
    rate, warnings = RATES[code], []
    taps = model.tap_codes[model.taps(rate)]
    yield from tell(registers.write(registers.SMPL_CTRL + 1, code), registers.write(registers.MODE_CTRL, taps))
    yield from tell(registers.COUNT_ON, registers.AUTO_ON)
    kept = yield from ask(registers.SMPL_CTRL)
    if kept is not None and kept >> 8 != code:
        rate = RATES.get(kept >> 8, rate)
        warnings.append(f"the sensor keeps rate code {kept >> 8} instead of {code}: taken as {rate:g} samples/s")
    mode = yield from ask(registers.MODE_CTRL)
    if mode is not None and mode & 0xFF != taps:
        warnings.append(f"the sensor keeps filter code {mode & 0xFF} instead of {taps}")
    count = yield from ask(registers.COUNT_CTRL)
    if count is not None and not count & 1:
        warnings.append("the sensor does not number its samples: losses are estimated")
    return rate, warnings


def start() -> Dialogue[int]:
    """Begin sampling; returns the length of the frames that come, 0 if none do."""
    for _ in range(2):
        heard = yield Exchange(
            registers.TO_SAMPLING, STREAM_S, enough=lambda heard: flat_frames(heard)[0] >= ENOUGH_FRAMES, discard=True
        )
        frames, length = flat_frames(heard)
        if frames >= ENOUGH_FRAMES:
            return length
    return 0


def listen(model: Model) -> Dialogue[tuple[float, int]]:
    """Rate and frame length of a stream that runs already; (0, 0) if none does."""
    heard = yield Exchange(listen_s=STREAM_S, discard=True)
    frames, length = flat_frames(heard)
    if frames < ENOUGH_FRAMES:
        return 0.0, 0
    per_second = len(heard) / length / STREAM_S
    return min(model.rates.values(), key=lambda hz: abs(math.log(hz / per_second))), length
