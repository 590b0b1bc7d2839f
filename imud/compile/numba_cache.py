"""The cache of the kernels that numba compiles, where the shared library does not have them.

numba keys its cache by the file of a kernel alone: if a callee or a constant in another file changes, it runs stale
machine code. So the name of our cache directory holds a digest of all that machine code depends on: every source file,
the compiling libraries, Python, and the processor. Directories that nobody has used for weeks are removed.
"""

import contextlib
import glob
import hashlib
import importlib.metadata
import os
import platform
import shutil
import sys
import tempfile
import time
from pathlib import Path

from ..errors import CannotCreateError
from ..folders import folders_for

_ROOT = Path(__file__).resolve().parents[2]
_PREFIX = "numba-"
_UNUSED_S = 14 * 86400.0
_FREE_BYTES = 64 << 20  # that must be free on the disk: all kernels take a third of it
# these change the code, but not numba's key
_SWITCHES = ("NUMBA_OPT", "NUMBA_BOUNDSCHECK", "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")
_CPU = {"vendor_id", "cpu family", "model", "stepping", "flags"}  # of /proc/cpuinfo
_CPU |= {"CPU implementer", "CPU part", "CPU variant", "Features"}  # on ARM


def _processor() -> str:
    """The processor's name and features in LLVM's terms."""
    try:
        first = Path("/proc/cpuinfo").read_text(errors="replace").split("\n\n")[0]
    except OSError:
        return platform.machine()
    return "\n".join(line for line in first.splitlines() if line.split("\t")[0].rstrip() in _CPU)


def source_digest(root: Path = _ROOT) -> str:
    """Digest of all sources that may hold kernels, and of everything that turns them into machine code."""
    digest = hashlib.sha256(f"{sys.version};{_processor()};".encode())
    for name in ("numba", "llvmlite", "numpy"):
        digest.update(f"{name}={importlib.metadata.version(name)};".encode())
    for variable in _SWITCHES:
        digest.update(f"{variable}={os.environ.get(variable, '')};".encode())
    # unlike Path.rglob, glob follows the links to folders
    for name in sorted(glob.glob("imud/**/*.py", root_dir=root, recursive=True)):  # noqa: PTH207
        digest.update(name.encode() + b"\0" + (root / name).read_bytes())
    return digest.hexdigest()[:16]


def is_writable(folder: Path) -> bool:
    """Whether files can be written in `folder` (made if need be), and its disk is not full."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return shutil.disk_usage(folder).free > _FREE_BYTES
    except OSError:
        return False


def candidates() -> list[Path]:
    """Folders in which compiled kernels may be kept: the one the user names; else systemd's, or the user's cache."""
    name = f"{_PREFIX}{source_digest()}"
    given = Path(os.environ.get("NUMBA_CACHE_DIR", ""))
    if given.name == name:  # a process of ours has settled it
        return [given]
    return [base / name for base in ([given] if given.name else folders_for("cache"))]


def _remove_unused(base: Path, now_s: float) -> None:
    """Remove directories that no process has used for weeks: of earlier versions, or of another processor."""
    for folder in base.glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):
            if now_s - folder.stat().st_mtime > _UNUSED_S:
                shutil.rmtree(folder, ignore_errors=True)


def prepare() -> Path | None:
    """Set numba's environment; call before anything imports it.

    Returns the cache directory; None if no folder can be written: then every start compiles (see `compile.jit`).
    """
    for folder in candidates():
        if is_writable(folder):
            if "NUMBA_CACHE_DIR" not in os.environ:
                os.utime(folder)  # used
                _remove_unused(folder.parent, time.time())
            os.environ["NUMBA_CACHE_DIR"] = str(folder)
            return folder
    os.environ.pop("NUMBA_CACHE_DIR", None)
    return None


def required() -> Path:
    """The cache directory. Raises CannotCreateError if there can be none."""
    if (folder := prepare()) is None:
        tried = " nor ".join(str(path) for path in candidates())
        raise CannotCreateError(f"neither {tried} can be written to: name a directory in NUMBA_CACHE_DIR")
    return folder
