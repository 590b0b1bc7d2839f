"""The newest state in a file on a tmpfs, behind a sequence lock: readers map it and need no system call.

Layout, all little-endian: the lock (uint64: 0 before the first state, odd while one is written), the record
(`imud.client.FIELDS`), the exclusive or of the record's 64-bit words, for readers that cannot order their reads, and
the daemon's `imud.client.LIVENESS`: heartbeat, pid and boot id, by which a reader detects a state that a crashed daemon
left behind. The daemon writes the file and does not map it: if a user with write permission truncates the file, the
daemon writes it anew, where a mapping would end the daemon with SIGBUS. All others may only read.

A daemon locks the file against a second one. Who may read a file may lock it, too; so a lock counts only if a daemon
has left its heartbeat or process in the file.
"""

import fcntl
import os
import stat
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..client import LIVENESS, MAGIC, RECORD, SHARED_SIZE, STALE_NS, boot_id
from ..compile.entry import entry
from ..compile.system import fence, pwrite, records
from ..errors import CannotCreateError, ImudError, PermissionDeniedError
from ..process.log import get_logger

WORD = np.dtype(np.uint64)
_LOCK_BYTES = WORD.itemsize  # before the record
_LIVENESS_WORDS = LIVENESS.size // WORD.itemsize
_HEARTBEAT = RECORD.size // WORD.itemsize + 2  # index of this word, after lock, record and check


@entry
def write(file: int, address: int, record: NDArray[np.uint64], now_ns: int) -> None:
    """Write the record, as 64-bit words, to the file and to our copy of its contents at the address."""
    size = len(record) + 2 + _LIVENESS_WORDS
    memory = records(address, size, WORD)
    lock = memory[0]
    memory[0] = lock + np.uint64(1)
    pwrite(file, address, 8, 0)
    fence()
    check = np.uint64(0)
    for i in range(len(record)):
        memory[i + 1] = record[i]
        check ^= record[i]
    memory[len(record) + 1] = check
    memory[len(record) + 2] = np.uint64(now_ns)
    pwrite(file, address + 8, size * 8 - 8, 8)
    fence()
    memory[0] = lock + np.uint64(2)
    pwrite(file, address, 8, 0)


class SharedMemory:
    """The one writer of one file. Not thread-safe."""

    def __init__(self, path: str) -> None:
        """Create the file, or reuse an earlier run's. Raises CannotCreateError (73), PermissionDeniedError (77)."""
        self.file, self._path, self._warned = _open(path), path, False
        self._memory: NDArray[np.uint64] = np.zeros(SHARED_SIZE // WORD.itemsize, WORD)
        self._memory[_HEARTBEAT:] = np.frombuffer(LIVENESS.pack(time.monotonic_ns(), os.getpid(), boot_id()), WORD)
        try:
            self._write_all()
        except OSError as error:
            os.close(self.file)
            raise CannotCreateError(f"cannot share memory in {path}: {error.strerror}") from error

    def _write_all(self) -> None:
        os.pwrite(self.file, self._memory.tobytes(), 0)

    @property
    def address(self) -> int:
        """Of the file's contents in our memory."""
        return int(self._memory.ctypes.data)

    def publish(self, record: NDArray[np.uint64]) -> None:
        """The newest record, as 64-bit words."""
        write(self.file, self.address, record, time.monotonic_ns())

    def write_heartbeat(self, now_ns: int) -> None:
        """Call several times per second: readers see that the daemon runs.

        Restores a file that was truncated or removed, as systemd-logind removes those of a user who has logged out.
        """
        self._memory[_HEARTBEAT] = now_ns
        try:
            if not os.path.lexists(self._path):
                new = _open(self._path)
                os.dup2(new, self.file, inheritable=False)  # the number is known to compiled code
                os.close(new)
        except ImudError as error:
            self._warn(str(error))
        self._try_write_all()

    def _try_write_all(self) -> None:
        """Where another program has truncated the file, there may be no space left for it."""
        try:
            self._write_all()
        except OSError as error:
            self._warn(f"the shared memory {self._path} cannot be written: {error.strerror}")

    def _warn(self, text: str) -> None:
        if not self._warned:
            get_logger().warning(text)
        self._warned = True

    def close(self) -> None:
        """Mark the file as without a state and without a running daemon."""
        self._memory[0] = self._memory[_HEARTBEAT] = 0
        self._try_write_all()
        os.close(self.file)


def _open(path: str) -> int:
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
    try:
        file = os.open(path, flags, 0o644)
    except PermissionError as error:
        raise PermissionDeniedError(f"cannot share memory in {path}: permission denied") from error
    except OSError as error:
        raise CannotCreateError(f"cannot share memory in {path}: {error.strerror}") from error
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise CannotCreateError(f"cannot share memory in {path}: that is no regular file; choose another name")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if _has_daemon(file):
            os.close(file)
            raise CannotCreateError(f"cannot share memory in {path}: another imud writes there") from error
        get_logger().warning(f"a program that is no imud holds a lock of the shared memory {path}")
    if os.fstat(file).st_size and os.pread(file, len(MAGIC), _LOCK_BYTES) not in (MAGIC, bytes(len(MAGIC))):
        os.close(file)
        raise CannotCreateError(f"cannot share memory in {path}: that is another kind of file; choose another name")
    os.fchmod(file, 0o644)  # whatever a service's umask
    return file


def _has_daemon(file: int) -> bool:
    """Whether a daemon writes to the file, or has created it and will; one that is stopped does, too."""
    liveness = os.pread(file, LIVENESS.size, _HEARTBEAT * WORD.itemsize)
    if len(liveness) < LIVENESS.size:
        return True
    heartbeat_ns, pid, boot = LIVENESS.unpack(liveness)
    if heartbeat_ns == 0 or boot != boot_id():
        return False
    return time.monotonic_ns() - heartbeat_ns < STALE_NS or Path(f"/proc/{pid}").exists()
