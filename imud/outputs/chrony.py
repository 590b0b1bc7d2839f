"""The receiver's time for chrony or ntpd: a sample per fix in the shared memory segment that both call refclock SHM.

Each sample is the time of the system clock at the epoch of a fix. Its error is that of `gnss.latency_s` plus the jitter
of the serial line, which is given as the precision: good enough to set a clock without a network to some hundredths of
a second, not to discipline one with a network. Let chrony start first and create the segment (`perm=0660`, with imud's
user in chrony's group): systemd removes a segment that a service created when the service ends (RemoveIPC), and chrony
would continue to read the old one. A process that may write to the segment can set the machine's clock.

Source: ntpd's refclock 28 (struct shmTime); chrony.conf(5), refclock SHM. The key is "NTP0" and the unit.
"""

import ctypes
import errno
import math
import os
import struct
import time

from imud.drivers.fix import Fix

from ..errors import CannotCreateError, PermissionDeniedError

KEY = 0x4E545030
_IPC_CREAT, _IPC_STAT = 0o1000, 2
_OTHERS_WRITE = 0o002
_NS = 1_000_000_000
_JITTER_GAIN = 1.0 / 16.0  # of one sample in the jitter
_COARSE, _FINE = 0, -10  # precision, log2 s
_UNDATED_NS = 10 * _NS  # without a date for so long, the receiver sends none: RMC or ZDA come more often
_STEP_S = 1.0  # a change of the offset between two fixes that is no jitter


class _ShmTime(ctypes.Structure):
    """struct shmTime; 96 bytes where time_t has 64 bits."""

    _fields_ = (
        ("mode", ctypes.c_int),
        ("count", ctypes.c_int),
        ("clock_s", ctypes.c_long),
        ("clock_us", ctypes.c_int),
        ("receive_s", ctypes.c_long),
        ("receive_us", ctypes.c_int),
        ("leap", ctypes.c_int),
        ("precision", ctypes.c_int),
        ("nsamples", ctypes.c_int),
        ("valid", ctypes.c_int),
        ("clock_ns", ctypes.c_uint),
        ("receive_ns", ctypes.c_uint),
        ("dummy", ctypes.c_int * 8),
    )


def _libc() -> ctypes.CDLL:
    libc = ctypes.CDLL(None, use_errno=True)
    libc.shmget.argtypes = (ctypes.c_int, ctypes.c_size_t, ctypes.c_int)
    libc.shmat.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_int)
    libc.shmat.restype = ctypes.c_void_p
    libc.shmdt.argtypes = (ctypes.c_void_p,)
    return libc


class ChronyOutput:
    """The writer of one unit. Never waits; not thread-safe."""

    def __init__(self, unit: int, mode: int = 0o600) -> None:
        """Attach to the segment; create it with these permissions if chrony has not.

        is_open_to_all: it was there already, and every user may write to it.
        Raises CannotCreateError (73), PermissionDeniedError (77).
        """
        self._offset_s: float | None = None
        self._dated_ns: int | None = None  # arrival of the last fix with a date, at first of the first fix
        self._jitter_s = 1.0
        self._libc = _libc()
        before = os.umask(0)
        try:
            segment = self._libc.shmget(KEY + unit, ctypes.sizeof(_ShmTime), _IPC_CREAT | mode)
        finally:
            os.umask(before)
        address = self._libc.shmat(segment, None, 0) if segment >= 0 else None
        if address is None or address == ctypes.c_void_p(-1).value:
            raise _attach_error(unit, ctypes.get_errno())
        self._address = address
        self.is_open_to_all = self._mode(segment) & _OTHERS_WRITE & ~mode != 0
        self._memory = _ShmTime.from_address(address)
        self._memory.valid, self._memory.mode = 0, 1

    def _mode(self, segment: int) -> int:
        """Permissions of the segment; 0 if the kernel does not say."""
        status = ctypes.create_string_buffer(256)  # struct shmid_ds: key, four ids, mode
        failed = self._libc.shmctl(segment, _IPC_STAT, status)
        return 0 if failed else int(struct.unpack_from("20xI", status)[0])

    def publish(self, fix: Fix, latency_s: float) -> None:
        """Publish the time of a fix; its epoch is `latency_s` before its arrival.

        One by which a clock has been set since the fix before, this machine's or the receiver's, is not published:
        a receiver whose date jumps from fix to fix gives none. Of a receiver that sends dates only fixes with a date
        are published: without one the day is that of the clock which is to be set.
        """
        system_less_monotonic_ns = time.time_ns() - time.monotonic_ns()
        receive_ns = fix.arrival_ns - round(latency_s * 1e9) + system_less_monotonic_ns
        clock_ns = fix.utc_ns(receive_ns)
        if self._dated_ns is None or fix.date is not None:
            self._dated_ns = fix.arrival_ns
        if clock_ns is None or (fix.date is None and fix.arrival_ns - self._dated_ns < _UNDATED_NS):
            return
        before_s, self._offset_s = self._offset_s, (clock_ns - receive_ns) * 1e-9
        change_s = None if before_s is None else abs(self._offset_s - before_s)
        if change_s is not None and change_s > _STEP_S:
            return
        memory = self._memory
        memory.valid = 0
        memory.count += 1
        memory.clock_s, memory.clock_ns = divmod(clock_ns, _NS)
        memory.receive_s, memory.receive_ns = divmod(receive_ns, _NS)
        memory.clock_us, memory.receive_us = memory.clock_ns // 1000, memory.receive_ns // 1000
        memory.leap, memory.precision = 0, self._precision(change_s)
        memory.count += 1
        memory.valid = 1

    def _precision(self, change_s: float | None) -> int:
        """log2 of the precision in s, from the change of the offset since the fix before."""
        if change_s is not None:
            self._jitter_s += _JITTER_GAIN * (change_s - self._jitter_s)
        return max(_FINE, min(_COARSE, math.ceil(math.log2(max(self._jitter_s, 2.0**_FINE)))))

    def close(self) -> None:
        """Detach. The segment stays: chrony, if it runs, continues to read it."""
        if self._address:
            self._memory.valid = 0
            self._libc.shmdt(self._address)
            self._address = 0


def _attach_error(unit: int, code: int) -> Exception:
    what = f"cannot share time with chrony (chrony.shm_unit = {unit}): {os.strerror(code)}"
    if code in (errno.EACCES, errno.EPERM):
        return PermissionDeniedError(
            f"{what}; another user created the segment: `refclock SHM {unit}:perm=0660` in chrony.conf opens it to "
            "chrony's group, of which imud's user must be a member"
        )
    if code == errno.EINVAL:
        return CannotCreateError(f"{what}: there is a smaller one; remove it with `ipcrm -M {KEY + unit:#x}`")
    return CannotCreateError(what)
