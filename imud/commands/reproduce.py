"""`imud reproduce`: the source papers' experiments, their numbers beside ours; it fails if a claim does not hold.

With --data the same on a user's recording: which of the claims hold on it, whatever they are.
"""

import argparse
import contextlib
import importlib
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import CannotCreateError, UsageError
from .arguments import add_settings, seed
from .files import input_file

if TYPE_CHECKING:
    from ..experiments.report import Report

PAPERS = {
    "farrell": "a stationary accelerometer: Phi and Q_d, drift, residuals, states",
    "suh": "attitude under external acceleration: three filters on a cart",
    "prasanna": "vehicle localisation: GPS track, INS on a table top, tilt",
}
CLAIM_FAILED = 1
_NARROWEST, _PAGE = 60, 100  # columns


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "paper", choices=PAPERS, metavar="PAPER", help="; ".join(f"{name}: {what}" for name, what in PAPERS.items())
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="write PAPER.html with the figures there")
    parser.add_argument("--data", type=input_file, metavar="FILE", help="on this recording or imu.csv instead of ours")
    parser.add_argument("--gnss", type=input_file, metavar="FILE", help="fixes beside an imu.csv: CSV or NMEA")
    parser.add_argument("--seed", type=seed, default=1, metavar="N", help="of the simulated data (default 1)")
    parser.add_argument("--json", action="store_true", help="the table for machines")
    add_settings(parser)


def _draw(report: "Report", folder: Path, paper: str) -> None:
    from .. import figures

    if not figures.available():
        raise CannotCreateError(f"no figures in {folder} without plotly: pip install 'imud[plots]'")
    path = folder / f"{paper}.html"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        figures.write(report.title, "", report.figures, path, report.table)
    except OSError as error:
        raise CannotCreateError(f"cannot write {path}: {error.strerror}") from error
    print(f"imud reproduce: figures in {path}", file=sys.stderr)


def _simulated(args: argparse.Namespace) -> "Report":
    if args.gnss or args.config or args.set:
        raise UsageError("reproduce: --gnss, --config and --set are of --data FILE; the simulations have their own")
    report: Report = importlib.import_module(f"imud.experiments.{args.paper}").reproduce(args.seed)
    return report


def _recorded(args: argparse.Namespace) -> "Report":
    """Raises ImudError if the data do not suffice for the paper."""
    from ..experiments.recorded import read

    data = read(args.data, args.gnss, args.config, args.set)
    report: Report = importlib.import_module(f"imud.experiments.{args.paper}_recorded").reproduce(data)
    return report


def _width() -> int:
    """Columns of the terminal, or of a page where there is none."""
    with contextlib.suppress(ValueError, AttributeError, OSError):
        return max(_NARROWEST, os.get_terminal_size(sys.stdout.fileno()).columns)
    return _PAGE


def run(args: argparse.Namespace) -> int:
    report = _recorded(args) if args.data else _simulated(args)
    print(json.dumps(report.as_dict(), ensure_ascii=False) if args.json else "\n".join(report.lines(_width())))
    for row in report.failed if report.ours else ():
        print(f"imud reproduce: does not hold: {row.quantity}: {row.ours}", file=sys.stderr)
    if args.output is not None:
        _draw(report, args.output, args.paper)
    return CLAIM_FAILED if report.ours and report.failed else 0
