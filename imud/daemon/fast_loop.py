"""The daemon's fast loop, which runs without Python: poll, read, decode, stamp, filter, publish.

A line is plain when its bytes come by reading the descriptor and nothing else in the daemon needs them. While the
inertial sensor's line is plain, a wake-up for its bytes never leaves compiled code. Control returns to Python when
anything else has happened or is due: an event of another descriptor, a signal, a deadline, a read that failed, a batch
so late that publishing it is a decision, a client whose message is due. About ten times a second the loop compares what
Python has to notice soon: the status of the newest solution, its age, and whether this process stood still. So there is
one loop, which costs as little as one in C, and all errors are handled in Python.

Two things make a wake-up cheap for Linux. The wait has no timeout, which would be armed and cancelled for each frame: a
timer wakes the loop where no byte does. And the line is reported when bytes come, not while there are some
(EPOLLET), so the loop reads until a read was short. It also tries a read at every wake-up for something else, so an end
of the line that is reported together with its last bytes is noticed by the next check.
"""

import contextlib
import select

import numpy as np

from imud.drivers.transport.serial import SerialPort
from imud.drivers.transport.timer import Timer

from ..compile.entry import entry, waiting_entry
from ..compile.jit import kernel
from ..compile.system import CLOCK_MONOTONIC, EAGAIN, clock_ns, epoll_wait, errno, read, records, set_timer
from ..estimators.records import SOLUTION
from ..math.arrays import Records
from ..outputs.binary import BinaryOutputs, publish
from ..pipeline import InertialPipeline
from ..stages import BATCH, INERTIAL_PIPELINE, RX, ingest

FAST_LOOP = np.dtype(
    [
        ("fd", "<i4"),  # of the line; -1: no line is plain
        ("epoll", "<i4"),  # of the line, the timer, and all other descriptors' poll object
        ("timer", "<i4"),
        ("more", "<i4"),  # whether the line may have bytes that were not read
        ("events", "<i8", (6,)),  # three struct epoll_event, written by epoll_wait
        ("time", "<i8", (4,)),  # struct timespec, written by clock_gettime; struct itimerspec
        ("events_address", "<i8"),
        ("time_address", "<i8"),
        ("timer_ns", "<i8"),  # when the timer wakes the loop
        ("check_ns", "<i8"),  # when the next check is due
        ("watched", "<i8"),  # bits of the status whose changes Python has to notice
        ("status", "<i8"),  # these bits of the newest solution that Python knows
        ("stale_ns", "<i8"),  # age from which on the newest solution is stale
    ],
    align=True,
)
_EVENTS = 3
CHECK_NS = 100_000_000  # between two checks
_LATE_NS = 20_000_000  # of the timer for a check, at most: a frame that comes meanwhile makes the check
PAUSE_NS = 500_000_000  # between two checks: this process did not run
_CHUNK = SerialPort.chunk  # numba has no type for the class
FAILED, PUBLISH_DUE = -1, -2


@kernel
def _watched(fast_loop: Records, pipeline: Records) -> int:
    """The watched bits of the newest solution; 0 before the first."""
    c, s = fast_loop[0], pipeline[0]
    return int(records(s.solutions, BATCH, SOLUTION)[s.newest].status & c.watched) if s.newest >= 0 else 0


@entry
def _note(fast_loop: Records, pipeline: Records, now_ns: int) -> None:
    """Python knows the newest solution: the next check compares with it."""
    c = fast_loop[0]
    c.check_ns, c.status = now_ns + CHECK_NS, _watched(fast_loop, pipeline)


@kernel
def _is_quiet(fast_loop: Records, pipeline: Records, now_ns: int) -> bool:
    """The check that is due: whether there is nothing that Python has to notice now."""
    c, s = fast_loop[0], pipeline[0]
    paused = now_ns - c.check_ns > PAUSE_NS - CHECK_NS
    if paused or now_ns - s.last_data_ns > c.stale_ns or _watched(fast_loop, pipeline) != c.status:
        return False
    c.check_ns = now_ns + CHECK_NS
    return True


@kernel
def _set_timer(fast_loop: Records, until_ns: int) -> None:
    """Wake the loop at `until_ns`, or earlier for the next check."""
    c = fast_loop[0]
    c.timer_ns = min(until_ns, c.check_ns + _LATE_NS) if c.fd >= 0 else until_ns
    set_timer(c.timer, c.timer_ns, c.time_address)


