"""The library's kernels against numba's, which are the reference of the bits, in replay with output."""

from collections.abc import Callable
from typing import cast

import numpy as np

from ...batch import play
from ...compile.entry import Entry
from ...compile.library import library
from ...configuration.settings import Initial, Settings
from ...errors import ImudError
from ...estimators import registry
from ...pipeline import Filter
from . import signals
from .table import Section
from .throughput import timed
from .turns import Turns

_NATIVE = "numba compiles the same functions, for this very processor; ours are for any with AVX2"


def against_numba(seconds: int, rounds: int) -> Section:
    """Processor time of each of the two estimators most used, as a share of what it takes with numba's kernels."""
    section = Section(f"Kernels of the library against numba's: replay of {seconds} s at 1 kHz, {rounds} turns")
    for name in ("attitude", "navigation"):
        row = f"time of {name} against numba"
        if library() is None:
            section.add(row, np.nan, "x", most=0.85, note="numba runs alone: there is no library")
            continue
        try:
            theirs = _replay(name, seconds, by_numba=True)
            theirs()
        except ImudError as error:
            section.add(row, np.nan, "x", most=0.85, note=str(error))
            continue
        turns = Turns(rounds, _replay(name, seconds), theirs)
        section.add(row, turns.ratio(0, 1), "x", most=0.85, reason=_NATIVE)
    return section


def _replay(name: str, seconds: int, by_numba: bool = False) -> Callable[[], float]:
    samples, fixes = signals.samples(seconds * signals.RATE_HZ), signals.fixes(seconds)
    estimator = registry.by_name(name)

    def run_once() -> float:
        filter_ = Filter(estimator, Settings(), Initial(), float(signals.RATE_HZ))
        if by_numba:
            filter_.stages.feed = cast(Entry, filter_.stages.feed).by_numba
        given = samples.copy()
        return timed(lambda: play(filter_, given, fixes, lambda rows: None))

    return run_once
