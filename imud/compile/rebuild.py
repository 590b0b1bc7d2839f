"""Builds the library of all kernels where there is none of these sources, in a process of its own."""

import contextlib
import fcntl
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..errors import UsageError
from . import build
from .seal import OTHER_SOURCES, ROOT, defect

LOCK_S = 60.0  # after which the next folder is tried, unless a build is at work in this one: some 15 s,
BUILD_S = 1800.0  # and at most, on a machine that is small and busy


def rebuild(candidates: Sequence[Path]) -> Path:
    """Build the library at the first of these candidates that can be written.

    Raises UsageError if a kernel has no translation, or the sources were edited meanwhile; CannotBuildError, OSError.
    """
    build.compiler()
    with _locked(candidates) as path:
        if defect(path) is not None:  # no other process has built it meanwhile
            print("imud: compiling the kernels for these sources, some 15 s", file=sys.stderr, flush=True)
            for left_behind in path.parent.glob(f"{path.stem}-*/"):  # by one that was killed: nobody else builds now
                shutil.rmtree(left_behind, ignore_errors=True)
            with tempfile.TemporaryDirectory(prefix=f"{path.stem}-", dir=path.parent) as folder:
                made = Path(folder, path.name)
                _in_a_process(made)
                if defect(made) == OTHER_SOURCES:
                    raise UsageError("the sources were edited while their kernels were compiled: start again")
                made.replace(path)  # whole or not at all
        return path


@contextlib.contextmanager
def _locked(candidates: Sequence[Path]) -> Iterator[Path]:
    """The first path in whose folder files can be written; within the block no other process builds there."""
    for path in candidates:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            folder = os.open(path.parent, os.O_RDONLY)
        except OSError:
            continue
        try:
            if os.access(path.parent, os.W_OK) and _try_lock(folder, path):
                yield path
                return
        finally:
            os.close(folder)
    raise build.CannotBuildError(
        f"none of {', '.join(str(path) for path in candidates)} can be written and is not locked"
    )


def _try_lock(folder: int, path: Path) -> bool:
    """Lock the folder of `path`, once another process has built there.

    Whoever may read it may lock it, too, and for ever; but only who may write in it has a build there.
    """
    deadline_s = time.monotonic() + LOCK_S
    while True:
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            if time.monotonic() >= deadline_s and not _is_being_built(path):
                return False
        time.sleep(0.1)


def _is_being_built(path: Path) -> bool:
    """Whether another process has begun to build it, not too long ago."""
    for folder in path.parent.glob(f"{path.stem}-*/"):
        with contextlib.suppress(OSError):  # it has just ended
            if time.time() - folder.stat().st_mtime < BUILD_S:
                return True
    return False


def _in_a_process(output: Path) -> None:
    """Build in a process of its own, which ends with this one's wait. Raises as `rebuild`."""
    command = [sys.executable, "-m", "imud.compile", str(output)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True, cwd=ROOT) as process:
        try:
            errors = process.communicate()[1]
        except BaseException:  # a signal ends us
            os.killpg(process.pid, signal.SIGKILL)
            raise
    if process.returncode == build.UNTRANSLATABLE:
        raise UsageError(f"{errors.strip()}; docs/compile.md says what a kernel may use, IMUD_JIT=1 has numba run it")
    if process.returncode:
        raise build.CannotBuildError(errors.strip()[-2000:])
