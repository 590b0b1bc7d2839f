"""`imud replay REC.mcap …`: recordings through the same code as live, one or many at a time."""

import argparse
import contextlib
import os
import sys
from collections import Counter
from pathlib import Path

from ...compile import library
from ...configuration.settings import Settings
from ...errors import BadDataError, CannotCreateError, ImudError, UsageError
from ...progress import Progress
from ...recording.replaying import Job, Outcome, play
from ...recording.source import Recording, adapter, group, print_notes


def run(args: argparse.Namespace) -> int:
    recordings, failed = group(args.recordings)
    several = len(recordings) + len(failed) > 1
    if several and (args.innovations or args.states):
        raise UsageError("replay: --innovations and --states are of one recording")
    jobs = _jobs(args, [recording.paths for recording in recordings], several)
    if several or args.cluster:
        return _many(jobs, failed, args)
    progress = Progress(1000)
    _report(play(jobs[0], lambda done, total: progress.at(1000 * done // max(total, 1))))
    return 0


def _many(jobs: list[Job], failed: list[str], args: argparse.Namespace) -> int:
    """Returns the exit code. Raises BadDataError if any could not be replayed, after the others have been."""
    from ...recording import many

    if not args.cluster:
        _compile(jobs)
    total = len(jobs) + len(failed)
    progress = Progress(total)
    progress.at(len(failed))
    outcomes = many.run_on_cluster(jobs, args.cluster) if args.cluster else many.run_locally(jobs, args.jobs)
    for done, outcome in enumerate(outcomes, len(failed) + 1):
        progress.clear()
        if isinstance(outcome, str):
            failed.append(outcome)
        else:
            _report(outcome)
        progress.at(done)
    if failed:
        raise BadDataError("\n  ".join([f"{len(failed)} of {total} recordings could not be replayed", *failed]))
    return 0


def _compile(jobs: list[Job]) -> None:
    """Compile what the jobs need, if installation did not: once, instead of in all their processes at the same time."""
    if library.library() is not None:
        return
    from ... import kernel_calls
    from ...estimators import registry
    from ...setup import choices

    needed: set[str] = set()
    for job in jobs:
        with contextlib.suppress(ImudError):  # it is reported when the job is replayed
            settings = Recording(job.paths).settings(adapter(job.config, job.overrides, job.estimator))
            needed.update(choices.estimators(settings).possible)
    for estimator in map(registry.by_name, sorted(needed)):
        kernel_calls.warm(estimator, Settings())
        kernel_calls.warm_replay(estimator, Settings())


def _jobs(args: argparse.Namespace, recordings: list[tuple[Path, ...]], into_folder: bool) -> list[Job]:
    """Paths are absolute: a worker may have another current directory."""
    to_stdout = str(args.output) == "-"
    output: Path = args.output if to_stdout else args.output.absolute()
    if to_stdout and (args.cluster or into_folder):
        raise UsageError("-o -: with --cluster name a file, of several recordings a folder")
    if into_folder:
        try:
            output.mkdir(exist_ok=True)
        except OSError as error:
            raise CannotCreateError(f"-o {output}: several recordings need a folder: {error.strerror}") from error
    names = distinct_names([paths[0] for paths in recordings])
    config_file = args.config and args.config.absolute()
    return [
        Job(
            paths=tuple(path.absolute() for path in paths),
            output=output / f"{name}.csv" if into_folder else output,
            config=config_file,
            overrides=tuple(args.set),
            estimator=args.estimator,
            initial=args.initial,
            rate_hz=args.rate,
            smooth=args.smooth,
            innovations=args.innovations and args.innovations.absolute(),
            states=args.states and args.states.absolute(),
            calibration=args.calibration and args.calibration.absolute(),
        )
        for paths, name in zip(recordings, names, strict=True)
    ]


def distinct_names(paths: list[Path]) -> list[str]:
    """A name for each path: that of its file, with those of its folders where files have the same name."""
    stems = Counter(path.stem for path in paths)
    if max(stems.values(), default=0) < 2:
        return [path.stem for path in paths]
    above = Path(os.path.commonpath([path.absolute().parent for path in paths]))
    within = [path.absolute().relative_to(above).with_suffix("") for path in paths]
    return [
        "_".join(part.parts) if stems[path.stem] > 1 else path.stem for path, part in zip(paths, within, strict=True)
    ]


def _report(outcome: Outcome) -> None:
    """Print the outcome on a terminal, and warnings always."""
    if sys.stderr.isatty():
        print(f"imud replay: {outcome}", file=sys.stderr)
    print_notes("replay", outcome.notes)
