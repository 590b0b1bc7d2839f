"""Files that a command reads and writes: keeps what comes through a pipe, and refuses to write over its own input."""

import atexit
import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path

from ..errors import CannotCreateError


def input_file(text: str) -> Path:
    """Type of an argument: a file to be read. A pipe (`-`, `<(zcat …)`) can be read only once, so it becomes a file.

    Raises OSError if that has no room.
    """
    path = Path("/dev/stdin" if text == "-" else text)
    return _kept(path) if path.is_fifo() else path


def _kept(pipe: Path) -> Path:
    """A file with all that came through the pipe; it exists until this process ends."""
    folder = Path(tempfile.mkdtemp(prefix="imud-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    copy = folder / pipe.name
    with pipe.open("rb") as source, copy.open("wb") as file:
        shutil.copyfileobj(source, file)
    return copy


def keep_apart(written: Iterable[Path | None], read: Iterable[Path | None]) -> None:
    """Raises CannotCreateError if what is to be written stands where something is read from."""
    sources = [path for path in read if path is not None and path.exists()]
    for path in written:
        if path is not None and path.is_file() and any(path.samefile(source) for source in sources):
            raise CannotCreateError(f"{path} is read here, and would be written over: choose another output")
