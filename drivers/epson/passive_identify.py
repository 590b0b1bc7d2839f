"""A stream that must not be interrupted: its layout and rate are determined from the stream itself.

The length of a flat frame determines its layout; length and checksum determine that of a windowed one. The decoder
learns whether there is a COUNT. A stream does not identify the model, so the user must name it. Without a checksum a
damaged windowed frame cannot be detected, so such a stream is rejected.
"""

import math
from dataclasses import replace

from ..dialogue import Dialogue, Exchange
from ..driver import Identity, Unsupported
from .dialects import FLAT, WINDOWED, Dialect, Layout
from .models import G350, MODELS, Model, model_of
from .signatures import ENOUGH_FRAMES, is_frame, is_stream_of, layout_of, longest_run
from .state import ALL_NEW
from .windowed import FLAG, READABLE, TEMP

LISTEN_S = 1.0
PIECE = 2048  # bytes that are searched for every layout; to search all would block the other ports for seconds
PLAUSIBLE_G = 0.7, 1.4  # mean specific force of a second
ModelLayout = tuple[Model, Layout]
PassiveIdentity = tuple[Identity, Model, float, Layout]  # rate in 1/s


def passive_identify(identity: Identity, named: str) -> Dialogue[PassiveIdentity | Unsupported | None]:
    """The stream that runs, of a sensor whose model the user `named`, or not. None: there is none."""
    received = yield Exchange(listen_s=LISTEN_S, discard=True)
    piece = received[:PIECE]
    if is_stream_of(piece, FLAT):
        found = _flat(identity, piece, named)
    else:
        found = _windowed(identity, piece, named) if is_stream_of(piece, WINDOWED) else None
    if not isinstance(found, tuple):
        return found
    model, layout = found
    per_second = len(received) / layout.length / LISTEN_S
    rate_hz = min(model.rates.values(), key=lambda hz: abs(math.log(hz / per_second)))
    return replace(identity, model=model.name, profile=model.profile), model, rate_hz, layout


def _flat(identity: Identity, received: bytes, named: str) -> ModelLayout | Unsupported | None:
    model = (model_of(named) if named else model_of(identity.model)) or G350
    if model.dialect is not FLAT:
        return _contradiction(identity, model, FLAT)
    layout = layout_of(received, FLAT.layouts)
    return (model, layout) if layout else None


def _windowed(identity: Identity, received: bytes, named: str) -> ModelLayout | Unsupported:
    length, checked = _shape(received)
    model = model_of(named or identity.model)
    shape = f"frames of {length} bytes {'with' if checked else 'without'} a checksum"
    if not checked or length not in READABLE:
        why = f"{shape} that imud cannot read as they are; let it write to the port, or have them set up otherwise"
        return _refusal(identity, why)
    if model is None:
        codes = ", ".join(model.code for model in MODELS if model.dialect is WINDOWED)
        return _refusal(identity, f"{shape} do not identify the model; set imu.model to one of {codes}")
    if model.dialect is not WINDOWED:
        return _contradiction(identity, model, WINDOWED)
    frames = _frames(received, length)
    if not all(word & ALL_NEW == ALL_NEW for word in (int.from_bytes(frame[FLAG : FLAG + 2]) for frame in frames)):
        return _refusal(identity, f"{shape} do not begin with FLAG: let imud write to the port")
    if not PLAUSIBLE_G[0] <= (force_g := _force_g(frames, model)) <= PLAUSIBLE_G[1]:
        return _refusal(identity, f"{shape}, read as those of {model.code}, show {force_g:.2g} g: is imu.model right?")
    return model, Layout(WINDOWED.header, length, (), checked=True)


def _shape(received: bytes) -> tuple[int, bool]:
    """Length of the frames, and whether their checksums are right."""
    header = WINDOWED.header
    for checked in (True, False):
        runs = {length: longest_run(received, header, length, checked) for length in WINDOWED.lengths}
        length = max(runs, key=lambda length: runs[length])
        if runs[length] >= ENOUGH_FRAMES:
            break
    return length, checked


def _frames(received: bytes, length: int) -> list[bytes]:
    pieces = (received[p : p + length] for p in range(len(received) - length + 1))
    return [piece for piece in pieces if is_frame(piece, WINDOWED.header, checked=True)]


def _force_g(frames: list[bytes], model: Model) -> float:
    """Mean specific force, g, if the words are where this driver expects them."""
    size = READABLE[len(frames[0])]
    lsb = model.accel_mg * 1e-3 / (1 << (8 * size - 16))
    offsets = range(TEMP + 4 * size, TEMP + 7 * size, size)
    sums = (sum(int.from_bytes(frame[i : i + size], signed=True) for frame in frames) for i in offsets)
    return lsb * math.hypot(*sums) / len(frames)


def _contradiction(identity: Identity, model: Model, dialect: Dialect) -> Unsupported:
    codes = ", ".join(model.code for model in MODELS if model.dialect is dialect)
    return _refusal(identity, f"imu.model says {model.code}, but the frames are of another kind, of {codes}")


def _refusal(identity: Identity, why: str) -> Unsupported:
    return Unsupported(identity.driver, "an Epson sensor's stream", why, identity.baud)
