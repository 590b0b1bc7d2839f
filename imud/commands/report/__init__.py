"""`imud report`: a run of the filter as one HTML page: its estimates, their consistency, and what looks wrong."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import CannotCreateError, UsageError
from ..files import input_file, refuse_overwriting

if TYPE_CHECKING:
    from .session import Session


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "files",
        nargs="+",
        type=input_file,
        metavar="FILE",
        help="recordings; or est.csv, innovations, states of `imud replay`, imu.csv, gnss.csv; several are overlaid",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="HTML", help="the page; works offline")


def read(paths: list[Path]) -> "Session":
    """All files, with a bar as they are read. Raises InputMissingError, BadDataError, UsageError."""
    from ...progress import Progress
    from ...tables.inputs import is_recording
    from .csv_files import read_table
    from .recording import read_recording
    from .session import merged

    kinds = [is_recording(path) for path in paths]
    total = sum(path.stat().st_size for path in paths)
    progress, done = Progress(1000), 0

    def advance(count: int) -> None:
        nonlocal done
        done += count
        progress.at(min(1000, 1000 * done // max(total, 1)))

    return merged(
        (read_recording if mcap else read_table)(path, name, advance)
        for path, name, mcap in zip(paths, distinct_labels(paths), kinds, strict=True)
    )


def distinct_labels(paths: list[Path]) -> list[str]:
    """The shortest name of each file by which all differ."""
    labels: tuple[Callable[[Path], str], ...] = (lambda path: path.stem, lambda path: path.name, str)
    choices = [[label(path) for path in paths] for label in labels]
    return next((names for names in choices if len(set(names)) == len(names)), choices[-1])


def run(args: argparse.Namespace) -> int:
    from ... import figures

    if not figures.available():
        raise UsageError("the page needs plotly: pip install 'imud[plots]'")
    refuse_overwriting([args.output], args.files)
    from .content import panels
    from .findings import findings, not_judged

    session = read(args.files)
    found = findings(session)
    text = "\n".join(["What looks wrong:", *(f"- {line}" for line in found)] if found else ["Nothing looks wrong."])
    text += "".join(f"\n{line}." for line in not_judged(session.innovations))
    if not session.innovations:
        text += "\nThere are no innovations in these files: whether the sigmas are right was not tested."
    if session.events:
        lines = (f"- {event.name} at {event.t:.1f} s: {event.text}" for event in session.events)
        text += "\n".join(["\nWarnings of the daemon:", *lines])
    title = "imud report: " + ", ".join(path.name for path in args.files)
    try:
        figures.write(title, text, panels(session), args.output)
    except OSError as error:
        raise CannotCreateError(f"cannot write {args.output}: {error.strerror}") from error
    print(text, file=sys.stderr)
    return 0
