"""Live at 1 kHz: what a frame costs imud and the C daemon, and how long both take (`race`)."""

import gc
import json
import shutil
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ImudError
from .race import Contestant, Pacer, match_sequence, race
from .table import Section

_WARM_UP = 3000  # frames before the measurement: the detection listens, caches fill
_TRACED = 2000  # frames
_PYTHON = "once a second Python checks silence, clients and health, and stores the filter's state"
_ALIKE = "both loops ask the same of Linux, 0.8 of a frame: other programs move the ratio by a few hundredths"
_SCHEDULER = "most of it is the scheduler's: two wake-ups, of the tty's worker and of ours; on a loaded machine more"
_STARVED = "this machine was too busy for a frame each millisecond: see the 99th percentile"
_MEMORY = "something was compiled in the daemon itself: it is less at the next start"
_GARBAGE = (
    "a first collection also frees what the interpreter keeps for reuse, and finds nothing in the processor's caches"
)
_KERNELS = "a kernel is missing in `imud/kernel_calls.py`"


def live(seconds: int) -> Section:
    """The race."""
    section = Section(f"Live at 1 kHz for {seconds} s: M-G350 on a PTY, attitude filter, every state to one subscriber")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with race(folder) as (contestants, why):
            pacer = Pacer(contestants)
            pacer.feed(_WARM_UP)
            gc.collect()
            gc.freeze()
            match_sequence(pacer, contestants)
            n = seconds * 1000
            before = [c.cpu_ns() for c in contestants]
            pacer.feed(n)
            pacer.wait_for(n)
            used_us = [(c.cpu_ns() - b) / n * 1e-3 for c, b in zip(contestants, before, strict=True)]
            lost = [n - len(c.latencies_ns) for c in contestants]
            if not all(c.latencies_ns for c in contestants):
                raise ImudError("bench: solutions and frames do not match; is the machine overloaded?")
            percentiles = [np.percentile(c.latencies_ns, (50, 99)) * 1e-3 for c in contestants]
            ours = contestants[0]
            section.add("processor time per frame", used_us[0], "us")
            _compare(section, "processor time against the C daemon", used_us, 1, why, _ALIKE)
            section.add("byte written to solution, median", percentiles[0][0], "us")
            _compare(section, "median against the C daemon", [p[0] for p in percentiles], 1.15, why, _SCHEDULER)
            _compare(section, "99th percentile against the C daemon", [p[1] for p in percentiles], None, why)
            notes = f"C daemon: {lost[1]}" if len(lost) > 1 else ""
            section.add(f"solutions missing of {n}", lost[0], "", most=0, note=notes, reason=_STARVED)
            section.add("memory, resident", ours.status_mb("VmRSS"), "MB", most=150, reason=_MEMORY)
            section.add("memory, at most since the start", ours.status_mb("VmHWM"), "MB")
            _syscalls(section, pacer, contestants)
        _interpreter(section, json.loads((folder / "observed.json").read_text()))
    return section


def _compare(section: Section, name: str, values: list[Any], most: float | None, why: str, reason: str = "") -> None:
    if len(values) < 2:
        section.add(name, np.nan, "x", most=most, note=why)
    else:
        section.add(name, values[0] / values[1], "x", most=most, note=f"C: {values[1]:.0f} us", reason=reason)


def _syscalls(section: Section, pacer: Pacer, contestants: list[Contestant]) -> None:
    """Per wake-up: a wait, a read, and a send for each solution and subscriber are the least there can be."""
    if shutil.which("strace") is None:
        section.add("system calls per wake-up", np.nan, "", most=2.1, note="strace is not on this machine")
        return
    for contestant in contestants:
        with tempfile.NamedTemporaryFile() as file:
            command = ["strace", "-c", "-f", "-o", file.name, "-p", str(contestant.pid)]
            tracer = subprocess.Popen(command, stderr=subprocess.DEVNULL)
            pacer.feed(500)  # until it has attached itself
            pacer.feed(_TRACED)
            tracer.send_signal(signal.SIGINT)
            tracer.wait()
            calls = traced_calls(Path(file.name).read_text())
        reads = max(calls.get("read", 0), calls.get("readv", 0), 1)
        sends = calls.get("sendto", 0)
        goal = 2.1 if contestant is contestants[0] else None
        listing = ", ".join(f"{name} {count / reads:.2f}" for name, count in calls.items() if count > 0.005 * reads)
        name = f"system calls per wake-up, sends apart, {contestant.name}"
        section.add(name, (sum(calls.values()) - sends) / reads, "", most=goal, note=listing, reason=_PYTHON)


def traced_calls(text: str) -> dict[str, int]:
    """The table of `strace -c`: name -> calls."""
    calls = {}
    for line in text.splitlines():
        words = line.split()
        if len(words) >= 5 and words[3].isdigit() and words[-1] != "total":
            calls[words[-1]] = int(words[3])
    return calls


def _interpreter(section: Section, seen: dict[str, Any]) -> None:
    section.add("garbage collections while it ran", len(seen["pauses_ns"]), "")
    note = f"of {seen['objects']} objects"
    goal = {"most": 0.05, "reason": _GARBAGE}
    worst = max([seen["full_collection_ns"], *seen["pauses_ns"]])
    section.add("longest pause, a full collection at the end too", worst * 1e-6, "ms", note=note, **goal)
    section.add("functions compiled after READY", seen["compiled"], "", most=0, reason=_KERNELS)
