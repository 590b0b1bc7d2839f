"""Whole arrays of samples, fixes and measurements through a filter: what `imud replay` of tables and the library do."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from .estimators.records import SOLUTION
from .math.arrays import Records
from .pipeline import Filter, room_for

BLOCK = 1024


def _ignore(_: int) -> None:
    pass


def play(
    filter_: Filter,
    samples: Records,
    fixes: Records,
    write: Any,
    keep: Records | None = None,
    note: Any = None,
    aiding: Records | None = None,
    advance: Callable[[int], None] = _ignore,
) -> int:
    """Feed everything in the order in which it became known: a fix goes in before the first sample not older than its
    arrival.

    samples: array of SAMPLE, turned to body axes in place. fixes, aiding: arrays of FIX and MEASUREMENT, in order of
    arrival. write: given the solutions of each block, in rows that the next block overwrites. keep: mask of the samples
    whose solutions are written; None: all. note: given innovations. advance: given the number of samples done. Returns
    the number of fixes fed.
    """
    out = np.zeros(BLOCK, SOLUTION)
    places = np.maximum.accumulate(np.searchsorted(samples["t_ns"], fixes["arrival_ns"], side="left"))
    among = (places > 0) & (places < len(samples))
    fixes, places = fixes[among], places[among]
    aided = np.zeros(0, np.int64) if aiding is None else np.searchsorted(samples["t_ns"], aiding["arrival_ns"])
    edges = np.unique(np.concatenate([np.arange(0, len(samples), BLOCK), aided[aided < len(samples)], [len(samples)]]))
    for start, stop in itertools.pairwise(edges):
        if aiding is not None and (aided == start).any():
            measured = filter_.aid(aiding[aided == start])
            if note is not None:
                note(measured.copy())
        due = slice(*np.searchsorted(places, [start, stop]))
        rows = out[: stop - start]
        innovations = filter_.feed(
            samples[start:stop], rows, fixes[due], places[due] - start, room_for(len(fixes[due]))
        )
        write(rows if keep is None else rows[keep[start:stop]])
        advance(stop)
        if note is not None:
            note(innovations.copy())  # a view would keep all the room
            note(filter_.pending_innovations().copy())
    return len(fixes)
