"""The process that writes a recording: `python -m imud.recording.writer FD`. Reads packets until the daemon's end.

Each second a chunk is ended and synchronised to the disk. A disk that is full or fails pauses the recording; when it
works again, the recording goes on in a new file.
"""

import contextlib
import os
import signal
import socket
import sys
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from imud.drivers.capture_messages import CONNECTIONS, READS, Connection, Raw, Reads

from ..configuration.settings import Record
from ..estimators.filter_states import FILTER_STATES
from . import parts
from .enu import LocalMap
from .file import RecordingFile
from .foxglove import encoded_location, encoded_transform, location, transform
from .messages import (
    AIDING,
    CLOCK_TABLE,
    ESTIMATE_TABLE,
    EVENTS,
    FIX_TABLE,
    INNOVATION_TABLE,
    INNOVATIONS,
    LOCATION,
    POSE,
    SAMPLE_TABLE,
    SETTINGS,
    STATES,
    Table,
    innovation_messages,
)
from .protocol import PACKET, STATE, MessageKind, items
from .state_messages import states_message
from .thinner import Thinner

_MB = 1 << 20
_COMMIT_S = 1.0
_DESCRIBE_S = 30.0  # between descriptions of what is recorded
_RETRY_S = 5.0
_BEGIN_MB = 1  # free for a file to begin: else a disk that is full to the last byte would fill with beginnings
_STEP_NS = 500_000_000  # by so much the clock on the wall may differ until its step is followed
_NICE = 5
_READS_BYTES = 1 << 16  # of the ports, which become one message at most
_ORDERED = {  # what was read from ports before these stays before them
    MessageKind.CONNECTION,
    MessageKind.SETTINGS,
    MessageKind.MEASUREMENT,
    MessageKind.CLOCK,
}
_encode = msgspec.json.encode


