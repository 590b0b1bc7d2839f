"""imud and a C daemon of the same function side by side, each on a pseudo-terminal of its own.

Frames go to both in turn, half a period apart, so that whatever slows the machine slows both. Both are bound to one
processor, as most of a frame's time is the kernel's wake-up, which costs twice as much from another processor. This
process subscribes to each daemon's state stream, and takes the time from the writing of a frame to the arrival of its
solution.
"""

import contextlib
import os
import select
import socket
import struct
import subprocess
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from ...client import RECORD
from ...errors import ImudError
from ...process.python import python_command
from . import reference, signals
from .throughput import attitude_pipeline

_PERIOD_NS = 1_000_000
_START_S = 3600.0  # a first start compiles
_TIMEOUT_S, _SILENCE_S = 2.0, 0.2  # to the first pending solution; after the last one
_SEQ = struct.Struct("<8xQ")


class Contestant:
    """A daemon, the line on which it receives frames, and our subscription to its solutions."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name = name
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        self.tty = os.ttyname(self._slave)
        self.path = folder / f"{name}.stream"
        self.latencies_ns: list[int] = []
        self.overruns = 0  # frames for which the line had no room
        self.written: list[int] = []  # when, ns
        self.first = 0  # seq of the first of them
        self.process: subprocess.Popen[bytes] | None = None
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)

    @property
    def pid(self) -> int:
        assert self.process is not None
        return self.process.pid

    def start(self, command: list[str], log: Path, environment: dict[str, str] | None) -> None:
        with log.open("wb") as file:
            self.process = subprocess.Popen(command, stderr=file, stdout=subprocess.DEVNULL, env=environment)
        os.sched_setaffinity(self.pid, {max(os.sched_getaffinity(0))})

    def connect(self) -> bool:
        """False while the daemon does not listen yet. Raises ImudError if it has ended."""
        assert self.process is not None
        if self.process.poll() is not None:
            raise ImudError(f"bench: the daemon {self.name} ended by itself with {self.process.returncode}")
        try:
            self.socket.connect(str(self.path))
        except OSError:
            return False
        self.socket.setblocking(False)
        return True

    def write(self, frame: bytes) -> None:
        self.written.append(time.monotonic_ns())
        try:
            os.write(self.master, frame)
        except BlockingIOError:
            self.overruns += 1

    def receive(self) -> int:
        """Read all waiting solutions; returns the last seq, 0 for none."""
        seq = 0
        with contextlib.suppress(BlockingIOError):
            while record := self.socket.recv(RECORD.size):
                now_ns = time.monotonic_ns()
                (seq,) = _SEQ.unpack_from(record)
                if 0 <= seq - self.first < len(self.written):
                    self.latencies_ns.append(now_ns - self.written[seq - self.first])
        return seq

    def cpu_ns(self) -> int:
        """Processor time of all its threads so far, those that have ended, too."""
        return time.clock_gettime_ns(~self.pid << 3 | 2)  # the clock that clock_getcpuclockid(3) names

    def status_mb(self, name: str) -> float:
        """Of /proc/PID/status, such as VmRSS."""
        lines = Path(f"/proc/{self.pid}/status").read_text().splitlines()
        return next(float(line.split()[1]) / 1024.0 for line in lines if line.startswith(f"{name}:"))

    def close(self) -> None:
        self.socket.close()
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(10.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        os.close(self.master)
        os.close(self._slave)


class Pacer:
    """Frames to all contestants at 1 kHz each, in turn, by absolute deadlines; slowness: times slower."""

    def __init__(self, contestants: list[Contestant], slowness: int = 1) -> None:
        self._contestants = contestants
        self._period_ns = _PERIOD_NS * slowness
        self._frames = [row.tobytes() for row in signals.frames(1 << 15)]
        self._sent = 0
        self._by_fd = {c.socket.fileno(): c for c in contestants}

    def feed(self, n: int) -> None:
        """Write n frames to each; receive solutions meanwhile."""
        connected = [c.socket for c in self._contestants if c.first]
        gap_ns = self._period_ns // len(self._contestants)
        deadline = time.monotonic_ns()
        for _ in range(n):
            frame = self._frames[self._sent % len(self._frames)]
            self._sent += 1
            for contestant in self._contestants:
                self._wait(connected, deadline)
                contestant.write(frame)
                deadline += gap_ns
        self._wait(connected, deadline + 20 * self._period_ns)

    def wait_for(self, n: int, timeout_s: float = _TIMEOUT_S) -> None:
        """Wait for pending solutions."""
        deadline = time.monotonic() + timeout_s
        while min(len(c.latencies_ns) for c in self._contestants) < n and time.monotonic() < deadline:
            self._wait([c.socket for c in self._contestants], time.monotonic_ns() + 20 * self._period_ns)

    def _wait(self, sockets: list[socket.socket], deadline: int) -> None:
        while (left := deadline - time.monotonic_ns()) > 0:
            for sock in select.select(sockets, [], [], left * 1e-9)[0]:
                self._by_fd[sock.fileno()].receive()


def _imud(folder: Path, contestant: Contestant) -> list[str]:
    settings = ("readonly=true", f"stream.listen={contestant.path}")
    return [
        *python_command("imud.commands.bench.observed", str(folder / "observed.json"), "run"),
        *("--port", f"{contestant.tty}:epson@460800", "--estimator", "attitude"),
        *("--listen", str(folder / "gpsd"), *(word for s in settings for word in ("--set", s))),
    ]


def _c_daemon(folder: Path, contestant: Contestant, options: Sequence[str]) -> list[str]:
    """Compile. Raises NoReferenceError."""
    text, memory = reference.pipeline_source(attitude_pipeline())
    (folder / "kernels.c").write_text(text)
    (folder / "memory").write_bytes(memory)
    reference.compile_c(reference.SOURCES / "daemon.c", folder / "daemon", f"-I{folder}", *options)
    return [str(folder / "daemon"), contestant.tty, str(contestant.path), str(folder / "memory")]


def _unchanged(name: str, command: list[str]) -> list[str]:
    return command


@contextlib.contextmanager
def race(
    folder: Path,
    wrap: Callable[[str, list[str]], list[str]] = _unchanged,
    environment: dict[str, str] | None = None,
    slowness: int = 1,
    options: Sequence[str] = (),
) -> Iterator[tuple[list[Contestant], str]]:
    """Both daemons, streaming and subscribed; and the reason if there is no C daemon.

    wrap: changes a contestant's command before it is run, in this environment; options: of the C compiler.
    """
    contestants, why = [Contestant("imud", folder)], ""
    try:
        contestants[0].start(wrap("imud", _imud(folder, contestants[0])), folder / "imud.log", environment)
        try:
            command = _c_daemon(folder, contestant := Contestant("c", folder), options)
            contestants.append(contestant)
            contestant.start(wrap("c", command), folder / "c.log", environment)
        except reference.NoReferenceError as error:
            contestant.close()
            why = str(error)
        _wait_for_solutions(Pacer(contestants, slowness), contestants, folder)
        yield contestants, why
    finally:
        for contestant in contestants:
            contestant.close()


def _wait_for_solutions(pacer: Pacer, contestants: list[Contestant], folder: Path) -> None:
    """Feed until every daemon streams to us."""
    deadline = time.monotonic() + _START_S
    waiting = list(contestants)
    while waiting:
        waiting = [c for c in waiting if not c.connect()]
        pacer.feed(100)
        if time.monotonic() > deadline:
            raise ImudError(f"bench: no daemon to measure: {(folder / 'imud.log').read_text()[-500:]}")
    while not all(c.receive() for c in contestants):
        pacer.feed(100)
        if time.monotonic() > deadline:
            raise ImudError(f"bench: no solution came: {(folder / 'imud.log').read_text()[-500:]}")


def match_sequence(pacer: Pacer, contestants: list[Contestant]) -> None:
    """Learn which solution belongs to the next frame written."""
    for contestant in contestants:
        contestant.receive()  # the queue, which is outdated: the daemon had to drop newer solutions
    pacer.feed(1)
    for contestant in contestants:
        seq = 0
        while select.select([contestant.socket], [], [], _TIMEOUT_S if not seq else _SILENCE_S)[0]:
            seq = contestant.receive()
        if not seq:
            raise ImudError(f"bench: no solution comes from the daemon {contestant.name}")
        contestant.first = seq + 1
        contestant.written, contestant.overruns = [], 0
        contestant.latencies_ns.clear()
