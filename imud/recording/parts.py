"""The files of a recording, `drive.mcap`, `drive.0001.mcap`, …: none is overwritten, the oldest make room for new."""

import contextlib
import os
import re
from pathlib import Path


def number_of(path: Path, base: Path) -> int | None:
    """Which part of the recording `base` the file is; None: it is none."""
    if path.name == base.name:
        return 0
    found = re.fullmatch(rf"{re.escape(base.stem)}\.(\d{{4,}}){re.escape(base.suffix)}", path.name)
    return int(found[1]) if found else None


def existing(base: Path) -> list[Path]:
    """The parts that there are, oldest first."""
    numbered = [(number, path) for path in base.parent.iterdir() if (number := number_of(path, base)) is not None]
    return [path for _, path in sorted(numbered)]


def next_file(base: Path) -> Path:
    """The name of the next part."""
    before = existing(base)
    if not before:
        return base
    last = number_of(before[-1], base)
    assert last is not None
    return base.with_name(f"{base.stem}.{last + 1:04d}{base.suffix}")


def free_bytes(base: Path) -> int:
    """Room left on its disk for this user."""
    disk = os.statvfs(base.parent)
    return disk.f_bavail * disk.f_frsize


def make_room(base: Path, budget: int, current: Path) -> list[Path]:
    """Remove the oldest parts until all take at most `budget` bytes, but not `current`; returns those removed.

    What is no plain file, or may not be removed, is left as it is.
    """
    sizes = {path: path.lstat().st_size for path in existing(base) if path.is_file() and not path.is_symlink()}
    removed = []
    for path in list(sizes):
        if sum(sizes.values()) <= budget or path == current:
            break
        with contextlib.suppress(OSError):
            path.unlink()
            removed.append(path)
        del sizes[path]
    return removed
