"""The time from the command to READY, compared with importing numba alone, which would be the least."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from imud.errors import ImudError

from .table import Section
from .turns import Turns

_READY = " ready "
_IMPORTS = "beside the kernels, Python, numpy and the packages of the daemon are loaded"


def _ready(cache: str | None = None) -> float:
    """Seconds from the start of `imud run` until it says that it is ready."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["-m", "imud", "run", "--port", f"{folder}/absent", "--listen", f"{folder}/gpsd"]
        environment = {**os.environ, "NO_COLOR": "1"}
        if cache is not None:
            environment["NUMBA_CACHE_DIR"] = cache
        begin = time.perf_counter()
        with subprocess.Popen(
            [sys.executable, *command], stderr=subprocess.PIPE, text=True, env=environment
        ) as process:
            assert process.stderr
            said = ""
            for line in process.stderr:
                said += line
                if _READY in line:
                    break
            seconds = time.perf_counter() - begin
            process.send_signal(signal.SIGTERM)
            process.stderr.read()
        if _READY not in said:
            raise ImudError(f"bench: the daemon does not start: {said[-500:]}")
        return seconds


def _import_numba() -> float:
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-c", "import numba"], check=True)
    return time.perf_counter() - begin


def start(rounds: int, cold: bool) -> Section:
    """Warm always; cold, with an empty cache, if asked for."""
    section = Section(f"Start, medians of {rounds} turns")
    turns = Turns(rounds, _ready, _import_numba)
    section.add("import numba", turns.median(1), "s")
    section.add("warm start to READY", turns.median(0), "s")
    section.add("warm start against import numba", turns.ratio(0, 1), "x", most=1.6, reason=_IMPORTS)
    if cold:
        with tempfile.TemporaryDirectory() as cache:
            section.add("cold start to READY, everything compiled", _ready(cache), "s")
            kilobytes = sum(path.stat().st_size for path in Path(cache).rglob("*") if path.is_file()) / 1000.0
            section.add("compiled kernels on disk", kilobytes / 1000.0, "MB")
    return section