@waiting_entry
def _run_until_event(
    fast_loop: Records, pipeline: Records, publisher: Records, until_ns: int, publish_ns: int, max_batch: int
) -> int:
    c, s = fast_loop[0], pipeline[0]
    _set_timer(fast_loop, until_ns)
    while True:
        ready = epoll_wait(c.epoll, c.events_address, _EVENTS, 0 if c.more else -1)
        if ready < 0:
            return 0
        received = 0
        if c.fd >= 0:
            room = min(_CHUNK, RX - s.fill)
            received = read(c.fd, s.rx + s.fill, room)
            failed = received == 0 or (received < 0 and errno() != EAGAIN)
            c.more = failed or received == room
            if failed:
                return FAILED
        now_ns = clock_ns(CLOCK_MONOTONIC, c.time_address)  # after the read, so that no stamp is before its bytes
        if received > 0:
            n = ingest(pipeline, received, now_ns)
            if n > max_batch:
                return n
            if n > 0:
                publish(publisher, s.solutions, n, s.count, now_ns)
                if now_ns >= publish_ns:
                    return PUBLISH_DUE
        others_are_ready = ready > (1 if received > 0 else 0) + (1 if now_ns >= c.timer_ns else 0)
        if others_are_ready or now_ns >= until_ns:
            return 0
        if c.fd >= 0 and now_ns >= c.check_ns:
            if not _is_quiet(fast_loop, pipeline, now_ns):
                return 0
            _set_timer(fast_loop, until_ns)


class FastLoop:
    """One line and its pipeline, and a poll object for everything else. Not thread-safe."""

    def __init__(self, watched: int = 0) -> None:
        """watched: bits of a solution's status whose changes Python has to notice."""
        self.others = select.epoll()
        self._all, self._timer = select.epoll(), Timer()
        self._all.register(self.others, select.EPOLLIN)
        self._all.register(self._timer.fd, select.EPOLLIN | select.EPOLLET)  # so nobody has to read it
        self._idle = np.zeros(1, INERTIAL_PIPELINE)
        self._idle["newest"] = -1
        self._record = np.zeros(1, FAST_LOOP)
        for name in ("events", "time"):
            self._record[f"{name}_address"] = self._record[name].ctypes.data
        self._record["watched"] = watched
        self._record["epoll"], self._record["timer"], self._record["fd"] = self._all.fileno(), self._timer.fd, -1
        self._pipeline = self._idle

    @property
    def fd(self) -> int:
        """The line's descriptor; -1: none is attached."""
        return int(self._record["fd"][0])

    def attach(self, fd: int, pipeline: InertialPipeline, stale_ns: int) -> None:
        """From now on, read this line into this pipeline; return when its newest solution is older than `stale_ns`."""
        self._record["fd"], self._record["stale_ns"], self._pipeline = fd, stale_ns, pipeline.record
        self._record["more"] = False
        self._all.register(fd, select.EPOLLIN | select.EPOLLET)

    def detach(self) -> None:
        """Stop reading the line."""
        if self.fd >= 0:
            with contextlib.suppress(OSError):  # it may be closed already
                self._all.unregister(self.fd)
        self._record["fd"], self._record["more"], self._pipeline = -1, False, self._idle

    def note(self, now_ns: int) -> int:
        """Python knows the newest solution, so that only changes count; returns the time since the last check, ns."""
        gap_ns = now_ns - int(self._record["check_ns"][0]) + CHECK_NS
        _note(self._record, self._pipeline, now_ns)
        return gap_ns

    def check_failed(self, now_ns: int) -> bool:
        """Whether the loop has returned because something that it checks has changed."""
        return self.fd >= 0 and now_ns >= int(self._record["check_ns"][0])

    def run_until_event(self, until_ns: int, outputs: BinaryOutputs, publish_ns: int, max_batch: int) -> int:
        """Wait until something happens or `until_ns`; meanwhile publish batches of at most `max_batch` solutions.

        Returns the size of a last batch that was larger than `max_batch` and was not published; FAILED if the line
        could not be read; PUBLISH_DUE once solutions were published at `publish_ns` or later; else 0.
        """
        return _run_until_event(self._record, self._pipeline, outputs.record, until_ns, publish_ns, max_batch)

    def close(self) -> None:
        self._all.close()
        self._timer.close()
        self.others.close()
