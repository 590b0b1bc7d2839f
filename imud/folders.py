"""Folders for our files: the service manager's first, then the user's own, named by the XDG rules."""

import contextlib
import errno
import functools
import os
import stat
from collections.abc import Callable, Iterable
from pathlib import Path

_FILE_MAX = 16 << 20  # bytes; the largest that imud keeps, a filter's checkpoint, has some 25 kB
_OWN = {"cache": ".cache", "state": ".local/state"}
_XDG = {"cache": "XDG_CACHE_HOME", "state": "XDG_STATE_HOME", "runtime": "XDG_RUNTIME_DIR"}


def folders_for(kind: str) -> list[Path]:
    """Folders for "cache", "state" or "runtime" (gone at the next boot), in order of preference; may be none.

    A service's user may have no home, and only a session or a service has a runtime folder.
    """
    found = []
    if service := os.environ.get(f"{kind.upper()}_DIRECTORY"):  # systemd.exec(5)
        found.append(Path(service.split(":")[0]))
    if named := os.environ.get(_XDG[kind]):
        found.append(Path(named) / "imud")
    elif kind in _OWN:
        with contextlib.suppress(RuntimeError):  # there is no home
            found.append(Path.home() / _OWN[kind] / "imud")
    return found


def read_file(path: Path) -> bytes:
    """All of a file that imud keeps. Raises OSError, also if it is a pipe or a device, or too long to be such a file.

    Reading a pipe would wait for another program, and reading a device might never end.
    """
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK | os.O_NOCTTY)) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
        if len(content := file.read(_FILE_MAX + 1)) > _FILE_MAX:
            raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
        return content


def replace_file(path: Path, content: bytes) -> None:
    """Write a file as a whole, in a folder that is made if need be; only the user may read it. Raises OSError."""
    if not path.parent.is_dir():
        path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_name(f".{path.name}-{os.getpid()}")
    try:
        with open(new, "wb", opener=lambda name, flags: os.open(name, flags, 0o600)) as file:
            file.write(content)
        new.replace(path)
    except OSError:
        new.unlink(missing_ok=True)
        raise


def overwrite_file(path: Path, content: bytes) -> None:
    """As `replace_file`, but in place if it can be, in a fifth of the time: no file is made, and written out at once.

    If it is interrupted, the file has neither its old nor its new content.
    """
    try:
        _write_in_place(path, content)
    except OSError:  # there is none, or it is no regular file, has other names, or is another user's
        replace_file(path, content)


def _write_in_place(path: Path, content: bytes) -> None:
    fd = os.open(path, os.O_WRONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY)
    try:
        before = os.fstat(fd)
        if not stat.S_ISREG(before.st_mode) or before.st_nlink != 1 or before.st_uid != os.geteuid():
            raise OSError(errno.EINVAL, "it is no regular file of ours alone", str(path))
        left = memoryview(content)
        while left:
            left = left[os.write(fd, left) :]
        if before.st_size > len(content):
            os.ftruncate(fd, len(content))
    finally:
        os.close(fd)


def save_in(paths: Iterable[Path], content: bytes, write: Callable[[Path, bytes], None] = replace_file) -> None:
    """Write the first of the files that may be written. Raises OSError, which names the last one, if there is none."""
    refused = OSError("there is no folder for state")
    for path in paths:
        try:
            write(path, content)
            return
        except OSError as error:
            refused = OSError(error.errno, error.strerror, str(path)) if error.filename is None else error
    raise refused


def forbids_writing(folder: Path) -> str:
    """Why no file can be made in a folder that there is; empty: nothing is known against it. Raises OSError."""
    if os.access(folder, os.W_OK):
        return ""
    if os.statvfs(folder).f_flag & os.ST_RDONLY:  # as of a card that the kernel found damaged
        return f"the file system of {folder} is read-only"
    return f"no permission to write in {folder}"


@functools.cache
def boot_id() -> str:
    """Of the machine, another one after each boot."""
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
