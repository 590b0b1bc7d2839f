"""The newest state in a file on a tmpfs, behind a sequence lock: readers map it and need no system call.

Layout, all little-endian: the lock (uint64: 0 before the first state, odd while one is written), the record
(`imud.client.FIELDS`), and the exclusive or of the record's 64-bit words, for readers that cannot order their reads.
Who may write to the file (its own user, root) can end the daemon by truncating it: SIGBUS. Linux seals only memory
that has no path, so there is nothing against that; all others may only read.
"""

import fcntl
import mmap
import os

import numpy as np
from numpy.typing import NDArray

from drivers.entry import entry
from imud.client import MAGIC, SHARED_SIZE
from imud.compile.system import fence
from imud.errors import CannotCreateError, PermissionDeniedError

WORD = np.dtype(np.uint64)
_LOCK_BYTES = WORD.itemsize  # before the record


@entry
def write(memory: NDArray[np.uint64], record: NDArray[np.uint64]) -> None:
    """The record, as 64-bit words, into memory that has room for three more."""
    lock = memory[0]
    memory[0] = lock + np.uint64(1)
    fence()
    check = np.uint64(0)
    for i in range(len(record)):
        memory[i + 1] = record[i]
        check ^= record[i]
    memory[len(record) + 1] = check
    fence()
    memory[0] = lock + np.uint64(2)


class SharedMemory:
    """The one writer of one file. Not thread-safe."""

    def __init__(self, path: str) -> None:
        """Create, or take over what an earlier run left. Raises CannotCreateError (73), PermissionDeniedError (77)."""
        self._file = _open(path)
        try:
            os.ftruncate(self._file, SHARED_SIZE)
            self._memory: NDArray[np.uint64] = np.frombuffer(mmap.mmap(self._file, SHARED_SIZE), np.uint64)
        except OSError as error:
            os.close(self._file)
            raise CannotCreateError(f"cannot share memory in {path}: {error.strerror}") from error
        self._memory[0] = 0

    @property
    def address(self) -> int:
        """Of the file in our memory."""
        return int(self._memory.ctypes.data)

    def publish(self, record: NDArray[np.uint64]) -> None:
        """The newest record, as 64-bit words."""
        write(self._memory, record)

    def close(self) -> None:
        """Let readers know that there is no state any more."""
        self._memory[0] = 0
        os.close(self._file)


def _open(path: str) -> int:
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
    try:
        file = os.open(path, flags, 0o644)
    except PermissionError as error:
        raise PermissionDeniedError(f"cannot share memory in {path}: permission denied") from error
    except OSError as error:
        raise CannotCreateError(f"cannot share memory in {path}: {error.strerror}") from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(file)
        raise CannotCreateError(f"cannot share memory in {path}: another imud writes there") from error
    if os.fstat(file).st_size and os.pread(file, len(MAGIC), _LOCK_BYTES) not in (MAGIC, bytes(len(MAGIC))):
        os.close(file)
        raise CannotCreateError(f"cannot share memory in {path}: that file is something else; choose another name")
    os.fchmod(file, 0o644)  # whatever a service's umask
    return file
