"""`imud bench`: imud's performance on this machine, as ratios to C and to numpy, measured in one run.

Absolute times vary with the machine and its load. So the programs are run alternately, and the medians of the ratios
are printed.
"""

import argparse
import os
import platform
import sys
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from ...errors import ImudError

if TYPE_CHECKING:
    from .table import Section


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--quick",
        action="store_true",
        help="a minute instead of several: shorter runs, no cold start, no numba, no instructions counted",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the table")


def _parts(quick: bool) -> list[tuple[str, "Callable[[], Section]"]]:
    from . import aided, instructions, live, numba_replay, recorded, startup, throughput

    seconds, rounds = (10, 5) if quick else (60, 9)
    parts: list[tuple[str, Callable[[], Section]]] = [
        ("replay", partial(throughput.replay, seconds, rounds)),
        ("navigation", partial(throughput.navigation, seconds, rounds)),
        ("aiding sources", partial(aided.aiding, seconds, rounds)),
        ("estimators", partial(throughput.estimators, rounds)),
        ("recordings", partial(recorded.recordings, seconds, 3)),
        ("live", partial(live.live, seconds)),
        ("start", partial(startup.start, rounds, not quick)),
    ]
    if quick:
        return parts
    by_numba = partial(numba_replay.against_numba, seconds, rounds)
    return [*parts, ("numba", by_numba), ("instructions", instructions.instructions)]


def run(args: argparse.Namespace) -> int:
    from . import table

    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # what is started finds its bytecode, as where pip installed it
    sections = []
    for name, part in _parts(args.quick):
        if sys.stderr.isatty():
            print(f"\r  measuring: {name:<20}", end="", file=sys.stderr, flush=True)
        try:
            sections.append(part())
        except ImudError as error:
            sections.append(table.Section(f"{name}: {error}"))
    if sys.stderr.isatty():
        print(f"\r{'':40}\r", end="", file=sys.stderr, flush=True)
    if args.json:
        print(table.as_json(sections))
    else:
        print(f"imud bench: {platform.machine()}, Python {platform.python_version()}")
        print(table.as_text(sections))
    return 0
