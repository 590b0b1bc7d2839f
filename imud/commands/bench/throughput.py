"""How fast recorded data goes through: against the same algorithm in C, against numpy, and estimator by estimator."""

import ctypes
import importlib
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.registry import by_name

from ...batch import play
from ...configuration.settings import Initial, Settings
from ...estimators import registry
from ...estimators.records import SOLUTION
from ...math.earth import STANDARD_GRAVITY
from ...pipeline import Filter, InertialPipeline
from . import naive, reference, signals
from .table import Section
from .turns import Turns

CHUNK = 180 * signals.FRAME  # bytes at a time, as a daemon with a backlog
_NAIVE = 200  # frames
START_S = 20  # in which a filter aligns itself
LLVM = "gcc fuses multiplications with additions; we do not, for the same results on every processor"
_MORE = "numpy runs the filter alone; ours also checks health, rest, motion and the clock"
_NAVIGATION = (
    "the goal is for 15 states, ours has 40; a fifth of the time is for late fixes: for each, samples of the 150 ms "
    "since its epoch are integrated again, so that the solution is that of a fix without latency"
)


def timed(act: Callable[[], Any]) -> float:
    """Seconds of processor time; what other processes take meanwhile does not count."""
    begin = time.process_time()
    act()
    return time.process_time() - begin


def attitude_pipeline() -> InertialPipeline:
    """An M-G350 into the attitude filter."""
    driver = by_name("epson")
    assert driver.kind == "imu"
    configured = ImuConfigured(Identity("epson", "M-G350"), 1000.0, 1_000_000, 0, signals.FRAME)
    filter_ = Filter(registry.by_name("attitude"), Settings(), Initial(), 1000.0)
    return InertialPipeline(driver, driver.new_state(configured), filter_)


def replay_wire(pipeline: InertialPipeline, wire: Any, period_ns: int) -> int:
    """All of its bytes, as they would come; returns how many solutions they make."""
    total = 0
    for at in range(0, len(wire), CHUNK):
        chunk = wire[at : at + CHUNK]
        pipeline.rx[pipeline.fill : pipeline.fill + len(chunk)] = chunk
        total += pipeline.ingest(len(chunk), (at + len(chunk)) * period_ns)
    return total


class CReplay:
    """`replay_wire` in C. Raises NoReferenceError."""

    def __init__(self, folder: Path, options: Sequence[str] = ()) -> None:
        """options: more of the compiler's."""
        text, self._memory = reference.pipeline_source(attitude_pipeline())
        self._function = reference.build(text, folder, reference.SOURCES / "replay.c", options).replay

    def __call__(self, wire: Any, period_ns: int) -> int:
        begin = ctypes.c_char_p(self._memory)
        return reference.call(self._function, reference.pointer(wire), len(wire), CHUNK, period_ns, begin)


def replay(seconds: int, rounds: int) -> Section:
    """Bytes of an M-G350 to attitude solutions, all in memory."""
    section = Section(f"Replay: bytes to attitude solutions, {seconds} s at 1 kHz, medians of {rounds} turns")
    frames = signals.frames(seconds * signals.RATE_HZ)
    wire, period_ns = np.ascontiguousarray(frames).reshape(-1), 1_000_000 // signals.FRAME
    n = len(frames)

    def run_once() -> float:
        pipeline = attitude_pipeline()
        return timed(lambda: replay_wire(pipeline, wire, period_ns))

    contestants = [run_once]
    why = ""
    with tempfile.TemporaryDirectory() as folder:
        try:
            in_c = CReplay(Path(folder))
            assert in_c(wire, period_ns) == replay_wire(attitude_pipeline(), wire, period_ns) >= n - 1
            contestants.append(lambda: timed(lambda: in_c(wire, period_ns)))
        except reference.NoReferenceError as error:
            why = str(error)
        contestants.append(lambda: timed(lambda: naive.run(frames[:_NAIVE])))
        turns = Turns(rounds, *contestants)
    against_c = np.nan if why else turns.ratio(0, 1)
    section.add("samples per second", n / turns.median(0), "/s")
    section.add("time against C (gcc -O3 -march=native)", against_c, "x", most=1.2, note=why, reason=LLVM)
    faster = turns.ratio(-1, 0) * n / _NAIVE
    section.add("against naive numpy, dense 28 states", faster, "x faster", least=500, reason=_MORE)
    return section


