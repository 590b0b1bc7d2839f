"""One recording through the same code as live, into a table of estimates."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import BadDataError
from ..setup import config
from ..tables.output import open_output
from .source import Recording, adapter
from .thinner import Thinner

if TYPE_CHECKING:
    from ..math.arrays import Records
    from ..pipeline import Filter
    from ..smoothing import Segments


@dataclass(frozen=True)
class Job:
    """One recording to be replayed."""

    paths: tuple[Path, ...]
    output: Path
    config: Path | None
    overrides: tuple[str, ...]
    estimator: str | None
    initial: str
    rate_hz: float | None
    smooth: bool = False
    innovations: Path | None = None
    states: Path | None = None
    calibration: Path | None = None


@dataclass(frozen=True)
class Outcome:
    """What became of it."""

    path: Path
    samples: int
    fixes: int
    span_s: float
    seconds: float
    notes: tuple[str, ...]

    def __str__(self) -> str:
        speed = self.span_s / max(self.seconds, 1e-9)
        return (
            f"{self.path}: {self.samples} samples of {self.span_s:.1f} s in {self.seconds:.2f} s "
            f"({speed:.0f} x real time), {self.fixes} fixes"
        )


def play(job: Job, progress: Callable[[int, int], None]) -> Outcome:
    """Replay one recording into its file. progress: called with the bytes done and all bytes. Raises ImudError."""
    from ..sensor_errors import calibration
    from ..tables.filter_states import write_states
    from .player import Handlers, Player

    begin = time.perf_counter()
    recording = Recording(job.paths)
    adapt = adapter(job.config, job.overrides, job.estimator)
    settings = recording.settings(adapt)
    notes = recording.version_notes()
    with ExitStack() as stack:
        tables = _Tables(job, stack)
        initial = config.parse_initial(job.initial)
        known = None if job.calibration is None else calibration.read(job.calibration)

        def on_step(samples: "Records", solutions: "Records") -> None:
            tables.on_step(player.filter, samples, solutions)

        handlers = Handlers(on_step, tables.on_update, aid=tables.on_aid, warn=notes.append)
        player = Player(settings, adapt, initial, handlers, known)
        for entry in recording.entries(Player.TOPICS):
            player.take(entry)
            progress(recording.read_bytes, recording.bytes)
        progress(recording.bytes, recording.bytes)  # behind the last message is the file's index
        tables.finish()
    if job.states is not None:
        write_states(job.states, 0, tables.states.rows)
    if tables.begin_ns is None:
        raise BadDataError("; ".join([f"{recording.path}: no samples of an inertial sensor in it", *recording.notes]))
    seconds = time.perf_counter() - begin
    span_s = (tables.end_ns - tables.begin_ns) * 1e-9
    return Outcome(recording.path, player.samples, player.fixes, span_s, seconds, (*notes, *recording.notes))


class _Tables:
    """What a job writes of the run: estimates, smoothed if it says so, innovations, the filter's states."""

    def __init__(self, job: Job, stack: ExitStack) -> None:
        """stack: closes the files. Raises CannotCreateError."""
        from ..tables.estimates import EstimateWriter, InnovationWriter
        from ..tables.filter_states import FilterStates

        self.begin_ns: int | None = None  # time of the first sample; None before it
        self.end_ns = 0  # of the last
        self.states = FilterStates()
        self._with_states = job.states is not None
        self._thinner = Thinner(job.rate_hz or 0.0)
        self._estimates = EstimateWriter(stack.enter_context(open_output(job.output)), 0, 256)
        self._innovations = (
            None if job.innovations is None else InnovationWriter(stack.enter_context(open_output(job.innovations)), 0)
        )
        self._smoother: Segments | None = None
        if job.smooth:
            from ..smoothing import Segments as Smoother

            self._smoother = Smoother(self._write_estimates)

    def on_step(self, filter_: "Filter", samples: "Records", solutions: "Records") -> None:
        """New samples and solutions of the filter; see `Player`."""
        if self.begin_ns is None:
            self.begin_ns = int(solutions[0]["t_ns"])
        self.end_ns = int(solutions[-1]["t_ns"])
        if self._smoother is None:
            self._write_estimates(solutions)
        else:
            self._smoother.step(filter_, samples, solutions)
        self._write_innovations(filter_.pending_innovations())
        if self._with_states:
            self.states.take(filter_, self.end_ns)

    def on_update(self, fix: "Records", innovations: "Records") -> None:
        """A fix that the filter was given; see `Player`."""
        self._write_innovations(innovations)
        if self._smoother is not None:
            self._smoother.take_fix(fix, innovations)

    def on_aid(self, measurement: "Records", innovations: "Records") -> None:
        """A measurement of an aiding source that the filter was given; see `Player`."""
        self._write_innovations(innovations)
        if self._smoother is not None:
            self._smoother.take_measurement(measurement, innovations)

    def finish(self) -> None:
        """No more samples."""
        if self._smoother is not None:
            self._smoother.finish()

    def _write_estimates(self, solutions: "Records") -> None:
        if len(kept := self._thinner.kept(solutions)):
            self._estimates.write(kept)

    def _write_innovations(self, innovations: "Records") -> None:
        if self._innovations is not None:
            self._innovations.write(innovations)
