"""Surfaces of `fuzz_surfaces.py` that need a device or a connection: the decoders of inertial sensors, the stream."""

import contextlib
import select
import socket
import tempfile
from functools import cache

import numpy as np
from crossbow_packets import packet
from framer_properties import KEPT, Decoder
from seraccel_lines import BINARY, GOLDEN, RAW, SUCCESSOR

from imud.client import DIVISOR
from imud.configuration.settings import Settings
from imud.configuration.settings import Stream as StreamSettings
from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.iio.layout import Channel, Layout
from imud.drivers.registry import by_name
from imud.outputs.binary import BinaryOutputs

_NO_GYROS = (False, False, False)
_AXIS = [Channel(0, 2 * i, 2, 16, 0, True, i % 2 == 1, 0.001) for i in range(6)]
_SCANS = Layout((24, 16), (16, 8), True, (1_000_000, 1_000_000), tuple(_AXIS[:3]), tuple(_AXIS[:3]))
SENSORS = {  # a connection of each kind of frame
    "epson": ImuConfigured(Identity("epson", "M-G350"), 1000.0, 1_000_000, 0, 22),
    "epson-windowed": ImuConfigured(Identity("epson", "M-G365"), 1000.0, 500_000, 0, 20),
    "crossbow": ImuConfigured(Identity("crossbow", "DMU RGA300CA"), 100.0, 790, 0, 24, gyro_axes=(False, False, True)),
    "seraccel": ImuConfigured(Identity("seraccel", "SerAccel (±1.5 g)"), 50.0, 20_000_000, 0, 28, gyro_axes=_NO_GYROS),
    "iio": ImuConfigured(Identity("iio", "two"), 1000.0, 1, 0, 17, layout=_SCANS.to_text()),
}


def decode(name: str, data: bytes) -> None:
    """In two chunks and in one: the same finite samples, and few bytes left."""
    driver = by_name(SENSORS[name].identity.driver)
    at = len(data) // 3
    parts, whole = (Decoder(driver, SENSORS[name], capacity=7) for _ in range(2))
    parts.feed(data[:at]).feed(data[at:])
    whole.feed(data)
    assert [s.tobytes() for s in parts.samples] == [s.tobytes() for s in whole.samples]
    assert whole["leftover"] <= KEPT
    for sample in whole.samples:
        assert np.isfinite(sample["w"]).all() and np.isfinite(sample["f"]).all()


@cache
def _outputs() -> tuple[BinaryOutputs, str, int]:
    path = f"{tempfile.mkdtemp(prefix='imud-fuzz-')}/stream"
    outputs = BinaryOutputs(Settings(stream=StreamSettings(listen=path)), select.poll(), 4)
    return outputs, path, next(iter(outputs.stream._listeners._sockets))


def stream_request(data: bytes) -> None:
    """What a client of the stream sends: a divisor, or the end of its connection."""
    outputs, path, listener = _outputs()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as client:
        client.connect(path)
        outputs.stream.on_event(listener)
        fd = outputs.stream._sockets[-1].fileno()
        with contextlib.suppress(OSError):
            client.send(data[:4096])
        outputs.stream.on_event(fd)
        valid = len(data) == DIVISOR.size and any(data)
        assert outputs.stream.clients == int(valid)
    for sock in list(outputs.stream._sockets):
        outputs.stream.on_event(sock.fileno())
    assert outputs.stream.clients == 0


def examples(name: str) -> tuple[bytes, ...]:
    if name == "crossbow":
        return (packet() + packet(clock=12_658) * 2,)
    if name == "seraccel":
        return (GOLDEN * 3, SUCCESSOR * 3, RAW * 3, BINARY * 3)
    if name == "iio":
        return ((b"\1" + bytes(16)) * 2 + b"\0" + bytes(24),)
    frame = {"epson": b"\x20" + bytes(20) + b"\r", "epson-windowed": b"\x80" + bytes(18) + b"\r"}[name]
    return (frame * 4,)
