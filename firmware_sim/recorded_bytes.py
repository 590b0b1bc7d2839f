"""A recording's own bytes on the emulated line: a daemon's MCAP, with what each port received and when.

The emulated device answers the host's questions as always. When the host has started its stream, the recorded bytes are
sent in place of its own, at their recorded distances; a stream that is started again begins the recording anew. A
receiver beside an inertial sensor begins with that sensor; until then it says that it has no fix.
"""

import base64
import binascii
import io
import json
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .device import RECEIVERS, Device
from .replay import DataError
from .uart import BITS, Damage

_CONNECTIONS, _READS, _RAW = "/connections", "/raw", "/raw/"
_LOOP_GAP_S = 0.01  # between the end of a lap and the next one
_MODELS = {  # by driver: the emulated device for a model that begins like this
    "epson": {"M-G350": "g350", "M-G364": "g364", "M-G365": "g365", "M-G370": "g370"},
    "crossbow": {"": "rga300"},
    "seraccel": {"": "seraccel"},
    "nmea": {"": "nmea"},
    "ubx": {"u-blox NEO-M8": "m8", "": "ubx"},
}
Chunks = list[tuple[int, bytes]]  # arrival in ns, and the bytes of one read


@dataclass
class RecordedPort:
    """One port of a recording, with the device that was first there."""

    path: Path
    device: str  # as `imud sim` calls it; empty: it has none like it
    model: str
    polled: bool
    rate_hz: float
    chunks: Chunks = field(default_factory=list)


@dataclass
class Playback:
    """What the devices of one recording have in common: where it is, in the emulation's time."""

    first_ns: int  # of the recording
    period_s: float  # until it is repeated; infinite: it is not
    began_s: float = math.inf


def read(path: Path) -> list[RecordedPort]:
    """The ports of a recording. Raises DataError, OSError."""
    try:
        from mcap.exceptions import McapError
        from mcap.reader import NonSeekingReader
    except ImportError:
        raise DataError(f"{path}: recordings need the package mcap: pip install 'imud[record]'") from None
    ports: dict[int, RecordedPort] = {}
    with path.open("rb") as file:
        try:
            for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
                if channel.topic == _CONNECTIONS:
                    _connect(path, ports, json.loads(message.data))
                elif channel.topic == _READS:
                    for number, t_ns, data in _reads(message.data):
                        _add(ports, number, t_ns, data)
                elif channel.topic.startswith(_RAW):  # before version 2
                    item = json.loads(message.data)
                    data = base64.b64decode(item["data"], validate=True)
                    _add(ports, int(channel.topic[len(_RAW) :]), item["t_ns"], data)
        except (McapError, struct.error, ValueError, IndexError, KeyError, TypeError, binascii.Error) as error:
            raise DataError(
                f"{path} is damaged ({type(error).__name__}): what can be read of it plays with "
                f"`imud run --port replay:{path}`"
            ) from None
    found = [port for port in ports.values() if port.chunks]
    if not found:
        raise DataError(f"{path} has no bytes of a device: give one that `imud run --record` or `imud record` made")
    return found


def _connect(path: Path, ports: dict[int, RecordedPort], connection: dict[str, Any]) -> None:
    if connection.get("streaming", True) and connection["port"] not in ports:
        configured = connection["configured"]
        model = configured["identity"].get("model") or connection["driver"]
        names = _MODELS.get(connection["driver"], {})
        device = next((name for start, name in names.items() if model.startswith(start)), "")
        polled = configured.get("request") is not None
        ports[connection["port"]] = RecordedPort(path, device, model, polled, configured.get("rate_hz", 0.0))


def _add(ports: dict[int, RecordedPort], number: int, t_ns: int, data: bytes) -> None:
    if number in ports and data:
        ports[number].chunks.append((t_ns, data))


