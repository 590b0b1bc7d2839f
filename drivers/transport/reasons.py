"""The meaning of the kernel's error numbers on opening a port of any kind."""

import errno
import os

ABSENT = {errno.ENOENT, errno.ENXIO, errno.ENODEV, errno.ENOTDIR}
DENIED = {errno.EACCES, errno.EPERM}
BUSY = {errno.EBUSY, errno.EAGAIN}
UNFIT = {errno.ENOTTY, errno.EINVAL, errno.EISDIR}


def reason(error: BaseException) -> str:
    """OSError and termios.error carry a number, pyserial sometimes only words."""
    return os.strerror(error.args[0]) if error.args and isinstance(error.args[0], int) else str(error)
