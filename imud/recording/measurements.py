"""A measurement of an aiding source as JSON in a recording, and back: the source by its name, NaN as null."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from ..estimators.aiding_source import AidingSource
from ..estimators.records import MEASUREMENT
from ..math.arrays import Records


def measurement_object(source: str, row: Records) -> dict[str, Any]:
    """row: of MEASUREMENT. Doubles are written so that they read back bit for bit."""
    return {
        "t_ns": int(row["t_ns"]),
        "arrival_ns": int(row["arrival_ns"]),
        "source": source,
        "value": row["value"].tolist(),
        "sigma": row["sigma"].tolist(),
    }


def measurement_row(message: dict[str, Any], known: Iterable[AidingSource]) -> Records | None:
    """The same as an array of one MEASUREMENT; None: the estimator does not take that source. known: those it takes.

    Raises KeyError, TypeError, ValueError for what is no measurement.
    """
    kinds = {source.name: source.kind for source in known}
    if message["source"] not in kinds:
        return None
    row = np.zeros(1, MEASUREMENT)
    row["t_ns"], row["arrival_ns"], row["kind"] = message["t_ns"], message["arrival_ns"], kinds[message["source"]]
    for name in ("value", "sigma"):
        numbers = [math.nan if number is None else number for number in message[name]]
        row[name] = math.nan
        row[name][0, : len(numbers)] = numbers  # older recordings have three
    return row
