"""A filter's checkpoint as a file: one for each sensor, on a tmpfs where there is one, for the next run of the daemon.

It is used once, by the next run, and only if nothing but a gap in the samples can lie between: the same boot, the same
sensor on the same port, seconds ago, and the right digest. Any other file in its place is ignored, and old ones of
sensors and ports that did not come back are removed.
"""

import contextlib
import functools
import time
from pathlib import Path

import msgspec

from ..compile.hashing import digest_of
from ..folders import boot_id, folders_for, read_file, save_in

_NS = 1_000_000_000
_UNUSED_S = 86400.0  # on the clock of the files, which may step: files that old are removed
_SUSPENDED_NS = 100_000_000  # if the two clocks differ by more, the machine was suspended and samples were lost


class _Header(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    sensor: str
    port: str
    boot_id: str
    monotonic_ns: int
    boottime_ns: int  # CLOCK_BOOTTIME, which goes on while the machine is suspended
    digest: str  # of the checkpoint


def save(sensor: str, port: str, checkpoint: bytes) -> None:
    """Replace the file as a whole, in the first folder that may be written. Raises OSError if there is none."""
    now = time.monotonic_ns(), time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    header = _Header(sensor, _printable(port), boot_id(), *now, digest_of(checkpoint))
    save_in(_folders(), _name(sensor, port), msgspec.json.encode(header) + b"\n" + checkpoint)


def take(sensor: str, port: str, max_age_ns: int) -> bytes:
    """The checkpoint that an earlier run has left at most `max_age_ns` ago; empty: none. Its file is removed."""
    found = b""
    for folder in _folders():
        with contextlib.suppress(OSError, msgspec.DecodeError, UnicodeDecodeError):
            path = folder / _name(sensor, port)
            head, _, checkpoint = read_file(path).partition(b"\n")
            path.unlink()  # a checkpoint with which the daemon fails must not fail the next run, too
            header = msgspec.json.decode(head, type=_Header)
            age_ns = time.monotonic_ns() - header.monotonic_ns
            suspended_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) - header.boottime_ns - age_ns
            same = (header.sensor, header.port, header.boot_id) == (sensor, _printable(port), boot_id())
            intact = header.digest == digest_of(checkpoint)
            if same and intact and 0 <= age_ns <= max_age_ns and suspended_ns <= _SUSPENDED_NS and not found:
                found = checkpoint
        _remove_unused(folder)
    return found


def _remove_unused(folder: Path) -> None:
    """Remove old checkpoints, and what a daemon that was killed while it wrote one has left of it."""
    for path in (*folder.glob("filter-*"), *folder.glob(".filter-*")):
        with contextlib.suppress(OSError):
            if time.time() - path.lstat().st_mtime > _UNUSED_S:
                path.unlink()


def _folders() -> list[Path]:
    return [*folders_for("runtime"), *folders_for("state")]


def _printable(port: str) -> str:
    """The path of a port as JSON can hold it: a path may have bytes that are no UTF-8."""
    return port.encode(errors="surrogateescape").decode(errors="backslashreplace")


@functools.lru_cache(maxsize=4)
def _name(sensor: str, port: str) -> str:
    key = digest_of(f"{sensor}\n{port}".encode(errors="surrogateescape"))
    return f"filter-{key[:16]}"
