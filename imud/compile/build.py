"""Compiles C to a shared library whose numbers are those of numba, to the last bit.

For that the compiler may fuse no multiplication with an addition, and keeps IEEE's rules. -ffp-contract=off alone is
not enough for gcc before 12.3, which makes vfmaddsub of a subtraction and an addition beside each other (gcc's bug
106902): so no level of processors (`levels`) has FMA.
"""

import contextlib
import errno
import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

FLAGS = (
    *("-std=gnu11", "-O3", "-w", "-pipe"),  # a pipe: an end by a signal leaves no file behind
    "-fno-ipa-cp",  # copies of functions for constants: a sixth of the time to compile, and no faster
    *("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-fwrapv", "-fno-strict-aliasing"),
)
UNTRANSLATABLE = 3  # exit code of `python -m imud.compile`: a kernel has no translation, which no compiler mends
_LIBRARY = ("-fPIC", "-shared", "-Wl,-Bsymbolic")


class CannotBuildError(Exception):
    """There is no compiler, or it failed; the message says which."""


def compiler(target: str | None = None) -> list[str]:
    """The command of the C compiler: $CC, else one on the PATH, else Python's `ziglang`. Raises CannotBuildError.

    target: another machine, as zig names it, for example aarch64-linux-gnu.2.28; then it is `ziglang`.
    """
    zig = [sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline"]  # else of this machine, with FMA
    if target is not None:
        if importlib.util.find_spec("ziglang") is None:
            raise CannotBuildError("for another machine the Python package `ziglang` is needed")
        return [*zig, "-g0", "-target", target]
    if given := os.environ.get("CC", "").split():
        if shutil.which(given[0]) is None:
            raise CannotBuildError(f"{given[0]}: {os.strerror(errno.ENOENT)}")
        return given
    for name in ("cc", "gcc", "clang"):
        if shutil.which(name):
            return [name]
    if importlib.util.find_spec("ziglang"):
        return zig
    raise CannotBuildError("there is no C compiler: install gcc or clang, or the Python package `ziglang`")


def compile_c(
    source: Path, output: Path, options: Sequence[str] = (), target: str | None = None, shared: bool = True
) -> None:
    """Compile one file of C, with more options than ours. Raises CannotBuildError with the compiler's message.

    target: another machine, see `compiler`; shared: make a shared library, not a program.
    """
    kind = _LIBRARY if shared else ()
    _run([*compiler(target), *FLAGS, *kind, *options, "-o", str(output), str(source), "-lm"])


def compile_library(sources: Iterable[Path], output: Path, target: str | None = None) -> None:
    """Compile files of C at the same time, each as soon as it comes, to one shared library. Raises as `compile_c`."""
    command = [*compiler(target), *FLAGS]
    objects, running = [], []
    with contextlib.ExitStack() as stack:
        for source in sources:
            objects.append(source.with_suffix(".o"))
            running.append(_started([*command, "-fPIC", "-c", "-o", str(objects[-1]), str(source)], stack))
        for process in running:
            _finish(process)
    _run([*command, *_LIBRARY, "-o", str(output), *map(str, objects), "-lm"])
    for made in objects:
        made.unlink()


def _run(command: list[str]) -> None:
    with contextlib.ExitStack() as stack:
        _finish(_started(command, stack))


def _started(command: list[str], stack: contextlib.ExitStack) -> "subprocess.Popen[str]":
    """A compiler that runs, until it ends or the stack is left."""
    try:
        process = stack.enter_context(subprocess.Popen(command, stderr=subprocess.PIPE, text=True))
    except OSError as error:
        raise CannotBuildError(f"{command[0]}: {error.strerror}") from error
    stack.callback(process.terminate)
    return process


def _finish(process: "subprocess.Popen[str]") -> None:
    """Wait for a compiler. Raises CannotBuildError with its message if it failed."""
    message = process.communicate()[1]
    if process.returncode:
        raise CannotBuildError(f"{shlex.join(process.args)}\n{message[:2000]}")  # type: ignore[arg-type]
