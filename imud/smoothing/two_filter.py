"""The whole of smoothing: collect the forward run, run backward, average.

`play_smoothed` is `batch.play` with smoothing; `Segments` takes a run as it comes.

A whole drive need not fit into memory: rows are in temporary files (456 bytes a sample; `TMPDIR` chooses the disk).
"""

import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from imud.drivers.sample import SAMPLE

from ..batch import NO_MEASUREMENT, ignore, play
from ..configuration.settings import Initial
from ..errors import UsageError
from ..estimators.records import (
    ATTITUDE_VALID,
    FIX,
    HEADING_VALID,
    HEIGHT_VALID,
    MEASUREMENT,
    POSITION_VALID,
    SOLUTION,
)
from ..math.arrays import Floats, Records
from ..math.rotation_arrays import matrices
from ..pipeline import Filter
from ..sensor_errors.stored_biases import Biases
from .attitude import smooth_attitude
from .average import combined
from .reversal import BLOCK, reversed_fixes, reversed_measurements, reversed_samples
from .rows import Rows

WIDER = 5.0  # the sigmas with which the backward filter begins, over those with which the forward one ended


class Forward:
    """The run of the filter forward in time: its solutions, and how late fixes and other measurements are."""

    def __init__(self, filter_: Filter) -> None:
        """Raises UsageError if the estimator cannot run backward."""
        if filter_.estimator.backward_tuning is None:
            raise UsageError(f"the estimator {filter_.estimator.name} cannot be smoothed; attitude and navigation can")
        self.filter = filter_
        self._solutions = Rows(SOLUTION)
        self._ages: list[tuple[int, Floats]] = []

    def take(self, solutions: Records) -> None:
        """The solutions of the next samples."""
        self._solutions.append(solutions)
        if len(solutions) and (ages := self.filter.estimator.source_ages_s) is not None:
            self._ages.append((int(solutions["t_ns"][-1]), ages(self.filter.state).copy()))

    def solutions(self) -> Records:
        """All of them."""
        return self._solutions.array()

    def delay_s(self) -> float:
        """By how much fixes are older than their epochs say, as the filter found from all of them."""
        delay = self.filter.estimator.fix_delay_s
        return 0.0 if delay is None else delay(self.filter.state)

    def fixes(self, fixes: Records) -> Records:
        """Fixes as a backward run uses them."""
        backward = self.filter.estimator.backward_fixes
        return fixes if backward is None else backward(self.filter.parameters, self.filter.state, fixes)

    def at_their_ages(self, measurements: Records) -> Records:
        """Measurements with the epochs that the filter took them for."""
        rows = measurements.copy()
        if self._ages and len(rows):
            times, ages = zip(*self._ages, strict=True)
            known = np.minimum(np.searchsorted(times, rows["arrival_ns"]), len(times) - 1)
            rows["t_ns"] -= np.round(1e9 * np.array(ages)[known, rows["kind"]]).astype(np.int64)
        return rows


def smooth(
    forward: Forward,
    samples: Records,
    fixes: Records,
    measurements: Records,
    write: Callable[[Records], object],
) -> None:
    """Write the smoothed solutions (SOLUTION) in blocks, first to last.

    samples: all of the forward run, in body axes. fixes, measurements: as given to it.
    """
    solutions = forward.solutions()
    if not len(solutions):
        return
    if forward.filter.is_recorded:
        smooth_attitude(_again(forward.filter), samples, write)
        return
    end_ns = int(samples["t_ns"][-1])
    turned, past = Rows(SAMPLE), Rows(SOLUTION)
    for block in reversed_samples(samples, solutions, forward.filter.estimator.rates_of_interval):
        turned.append(block)
    filter_ = _backward_filter(forward.filter, solutions[-1])
    aiding = reversed_measurements(forward.at_their_ages(measurements), filter_.estimator.sources, end_ns)
    turned_fixes = reversed_fixes(forward.fixes(fixes), end_ns, forward.delay_s())
    play(filter_, turned.array(), turned_fixes, past.append, aiding=aiding)
    backward = past.array()[::-1]
    for start in range(0, len(solutions), BLOCK):
        part = slice(start, start + BLOCK)
        write(combined(solutions[part], backward[part]))


def play_smoothed(
    filter_: Filter,
    samples: Records,
    fixes: Records,
    on_solutions: Callable[[Records], object],
    *,
    on_innovations: Callable[[Records], object] | None = None,
    aiding: Records = NO_MEASUREMENT,
    on_progress: Callable[[int], None] = ignore,
    each_second: Callable[[int], None] | None = None,
) -> int:
    """As `batch.play`, but the solutions are smoothed; all else is of the run forward in time. Raises UsageError."""
    forward = Forward(filter_)
    fed = play(
        filter_,
        samples,
        fixes,
        forward.take,
        on_innovations=on_innovations,
        aiding=aiding,
        on_progress=on_progress,
        each_second=each_second,
    )
    smooth(forward, samples, fixes, aiding, on_solutions)
    return fed


