"""A recording as a port: the bytes of one of its devices, readable at their recorded times.

It begins where all its devices stream. Lines that play the same file at the same time share that beginning, so that
inertial sensor and receiver stay together.
"""

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from weakref import WeakValueDictionary

from ..capture_messages import Connection, Raw
from ..driver import GnssConfigured, ImuConfigured
from ..errors import CaptureError, NotSerialError, PortAbsentError, PortEndedError, PortSupportError
from .portspec import PortSpec
from .timer import Timer

try:
    from .. import capture
except ImportError:
    capture = None  # type: ignore[assignment]

START_NS = 200_000_000  # from the opening to the first byte


class _Playback:
    """Where the beginning of a file lies on our clock."""

    def __init__(self, first_ns: int) -> None:
        self.shift_ns = time.monotonic_ns() + START_NS - first_ns


_playing: WeakValueDictionary[Path, _Playback] = WeakValueDictionary()


class ReplayPort:
    """One device of a recording: `replay:FILE[:DRIVER]`, or `:imu`, `:gnss`; else its first inertial sensor.

    Not thread-safe. Raises PortAbsentError, NotSerialError, PortSupportError on opening; PortEndedError at the end.
    """

    warning, plain = "", False
    configured: ImuConfigured | GnssConfigured

    def __init__(self, spec: PortSpec) -> None:
        self.path = spec.path
        if capture is None:
            raise PortSupportError(spec.path, f"{spec.path}: recordings need: pip install 'imud[record]'")
        file = Path(spec.path.partition(":")[2])
        try:
            recording = capture.Capture(file)
            first_ns, connection = self._device(recording, spec.driver or "imu")
            self.configured = connection.imu() if connection.kind == "imu" else connection.gnss()
        except (CaptureError, ValueError) as error:
            raise NotSerialError(spec.path, f"{file} cannot be played: {error}") from error
        except OSError as error:
            raise PortAbsentError(spec.path, f"{file} cannot be read: {error.strerror}") from error
        self._playback = _playing.setdefault(file.resolve(), _Playback(first_ns))
        self._pending = self._reads(recording, connection.port, first_ns)
        self._timer = Timer()
        self.fd = self._timer.fd
        self._next = next(self._pending, None)
        self._wait()

    def _device(self, recording: "capture.Capture", wanted: str) -> tuple[int, Connection]:
        """When the last of its devices began to stream, and the device that is wanted."""
        devices = recording.devices()
        for device in devices:
            if wanted in (device.kind, device.driver):
                return max(other.t_ns for other in devices), device
        there = ", ".join(device.driver for device in devices) or "none"
        raise CaptureError(f"{recording.path}: no {wanted} in it; its devices: {there}")

    def _reads(self, recording: "capture.Capture", port: int, first_ns: int) -> Iterator[Raw]:
        """The reads of that port from then on."""
        for entry in recording:
            for number, raw in entry.reads() or ():
                if number == port and raw.data and raw.t_ns >= first_ns:
                    yield raw

    def _wait(self) -> None:
        due_ns = 1 if self._next is None else self._next.t_ns + self._playback.shift_ns
        self._timer.set(due_ns)

    @property
    def counters(self) -> Mapping[str, int]:
        """Nothing goes wrong on this line."""
        return {}

    def receive(self, buffer: memoryview, now_ns: int) -> tuple[int, int]:
        """The bytes of the next reading, and when they came, on our clock; none before that."""
        if self._next is None:
            raise PortEndedError(self.path, f"{self.path} has been played to its end")
        arrival_ns = self._next.t_ns + self._playback.shift_ns
        if arrival_ns > now_ns:
            self._wait()
            return 0, now_ns
        data = self._next.data[: len(buffer)]
        buffer[: len(data)] = data
        if len(data) < len(self._next.data):
            self._next = Raw(self._next.t_ns, self._next.data[len(data) :])
        else:
            self._next = next(self._pending, None)
        self._wait()
        return len(data), arrival_ns

    def read(self) -> bytes:
        """As `receive`, without the time."""
        buffer = memoryview(bytearray(4096))
        received, _ = self.receive(buffer, time.monotonic_ns())
        return bytes(buffer[:received])

    def set_baud(self, baud: int) -> None:
        """A recording has its own speed."""

    def discard(self) -> None:
        """Nothing is discarded."""

    def write(self, data: bytes) -> int:
        """Nothing is sent."""
        return 0

    def close(self) -> None:
        """May be called twice."""
        if self.fd >= 0:
            self._timer.close()
            self.fd = -1
