"""Many recordings at once: in processes of this machine, or on a Dask cluster (the extra `imud[cluster]`).

Either way the same function replays each recording in a process of its own, so a failure of one leaves the others
alone.
"""

import importlib
import importlib.util
import logging
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from functools import partial
from multiprocessing import get_context
from typing import Any

from .. import __version__
from ..errors import ImudError, InputOutputError, UsageError
from .replaying import Job, Outcome, play

Replay = Callable[[Job], Outcome | str]
ANSWER_S = 10.0  # a cluster that is there answers sooner


def run_locally(jobs: list[Job], at_a_time: int, replay: Replay | None = None) -> Iterator[Outcome | str]:
    """Outcomes as they come, from `at_a_time` processes; a text says why a recording could not be replayed.

    Each process is a pool of its own, so that one that dies costs one recording. replay: what it runs for a job.
    """
    waiting = iter(jobs)
    busy: dict[Future[Outcome | str], tuple[Job, ProcessPoolExecutor]] = {}
    with ExitStack() as stack:

        def go_on(pool: ProcessPoolExecutor | None = None) -> None:
            if job := next(waiting, None):
                pool = pool or stack.enter_context(ProcessPoolExecutor(1, get_context("spawn")))
                busy[pool.submit(replay or replay_locally, job)] = job, pool

        for _ in range(at_a_time):
            go_on()
        while busy:
            for future in wait(busy, return_when=FIRST_COMPLETED).done:
                job, pool = busy.pop(future)
                go_on(None if isinstance(future.exception(), BrokenProcessPool) else pool)
                yield _result(future, job)


def run_on_cluster(jobs: list[Job], address: str) -> Iterator[Outcome | str]:
    """The same on the Dask cluster with that scheduler. Its workers must see the files under the same paths.

    Raises UsageError, InputOutputError.
    """
    if importlib.util.find_spec("distributed") is None:
        raise UsageError("--cluster needs the package distributed: pip install 'imud[cluster]'")
    dask: Any = importlib.import_module("distributed")
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # imud reports what matters
    try:
        client = dask.Client(address, timeout=ANSWER_S)
    except (OSError, ValueError) as error:
        raise InputOutputError(
            f"--cluster {address}: no Dask scheduler answers there ({type(error).__name__}); "
            "start one with `dask scheduler`, and `dask worker ADDRESS --nthreads 1` on each machine"
        ) from error
    with client:
        if refused := version_mismatch(client.run(version, on_error="return")):
            raise InputOutputError(f"--cluster {address}: {refused}")
        waiting = {client.submit(partial(replay_locally, job), pure=False): job for job in jobs}
        for future in dask.as_completed(list(waiting)):
            yield _result(future, waiting[future])


def version() -> str:
    """Of this imud, to be asked for on other machines."""
    return __version__


def version_mismatch(versions: dict[str, Any]) -> str:
    """Why these workers cannot replay as we do; versions: imud's on each worker, or the error met in asking for it."""
    ours = version()
    if not versions:
        return "it has no workers; start some with `dask worker ADDRESS --nthreads 1`"
    if wrong := {worker: version for worker, version in versions.items() if version != ours}:
        texts = ", ".join(
            f"{worker} has {'no imud' if isinstance(version, Exception) else f'imud {version}'}"
            for worker, version in wrong.items()
        )
        return f"{texts}; this is imud {ours}: install the same on every worker"
    return ""


def replay_locally(job: Job) -> Outcome | str:
    """Replay in a process of its own, perhaps on another machine; an error is returned as text, so the others go on."""
    try:
        return play(job, lambda done, total: None)
    except ImudError as error:
        why, path = str(error), str(job.paths[0])
        return why if why.startswith(path) else f"{path}: {why}"
    except OSError as error:  # of the output, or of a shared folder
        return f"{job.paths[0]}: {error} (on {socket.gethostname()})"


def _result(future: Any, job: Job) -> Outcome | str:
    """The outcome of a job; of a process that died, a text that says so."""
    try:
        found: Outcome | str = future.result()
    except BrokenProcessPool:
        return f"{job.paths[0]}: its process was killed; if that was for lack of memory, take fewer --jobs"
    except Exception as error:
        return f"{job.paths[0]}: its process ended ({type(error).__name__}: {error})"
    return found