class Segments:
    """Smooths what a recording holds, a segment for each filter: another sensor begins a new one. Not thread-safe."""

    def __init__(self, write: Callable[[Records], None]) -> None:
        """write: given the smoothed solutions in blocks."""
        self._write = write
        self._forward: Forward | None = None

    def step(self, filter_: Filter, samples: Records, solutions: Records) -> None:
        """The filter's next samples (SAMPLE, in body axes) and solutions."""
        if self._forward is None or self._forward.filter is not filter_:
            self.finish()
            self._forward = Forward(filter_)
            self._samples, self._fixes, self._measurements = Rows(SAMPLE), Rows(FIX), Rows(MEASUREMENT)
        self._forward.take(solutions)
        self._samples.append(samples)

    def take_fix(self, fix: Records, innovations: Records) -> None:
        """A fix (array of one FIX) that the filter was given."""
        if self._forward is not None:
            self._fixes.append(fix)

    def take_measurement(self, measurement: Records, innovations: Records) -> None:
        """A measurement (array of one MEASUREMENT) of an aiding source that it was given."""
        if self._forward is not None:
            self._measurements.append(measurement)

    def finish(self) -> None:
        """No more samples: smooth the last segment."""
        if self._forward is not None:
            samples, fixes, measurements = self._samples.array(), self._fixes.array(), self._measurements.array()
            smooth(self._forward, samples, fixes, measurements, self._write)
            self._forward = None


def _again(forward: Filter) -> Filter:
    """A filter that begins as this one did, for samples that are mounted and calibrated."""
    settings = msgspec.structs.replace(
        forward.settings, imu=msgspec.structs.replace(forward.settings.imu, mount_rpy_deg=(0.0, 0.0, 0.0))
    )
    filter_ = Filter(forward.estimator, settings, Initial(), forward.rate_hz)
    filter_.state[:] = forward.beginning
    filter_.health["range"] = forward.health["range"]  # of this sensor
    return filter_


def _backward_filter(forward: Filter, last: Any) -> Filter:
    """A filter that begins at `last` (a SOLUTION), the end of the forward run, with sigmas so wide that what both have
    in common weighs little. Its samples were mounted and calibrated on the way forward.
    """
    estimator, settings = forward.estimator, forward.settings
    assert estimator.backward_tuning is not None
    known = estimator.backward_tuning(forward.parameters[0], forward.state, last, WIDER)
    table = getattr(settings, estimator.table)
    tuning = table.tuning | _within_range(estimator.tunables, known)
    settings = msgspec.structs.replace(
        settings,
        imu=msgspec.structs.replace(settings.imu, mount_rpy_deg=(0.0, 0.0, 0.0)),
        aiding=msgspec.structs.replace(settings.aiding, magnetometer=False),  # its error is the same both ways
        **{estimator.table: msgspec.structs.replace(table, tuning=tuning)},
    )
    filter_ = Filter(estimator, settings, _state_of(last), forward.rate_hz)
    filter_.health["range"] = forward.health["range"]  # of this sensor
    biases = Biases(
        tuple((-last["bg"]).tolist()),
        tuple((WIDER * last["sigma_bg"]).tolist()),
        tuple(last["ba"].tolist()),
        tuple((WIDER * last["sigma_ba"]).tolist()),
    )
    if biases.is_plausible:
        filter_.restore_biases(biases)
    return filter_


def _within_range(tunables: Any, wanted: dict[str, float]) -> dict[str, float]:
    known = {tunable.name: tunable for tunable in tunables}
    return {
        name: min(max(value, known[name].least), known[name].most)
        for name, value in wanted.items()
        if math.isfinite(value)
    }


def _state_of(last: Any) -> Initial:
    """What is valid of a solution, seen backward."""
    status = int(last["status"])
    known: dict[str, float] = {}
    if status & ATTITUDE_VALID:
        m = matrices(last["q_nb"][None])[0]
        known["roll_deg"] = math.degrees(math.atan2(m[2, 1], m[2, 2]))
        known["pitch_deg"] = math.degrees(math.asin(max(-1.0, min(1.0, -m[2, 0]))))
        if status & HEADING_VALID:
            known["yaw_deg"] = math.degrees(math.atan2(m[1, 0], m[0, 0]))
    if status & POSITION_VALID:
        known |= {"lat_deg": math.degrees(last["lat"]), "lon_deg": math.degrees(last["lon"])}
        known |= {f"v{axis}_mps": -float(v) for axis, v in zip("ned", last["v"], strict=True)}
        if status & HEIGHT_VALID:
            known["height_m"] = float(last["height"])
    return Initial(**known)
