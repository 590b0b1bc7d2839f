"""The inertial samples of a recording, every one, decoded from its bytes as the daemon did."""

import math
from pathlib import Path

import numpy as np

from ..errors import BadDataError
from ..settings import Initial
from .player import Player, Records
from .source import Recording, adapter, tell


def samples_of(path: Path) -> tuple[Records, int, int]:
    """Samples (array of SAMPLE, body axes), the origin in whole s, and how many had to be left out: none.

    Raises UsageError, InputMissingError, BadDataError.
    """
    recording = Recording([path])
    adapt = adapter(None, (), "tilt")  # the cheapest estimator: only the samples are wanted
    batches: list[Records] = []

    def keep(samples: Records, solutions: Records) -> None:
        batches.append(samples.copy())

    player = Player(recording.settings(adapt), adapt, Initial(), keep, warn=recording.notes.append)
    for entry in recording:
        player.take(entry)
    tell("", recording.notes)
    if player.samples < 2:
        raise BadDataError("; ".join([f"{path}: {player.samples} inertial samples in it", *recording.notes]))
    samples = np.concatenate(batches)
    origin = math.floor(samples["t_ns"][0] * 1e-9)
    samples["t_ns"] -= origin * 1_000_000_000
    return samples, origin, 0
