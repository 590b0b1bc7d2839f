"""`imud foxglove`: a running daemon in Foxglove, live. A process of its own, as `imud web`, and only a client."""

import argparse
import importlib.util

from ...errors import ConfigError, UsageError
from ..arguments import above_zero, add_live

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
    from ...outputs.addresses import parse_address

    if importlib.util.find_spec("foxglove") is None:
        raise UsageError("the server for Foxglove needs foxglove-sdk: pip install 'imud[foxglove]'")
    from .server import serve

    try:
        address = parse_address(args.listen, _PORT)
    except ConfigError as error:
        raise UsageError(f"--listen: {error}") from error
    if isinstance(address.where, str):
        raise UsageError(f"--listen {args.listen}: Foxglove opens no Unix sockets; write HOST:PORT")
    return serve(args, address)
