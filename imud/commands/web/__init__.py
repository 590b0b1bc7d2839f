"""`imud web`: a live page of a running daemon. A process of its own, and only a client of the daemon's gpsd socket."""

import argparse
import importlib.util

from ...errors import ConfigError, UsageError

_NEEDED = ("aiohttp", "plotly")
_PAGE_PORT, _DAEMON_PORT = 8080, 2947


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "daemon",
        nargs="?",
        default=f"127.0.0.1:{_DAEMON_PORT}",
        metavar="ADDRESS",
        help="of the daemon's gpsd socket: HOST:PORT or /path (default: %(default)s); it may come and go",
    )
    parser.add_argument(
        "--listen",
        default=f"127.0.0.1:{_PAGE_PORT}",
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
    from ...outputs.addresses import parse_address

    require()
    from .server import serve

    try:
        daemon = parse_address(args.daemon, _DAEMON_PORT)
    except ConfigError as error:
        raise UsageError(f"no daemon can be at {args.daemon!r}: name its gpsd socket, HOST:PORT or /path") from error
    try:
        page = parse_address(args.listen, _PAGE_PORT)
    except ConfigError as error:
        raise UsageError(f"--listen: {error}") from error
    if isinstance(page.where, str):
        raise UsageError(f"--listen {args.listen}: browsers open no Unix sockets; write HOST:PORT")
    return serve(daemon, page, args.control)
