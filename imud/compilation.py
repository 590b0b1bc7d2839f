"""Compiles kernels before they are needed: all that a loop will call is called once before the loop begins.

Compiling takes twice the memory of running, and a process never gives it back. So a daemon that finds no compiled
kernels has a child process compile them into the cache, serves its clients meanwhile, loads them from there, and
releases the compiler's own code.
"""

import contextlib
import ctypes
import io
import os
import signal
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.driver import Identity, ImuConfigured, ImuDriver
from drivers.entry import Entry, Kind, noting
from drivers.registry import drivers
from drivers.sample import SAMPLE

from .configuration.settings import Initial, Settings
from .daemon.cycle import Cycle
from .estimators import Estimator, registry
from .estimators.records import FIX, SOLUTION
from .outputs.binary import BinaryOutputs
from .outputs.shared_memory import WORD, write
from .pipeline import Filter, Stream
from .sensors.health import shown
from .stages import decoding

_MADV_DONTNEED, _PR_SET_PDEATHSIG = 4, 1
_RATE_HZ, _PERIOD_NS = 1000.0, 1_000_000


def _scratch() -> list[tuple[ImuDriver, NDArray[np.void]]]:
    """Every driver of inertial sensors, with a decoder state for it to work on."""
    sensors = [driver for driver in drivers() if driver.kind == "imu"]
    return [(d, d.new_state(ImuConfigured(Identity(d.name, ""), _RATE_HZ, _PERIOD_NS, 0, 0))) for d in sensors]


def warm_decoders() -> None:
    """Compile, or load, the decoder of every inertial sensor, and the daemon's cycle."""
    for driver, state in _scratch():
        decoding(driver, state)
    with contextlib.closing(Cycle()) as cycle:
        outputs = BinaryOutputs(Settings(), cycle.others, 1)
        cycle.turn(0, outputs, 0, 0)
        outputs.publish(np.zeros(1, SOLUTION), 1, 0, 0)


def warm(estimator: Estimator, settings: Settings) -> None:
    """Compile, or load, the kernels of an estimator that a live stream calls."""
    filter_ = Filter(estimator, settings, Initial(), _RATE_HZ)
    Stream(*_scratch()[0], filter_).ingest(0, 0)
    filter_.update(np.zeros(1, FIX))
    filter_.told()
    shown(filter_.health)


def warm_replay(estimator: Estimator, settings: Settings) -> None:
    """Compile, or load, the kernels of an estimator that a replay calls."""
    from .tables.estimates import EstimateWriter

    solutions = np.zeros(1, SOLUTION)
    Filter(estimator, settings, Initial(), _RATE_HZ).run(np.zeros(1, SAMPLE), solutions)
    EstimateWriter(io.BytesIO(), 0).write(solutions)


def entries() -> dict[str, tuple[Entry, tuple[Kind, ...]]]:
    """Every entry that imud itself calls, by symbol, with its arguments' types. Nothing is compiled for that."""
    words = np.zeros(4, WORD)
    with noting() as found:
        warm_decoders()
        write(0, 0, words, 0)
        for name in registry.NAMES:
            warm(registry.by_name(name), Settings())
            warm_replay(registry.by_name(name), Settings())
    return found


def missing(estimators: Iterable[Estimator]) -> list[Estimator]:
    """Those of the estimators that are not in the cache yet."""
    cache = os.environ.get("NUMBA_CACHE_DIR")
    return [estimator for estimator in estimators if cache is None or not _mark(cache, estimator).exists()]


def release_compiler() -> None:
    """Give back the memory of LLVM's code, 50 MB; Linux reads it from the file again if it should be needed."""
    libc = ctypes.CDLL(None)
    for line in Path("/proc/self/maps").read_text().splitlines():
        span, protection, *_, name = line.split(maxsplit=5)
        if protection == "r-xp" and "llvmlite" in name:
            begin, end = (int(address, 16) for address in span.split("-"))
            libc.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), _MADV_DONTNEED)


@contextlib.contextmanager
def cache() -> Iterator[None]:
    """Within the block there is a cache: where none can be kept, one that is removed with the block, if even that."""
    with contextlib.ExitStack() as stack:
        if "NUMBA_CACHE_DIR" not in os.environ:
            with contextlib.suppress(OSError):
                passing = tempfile.TemporaryDirectory(prefix="imud-", ignore_cleanup_errors=True)
                os.environ["NUMBA_CACHE_DIR"] = stack.enter_context(passing)
                stack.callback(os.environ.pop, "NUMBA_CACHE_DIR")
        yield


def compile_apart(
    estimators: list[Estimator], settings: Settings, meanwhile: Callable[[int], None] = lambda fd: None
) -> bool:
    """Have a child process compile what a daemon needs into the cache; False if there is no cache, or it failed.

    `meanwhile` may do something until the descriptor that it is given is readable: the child has ended. An exception
    during the wait, as a signal's action may raise, ends the child as well.
    """
    import multiprocessing

    cache = os.environ.get("NUMBA_CACHE_DIR")
    if cache is None:
        return False
    fork = multiprocessing.get_context("fork")
    child = fork.Process(target=_fill_all, args=(cache, estimators, settings), daemon=True)
    child.start()
    try:
        meanwhile(child.sentinel)
        child.join()
    finally:
        child.kill()
        child.join()
    return child.exitcode == 0


def fill(cache: str, estimator: Estimator, settings: Settings) -> None:
    """Compile into the cache what a daemon needs for this estimator.

    The decoders last: of two processes with estimators of their own, the later finds them there.
    """
    warm(estimator, settings)
    warm_decoders()
    _mark(cache, estimator).touch()


def _fill_all(cache: str, estimators: list[Estimator], settings: Settings) -> None:
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)  # or, its parent killed, it would hold on to the sockets
    for estimator in estimators:
        fill(cache, estimator, settings)


def _mark(cache: str, estimator: Estimator) -> Path:
    """A file that exists once decoders and estimator have been compiled into the cache."""
    return Path(cache) / f"{estimator.name}.compiled"
