"""What happens to the daemon from outside while it soaks: clients that stall, reloads, a full disk, clock steps.

Each trouble is repeated with a period of its own, so that over the minutes they meet in all combinations.
"""

import contextlib
import math
import os
import resource
import signal
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path

from ...errors import ImudError
from ..bench import reference

_STALLED = 8  # clients of each kind that never read
_ROUND_S = 20.0  # after which they are replaced by others
_RELOAD_S, _DISK_S, _STEP_S = 17.0, 60.0, 45.0
_DISK_FULL_S = 20.0  # of each _DISK_S
_CLOCK_STEPS_S = (3600.0, -3600.0, 0.5, -0.5, 86400.0, -86400.0)  # ahead, then back again
_FLOOD = os.urandom(4096).replace(b"?", b"!") + b"?WATCH={;\r\n"
CONFIGURATION = "[gpsd]\nrate_hz = {}\n"


class StalledClients:
    """Clients that connect and never read, and one that sends garbage."""

    def __init__(self, gpsd: Path, stream: Path) -> None:
        self._gpsd, self._stream = gpsd, stream
        self._clients: list[socket.socket] = []
        self.connected = 0

    def replace(self) -> None:
        """Disconnect them all; connect others."""
        self.close()
        for _ in range(_STALLED):
            self._connect(self._gpsd, socket.SOCK_STREAM, b'?WATCH={"enable":true,"json":true,"rate":100};\n')
            self._connect(self._stream, socket.SOCK_SEQPACKET, b"")
        self._connect(self._gpsd, socket.SOCK_STREAM, _FLOOD)

    def flood(self) -> None:
        """Send more garbage."""
        with contextlib.suppress(OSError, IndexError):  # there are none yet
            self._clients[-1].send(_FLOOD)

    def _connect(self, path: Path, kind: socket.SocketKind, request: bytes) -> None:
        client = socket.socket(socket.AF_UNIX, kind)
        client.setblocking(False)
        self._clients.append(client)
        with contextlib.suppress(OSError):
            client.connect(str(path))
            self.connected += 1
            if request:
                client.send(request)

    def close(self) -> None:
        while self._clients:
            self._clients.pop().close()


class WallClock:
    """The wall clock that the daemon sees, by a library loaded before its own; needs a C compiler."""

    def __init__(self, folder: Path) -> None:
        self.environment: dict[str, str] = {}
        self.missing, self._file = "", folder / "clock"
        self.ahead_s = 0.0
        self._file.write_bytes(bytes(8))
        library = folder / "step_time.so"
        try:
            reference.compile_c(Path(__file__).with_name("step_time.c"), library, "-shared", "-fPIC")
        except reference.NoReferenceError as error:
            self.missing = str(error)
            return
        self.environment = {"LD_PRELOAD": str(library), "IMUD_CLOCK_STEP": str(self._file)}

    def step(self, seconds: float) -> None:
        """Let it jump."""
        self.ahead_s += seconds
        with self._file.open("r+b", buffering=0) as file:
            file.write(round(self.ahead_s * 1e9).to_bytes(8, "little", signed=True))


class Troubles:
    """All of them, by the clock. `counts`: how often each happened."""

    def __init__(
        self,
        daemon: subprocess.Popen[str],
        clients: StalledClients,
        clock: WallClock,
        settings: Path,
        pace: float = 1.0,
    ) -> None:
        """pace: factor of all periods."""
        self._daemon, self._clients, self._clock, self._settings = daemon, clients, clock, settings
        self.counts = dict.fromkeys(("stalled clients", "reloads", "full disks", "clock steps"), 0)
        self._due: list[tuple[float, float, Callable[[], None]]] = [
            (_ROUND_S / 4.0, _ROUND_S, self._stall),
            (_RELOAD_S, _RELOAD_S, self._reload),
            (_DISK_S - _DISK_FULL_S, _DISK_S, self._fill_disk),
            (_DISK_S, _DISK_S, self._free_disk),
        ]
        if not clock.missing:
            self._due.append((_STEP_S, _STEP_S, self._step_clock))
        self._due = [(pace * at, pace * period, act) for at, period, act in self._due]

    @property
    def due_s(self) -> float:
        """When the next one is due, in s since the start."""
        return min((at for at, *_ in self._due), default=math.inf)

    def on_time(self, elapsed_s: float) -> None:
        """Do what is due."""
        for k, (at, period, act) in enumerate(self._due):
            if elapsed_s >= at:
                self._due[k] = (at + period, period, act)
                act()

    def _stall(self) -> None:
        self._clients.replace()
        self.counts["stalled clients"] = self._clients.connected

    def _reload(self) -> None:
        self.counts["reloads"] += 1
        self._settings.write_text(CONFIGURATION.format(10 + self.counts["reloads"] % 2))
        self._daemon.send_signal(signal.SIGHUP)

    def _fill_disk(self) -> None:
        self._limit_files(0)
        self.counts["full disks"] += 1

    def _free_disk(self) -> None:
        self._limit_files(resource.RLIM_INFINITY)

    def _limit_files(self, size: int) -> None:
        """The recorder, a child of the daemon, may write so many bytes to a file; 0: as on a disk that is full."""
        with contextlib.suppress(OSError):
            children = Path(f"/proc/{self._daemon.pid}/task/{self._daemon.pid}/children").read_text().split()
            for child in map(int, children):
                hard = resource.prlimit(child, resource.RLIMIT_FSIZE)[1]
                resource.prlimit(child, resource.RLIMIT_FSIZE, (size, hard))

    def _step_clock(self) -> None:
        self._clock.step(_CLOCK_STEPS_S[self.counts["clock steps"] % len(_CLOCK_STEPS_S)])
        self.counts["clock steps"] += 1


def require_ended_well(daemon: subprocess.Popen[str], log: Path) -> None:
    """Raises ImudError if the daemon has ended by itself."""
    if daemon.poll() is not None:
        raise ImudError(f"soak: the daemon ended with code {daemon.returncode}:\n{log.read_text()[-3000:]}")