def navigation(seconds: int, rounds: int) -> Section:
    """Samples and fixes through the navigation filter, with a solution record for each sample."""
    samples, fixes = signals.samples(seconds * signals.RATE_HZ), signals.fixes(seconds)

    def run_once() -> float:
        filter_ = Filter(registry.by_name("navigation"), Settings(), Initial(), 1000.0)
        return timed(lambda: play(filter_, samples, fixes, lambda rows: None))

    section = Section(f"Navigation filter, {seconds} s at 1 kHz with fixes at {signals.FIX_HZ} Hz")
    speed = seconds / Turns(rounds, run_once).median(0)
    section.add("replay against real time, with output", speed, "x", least=5000, reason=_NAVIGATION)
    return section


def estimators(rounds: int) -> Section:
    """What one sample costs each estimator once it runs, fixes apart."""
    section = Section("One step of each estimator, and in C")
    block = 10 * signals.RATE_HZ
    for name in registry.NAMES:
        with tempfile.TemporaryDirectory() as folder:
            contestants, note = [_Stepping(name, block).run_once], ""
            try:
                contestants.append(_Stepping(name, block, Path(folder)).run_once)
            except reference.NoReferenceError as error:
                note = str(error) if name == registry.NAMES[0] else ""
            turns = Turns(rounds, *contestants)
            if len(contestants) > 1:
                note = f"C: {1e9 * turns.median(1) / block:.0f} ns, {turns.ratio(0, 1):.2f} x"
            section.add(name, 1e9 * turns.median(0) / block, "ns", note=note)
    for name, other, how in (("VQF", _vqf, "one call"), ("x-io Fusion", _fusion, "a call from Python per sample")):
        try:
            section.add(f"{name}, for comparison", 1e9 * other(block) / block, "ns", note=how)
        except ImportError as error:
            section.add(f"{name}, for comparison", np.nan, "ns", note=f"not installed ({error.name})")
    return section


class _Stepping:
    """An estimator that runs already, stepping through one block of samples again and again, later each time.

    folder: where it is translated to C. Raises NoReferenceError.
    """

    def __init__(self, name: str, block: int, folder: Path | None = None) -> None:
        samples, fixes = signals.samples(START_S * signals.RATE_HZ + block), signals.fixes(START_S)
        before = START_S * signals.RATE_HZ
        self._filter = Filter(registry.by_name(name), Settings(), Initial(), 1000.0)
        if folder is not None:
            reference.to_c([self._filter], folder)
        play(self._filter, samples[:before], fixes, lambda rows: None)
        self._block, self._out = samples[before:].copy(), np.zeros(block, SOLUTION)

    def run_once(self) -> float:
        seconds = timed(lambda: self._filter.run(self._block, self._out))
        self._block["t_ns"] += len(self._block) * 1_000_000
        return seconds


def _vqf(n: int) -> float:
    vqf = importlib.import_module("vqf")
    samples = signals.samples(n)
    w, f = np.ascontiguousarray(samples["w"]), np.ascontiguousarray(samples["f"])
    filter_ = vqf.VQF(1.0 / signals.RATE_HZ)
    return timed(lambda: filter_.updateBatch(w, f))


def _fusion(n: int) -> float:
    fusion = importlib.import_module("imufusion")
    samples = signals.samples(n)
    w, f = np.degrees(samples["w"]), samples["f"] / STANDARD_GRAVITY
    ahrs = fusion.Ahrs()
    period: tuple[float, ...] = (1.0 / signals.RATE_HZ,)
    if hasattr(ahrs, "set_sample_period"):  # since version 1.3
        ahrs.set_sample_period(*period)
        period = ()

    def run() -> None:
        for k in range(n):
            ahrs.update_no_magnetometer(w[k], f[k], *period)

    return timed(run)
