"""The daemon's side of a recording: hands bytes and records to a process that writes, and never waits for it.

Packets for which its socket has no room (an SD card may stall for seconds) are queued up to a limit. Beyond the limit
whole packets are dropped and counted; the log says when that begins and ends.
"""

import contextlib
import os
import socket
import subprocess
import sys
import time
import uuid
from collections import deque
from collections.abc import Iterator
from functools import partial
from importlib import util
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from imud.drivers.driver import GnssConfigured, ImuConfigured

from .. import __version__
from ..configuration.settings import Settings
from ..errors import CannotCreateError, ImudError, UsageError
from ..folders import forbids_writing
from ..math.arrays import Records
from ..pipeline import NOTHING_STORED, Stored
from ..process.python import python_command
from ..sensor_errors.calibration import Calibration
from ..sensors.byte_sink import ByteSink
from ..sensors.inertial import Inertial
from .clock_fit import row_of
from .measurements import measurement_object
from .protocol import HEADER, PACKET, STATE, MessageKind

Buffer = bytes | memoryview
_SHIP_BYTES = 32 << 10
_KEPT_BYTES = 16 << 20
_SOCKET_BYTES = 1 << 20  # as far as the system allows
_CLOCK_PERIOD_NS = 1_000_000_000
_CLOSE_TIMEOUT_S = 4.0  # systemd waits 5


class Recorder:
    """One recording; not thread-safe. Raises UsageError, CannotCreateError at the start, and nothing afterwards."""

    def __init__(self, settings: Settings) -> None:
        path = Path(settings.record.path)
        _check(path)
        self.dropped = 0  # packets
        self.state: dict[str, Any] = {}  # path, bytes and trouble, as the writer reported last
        self._batch = bytearray()
        self._queue: deque[bytes] = deque()
        self._queued = self._clock_due_ns = 0
        self._full = self._dead = False
        self._end_s = 0.0
        self._gap_reported = self._end_reported = False
        try:
            self._socket, self._process = _start_writer()
        except OSError as error:  # too many descriptors, no memory
            raise CannotCreateError(f"cannot record to {path}: its writer does not start: {error.strerror}") from error
        start = {
            "record": msgspec.structs.replace(settings.record, path=str(path.absolute())),
            "facts": {
                "session": uuid.uuid4().hex,
                "version": __version__,
                "host": os.uname().nodename,
                "machine": os.uname().machine,
                "numpy": np.__version__,
                "python": sys.version.split()[0],
            },
            "ports": settings.ports,
            "settings": settings,
        }
        self._json(MessageKind.START, start)
        self._ship()

    def byte_sink(self, port: int) -> ByteSink:
        """The function that records the bytes of that port, as they are read."""
        return partial(self._raw, port)

    def _raw(self, port: int, data: Buffer, t_ns: int, pulse_ns: int | None = None) -> None:
        if pulse_ns is not None:
            self._put(MessageKind.PULSE, b"", pulse_ns, port)
        self._put(MessageKind.RAW, data, t_ns, port)

    def connected(
        self,
        port: int,
        path: str,
        configured: ImuConfigured | GnssConfigured,
        calibration: Calibration | None,
        now_ns: int,
        stored: Stored = NOTHING_STORED,
    ) -> None:
        """A device streams since `now_ns`.

        Of an inertial sensor, calibration: what is taken out of its samples; stored: with which its filter begins.
        """
        from imud.drivers.capture_messages import Connection, to_builtins

        kind = "imu" if isinstance(configured, ImuConfigured) else "gnss"
        known = {} if calibration is None else msgspec.to_builtins(calibration)
        biases = {} if stored.biases is None else msgspec.to_builtins(stored.biases)
        driver, setup = configured.identity.driver, to_builtins(configured)
        opened = Connection(now_ns, port, path, True, kind, driver, setup, known, biases, stored.checkpoint)
        self._json(MessageKind.CONNECTION, opened, port)

    def disconnected(self, port: int, path: str) -> None:
        """It streams no more."""
        from imud.drivers.capture_messages import Connection

        self._json(MessageKind.CONNECTION, Connection(time.monotonic_ns(), port, path, False), port)

    def record_solutions(self, samples: Records, solutions: Records) -> None:
        """Samples (SAMPLE) and the solutions (SOLUTION) after each."""
        t_ns = int(samples[0]["t_ns"])
        self._put(MessageKind.SAMPLES, samples.view(np.uint8).data, t_ns)
        self._put(MessageKind.SOLUTIONS, solutions.view(np.uint8).data, t_ns)

    def record_fix(self, fix: Records, innovations: Records) -> None:
        """A fix (FIX) and what the filter made of it (INNOVATION)."""
        t_ns = int(fix[0]["arrival_ns"])
        self._put(MessageKind.FIX, fix.tobytes(), t_ns)
        if len(innovations):
            self._put(MessageKind.INNOVATIONS, innovations.tobytes(), t_ns)

    def record_measurement(self, source: str, measurement: Records, innovations: Records) -> None:
        """A measurement (array of one MEASUREMENT) of an aiding source, and what the filter made of it."""
        t_ns = int(measurement[0]["arrival_ns"])
        self._put(MessageKind.MEASUREMENT, msgspec.json.encode(measurement_object(source, measurement[0])), t_ns)
        if len(innovations):
            self._put(MessageKind.INNOVATIONS, innovations.tobytes(), t_ns)

    def record_innovations(self, innovations: Records) -> None:
        """Innovations that the filter made without a fix (INNOVATION)."""
        self._put(MessageKind.INNOVATIONS, innovations.tobytes(), int(innovations[-1]["t_ns"]))

    def record_clock(self, port: int, inertial: Inertial, now_ns: int) -> None:
        """Record the state of that sensor's clock, once a second."""
        if now_ns >= self._clock_due_ns:
            self._clock_due_ns = now_ns + _CLOCK_PERIOD_NS
            self._put(MessageKind.CLOCK, row_of(inertial, port, now_ns).tobytes(), now_ns)

    def record_states(self, states: Records) -> None:
        """What a filter has found beside its solution (at most one row of FILTER_STATES)."""
        if len(states):
            self._put(MessageKind.STATES, states.tobytes(), int(states[0]["t_ns"]))

    def record_settings(self, settings: Settings) -> None:
        """These are the settings from now on."""
        self._json(MessageKind.SETTINGS, settings)

    def record_event(self, level: str, text: str, facts: dict[str, Any]) -> None:
        """A line of the log."""
        self._json(
            MessageKind.EVENT,
            {"level": level, "text": text, "facts": {name: str(fact) for name, fact in facts.items()}},
        )

    def _json(self, kind: MessageKind, value: Any, port: int = 0) -> None:
        self._put(kind, msgspec.json.encode(value), time.monotonic_ns(), port)

    def _put(self, kind: int, data: Buffer, t_ns: int, port: int = 0) -> None:
        self._batch += HEADER.pack(kind, port, 0, len(data), t_ns)
        self._batch += data
        if len(self._batch) >= _SHIP_BYTES:
            self._ship()

    def _ship(self) -> None:
        """Put what has gathered, as one packet, behind those that wait."""
        if self._batch:
            if self._dead or self._queued + len(self._batch) > _KEPT_BYTES:
                self.dropped += 1
                self._full = True
            else:
                self._queue.append(bytes(self._batch))
                self._queued += len(self._batch)
            self._batch.clear()
        try:
            while self._queue:
                self._socket.send(self._queue[0])
                self._queued -= len(self._queue.popleft())
        except BlockingIOError:
            return
        except OSError:
            self._dead = True
            self._queue.clear()
            self._queued = 0

    def tick(self) -> list[tuple[str, str]]:
        """Call several times per second: sends queued packets without waiting; returns (level, text) for the log."""
        self._ship()
        messages = []
        with contextlib.suppress(OSError):
            while packet := self._socket.recv(PACKET):
                level, _, text = packet.decode(errors="replace").partition(":")
                if level == STATE:
                    self.state = msgspec.json.decode(text)
                else:
                    messages.append((level, text))
        if self._dead and not self._end_reported:
            self._end_reported = True
            self.state = {"trouble": "the recording ended: its writer is gone"}
            messages.append(("error", f"{self.state['trouble']}; everything else goes on"))
        elif self._full and not (self._gap_reported or self._dead):
            self._gap_reported = True
            messages.append(("warning", "the recording has gaps from here: its disk is too slow"))
        elif self._full and not self._queue and not self._dead:
            self._full = self._gap_reported = False
            messages.append(("info", f"the recording is whole again; {self.dropped} packets are missing in it so far"))
        return messages

    @property
    def has_lost_its_writer(self) -> bool:
        """Whether nothing more is recorded; `tick` has said so."""
        return self._end_reported

    def discard_unused(self) -> None:
        """Leave no file behind, if no device has streamed."""
        self._put(MessageKind.DISCARD, b"", time.monotonic_ns())

    def begin_close(self) -> None:
        """Begin to send the rest and to finish the file. Call `is_finished` until it returns True."""
        self._end_s = time.monotonic() + _CLOSE_TIMEOUT_S

    def is_finished(self) -> bool:
        """After `begin_close`: whether the file is finished. Gives up after some seconds."""
        self._ship()
        late = time.monotonic() > self._end_s
        if not self._queue or self._dead or late:
            self._socket.close()
            self._dead = True
        if late:
            self._process.kill()
        return self._process.poll() is not None

    def close(self) -> None:
        """`begin_close`, and wait until the file is finished."""
        self.begin_close()
        while not self.is_finished():
            time.sleep(0.01)


