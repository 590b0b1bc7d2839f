"""Many recordings at once: in processes of this machine, or on a Dask cluster (the extra `imud[cluster]`).

Either way the same function replays each in a process elsewhere, and what befalls one does not touch the others.
"""

import importlib
import importlib.util
import logging
import socket
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from importlib import metadata
from multiprocessing import get_context
from typing import Any

from .. import runtime
from ..errors import ImudError, InputOutputError, UsageError
from .replaying import Job, Outcome, play

ANSWER_S = 10.0  # a cluster that is there answers sooner


def here(jobs: list[Job], at_a_time: int) -> Iterator[Outcome | str]:
    """Outcomes as they come, from so many processes; a text is why a recording could not be replayed."""
    with ProcessPoolExecutor(max(1, min(at_a_time, len(jobs))), get_context("spawn")) as pool:
        waiting = {pool.submit(alone, job): job for job in jobs}
        yield from _collected(as_completed(waiting), waiting)


def on_cluster(jobs: list[Job], address: str) -> Iterator[Outcome | str]:
    """The same on the Dask cluster whose scheduler is there. Its workers must see the files under the same paths.

    Raises UsageError, InputOutputError.
    """
    if importlib.util.find_spec("distributed") is None:
        raise UsageError("--cluster needs the package distributed: pip install 'imud[cluster]'")
    dask: Any = importlib.import_module("distributed")
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters is told by us
    try:
        client = dask.Client(address, timeout=ANSWER_S)
    except (OSError, ValueError) as error:
        raise InputOutputError(
            f"--cluster {address}: no Dask scheduler answers there ({type(error).__name__}); "
            "start one with `dask scheduler`, and `dask worker ADDRESS --nthreads 1` on each machine"
        ) from error
    with client:
        if refused := unfit(client.run(metadata.version, "imud", on_error="return")):
            raise InputOutputError(f"--cluster {address}: {refused}")
        waiting = {client.submit(partial(alone, job), pure=False): job for job in jobs}
        yield from _collected(dask.as_completed(list(waiting)), waiting)


def unfit(versions: dict[str, Any]) -> str:
    """Why these workers cannot replay as we do; versions: of imud on each, or what went wrong when it was asked for."""
    ours = metadata.version("imud")
    if not versions:
        return "it has no workers; start some with `dask worker ADDRESS --nthreads 1`"
    if wrong := {worker: version for worker, version in versions.items() if version != ours}:
        told = ", ".join(
            f"{worker} has {'no imud' if isinstance(version, Exception) else f'imud {version}'}"
            for worker, version in wrong.items()
        )
        return f"{told}; this is imud {ours}: install the same on every worker"
    return ""


def alone(job: Job) -> Outcome | str:
    """In a process of its own, perhaps on another machine: an error is told, and the others go on."""
    runtime.prepare()
    try:
        return play(job, lambda done, total: None)
    except ImudError as error:
        return f"{job.paths[0]}: {error}"
    except OSError as error:  # of the output, or of a shared folder
        return f"{job.paths[0]}: {error} (on {socket.gethostname()})"


def _collected(futures: Iterable[Any], jobs: dict[Any, Job]) -> Iterator[Outcome | str]:
    """Results; of a process that died, that it did."""
    for future in futures:
        job = jobs[future]
        try:
            yield future.result()
        except Exception as error:
            yield f"{job.paths[0]}: its process ended ({type(error).__name__}: {error})"
