"""`imud foxglove`: a running daemon in Foxglove, live. A process of its own, as `imud web`, and only a client."""

import argparse
import importlib.util

from ...errors import UsageError
from ..arguments import above_zero, add_live, listen_address_of

_PORT = 8765  # Foxglove's
_RATE_HZ = 30.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_live(parser)
    parser.add_argument(
        "--listen",
        default=f"127.0.0.1:{_PORT}",
        metavar="HOST:PORT",
        help="where Foxglove connects (default: %(default)s); 0.0.0.0:8765 is for other machines, too, without a "
        "password",
    )
    parser.add_argument(
        "--rate", type=above_zero, default=_RATE_HZ, metavar="HZ", help="estimates per second (default: %(default)g)"
    )


def run(args: argparse.Namespace) -> int:
    if importlib.util.find_spec("foxglove") is None:
        raise UsageError("the server for Foxglove needs foxglove-sdk: pip install 'imud[foxglove]'")
    from .server import serve

    return serve(args, listen_address_of(args.listen, _PORT))
