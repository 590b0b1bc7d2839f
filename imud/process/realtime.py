"""The settings of `[realtime]`: memory that is never paged out, a real-time priority, a choice of processors.

They are applied once, before READY. All of them need permission, and a refusal fails the start, so that a control loop
does not find out by being late. Pages are locked when they are touched (MCL_ONFAULT); by then all that the kernels need
has been touched.
"""

import ctypes
import errno
import os
from typing import NoReturn

from ..configuration.settings import Realtime
from ..errors import ConfigError, ImudError, PermissionDeniedError

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_POLICIES = {"fifo": os.SCHED_FIFO, "rr": os.SCHED_RR}
_GRANT = (
    "in a service: `imud install-service --realtime`, or LimitRTPRIO= and LimitMEMLOCK=infinity in a drop-in; in a "
    "shell: `ulimit -r` and `ulimit -l`, which /etc/security/limits.conf raises"
)


def apply(settings: Realtime) -> None:
    """Apply them. Raises ConfigError (78) for processors that do not exist, PermissionDeniedError (77)."""
    if settings.cpus:
        _pin(set(settings.cpus))
    if settings.lock_memory:
        _lock()
    if settings.scheduler != "other":
        _schedule(settings.scheduler, settings.priority)


def _pin(cpus: set[int]) -> None:
    try:
        os.sched_setaffinity(0, cpus)
    except OSError as error:
        allowed = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
        raise ConfigError(f"realtime.cpus = {sorted(cpus)}: {error.strerror}; there are {allowed}") from error


def _lock() -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
        _refused("realtime.lock_memory", ctypes.get_errno())


def _schedule(name: str, priority: int) -> None:
    try:
        os.sched_setscheduler(0, _POLICIES[name], os.sched_param(priority))
    except OSError as error:
        _refused(f"realtime.scheduler = {name} at priority {priority}", error.errno or 0)


def _refused(what: str, code: int) -> NoReturn:
    if code in (errno.EPERM, errno.ENOMEM, errno.EAGAIN):  # by a limit that is too low
        raise PermissionDeniedError(f"{what}: not permitted; {_GRANT}")
    raise ImudError(f"{what}: {os.strerror(code)}")
