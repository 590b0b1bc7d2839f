"""Whole arrays of samples, fixes and measurements through a filter: what `imud replay` of tables and the library do."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .estimators.filter_states import PERIOD_NS
from .estimators.records import MEASUREMENT, SOLUTION
from .math.arrays import Records
from .pipeline import Filter, room_for

BLOCK = 4096  # samples: each costs some 20 us of Python
_NO_MEASUREMENT = np.zeros(0, MEASUREMENT)


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
    each_second: Callable[[int], None] | None = None,
) -> int:
    """Feed everything in the order in which it became known: a fix goes in before the first sample not older than its
    arrival.

    samples: array of SAMPLE, turned to body axes in place. fixes, aiding: arrays of FIX and MEASUREMENT, in order of
    arrival. write: given the solutions of each block, in rows that the next block overwrites. keep: mask of the samples
    whose solutions are written; None: all. note: given innovations. advance: given the number of samples done.
    each_second: called behind the first sample of each second, and perhaps of others, with its time. Returns the number
    of fixes fed.
    """
    out = np.zeros(min(BLOCK, len(samples)), SOLUTION)
    t_ns = samples["t_ns"].copy()  # one behind the other
    fixes, places = _placed(t_ns, fixes, first=1)
    aiding, aided = _placed(t_ns, _NO_MEASUREMENT if aiding is None else aiding, first=0)
    alone = aided[filter_.needing_place(aiding)]
    seconds = np.flatnonzero(np.diff(t_ns // PERIOD_NS, prepend=-1))[: None if each_second else 0] + 1
    edges = np.unique(np.concatenate([np.arange(0, len(samples), BLOCK), alone, seconds, [len(samples)]]))
    due, taken = np.searchsorted(places, edges), np.searchsorted(aided, edges)  # of all blocks at once
    room = room_for(int(np.max(np.diff(due) + np.diff(taken), initial=0)))
    blocks = zip(*(itertools.pairwise(at.tolist()) for at in (edges, due, taken)), strict=True)
    for (start, stop), (fix, next_fix), (measurement, next_measurement) in blocks:
        rows = out[: stop - start]
        innovations = filter_.feed(
            samples[start:stop],
            rows,
            fixes[fix:next_fix],
            places[fix:next_fix] - start,
            room,
            aiding[measurement:next_measurement],
            aided[measurement:next_measurement] - start,
        )
        write(rows if keep is None else rows[keep[start:stop]])
        advance(stop)
        if each_second is not None:
            each_second(int(t_ns[stop - 1]))
        if note is not None:
            note(innovations.copy())  # a view would keep all the room
            note(filter_.pending_innovations().copy())
    return len(fixes)


def _placed(t_ns: NDArray[np.int64], rows: Records, first: int) -> tuple[Records, Records]:
    """Fixes or measurements with the index of the sample before which each goes in: of those from `first` on."""
    places = np.maximum.accumulate(np.searchsorted(t_ns, rows["arrival_ns"], side="left"))
    among = (places >= first) & (places < len(t_ns))
    return rows[among], places[among]