class RecordingWriter:
    """The recording of one daemon. log: called with (level, text) of each line for the daemon's log."""

    def __init__(self, start: dict[str, Any], log: Any) -> None:
        self._record = msgspec.convert(start["record"], Record)
        self._base = Path(self._record.path)
        self._facts: dict[str, str] = start["facts"] | {"ports": " ".join(start["ports"])}
        self._settings: Any = start["settings"]
        self._log = log
        self._part = 0
        self._offset_ns = time.time_ns() - time.monotonic_ns()
        self._connections: dict[int, Connection] = {}
        self._pulses: dict[int, int] = {}
        self._reads: list[tuple[int, Raw]] = []
        self._unwritten = 0  # bytes of them
        self._samples = Thinner(self._record.sample_rate_hz)
        self._estimates = Thinner(self._record.estimate_rate_hz)
        self._plane = LocalMap()
        self._file: RecordingFile | None = None
        self._opened_s = self._described_s = self._retry_s = 0.0
        self._trouble = ""
        self._open()

    def take(self, kind: int, port: int, t_ns: int, data: bytes) -> None:
        """An item of a packet."""
        if kind in _ORDERED:
            self._write_reads()
        if kind == MessageKind.RAW:
            self._reads.append((port, Raw(t_ns, data, self._pulses.pop(port, None))))
            self._unwritten += len(data)
            if self._unwritten >= _READS_BYTES:
                self._write_reads()
        elif kind == MessageKind.PULSE:
            self._pulses[port] = t_ns
        elif kind == MessageKind.SAMPLES:
            self._rows(SAMPLE_TABLE, self._samples.kept(np.frombuffer(data, SAMPLE_TABLE.dtype)))
        elif kind == MessageKind.SOLUTIONS:
            self._solutions(self._estimates.kept(np.frombuffer(data, ESTIMATE_TABLE.dtype)))
        elif kind == MessageKind.FIX:
            self._rows(FIX_TABLE, np.frombuffer(data, FIX_TABLE.dtype), t_ns)
        elif kind == MessageKind.CLOCK:
            self._rows(CLOCK_TABLE, np.frombuffer(data, CLOCK_TABLE.dtype))
        elif kind == MessageKind.STATES:
            for row in np.frombuffer(data, FILTER_STATES):
                self._write(STATES, t_ns, states_message(row))
        elif kind == MessageKind.INNOVATIONS:
            for message in innovation_messages(np.frombuffer(data, INNOVATION_TABLE.dtype)):
                self._write(INNOVATIONS, t_ns, message)
        elif kind == MessageKind.MEASUREMENT:
            self._write(AIDING, t_ns, data)
        elif kind == MessageKind.CONNECTION:
            self._connections[port] = msgspec.json.decode(data, type=Connection)
            self._write(CONNECTIONS, t_ns, data)
        elif kind == MessageKind.EVENT:
            self._write(EVENTS, t_ns, _encode({"t_ns": t_ns, **msgspec.json.decode(data)}))
        elif kind == MessageKind.SETTINGS:
            self._settings = msgspec.json.decode(data)
            self._write(SETTINGS, t_ns, _encode({"t_ns": t_ns, "settings": self._settings}))
        elif kind == MessageKind.DISCARD and self._file is not None and not self._connections:
            self._file.discard()
            self._file = None

    def _write_reads(self) -> None:
        """What was read from the ports, before anything that must come after it."""
        if self._reads:
            self._write(READS, self._reads[0][1].t_ns, Reads.of(self._reads).encode())
            self._reads.clear()
            self._unwritten = 0

    def _rows(self, table: Table, rows: Any, t_ns: int | None = None) -> None:
        for message, row_ns in zip(table.encode(rows), rows["t_ns"].tolist(), strict=True):
            self._write(table.topic, t_ns or row_ns, message)

    def _solutions(self, rows: Any) -> None:
        self._rows(ESTIMATE_TABLE, rows)
        for entry in ESTIMATE_TABLE.objects(rows):
            t_ns = entry["t_ns"]
            unix_ns = t_ns + self._offset_ns
            if (where := encoded_location(location(entry, unix_ns))) is not None:
                self._write(LOCATION, t_ns, where)
            if (pose := encoded_transform(transform(entry, unix_ns, self._plane))) is not None:
                self._write(POSE, t_ns, pose)

    def _write(self, topic: str, t_ns: int, data: bytes) -> None:
        if self._file is not None:
            self._guard(lambda file: file.write(topic, t_ns + self._offset_ns, data))

    def _guard(self, act: Any) -> None:
        try:
            act(self._file)
        except OSError as error:
            assert self._file is not None
            self._file.abandon()
            self._pause(f"the disk refuses it: {error.strerror}")

    def _pause(self, why: str) -> None:
        self._file = None
        self._retry_s = time.monotonic() + _RETRY_S
        if why != self._trouble:
            self._trouble = why
            self._log("error", f"recording pauses: {why}; everything else goes on")

    def _open(self) -> None:
        """The next file, with what a reader must know first."""
        facts = self._facts | {"part": str(self._part), "unix_less_monotonic_ns": str(self._offset_ns)}
        try:
            if why := self._why_full(max(self._record.spare_mb, _BEGIN_MB)):
                self._pause(why)
                return
            path = parts.next_file(self._base)
            self._file = RecordingFile(path, facts, _encode(self._settings), time.time_ns())
        except OSError as error:
            self._pause(f"cannot write in {self._base.parent}: {error.strerror}")
            return
        self._opened_s = time.monotonic()
        self._part += 1
        self._trouble = ""
        self._log("info", f"recording to {path}")
        self._describe()

    def _describe(self) -> None:
        """What a reader must know to use what follows: at the start, and again, as the chunk with it may be damaged."""
        now_ns = time.monotonic_ns()
        self._described_s = now_ns * 1e-9
        if self._file is not None:
            self._file.declare_again()
        for connection in self._connections.values():
            if connection.streaming:
                repeated = msgspec.structs.replace(connection, repeated=True)
                self._write(CONNECTIONS, now_ns, _encode(repeated))

    def commit(self) -> None:
        """Do what is due each second: synchronise to the disk, begin a new file, make room, follow the wall clock."""
        offset_ns = time.time_ns() - time.monotonic_ns()
        if abs(offset_ns - self._offset_ns) > _STEP_NS:
            self._offset_ns = offset_ns
        self._write_reads()
        if self._file is None:
            if time.monotonic() >= self._retry_s:
                self._open()
            return
        self._guard(lambda file: file.commit())
        if self._file is not None:
            self._guard(self._keep_to_limits)  # its folder may be gone
        if self._file is not None and time.monotonic() - self._described_s >= _DESCRIBE_S:
            self._describe()

    def publish_state(self) -> None:
        """Send the state of the recording: where it goes, how large the file is, and what keeps it from growing."""
        file = self._file
        state = {"path": str(file.path) if file else "", "bytes": file.size if file else 0, "trouble": self._trouble}
        self._log(STATE, _encode(state).decode())

    def _keep_to_limits(self, file: RecordingFile) -> None:
        record = self._record
        if record.budget_mb:
            for path in parts.make_room(self._base, record.budget_mb * _MB, file.path):
                self._log("info", f"removed {path}: the recordings may take {record.budget_mb} MB (record.budget_mb)")
        if why := self._why_full(record.spare_mb):
            self._guard(lambda file: file.finish())
            if self._file is not None:
                self._pause(why)
        elif not file.is_in_place:
            self._log("warning", f"{file.path} was removed or renamed while it was recorded to: it ends here")
            self._begin_next()
        elif (0 < record.file_mb * _MB <= file.size) or (0.0 < record.file_s <= time.monotonic() - self._opened_s):
            self._begin_next()

    def _why_full(self, spare_mb: int) -> str:
        """What to report if less is free than that; empty: there is room."""
        if parts.free_bytes(self._base) >= spare_mb * _MB:
            return ""
        return f"less than {spare_mb} MB are free where {self._base} is (record.spare_mb)"

    def _begin_next(self) -> None:
        self._guard(lambda file: file.finish())
        self._open()

    def finish(self) -> None:
        """The end."""
        self._write_reads()
        if self._file is not None:
            self._guard(lambda file: file.finish())


def _lower_priority() -> None:
    """Below the daemon's, as far as this machine permits: the filter of system calls of a service may forbid each."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))  # the service may be a real-time one
    with contextlib.suppress(OSError):
        os.nice(_NICE)


def main(fd: int) -> None:
    """Write what comes until the other side is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # sent to a whole service; the end of the daemon is ours
    _lower_priority()
    with socket.socket(fileno=fd) as packets:

        def log(level: str, text: str) -> None:
            with contextlib.suppress(OSError):
                packets.send(f"{level}:{text}".encode(), socket.MSG_DONTWAIT)

        writer: RecordingWriter | None = None
        due_s = time.monotonic() + _COMMIT_S
        while True:
            packets.settimeout(max(0.01, due_s - time.monotonic()))
            with contextlib.suppress(TimeoutError, ConnectionResetError):  # reset: it left without hearing us out
                packet = packets.recv(PACKET)
                if not packet:
                    break
                for kind, port, t_ns, data in items(packet):
                    if writer is None:
                        writer = RecordingWriter(msgspec.json.decode(data), log)
                        writer.publish_state()
                    else:
                        writer.take(kind, port, t_ns, data)
            if time.monotonic() >= due_s:
                due_s = time.monotonic() + _COMMIT_S
                if writer is not None:
                    writer.commit()
                    writer.publish_state()
        if writer is not None:
            writer.finish()


if __name__ == "__main__":
    main(int(sys.argv[1]))