@contextlib.contextmanager
def recording(settings: Settings) -> Iterator[Recorder | None]:
    """The recording that `settings.record` asks for, until the block ends; None: it asks for none."""
    recorder = Recorder(settings) if settings.record.path else None
    try:
        yield recorder
    except ImudError:
        if recorder is not None:
            recorder.discard_unused()
        raise
    finally:
        if recorder is not None:
            recorder.close()


def _start_writer() -> tuple[socket.socket, "subprocess.Popen[bytes]"]:
    """Our end of the socket, and the process at the other. Raises OSError."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setblocking(False)
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SOCKET_BYTES)
    with theirs:
        try:
            return ours, subprocess.Popen(
                python_command("imud.recording.writer", str(theirs.fileno())),
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C is for us, and ends it by our end
            )
        except OSError:
            ours.close()
            raise


def _check(path: Path) -> None:
    """Refuse at once what cannot become a recording."""
    if util.find_spec("mcap") is None:
        raise UsageError("recordings need the package mcap: pip install 'imud[record]'")
    if path.is_dir():
        raise CannotCreateError(f"cannot record to {path}: it is a folder; name a file, such as {path / 'drive.mcap'}")
    if path.exists() and not path.is_file():  # the recording would be /dev/null.0001, in memory
        raise CannotCreateError(f"cannot record to {path}: it is a device, a pipe or a socket; name a file")
    if not path.absolute().parent.is_dir():
        raise CannotCreateError(f"cannot record to {path}: there is no folder {path.parent}")
    if why := forbids_writing(path.absolute().parent):
        raise CannotCreateError(f"cannot record to {path}: {why}")
