"""Files that a command reads and writes: copies a pipe to a file, and refuses to overwrite an input."""

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
    return _copy_of_pipe(path) if path.is_fifo() else path


def _copy_of_pipe(pipe: Path) -> Path:
    """A file with all bytes of the pipe; it exists until this process ends."""
    folder = Path(tempfile.mkdtemp(prefix="imud-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    copy = folder / pipe.name
    with pipe.open("rb") as source, copy.open("wb") as file:
        shutil.copyfileobj(source, file)
    return copy


def refuse_overwriting(written: Iterable[Path | None], read: Iterable[Path | None]) -> None:
    """Raises CannotCreateError if a file is to be written that is also read, or written twice."""
    sources = [path for path in read if path is not None and path.exists()]
    outputs: set[Path] = set()
    for path in written:
        if path is None or (path.exists() and not path.is_file()):  # a device, such as /dev/null, takes any number
            continue
        if path.exists() and any(path.samefile(source) for source in sources):
            raise CannotCreateError(f"{path} is an input, and would be overwritten: choose another output")
        if path.resolve() in outputs:
            raise CannotCreateError(f"{path} is to be written twice: choose another name for one of the outputs")
        outputs.add(path.resolve())
