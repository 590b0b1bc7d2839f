"""The time from the command to READY, and the memory then; compared with importing numpy alone, the least there is."""

import math
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

from imud.errors import ImudError

from .table import Section
from .turns import Turns

_READY = " ready "
_IMPORTS = "Python and numpy are most of it; then structlog, msgspec and the daemon's own modules"
_VERSION = "it needs neither numpy nor a kernel, only Python and argparse"


def _ready(memory_mb: list[float], **variables: str) -> float:
    """Seconds from the start of `imud run` until it logs that it is ready; appends the memory that it uses then."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["-m", "imud", "run", "--port", f"{folder}/absent", "--listen", f"{folder}/gpsd"]
        environment = {**os.environ, "NO_COLOR": "1", **variables}
        begin = time.perf_counter()
        with subprocess.Popen(
            [sys.executable, *command], stderr=subprocess.PIPE, text=True, env=environment
        ) as process:
            assert process.stderr
            log = ""
            for line in process.stderr:
                log += line
                if _READY in line:
                    break
            seconds = time.perf_counter() - begin
            memory_mb.append(_resident_mb(process.pid))
            process.send_signal(signal.SIGTERM)
            process.stderr.read()
        if _READY not in log:
            raise ImudError(f"bench: the daemon does not start: {log[-500:]}")
        return seconds


def _resident_mb(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS:")) * 1024e-6


def _python(*arguments: str) -> float:
    begin = time.perf_counter()
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - begin


def start(rounds: int, cold: bool) -> Section:
    """cold: also of sources that have changed, so that the kernels are compiled."""
    section = Section(f"Start, medians of {rounds} turns")
    memory_mb: list[float] = []
    turns = Turns(
        rounds,
        partial(_ready, memory_mb),
        partial(_python, "-c", "import numpy"),
        partial(_python, "-m", "imud", "--version"),
    )
    section.add("import numpy", turns.median(1), "s")
    section.add("start to READY", turns.median(0), "s")
    section.add("start against import numpy", turns.ratio(0, 1), "x", most=2.5, reason=_IMPORTS)
    section.add("imud --version against import numpy", turns.ratio(2, 1), "x", most=1.0, reason=_VERSION)
    section.add("memory when READY", statistics.median(memory_mb), "MB", most=40, reason=_IMPORTS)
    if cold:
        with tempfile.TemporaryDirectory() as folder:
            library = Path(folder, "kernels.so")
            section.add("start after a change of the sources", _ready([], IMUD_KERNELS=str(library)), "s")
            size = library.stat().st_size if library.exists() else math.nan
            section.add("compiled kernels", size * 1e-6, "MB", note="" if library.exists() else "no C compiler")
    return section
