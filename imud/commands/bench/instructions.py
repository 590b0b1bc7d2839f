"""Instructions per frame, counted by valgrind's callgrind: unlike times they are the same on a loaded machine.

Under valgrind a program is fifty times slower. For the live race its clock is slowed down as well, so that frames still
come one by one and everything that goes by the clock stays in proportion.
"""

import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from ...errors import ImudError
from ...process.python import python_command
from . import reference
from .race import Pacer, match_sequence, race
from .table import Section
from .throughput import LLVM

SLOWNESS = 10  # times
_OPTIONS = {"x86_64": ("-mno-avx512f",)}.get(platform.machine(), ())  # valgrind does not know these instructions
_REPLAYED, _LIVE = (2000, 7000), 1000  # frames; the difference of two replays has no fixed cost
_WARM_UP = 300  # frames
_TIMEOUT_S = 60.0
_PROCESSOR = "import llvmlite.binding as b; print(b.get_host_cpu_name()); print(b.get_host_cpu_features().flatten())"


class CountError(Exception):
    """Instructions cannot be counted; the message says why."""


def processor() -> dict[str, str]:
    """Environment that selects machine code for the processor which valgrind emulates. Raises CountError."""
    if not (shutil.which("valgrind") and shutil.which("callgrind_control")):
        raise CountError("valgrind is not on this machine")
    command = ["valgrind", "-q", "--tool=none", sys.executable, "-c", _PROCESSOR]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise CountError(f"valgrind: {done.stderr[-200:]}")
    name, features = done.stdout.split()
    return {**os.environ, "NUMBA_CPU_NAME": name, "NUMBA_CPU_FEATURES": features}


def with_compiled_kernels(environment: dict[str, str]) -> dict[str, str]:
    """The environment, after kernels have been compiled for it into a cache of their own."""
    environment = {name: value for name, value in environment.items() if name != "NUMBA_CACHE_DIR"}
    command = python_command("imud", "warmup", "--estimator", "attitude")
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise CountError(f"imud warmup: {done.stderr[-200:]}")
    return environment


class Counter:
    """Counts the instructions of one process. out: where it may write files."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._dumps = 0
        self.prefix = [
            *("valgrind", "-q", "--tool=callgrind", "--instr-atstart=no"),
            f"--callgrind-out-file={out}",
        ]

    def begin(self, pid: int) -> None:
        """Count from now on."""
        self._control("-i", "on", str(pid))
        self.read(pid)

    def read(self, pid: int) -> int:
        """Instructions since the last call. Raises CountError."""
        self._dumps += 1
        self._control("-d", str(pid))
        text = self._out.with_name(f"{self._out.name}.{self._dumps}").read_text()
        found = re.search(r"^(?:totals|summary): (\d+)", text, re.MULTILINE)
        if found is None:
            raise CountError("callgrind wrote no total")
        return int(found[1])

    def _control(self, *arguments: str) -> None:
        done = subprocess.run(["callgrind_control", *arguments], capture_output=True, text=True, check=False)
        if done.returncode:
            raise CountError(f"callgrind_control: {(done.stderr or done.stdout)[-200:]}")


def _replay(section: Section, environment: dict[str, str], folder: Path) -> None:
    counter = Counter(folder / "replay")
    command = [*counter.prefix, *python_command("imud.commands.bench.counted"), *_OPTIONS]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment
    ) as process:
        assert process.stdin and process.stdout

        def request(name: str, frames: int) -> None:
            print(f"{name} {frames}", file=process.stdin, flush=True)
            if not process.stdout.readline():  # type: ignore[union-attr]
                raise CountError("the replay ended by itself under valgrind")

        status = process.stdout.readline().strip()
        names = ["ours", "c"] if status == "ready" else ["ours"]
        for name in names:
            request(name, _REPLAYED[0])
        counter.begin(process.pid)
        counts = []
        for name in names:
            short, long = 0, 0
            for frames in _REPLAYED:
                request(name, frames)
                short, long = long, counter.read(process.pid)
            counts.append((long - short) / (_REPLAYED[1] - _REPLAYED[0]))
        process.stdin.close()
    section.add("replay, bytes to solution", counts[0], "/frame")
    _compare(section, "replay against C", counts, 1.2, status)


def _live(section: Section, environment: dict[str, str], folder: Path) -> None:
    library = folder / "slow_time.so"
    reference.compile_c(reference.SOURCES / "slow_time.c", library, "-shared", "-fPIC")
    environment = {**environment, "LD_PRELOAD": str(library), "SLOWNESS": str(SLOWNESS)}
    counters: list[Counter] = []

    def counted(name: str, command: list[str]) -> list[str]:
        counters.append(Counter(folder / f"live.{name}"))
        return [*counters[-1].prefix, *command]

    with race(folder, counted, environment, SLOWNESS, _OPTIONS) as (contestants, why):
        pacer = Pacer(contestants, SLOWNESS)
        for contestant, counter in zip(contestants, counters, strict=True):
            counter.begin(contestant.pid)
        pacer.feed(_WARM_UP)
        match_sequence(pacer, contestants)
        for contestant, counter in zip(contestants, counters, strict=True):
            counter.read(contestant.pid)
        pacer.feed(_LIVE)
        pacer.wait_for(_LIVE, _TIMEOUT_S)
        if any(len(contestant.latencies_ns) < _LIVE for contestant in contestants):
            raise CountError("this machine is too busy: frames were lost")
        counts = [counter.read(c.pid) / _LIVE for c, counter in zip(contestants, counters, strict=True)]
    section.add("live at 1 kHz, one subscriber, user space", counts[0], "/frame")
    _compare(section, "live against the C daemon", counts, None, why)


def _compare(section: Section, name: str, counts: list[float], most: float | None, why: str) -> None:
    if len(counts) > 1:
        section.add(name, counts[0] / counts[1], "x", most=most, note=f"C: {counts[1]:,.0f}", reason=LLVM)
    else:
        section.add(name, np.nan, "x", most=most, note=why)


def instructions() -> Section:
    """The counts."""
    section = Section("Instructions, by callgrind: M-G350, attitude filter")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            environment = with_compiled_kernels(processor())
            _replay(section, environment, folder)
            _live(section, environment, folder)
        except (CountError, reference.NoReferenceError, ImudError) as error:
            section.add("instructions per frame", np.nan, "", note=str(error))
    return section
