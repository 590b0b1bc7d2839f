"""Opens a file that a command writes, and turns its failures into exit codes."""

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ..errors import CannotCreateError, InputOutputError


@contextlib.contextmanager
def open_output(path: Path) -> Iterator[BinaryIO]:
    """Open a file for writing, or stdout for `-`. Raises CannotCreateError, and InputOutputError on a full disk."""
    try:
        file = os.fdopen(sys.stdout.fileno(), "wb", closefd=False) if str(path) == "-" else path.open("wb")
    except OSError as error:
        raise CannotCreateError(f"cannot write {path}: {error.strerror}") from error
    try:
        with file:
            yield file
    except BrokenPipeError:
        raise
    except OSError as error:
        raise InputOutputError(f"cannot go on writing {path}: {error.strerror}") from error
