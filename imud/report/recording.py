"""A recording of the daemon (MCAP) as a report wants it: what it recorded of its estimates, not a replay of them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imud.errors import BadDataError
from imud.recording.messages import ESTIMATE_TABLE, FIX_TABLE, INNOVATION_TABLE, SAMPLE_TABLE, TABLES
from imud.recording.source import Recording, tell

MAGIC = b"\x89MCAP"


def is_recording(path: Path) -> bool:
    """By its first bytes. Raises OSError."""
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


class Recorded:
    """Rows of SOLUTION, INNOVATION, SAMPLE and FIX, times on the host's monotonic clock."""

    def __init__(self, path: Path) -> None:
        """Raises BadDataError, InputMissingError, UsageError. What is wrong with the file is told on stderr."""
        recording = Recording([path])
        objects: dict[str, list[Any]] = {table.topic: [] for table in TABLES}
        try:
            for entry in recording:
                if entry.topic in objects:
                    objects[entry.topic].append(json.loads(entry.data))
            self.estimates, self.innovations, self.samples, self.fixes = (
                table.rows(objects[table.topic])
                for table in (ESTIMATE_TABLE, INNOVATION_TABLE, SAMPLE_TABLE, FIX_TABLE)
            )
        except (ValueError, KeyError, TypeError) as error:
            raise BadDataError(f"{path}: a message cannot be understood: {error}") from error
        tell("report", recording.notes)
        if not len(self.estimates):
            raise BadDataError(f"{path}: no estimates in it; `imud replay {path} -o est.csv` makes them of its bytes")

    @property
    def first_s(self) -> float:
        """Of the earliest estimate."""
        return float(self.estimates["t_ns"][0]) * 1e-9


def thinned(rows: NDArray[np.void], most: int) -> NDArray[np.void]:
    """At most so many of them, evenly."""
    return rows[:: max(1, -(-len(rows) // most))]
