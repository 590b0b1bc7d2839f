"""The other processes that have a terminal line open, found in /proc as `fuser` does.

Two kinds of process do not count: the one that owns the master side of a pseudo-terminal, which is its device, even if
it also holds the slave side open; and those that started this process.

No `Path` is made of what is in /proc: Python keeps each part of its text, in a table that never shrinks.
"""

# ruff: noqa: PTH116, PTH123, PTH208
import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass

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
    return (int(name) for name in os.listdir("/proc") if name.isdecimal())


def _holds(pid: int, status: os.stat_result) -> bool:
    holds = False
    try:
        descriptors = os.listdir(f"/proc/{pid}/fd")
    except OSError:  # gone, or another user's
        return False
    for descriptor in descriptors:
        try:
            other = os.stat(f"/proc/{pid}/fd/{descriptor}")
        except OSError:
            continue
        if not stat.S_ISCHR(other.st_mode):
            continue
        if is_pty(status) and other.st_rdev == PTMX and _drives(pid, descriptor, status):
            return False
        # each container numbers its pseudo-terminals anew: the file system distinguishes them
        same_system = not is_pty(status) or other.st_dev == status.st_dev
        holds |= other.st_rdev == status.st_rdev and same_system
    return holds


def _read(path: str) -> bytes:
    with open(path, "rb") as file:
        return file.read()


def _drives(pid: int, descriptor: str, status: os.stat_result) -> bool:
    """Whether this master side is that of the slave `status`."""
    index = 256 * (os.major(status.st_rdev) - PTS_MAJORS[0]) + os.minor(status.st_rdev)
    try:
        lines = _read(f"/proc/{pid}/fdinfo/{descriptor}").splitlines()
    except OSError:
        return False
    return any(line.split() == [b"tty-index:", str(index).encode()] for line in lines)


def _ancestors() -> Iterator[int]:
    pid = os.getppid()
    while pid > 1:
        yield pid
        try:
            fields = _read(f"/proc/{pid}/stat").rpartition(b")")[2].split()
        except OSError:
            return
        pid = int(fields[1])


def _command(pid: int) -> str:
    try:
        words = _read(f"/proc/{pid}/cmdline").rstrip(b"\0").split(b"\0")
    except OSError:
        return "gone"
    line = " ".join(b" ".join(words).decode(errors="replace").split())
    return line if len(line) <= 100 else line[:97] + "..."
