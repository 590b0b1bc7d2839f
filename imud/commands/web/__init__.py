"""`imud web`: a live page of a running daemon. A process of its own, and only a client of the daemon's gpsd socket."""

import argparse
import importlib.util

from ...client import GPSD_ADDRESS
from ...errors import UsageError
from ..arguments import address_of, listen_address_of

_NEEDED = ("aiohttp", "plotly")
_PORT = 8080


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "daemon",
        nargs="?",
        default=GPSD_ADDRESS,
        metavar="ADDRESS",
        help="of the daemon's gpsd socket: HOST:PORT or /path (default: %(default)s); it may come and go",
    )
    parser.add_argument(
        "--listen",
        default=f"127.0.0.1:{_PORT}",
        metavar="HOST:PORT",
        help="where the page is (default: %(default)s); 0.0.0.0:8080 shows it to other machines, without a password",
    )
    parser.add_argument(
        "--control",
        action="store_true",
        help="let browsers on other machines begin and end recordings, too (those on this one may, if the daemon's "
        "record.folder says where to)",
    )


def require() -> None:
    """Raises UsageError unless the extra is installed."""
    if missing := [name for name in _NEEDED if importlib.util.find_spec(name) is None]:
        raise UsageError(f"the live page needs {' and '.join(missing)}: pip install 'imud[web]'")


def run(args: argparse.Namespace) -> int:
    from ...outputs.addresses import PORT

    require()
    from .server import serve

    return serve(address_of("gpsd socket", args.daemon, PORT), listen_address_of(args.listen, _PORT), args.control)
