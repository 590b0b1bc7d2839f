"""What must be settled before numba is imported: where compiled kernels are kept, and how many threads BLAS starts.

numba keys its cache by the file of a kernel alone: it does not notice a changed callee or constant in another file and
would run stale machine code. So the cache directory's name holds a digest of every source file and library version.
"""

import hashlib
import importlib.metadata
import os
import tempfile
from pathlib import Path

_ROOMS = ("imud", "drivers")


def source_digest() -> str:
    """Digest of all sources that kernels may come from, and of the compilers that turn them into machine code."""
    digest = hashlib.sha256()
    for name in ("numba", "llvmlite", "numpy"):
        digest.update(f"{name}={importlib.metadata.version(name)};".encode())
    for variable in ("NUMBA_OPT", "NUMBA_BOUNDSCHECK"):  # change the code, not numba's key
        digest.update(f"{variable}={os.environ.get(variable, '')};".encode())
    root = Path(__file__).resolve().parent.parent
    for room in _ROOMS:
        for path in sorted((root / room).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def _writable(base: Path) -> bool:
    try:
        base.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=base):
            return True
    except OSError:
        return False


def _cache_base() -> Path:
    """First writable of: systemd's CacheDirectory, the user's cache, a private directory that dies with the machine."""
    candidates = []
    if service := os.environ.get("CACHE_DIRECTORY"):
        candidates.append(Path(service.split(":")[0]))
    candidates.append(Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "imud")
    for base in candidates:
        if _writable(base):
            return base
    return Path(tempfile.mkdtemp(prefix="imud-cache-"))


def prepare() -> Path:
    """Set the environment for numba; call before anything imports it. Returns the cache directory."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread and 57 MB of address space less
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(given)
    cache = _cache_base() / f"numba-{source_digest()}"
    os.environ["NUMBA_CACHE_DIR"] = str(cache)
    return cache
