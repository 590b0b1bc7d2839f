"""The shared library with all kernels: its path, and whether it was built from these sources.

`pip install` builds it, into this folder. The file's last line holds the digests of its sources and of its code. A
library of other sources, of another processor, or damaged is never loaded: with a C compiler it is rebuilt, in some
15 s; else numba compiles the kernels, in minutes. The order of search: $IMUD_KERNELS alone, if it is set; this folder;
the cache folder, if this one cannot be written. IMUD_JIT=1 uses numba.
"""

import ctypes
import functools
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from .hashing import digest_of

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "imud"  # our sources: `imud/drivers` is a link in a checkout, a folder where it is installed
INSTALLED = Path(__file__).with_name("kernels.so")


def digest(files: Sequence[str], root: Path = ROOT) -> str:
    """Digest of these files of the sources, names and contents. Raises OSError if one is not there."""
    contents = [(name, (root / name).read_bytes()) for name in files]
    return digest_of(*(f"{name}\0{len(content)}\0".encode() + content for name, content in contents))


def defect(library: Path) -> str | None:
    """Why a library must not be loaded; None: it may."""
    try:
        code, _, line = library.read_bytes().rpartition(b"\n")
        seal = json.loads(line)
        if seal["code"] != digest_of(code):
            return "is damaged"
        if seal["machine"] != os.uname().machine:
            return f"is for {seal['machine']}"
        return None if seal["sources"] == digest(seal["files"]) else "is of other sources"
    except FileNotFoundError:
        return "does not exist, or is of sources that do not"
    except OSError as error:
        return str(error)
    except (ValueError, KeyError, TypeError):
        return "is damaged"


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


def origin() -> str:
    """The library that this process's kernels are from, or numba."""
    loaded = library()
    return "numba" if loaded is None else loaded._name


@functools.cache
def library() -> ctypes.CDLL | None:
    """The library of these sources, built if need be; None: numba has to compile. Once per process."""
    if os.environ.get("IMUD_JIT", "0") not in ("", "0"):
        return None
    if path := current():
        return ctypes.CDLL(str(path))
    from . import build, rebuild  # which most processes do not need

    try:
        return ctypes.CDLL(str(rebuild.rebuild(candidates())))
    except (build.CannotBuildError, OSError) as error:
        print(f"imud: the kernels cannot be compiled ahead of time: {error}", file=sys.stderr)
        print("imud: numba compiles them now, which takes minutes", file=sys.stderr, flush=True)
        return None


def address(symbol: str) -> int | None:
    """Where the function of this name is; None: the library does not have it, or there is none."""
    loaded = library()
    function = getattr(loaded, symbol, None) if loaded else None
    return None if function is None else ctypes.cast(function, ctypes.c_void_p).value
