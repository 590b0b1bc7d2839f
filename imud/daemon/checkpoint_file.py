"""A filter's checkpoint as files: two for each sensor, on a tmpfs where there is one, for the next run of the daemon.

They are written in turn and in place, so that one of them is whole whenever the daemon is killed, and a second costs
little. The newer one is used once, by the next run, and only if nothing but a gap in the samples can lie between: the
same boot, the same sensor on the same port, seconds ago, and the right digest. Any other file in its place is ignored,
and old ones of sensors and ports that did not come back are removed.
"""

import contextlib
import time
from pathlib import Path

import msgspec

from ..compile.hashing import digest_of
from ..folders import boot_id, folders_for, overwrite_file, read_file, save_in

_UNUSED_S = 86400.0  # on the clock of the files, which may step: files that old are removed
_SUSPENDED_NS = 100_000_000  # if the two clocks differ by more, the machine was suspended and samples were lost


class _Header(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    sensor: str
    port: str
    boot_id: str
    monotonic_ns: int
    boottime_ns: int  # CLOCK_BOOTTIME, which goes on while the machine is suspended
    digest: str  # of the checkpoint


class CheckpointFiles:
    """Of a sensor on a port. Not thread-safe."""

    def __init__(self, sensor: str, port: str) -> None:
        key = digest_of(f"{sensor}\n{port}".encode())[:16]
        self.names = (f"filter-{key}", f"filter-{key}-b")
        self._sensor, self._port = sensor, port
        self._folders = [*folders_for("runtime"), *folders_for("state")]
        self._paths = [[folder / name for folder in self._folders] for name in self.names]

    def save(self, checkpoint: bytes) -> None:
        """Write the older one, in the first folder that may be written. Raises OSError if there is none."""
        now = time.monotonic_ns(), time.clock_gettime_ns(time.CLOCK_BOOTTIME)
        header = _Header(self._sensor, self._port, boot_id(), *now, digest_of(checkpoint))
        save_in(self._paths[0], msgspec.json.encode(header) + b"\n" + checkpoint, overwrite_file)
        self._paths.reverse()

    def take(self, max_age_ns: int) -> bytes:
        """The newest checkpoint, which an earlier run has left at most `max_age_ns` ago; empty: none. Removes all."""
        found, newest_ns = b"", -1
        for path in (path for paths in self._paths for path in paths):
            with contextlib.suppress(OSError, msgspec.DecodeError, UnicodeDecodeError):
                head, _, checkpoint = read_file(path).partition(b"\n")
                path.unlink()  # a checkpoint with which the daemon fails must not fail the next run, too
                header = msgspec.json.decode(head, type=_Header)
                age_ns = time.monotonic_ns() - header.monotonic_ns
                suspended_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) - header.boottime_ns - age_ns
                same = (header.sensor, header.port, header.boot_id) == (self._sensor, self._port, boot_id())
                intact = header.digest == digest_of(checkpoint)
                timely = 0 <= age_ns <= max_age_ns and suspended_ns <= _SUSPENDED_NS
                if same and intact and timely and header.monotonic_ns > newest_ns:
                    found, newest_ns = checkpoint, header.monotonic_ns
        for folder in self._folders:
            _remove_unused(folder)
        return found


def _remove_unused(folder: Path) -> None:
    """Remove old checkpoints, and what a daemon that was killed while it wrote one has left of it."""
    for path in (*folder.glob("filter-*"), *folder.glob(".filter-*")):
        with contextlib.suppress(OSError):
            if time.time() - path.lstat().st_mtime > _UNUSED_S:
                path.unlink()
