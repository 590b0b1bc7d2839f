"""`imud status`: the state of a running daemon on one screen, as JSON, or for Prometheus, read from its gpsd socket."""

import argparse
import json
import socket
import sys
from collections.abc import Mapping
from typing import Any

from ... import __version__
from ...client import GPSD_ADDRESS
from ...errors import DeviceAbsentError, ImudError, PermissionDeniedError
from ...outputs.addresses import PORT, Address
from ...outputs.listeners import NO_DESCRIPTORS, TOO_MANY
from ..arguments import address_of
from . import metrics, screen

TIMEOUT_S = 5.0
ANSWER_MAX = 1 << 20  # bytes
Table = Mapping[str, Any]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "address",
        nargs="?",
        default=GPSD_ADDRESS,
        metavar="ADDRESS",
        help="where it listens: HOST[:PORT], or /path of a Unix socket (default %(default)s)",
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="everything, as one JSON object")
    form.add_argument("--prometheus", action="store_true", help="as metrics, for example for a textfile collector")


def run(args: argparse.Namespace) -> int:
    address = address_of("gpsd socket", args.address, PORT)
    form = "prometheus" if args.prometheus else "json" if args.json else "screen"
    sys.stdout.write(text_of(ask(address), form))
    return 0


def text_of(status: Table, form: str) -> str:
    """The flat status as "prometheus", "json" or "screen". Raises ImudError for one of another version of imud."""
    try:
        if form == "prometheus":
            return metrics.prometheus(status)
        if form == "json":
            return json.dumps(nested(status)) + "\n"
        return "".join(f"{name:<12}{text}\n" for name, text in screen.lines(nested(status)))
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        version = status.get("version", "unknown")
        raise ImudError(
            f"this status cannot be shown ({error!r}): the daemon's version is {version}, this one's {__version__}; "
            "use the same version for both"
        ) from error


def ask(address: Address, timeout_s: float = TIMEOUT_S) -> dict[str, Any]:
    """The flat status of the daemon there. Raises DeviceAbsentError (69), PermissionDeniedError (77), ImudError."""
    with socket.socket(address.family, socket.SOCK_STREAM) as sock:
        sock.settimeout(timeout_s)
        try:
            sock.connect(address.where)
            sock.sendall(b"?STATUS;\n")
            return _answer(sock, address)
        except TimeoutError:
            raise DeviceAbsentError(
                f"{address.text} is open, but does not answer: see the log of the program that listens there"
            ) from None
        except PermissionError as error:
            raise PermissionDeniedError(f"cannot connect to {address.text}: permission denied") from error
        except OSError as error:
            raise DeviceAbsentError(
                f"no daemon answers at {address.text} ({error.strerror}): start one (`imud --port DEV`), or name the "
                "address that it listens on (`imud status HOST:PORT` or `imud status /path`)"
            ) from None


def _answer(sock: socket.socket, address: Address) -> dict[str, Any]:
    not_imud = DeviceAbsentError(f"the program at {address.text} is not imud, or is an imud without ?STATUS")
    received = b""
    while len(received) < ANSWER_MAX and (data := sock.recv(65536)):
        *lines, received = (received + data).split(b"\n")
        for text in lines:
            try:
                message = json.loads(text)
                kind = message.pop("class")
            except (ValueError, TypeError, AttributeError, KeyError, RecursionError):
                raise not_imud from None
            if kind == "STATUS":
                return dict(message)
            if kind == "ERROR" and message.get("message") == TOO_MANY:
                raise ImudError(f"{address.text} answers {TOO_MANY}: close some clients, or raise gpsd.max_clients")
            if kind == "ERROR" and message.get("message") == NO_DESCRIPTORS:
                raise ImudError(f"{address.text} answers {NO_DESCRIPTORS}: close some, or raise its limit (ulimit -n)")
            if kind == "ERROR":
                raise DeviceAbsentError(f"{not_imud}: it answers {message.get('message')!r}")
    raise not_imud


def nested(status: Table) -> dict[str, Any]:
    """`{"a.b": 1}` as `{"a": {"b": 1}}`; the ports become a list."""
    tree: dict[str, Any] = {}
    for key, value in status.items():
        *path, name = key.split(".")
        branch = tree
        for step in path:
            branch = branch.setdefault(step, {})
        branch[name] = value
    tree["ports"] = list(tree.get("ports", {}).values())
    return tree


def aiding_lines(status: Table) -> list[str]:
    """What came of the sources of measurements, by the flat status; none if there are none."""
    return list(screen.measurements(nested(status).get("aiding", {})))
