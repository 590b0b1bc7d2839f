"""`imud reproduce`: the source papers' experiments, their numbers beside ours; it fails if a claim does not hold."""

import argparse
import importlib
import json
import sys
from pathlib import Path

from ..errors import CannotCreateError
from .arguments import seed

PAPERS = {
    "farrell": "a stationary accelerometer: Phi and Q_d, drift, residuals, states",
    "suh": "attitude under external acceleration: three filters on a cart",
    "prasanna": "vehicle localisation: GPS track, INS on a table top, tilt",
}
CLAIM_FAILED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "paper", choices=PAPERS, metavar="PAPER", help="; ".join(f"{name}: {what}" for name, what in PAPERS.items())
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="write PAPER.html with the figures there")
    parser.add_argument("--seed", type=seed, default=1, metavar="N", help="of the simulated data (default 1)")
    parser.add_argument("--json", action="store_true", help="the table for machines")


def _draw(report: object, folder: Path, paper: str) -> None:
    from .. import figures
    from ..experiments.report import Report

    assert isinstance(report, Report)
    if not figures.available():
        raise CannotCreateError(f"no figures in {folder} without plotly: pip install 'imud[plots]'")
    path = folder / f"{paper}.html"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        figures.write(report.title, "\n".join(report.lines()), report.figures, path)
    except OSError as error:
        raise CannotCreateError(f"cannot write {path}: {error.strerror}") from error
    print(f"imud reproduce: figures in {path}", file=sys.stderr)


def run(args: argparse.Namespace) -> int:
    report = importlib.import_module(f"imud.experiments.{args.paper}").reproduce(args.seed)
    print(json.dumps(report.as_dict(), ensure_ascii=False) if args.json else "\n".join(report.lines()))
    for row in report.failed:
        print(f"imud reproduce: does not hold: {row.quantity}: {row.ours}", file=sys.stderr)
    if args.output is not None:
        _draw(report, args.output, args.paper)
    return CLAIM_FAILED if report.failed else 0
