"""The daemon's fast loop, which runs without Python: poll, read, decode, stamp, filter, publish.

A line is plain when its bytes come by reading the descriptor and nobody else wants to see them. While the inertial
sensor's line is plain, a wake-up for its bytes never leaves compiled code. Control returns to Python when anything else
has happened or is due: another descriptor, a signal, a time, a read that failed, a late batch of which it must be
decided what is still published, a client whose message is due. So there is one loop, which costs as little as one in
C, and every fault is handled where it can be seen, in Python.
"""

import select

import numpy as np

from imud.drivers.transport.serial import SerialPort

from ..compile.entry import waiting_entry
from ..compile.system import CLOCK_MONOTONIC, clock_ns, ppoll, read
from ..math.arrays import Records
from ..outputs.binary import BinaryOutputs, publish
from ..pipeline import InertialPipeline
from ..stages import INERTIAL_PIPELINE, RX, ingest

FAST_LOOP = np.dtype(
    [
        ("fd", "<i4"),  # struct pollfd twice: of the line, -1: there is none that is plain
        ("events", "<i2"),
        ("happened", "<i2"),
        ("others_fd", "<i4"),  # and of the poll object with all other descriptors
        ("others_events", "<i2"),
        ("others_happened", "<i2"),
        ("timeout_s", "<i8"),  # struct timespec
        ("timeout_ns", "<i8"),
        ("time", "<i8", (2,)),  # room for another
        ("at", "<i8"),  # addresses: of this record,
        ("timeout_at", "<i8"),  # and of parts of it
        ("time_at", "<i8"),
    ],
    align=True,
)
_SECOND_NS = 1_000_000_000
_CHUNK = SerialPort.chunk  # numba has no type for the class
FAILED, PUBLISH_DUE = -1, -2


@waiting_entry
def _run_until_event(
    fast_loop: Records, stream: Records, publisher: Records, until_ns: int, publish_ns: int, max_batch: int
) -> int:
    c, s = fast_loop[0], stream[0]
    now_ns = clock_ns(CLOCK_MONOTONIC, c.time_at)
    while True:
        wait_ns = max(until_ns - now_ns, 0)
        c.timeout_s, c.timeout_ns = wait_ns // _SECOND_NS, wait_ns % _SECOND_NS
        if ppoll(c.at, 2, c.timeout_at, 0) <= 0:
            return 0
        received = read(c.fd, s.rx + s.fill, min(_CHUNK, RX - s.fill)) if c.happened != 0 else 0
        now_ns = clock_ns(CLOCK_MONOTONIC, c.time_at)  # after the read: late bytes must not seem early
        if c.happened != 0:
            if received <= 0:
                return FAILED
            n = ingest(stream, received, now_ns)
            if n > max_batch:
                return n
            if n > 0:
                publish(publisher, s.solutions, n, s.count, now_ns)
                if now_ns >= publish_ns:
                    return PUBLISH_DUE
        if c.others_happened != 0 or now_ns >= until_ns:
            return 0


class FastLoop:
    """One line and its stream, and a poll object for everything else. Not thread-safe."""

    def __init__(self) -> None:
        self.others = select.epoll()
        self._idle = np.zeros(1, INERTIAL_PIPELINE)
        self._record = np.zeros(1, FAST_LOOP)
        for name, part in (("at", "fd"), ("timeout_at", "timeout_s"), ("time_at", "time")):
            self._record[name] = self._record[part].ctypes.data
        self._record["events"] = self._record["others_events"] = select.POLLIN
        self._record["others_fd"] = self.others.fileno()
        self.detach()

    @property
    def fd(self) -> int:
        """The line's descriptor; -1: none is attached."""
        return int(self._record["fd"][0])

    def attach(self, fd: int, stream: InertialPipeline) -> None:
        """From now on, read this line into this stream."""
        self._record["fd"], self._stream = fd, stream.record

    def detach(self) -> None:
        """Stop reading the line."""
        self._record["fd"], self._stream = -1, self._idle

    def run_until_event(self, until_ns: int, outputs: BinaryOutputs, publish_ns: int, max_batch: int) -> int:
        """Wait until something happens or `until_ns`; meanwhile publish batches of at most `max_batch` solutions.

        Returns the size of a last batch that was larger than `max_batch` and was not published; FAILED if the line
        could not be read; PUBLISH_DUE once solutions were published at `publish_ns` or later; else 0.
        """
        return _run_until_event(self._record, self._stream, outputs.record, until_ns, publish_ns, max_batch)

    def close(self) -> None:
        self.others.close()