def _reads(message: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Port, arrival and bytes of each read of a message imud.v3.Reads or v2, all of whose fields are of wire type 2."""
    parts: dict[int, bytes] = {}
    at = 0
    while at < len(message):
        number, at = message[at] >> 3, at + 1
        size = shift = 0
        while message[at] >= 0x80:
            size, shift, at = size | (message[at] & 0x7F) << shift, shift + 7, at + 1
        size, at = size | message[at] << shift, at + 1
        parts[number] = message[at : at + size]
        at += size
    ports, sizes = parts.get(1, b""), [size for (size,) in struct.iter_unpack("<I", parts.get(3, b""))]
    if 6 not in parts:  # version 2
        data, at = parts.get(4, b""), 0
        for port, (t_ns,), size in zip(ports, struct.iter_unpack("<q", parts.get(2, b"")), sizes, strict=True):
            yield port, t_ns, data[at : at + size]
            at += size
        return
    streams, at = {}, 0
    for port, (width,) in zip(sorted(set(ports)), struct.iter_unpack("<I", parts.get(7, b"")), strict=True):
        end = at + sum(size for owner, size in zip(ports, sizes, strict=True) if owner == port)
        streams[port] = io.BytesIO(_by_rows(parts.get(8, b"")[at:end], width))
        at = end
    t_ns = 0
    elapsed = struct.iter_unpack("<q", _by_rows(parts[6], 8))
    for port, (elapsed_ns,), size in zip(ports, elapsed, sizes, strict=True):
        t_ns += elapsed_ns
        yield port, t_ns, streams[port].read(size)


def _by_rows(data: bytes, width: int) -> bytes:
    """Of rows of `width` bytes that stand there column by column, with a rest behind them that is no whole row."""
    rows = len(data) // width
    turned = bytearray(data)
    for column in range(width if rows else 0):
        turned[column : rows * width : width] = data[column * rows : (column + 1) * rows]
    return bytes(turned)


def choose(ports: list[RecordedPort], names: list[str], loop: bool) -> tuple[list[RecordedPort], Playback]:
    """The recorded port for each device, and what they have in common. Raises DataError."""
    left, chosen = list(ports), []
    for name in names:
        port = next((port for port in left if port.device == name), None)
        if port is None:
            there = ", ".join(f"{port.device or 'no emulated device'} ({port.model})" for port in ports)
            raise DataError(
                f"{ports[0].path}: there is no {name} in it, or not so many; there is {there}. Name those, or make "
                "a table of its samples, which any device can play: imud export --csv DIR"
            )
        if port.polled:
            raise DataError(
                f"{port.path}: its {port.model} was polled, so it has answers and no stream; make a table of its "
                "samples: imud export --csv DIR"
            )
        left.remove(port)
        chosen.append(port)
    leaders = [port for port in chosen if port.device not in RECEIVERS] or chosen
    first_ns = min(port.chunks[0][0] for port in leaders)
    last_ns = max(port.chunks[-1][0] for port in chosen)
    return chosen, Playback(first_ns, (last_ns - first_ns) * 1e-9 + _LOOP_GAP_S if loop else math.inf)


class BytePlayback:
    """A device whose stream is a recording's."""

    def __init__(self, device: Device, port: RecordedPort, playback: Playback, leads: bool) -> None:
        """leads: the recording begins with its stream; else with another one's. A receiver's begins at once."""
        self.uart = device.uart
        self._device, self._playback, self._leads = device, playback, leads
        self._chunks = [chunk for chunk in port.chunks if chunk[0] >= playback.first_ns]
        self._others: Damage = device.uart.damage
        self._own = False  # what is sent now is the recording's
        self._began = math.inf  # as `playback.began_s` was when the next chunk was chosen
        self._next = 0
        device.uart.damage = self._pass

    def receive(self, data: bytes, t: float) -> None:
        self.advance(t)
        self._device.receive(data, t)
        self._look(t)

    def advance(self, t: float) -> None:
        self._device.advance(t)
        self._look(t)
        self._own = True
        while (due := self._due()) <= t:
            data = self._chunk()[1]
            self.uart.send(data, due - len(data) * BITS / self.uart.baud)
            self._next += 1
        self._own = False

    def deadline(self) -> float:
        if self._streams():
            return self._due()
        return self._device.deadline()

    def restart(self, t: float) -> None:
        self._device.restart(t)
        self._look(t)

    def prepare(self) -> None:
        self._device.prepare()

    def _streams(self) -> bool:
        return self._playback.began_s < math.inf and getattr(self._device, "streaming", True)

    def _look(self, t: float) -> None:
        """Notice that a stream began, or ended."""
        if self._leads:
            streams = getattr(self._device, "streaming", True)
            if streams != (self._playback.began_s < math.inf):
                self._playback.began_s = t if streams else math.inf
        if self._began != self._playback.began_s:
            self._began, self._next = self._playback.began_s, 0

    def _chunk(self) -> tuple[int, bytes]:
        return self._chunks[self._next % len(self._chunks)]

    def _due(self) -> float:
        if not self._streams() or not self._chunks:
            return math.inf
        laps = self._next // len(self._chunks)
        if laps and math.isinf(self._playback.period_s):
            return math.inf
        since = (self._chunk()[0] - self._playback.first_ns) * 1e-9
        return self._playback.began_s + since + (laps * self._playback.period_s if laps else 0.0)

    def _pass(self, message: bytes, t: float) -> tuple[bytes, float]:
        """The device's own stream is not sent; its answers are."""
        return self._others(message, t) if self._own or not self._streams() else (b"", -math.inf)


def summary(ports: list[RecordedPort]) -> Iterator[str]:
    """A line about each, for the log."""
    for port in ports:
        seconds = (port.chunks[-1][0] - port.chunks[0][0]) * 1e-9
        size = sum(len(data) for _, data in port.chunks)
        rate = f", {port.rate_hz:g}/s" if port.rate_hz else ""
        yield f"{port.device}: {size} bytes of {seconds:.1f} s, recorded from a {port.model}{rate}"
