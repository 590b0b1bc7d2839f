"""The shared library with all kernels: its path, and whether it was built from these sources.

`pip install` builds it, into this folder. The file's last line holds the digests of its sources and of its code. A
library of other sources, of another processor, or damaged is never loaded: with a C compiler it is rebuilt, in some
15 s; else numba compiles the kernels, in minutes. The order of search: $IMUD_KERNELS alone, if it is set; this folder;
the cache folder, if this one cannot be written. IMUD_JIT=1 uses numba.
"""

import ctypes
import functools
import importlib.util
import os
import sys
from pathlib import Path

from ..errors import UsageError
from .hashing import digest_of
from .levels import of_processor
from .seal import ROOT, defect

INSTALLED = Path(__file__).with_name("kernels.so")
_WANTED = "IMUD_JIT is set"


def candidates() -> list[Path]:
    """Where the library is looked for, and built: the first of them that can be written."""
    if given := os.environ.get("IMUD_KERNELS"):
        return [Path(given).resolve()]
    from ..folders import folders_for

    name = f"kernels-{digest_of(str(ROOT).encode())[:12]}.so"  # of this installation
    return [INSTALLED, *(folder / name for folder in folders_for("cache"))]


def current() -> Path | None:
    """Where the library of these sources is; None: it has to be built."""
    return next((path for path in candidates() if defect(path) is None), None)


def outlook() -> tuple[bool, str]:
    """Whether the next start will have a library, and a sentence about it. Builds nothing."""
    if numba_is_wanted():
        return False, f"numba compiles the kernels, in minutes: {_WANTED}"
    if path := current():
        return True, f"compiled kernels are in {path}"
    from . import build

    try:
        compiler = build.compiler()
    except build.CannotBuildError as error:
        return False, f"numba compiles the kernels, in minutes: {error}"
    return True, f"the kernels will be compiled by {compiler[0]} at the next start, in some 15 s"


def origin() -> str:
    """The library that this process's kernels are from; or numba, and why."""
    loaded, why_numba = _loaded()
    return f"numba: {why_numba}" if loaded is None else loaded._name


def library() -> ctypes.CDLL | None:
    """The library of these sources, built if need be; None: numba has to compile. Once per process.

    Raises UsageError if there is neither, or if a kernel has no translation to C.
    """
    return _loaded()[0]


def numba_is_wanted() -> bool:
    """Whether the user has asked for numba instead of the library."""
    return os.environ.get("IMUD_JIT", "0") not in ("", "0")


@functools.cache
def _loaded() -> tuple[ctypes.CDLL | None, str]:
    """The library, or None and why numba has to compile."""
    if numba_is_wanted():
        require_numba()
        return None, _WANTED
    if path := current():
        return ctypes.CDLL(str(path)), ""
    from . import build, rebuild  # which most processes do not need

    try:
        return ctypes.CDLL(str(rebuild.rebuild(candidates()))), ""
    except (build.CannotBuildError, OSError) as error:
        print(f"imud: the kernels cannot be compiled ahead of time: {error}", file=sys.stderr)
        require_numba()
        print("imud: numba compiles them now, which takes minutes", file=sys.stderr, flush=True)
        return None, str(error)


def require_numba() -> None:
    """Raises UsageError where it is not installed: on 32-bit ARM there is none."""
    if importlib.util.find_spec("numba") is None:
        raise UsageError("numba is not installed: pip install numba; or install gcc, and start again without IMUD_JIT")


def address(symbol: str) -> int | None:
    """Where the function of this name is; None: the library does not have it, or there is none."""
    loaded = library()
    functions = (getattr(loaded, symbol + level, None) for level in of_processor()) if loaded else ()
    return next((ctypes.cast(found, ctypes.c_void_p).value for found in functions if found is not None), None)
