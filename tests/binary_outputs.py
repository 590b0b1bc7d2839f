"""The outputs for clients of the daemon (stream and shared memory), and states to publish."""

import select
from contextlib import contextmanager

import numpy as np

from imud.configuration.settings import Settings
from imud.configuration.settings import SharedMemory as SharedMemorySettings
from imud.configuration.settings import Stream as StreamSettings
from imud.estimators.records import SOLUTION
from imud.outputs.binary import BinaryOutputs


def solutions(n: int, first: int = 0) -> np.ndarray:
    """Rows whose every number tells row and column."""
    rows = np.zeros(n, SOLUTION)
    numbers = rows.view(np.float64).reshape(n, -1)
    numbers[:, 2:] = np.arange(first, first + n)[:, None] + np.arange(numbers.shape[1] - 2) / 64.0
    rows["t_ns"], rows["status"] = 1000 + np.arange(first, first + n), 5
    return rows


def serve(outputs: BinaryOutputs) -> None:
    for fd, _ in outputs.poller.poll(0):
        outputs.stream.on_event(fd)


@contextmanager
def opened(folder):
    """The outputs in this folder; `poller` and `at` are the poll object and the folder."""
    settings = Settings(
        stream=StreamSettings(listen=str(folder / "s"), max_clients=5),
        shared_memory=SharedMemorySettings(path=str(folder / "m")),
    )
    poller = select.poll()
    made = BinaryOutputs(settings, poller, 256)
    made.poller, made.at = poller, folder
    yield made
    made.close()
