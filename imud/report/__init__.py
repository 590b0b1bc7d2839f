"""`imud report`: a run of the filter as one page: its estimates, how far to believe them, and what looks wrong."""

import argparse
import html
import sys
from pathlib import Path

from imud.errors import CannotCreateError, UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="recordings; or est.csv and innovations of `imud replay`, its imu.csv and gnss.csv; several are overlaid",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="HTML", help="the page; works offline")


def run(args: argparse.Namespace) -> int:
    from imud import figures

    if not figures.available():
        raise UsageError("the page needs plotly: pip install 'imud[web]'")
    from .content import panels
    from .findings import findings
    from .session import read

    session = read(args.files)
    said = findings(session)
    text = "\n".join(["What looks wrong:", *(f"- {line}" for line in said)] if said else ["Nothing looks wrong."])
    if not session.innovations:
        text += "\nThere are no innovations in these files: whether the sigmas are right was not judged."
    title = "imud report: " + ", ".join(path.name for path in args.files)
    try:
        figures.write(html.escape(title), f"{title}\n\n{text}", panels(session), args.output)
    except OSError as error:
        raise CannotCreateError(f"cannot write {args.output}: {error.strerror}") from error
    print(text, file=sys.stderr)
    return 0
