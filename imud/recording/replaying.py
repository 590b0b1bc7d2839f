"""One recording through the same code as live, into a table of estimates."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from ..configuration.settings import Initial
from ..errors import BadDataError
from ..setup import config
from ..tables.output import open_output
from .source import Recording, adapter


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
    from ..math.arrays import Records
    from ..sensor_errors import calibration
    from ..tables.estimates import EstimateWriter, InnovationWriter
    from ..tables.filter_states import FilterStates, write_states
    from .player import Player, ignore
    from .writer import Thinner

    begin = time.perf_counter()
    recording = Recording(job.paths)
    adapt = adapter(job.config, job.overrides, job.estimator)
    settings = recording.settings(adapt)
    notes = recording.doubts()
    thinner = Thinner(job.rate_hz or 0.0)
    times: list[int] = []
    states = FilterStates()
    with ExitStack() as stack:
        writer = EstimateWriter(stack.enter_context(open_output(job.output)), 0, 256)
        note: Callable[[Records], None] = ignore
        if job.innovations is not None:
            note = InnovationWriter(stack.enter_context(open_output(job.innovations)), 0).write

        def write(solutions: Records) -> None:
            if len(kept := thinner.kept(solutions)):
                writer.write(kept)

        def step(samples: Records, solutions: Records) -> None:
            times[1:] = [int(solutions[-1]["t_ns"])] if times else [int(solutions[0]["t_ns"])] * 2
            if smoother is None:
                write(solutions)
            else:
                smoother.step(player.filter, samples, solutions)
            note(player.filter.pending_innovations())
            if job.states is not None:
                states.take(player.filter, int(solutions[-1]["t_ns"]))

        smoother = None
        if job.smooth:
            from ..smoothing import Segments

            smoother = Segments(write)
        initial = config.parse_assignments(job.initial, Initial, "--initial")

        def update(fix: Records, new: Records) -> None:
            note(new)
            if smoother is not None:
                smoother.take_fix(fix, new)

        def aid(measurement: Records, new: Records) -> None:
            note(new)
            if smoother is not None:
                smoother.take_measurement(measurement, new)

        known = None if job.calibration is None else calibration.read(job.calibration)
        player = Player(settings, adapt, initial, step, update, notes.append, on_aid=aid, calibration=known)
        for entry in recording.entries(Player.TOPICS):
            player.take(entry)
            progress(recording.read_bytes, recording.bytes)
        progress(recording.bytes, recording.bytes)  # behind the last message is the file's index
        if smoother is not None:
            smoother.finish()
    if job.states is not None:
        write_states(job.states, 0, states.rows)
    if not player.samples:
        raise BadDataError("; ".join([f"{recording.path}: no samples of an inertial sensor in it", *recording.notes]))
    span_s = (times[1] - times[0]) * 1e-9
    seconds = time.perf_counter() - begin
    return Outcome(recording.path, player.samples, player.fixes, span_s, seconds, (*notes, *recording.notes))
