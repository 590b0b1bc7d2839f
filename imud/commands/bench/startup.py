"""How long commands take from their start, and the memory of the daemon; beside importing numpy alone, in turns."""

import contextlib
import math
import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from ...errors import ImudError
from ...process.python import python_command
from ..processes import process
from . import signals
from .table import Section
from .turns import Turns

_READY = " ready "
_MINUTE_S = 60
_CLIENT_S, _WAIT_S = 5.0, 30.0  # with a client until the memory is read; for its first report
_SMALL = ("--version", "--help", "status", "probe")  # commands: status and probe find no daemon, no device
_IMPORTS = "Python and numpy are most of it; then structlog, msgspec and the daemon's own modules"
_RECEIVER = "with a receiver: the filter's 2 MB of rings, the receivers' drivers, the gpsd protocol"
_PARSER = "it needs neither numpy nor a kernel, only Python and argparse"
_TABLE = "most of it is decimal text, in and out, of 60,000 rows"


def _ready(memory_mb: list[float], **variables: str) -> float:
    """Seconds from the start of `imud run` until it logs that it is ready; appends the memory that it uses then."""
    with tempfile.TemporaryDirectory() as folder:
        command = python_command("imud", "run", "--port", f"{folder}/absent", "--listen", f"{folder}/gpsd")
        environment = {**os.environ, "NO_COLOR": "1", **variables}
        begin = time.perf_counter()
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment) as daemon:
            assert daemon.stderr
            log = ""
            for line in daemon.stderr:
                log += line
                if _READY in line:
                    break
            seconds = time.perf_counter() - begin
            memory_mb.append(_resident_mb(daemon.pid))
            daemon.send_signal(signal.SIGTERM)
            daemon.stderr.read()
        if _READY not in log:
            raise ImudError(f"bench: the daemon does not start: {log[-500:]}")
        return seconds


def _resident_mb(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS:")) * 1024e-6


def _time(command: list[str]) -> float:
    begin = time.perf_counter()
    # status and probe end with an error where there is nothing
    subprocess.run(command, check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.perf_counter() - begin


def memory_with_receiver() -> float:
    """MB that the daemon takes with an inertial sensor, a receiver and a client. Raises ImudError."""
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        imu, gnss, address, log = (folder / entry for entry in ("imu", "gnss", "gpsd", "log"))
        output = stack.enter_context(log.open("a"))
        links, ports = ([f"--{option}={path}" for path in (imu, gnss)] for option in ("link", "port"))
        stack.enter_context(process("sim", "g350", "nmea", "--scenario=car", *links, stdout=output, stderr=output))
        _wait_until(lambda: imu.exists() and gnss.exists(), log)
        daemon = stack.enter_context(process("run", *ports, f"--listen={address}", stdout=output, stderr=output))
        _wait_until(lambda: log.read_text().count(" streaming ") == len(ports), log)
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(address))
            client.sendall(b'?WATCH={"enable":true,"json":true};\n')
            client.settimeout(_WAIT_S)
            end = time.monotonic() + _CLIENT_S
            while time.monotonic() < end:
                client.recv(1 << 16)
            return _resident_mb(daemon.pid)


def _wait_until(met: Callable[[], bool], log: Path) -> None:
    end = time.monotonic() + _WAIT_S
    while not met():
        if time.monotonic() > end:
            raise ImudError(f"bench: {log.read_text()[-500:]}")
        time.sleep(0.05)


def _write_minute(file: Path) -> None:
    """A minute of samples at 1 kHz, as `imud replay` reads them."""
    rows = signals.samples(_MINUTE_S * signals.RATE_HZ)
    names = "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2"
    np.savetxt(file, np.c_[rows["t_ns"] * 1e-9, rows["w"], rows["f"]], "%.7g", ",", header=names, comments="")


def start(rounds: int, cold: bool) -> Section:
    """cold: also how long the kernels take to compile, as at the installation."""
    section = Section(f"Start, medians of {rounds} turns; x: times as long as importing numpy")
    memory_mb: list[float] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        minute, library = folder / "imu.csv", folder / "kernels.so"
        _write_minute(minute)
        turns = Turns(
            rounds,
            partial(_time, [sys.executable, "-c", "import numpy"]),
            partial(_ready, memory_mb),
            partial(_time, python_command("imud", "replay", f"--imu={minute}", f"-o={folder / 'estimates.csv'}")),
            *(partial(_time, python_command("imud", command)) for command in _SMALL),
        )
        section.add("import numpy", turns.median(0), "s")
        section.add("start to READY", turns.ratio(1, 0), "x", most=2.5, reason=_IMPORTS)
        for place, command in enumerate(_SMALL, 3):
            section.add(f"imud {command}", turns.ratio(place, 0), "x", most=1.0, reason=_PARSER)
        section.add("imud replay of a minute, 1 kHz, CSV", turns.ratio(2, 0), "x", most=4.0, reason=_TABLE)
        section.add("memory when READY", statistics.median(memory_mb), "MB", most=40, reason=_IMPORTS)
        try:
            section.add("memory with receiver and client", memory_with_receiver(), "MB", most=40, reason=_RECEIVER)
        except (ImudError, OSError) as error:
            section.add("memory with receiver and client", math.nan, "MB", most=40, note=str(error))
        if cold:
            seconds = _time(python_command("imud.compile", str(library)))
            size = library.stat().st_size if library.exists() else math.nan
            note = "" if library.exists() else "no C compiler"
            ratio = math.nan if note else seconds / turns.median(0)
            section.add("installing: compiling the kernels", ratio, "x", note=note)
            section.add("compiled kernels", size * 1e-6, "MB", note=note)
    return section
