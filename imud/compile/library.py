"""The shared library with all kernels: where it lies, whether it belongs to these sources, and how it comes there.

`pip install` builds it, into this folder. The file's last line says of which sources it was made and what its bytes
are. One that is of other sources, of another processor, or damaged is never loaded: where there is a C compiler it is
built anew, in some 15 s; else numba compiles the kernels, in minutes. In this order are looked at: $IMUD_KERNELS alone,
if it is set; this folder; the cache folder, for where this one cannot be written. IMUD_JIT=1 takes numba at once.
"""

import contextlib
import ctypes
import fcntl
import functools
import hashlib
import json
import os
import platform
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from . import build

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("imud", "drivers")  # that have kernels
INSTALLED = Path(__file__).with_name("kernels.so")


def digest(files: Sequence[str], root: Path = ROOT) -> str:
    """Digest of these files of the sources, names and contents. Raises OSError if one is not there."""
    whole = hashlib.sha256()
    for name in files:
        content = (root / name).read_bytes()
        whole.update(f"{name}\0{len(content)}\0".encode() + content)
    return whole.hexdigest()


def loaded_sources(root: Path = ROOT) -> list[str]:
    """The source files of ours that this process has loaded: whatever the kernels depend on is among them."""
    folders = tuple(f"{root / package}{os.sep}" for package in PACKAGES)
    files = (getattr(module, "__file__", None) for module in list(sys.modules.values()))
    return sorted({Path(f).relative_to(root).as_posix() for f in files if f and f.startswith(folders)})


def seal(library: Path, files: Sequence[str]) -> None:
    """Append the line that says of which sources a library is."""
    code = library.read_bytes()
    line = {"machine": platform.machine(), "code": _sha(code), "sources": digest(files), "files": list(files)}
    with library.open("ab") as file:
        file.write(b"\n" + json.dumps(line).encode())


def defect(library: Path) -> str | None:
    """Why a library must not be loaded; None: it may."""
    try:
        code, _, line = library.read_bytes().rpartition(b"\n")
        said = json.loads(line)
        if said["code"] != _sha(code):
            return "is damaged"
        if said["machine"] != platform.machine():
            return f"is for {said['machine']}"
        return None if said["sources"] == digest(said["files"]) else "is of other sources"
    except FileNotFoundError:
        return "does not exist, or is of sources that do not"
    except OSError as error:
        return str(error)
    except (ValueError, KeyError, TypeError):
        return "is damaged"


def _sha(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def places() -> list[Path]:
    """Where the library is looked for, and built: the first of them that can be written."""
    if given := os.environ.get("IMUD_KERNELS"):
        return [Path(given).resolve()]
    from ..configuration.folders import places as folders

    name = f"kernels-{_sha(str(ROOT).encode())[:12]}.so"  # of this installation
    return [INSTALLED, *(folder / name for folder in folders("cache"))]


def current() -> Path | None:
    """Where the library of these sources is; None: it has to be built."""
    return next((place for place in places() if defect(place) is None), None)


def described() -> str:
    """Where this process's kernels are from."""
    loaded = library()
    return "numba" if loaded is None else loaded._name


@functools.cache
def library() -> ctypes.CDLL | None:
    """The library of these sources, built if need be; None: numba has to compile. Once per process."""
    if os.environ.get("IMUD_JIT", "0") not in ("", "0"):
        return None
    try:
        return ctypes.CDLL(str(current() or rebuild(places())))
    except (build.CannotBuildError, OSError) as error:
        print(f"imud: the kernels cannot be compiled ahead of time: {error}", file=sys.stderr)
        print("imud: numba compiles them now, which takes minutes", file=sys.stderr, flush=True)
        return None


def address(symbol: str) -> int | None:
    """Where the function of this name is; None: the library does not have it, or there is none."""
    loaded = library()
    function = getattr(loaded, symbol, None) if loaded else None
    return None if function is None else ctypes.cast(function, ctypes.c_void_p).value


def rebuild(candidates: Sequence[Path]) -> Path:
    """Build the library at the first of these places that can be written. Raises CannotBuildError, OSError."""
    build.compiler()
    with _locked(candidates) as place:
        if defect(place) is not None:  # nobody else has built it meanwhile
            print("imud: compiling the kernels for these sources, some 15 s", file=sys.stderr, flush=True)
            with tempfile.TemporaryDirectory(prefix=f"{place.stem}-", dir=place.parent) as folder:
                made = Path(folder, place.name)
                _in_a_process(made)
                made.replace(place)  # whole or not at all
        return place


@contextlib.contextmanager
def _locked(candidates: Sequence[Path]) -> Iterator[Path]:
    """The first place in whose folder files can be written; within the block no other process builds there."""
    for place in candidates:
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            folder = os.open(place.parent, os.O_RDONLY)
        except OSError:
            continue
        try:
            if os.access(place.parent, os.W_OK):
                fcntl.flock(folder, fcntl.LOCK_EX)
                yield place
                return
        finally:
            os.close(folder)
    raise build.CannotBuildError(f"none of {', '.join(str(place) for place in candidates)} can be written")


def _in_a_process(output: Path) -> None:
    """Build in a process of its own, which ends with this one's wait. Raises CannotBuildError."""
    command = [sys.executable, "-m", "imud.compile", str(output)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True, cwd=ROOT) as process:
        try:
            said = process.communicate()[1]
        except BaseException:  # a signal ends us
            os.killpg(process.pid, signal.SIGKILL)
            raise
    if process.returncode:
        raise build.CannotBuildError(said.strip()[-2000:])
