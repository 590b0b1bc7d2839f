"""`imud replay REC.mcap …`: recordings through the same code as live, one or many at a time."""

import argparse
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from .. import config
from ..errors import BadDataError, CannotCreateError, ImudError, UsageError
from ..progress import Progress
from ..replay import open_output
from ..settings import Initial
from .source import Recording, adapter, group, tell


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
    """Replay one recording into its file. progress: told bytes done, and of how many. Raises ImudError."""
    from ..tables import EstimateWriter
    from .player import Player, Records
    from .writer import Thinner

    begin = time.perf_counter()
    recording = Recording(job.paths)
    adapt = adapter(job.config, job.overrides, job.estimator)
    settings = recording.settings(adapt)
    notes = recording.doubts()
    thinner = Thinner(job.rate_hz or 0.0)
    times: list[int] = []
    with open_output(job.output) as file:
        writer = EstimateWriter(file, 0, 256)

        def write(samples: Records, solutions: Records) -> None:
            times[1:] = [int(solutions[-1]["t_ns"])] if times else [int(solutions[0]["t_ns"])] * 2
            if len(kept := thinner.kept(solutions)):
                writer.write(kept)

        initial = config.parse_assignments(job.initial, Initial, "--initial")
        player = Player(settings, adapt, initial, write, warn=notes.append)
        for entry in recording:
            player.take(entry)
            progress(recording.read_bytes, recording.bytes)
    if not player.samples:
        raise BadDataError("; ".join([f"{recording.path}: no samples of an inertial sensor in it", *recording.notes]))
    span_s = (times[1] - times[0]) * 1e-9
    seconds = time.perf_counter() - begin
    return Outcome(recording.path, player.samples, player.fixes, span_s, seconds, (*notes, *recording.notes))


def _alone(job: Job) -> Outcome | str:
    """In a process of its own: an error is told, and the others go on."""
    try:
        return play(job, lambda done, total: None)
    except ImudError as error:
        return f"{job.paths[0]}: {error}"


def run(args: argparse.Namespace) -> int:
    if args.jobs < 1:
        raise UsageError(f"--jobs {args.jobs}: at least 1")
    recordings = group(args.recordings)
    jobs = [_job(args, recording.paths, len(recordings)) for recording in recordings]
    if len(jobs) == 1:
        progress = Progress(1000)
        _tell(play(jobs[0], lambda done, total: progress.at(1000 * done // max(total, 1))))
        return 0
    return _many(jobs, args.jobs)


def _many(jobs: list[Job], at_a_time: int) -> int:
    """Returns the exit code: 65 if any could not be replayed."""
    progress, failed = Progress(len(jobs)), []
    with ProcessPoolExecutor(min(at_a_time, len(jobs)), get_context("spawn")) as pool:
        waiting = [pool.submit(_alone, job) for job in jobs]
        for done, future in enumerate(as_completed(waiting), 1):
            outcome = future.result()
            progress.at(done)
            if isinstance(outcome, str):
                failed.append(outcome)
            else:
                _tell(outcome)
    if failed:
        raise BadDataError("\n  ".join([f"{len(failed)} of {len(jobs)} recordings could not be replayed", *failed]))
    return 0


def _job(args: argparse.Namespace, paths: tuple[Path, ...], total: int) -> Job:
    output: Path = args.output
    if total > 1:
        try:
            output.mkdir(exist_ok=True)
        except OSError as error:
            raise CannotCreateError(f"-o {output}: several recordings need a folder: {error.strerror}") from error
        output /= f"{paths[0].stem}.csv"
    return Job(paths, output, args.config, tuple(args.set), args.estimator, args.initial, args.rate)


def _tell(outcome: Outcome) -> None:
    """What was done, on a terminal; what went wrong, everywhere."""
    if sys.stderr.isatty():
        print(f"imud replay: {outcome}", file=sys.stderr)
    tell("replay", outcome.notes)
