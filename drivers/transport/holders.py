"""The other processes that have a terminal line open, found in /proc as `fuser` does.

Two kinds of process do not count: the one that owns the master side of a pseudo-terminal, which is its device, even if
it also holds the slave side open; and those that started this process.
"""

import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PTMX = os.makedev(5, 2)
PTS_MAJORS = range(136, 144)


@dataclass(frozen=True)
class Holder:
    """A process that has the line open."""

    pid: int
    command: str

    def __str__(self) -> str:
        return f"process {self.pid} ({self.command})"


def is_pty(status: os.stat_result) -> bool:
    """Whether this is the slave side of a pseudo-terminal."""
    return os.major(status.st_rdev) in PTS_MAJORS


def holders(status: os.stat_result) -> list[Holder]:
    """Processes, as far as this user may see them, that hold the device of `status` open."""
    ignored = {os.getpid(), *_ancestors()}
    return [Holder(pid, _command(pid)) for pid in _pids() if pid not in ignored and _holds(pid, status)]


def _pids() -> Iterator[int]:
    return (int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdecimal())


def _holds(pid: int, status: os.stat_result) -> bool:
    holds = False
    try:
        descriptors = list(Path(f"/proc/{pid}/fd").iterdir())
    except OSError:  # gone, or another user's
        return False
    for descriptor in descriptors:
        try:
            other = descriptor.stat()
        except OSError:
            continue
        if not stat.S_ISCHR(other.st_mode):
            continue
        if is_pty(status) and other.st_rdev == PTMX and _drives(pid, descriptor.name, status):
            return False
        # each container numbers its pseudo-terminals anew: the file system tells them apart
        same_system = not is_pty(status) or other.st_dev == status.st_dev
        holds |= other.st_rdev == status.st_rdev and same_system
    return holds


def _drives(pid: int, descriptor: str, status: os.stat_result) -> bool:
    """Whether this master side is that of the slave `status`."""
    index = 256 * (os.major(status.st_rdev) - PTS_MAJORS[0]) + os.minor(status.st_rdev)
    try:
        lines = Path(f"/proc/{pid}/fdinfo/{descriptor}").read_text().splitlines()
    except OSError:
        return False
    return any(line.split() == ["tty-index:", str(index)] for line in lines)


def _ancestors() -> Iterator[int]:
    pid = os.getppid()
    while pid > 1:
        yield pid
        try:
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return
        pid = int(fields[1])


def _command(pid: int) -> str:
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().rstrip(b"\0").split(b"\0")
    except OSError:
        return "gone"
    line = " ".join(b" ".join(words).decode(errors="replace").split())
    return line if len(line) <= 100 else line[:97] + "..."
