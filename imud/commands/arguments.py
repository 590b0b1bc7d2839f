"""Arguments that several commands take, and types of arguments."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from ..client import GPSD_ADDRESS
from ..errors import ConfigError, UsageError

if TYPE_CHECKING:
    from ..outputs.addresses import Address


def add_settings(parser: argparse.ArgumentParser) -> None:
    """--config and --set, for `config.load`."""
    parser.add_argument("--config", type=Path, metavar="TOML", help="a file of settings: see `imud reference`")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override one of the settings")


def add_scenario(parser: argparse.ArgumentParser) -> None:
    """--scenario and --seed, for `imud sim`."""
    from imud.firmware_sim.cli import SCENARIO_NAMES  # for commands that emulate only

    parser.add_argument(
        "--scenario",
        choices=SCENARIO_NAMES,
        default="car",
        metavar="NAME",
        help=f"what the emulated vehicle does: {', '.join(SCENARIO_NAMES)} (default: %(default)s)",
    )
    parser.add_argument("--seed", type=seed, default=1, metavar="N", help="of the sensors' errors (default: 1)")


def add_live(parser: argparse.ArgumentParser) -> None:
    """Where a running daemon is, for `live.follow`."""
    parser.add_argument("stream", metavar="STREAM", help="the daemon's `stream.listen`, such as /run/imud/front.stream")
    parser.add_argument(
        "--gpsd",
        default=GPSD_ADDRESS,
        metavar="ADDRESS",
        help="its gpsd socket, for the receiver's fixes and the status: HOST:PORT or /path (default: %(default)s)",
    )


def address_of(argument: str, text: str, default_port: int) -> "Address":
    """Where to connect. argument: its name. Raises UsageError."""
    from ..outputs.addresses import parse_address  # which resolves names; not for every command

    try:
        return parse_address(text, default_port)
    except ConfigError as error:
        raise UsageError(f"{argument}: {error}") from error


def listen_address_of(text: str, default_port: int) -> "Address":
    """Where a server of web pages listens: its clients open no Unix sockets. Raises UsageError."""
    address = address_of("--listen", text, default_port)
    if isinstance(address.where, str):
        raise UsageError(f"--listen {text}: its clients open no Unix sockets; write HOST:PORT")
    return address


def above_zero(text: str) -> float:
    """A finite number, such as a rate or a time."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r}: a number above 0 is needed")
    return value


def seconds(text: str) -> float:
    """A finite time, which may be below 0."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r}: a number of seconds is needed")
    return value


def at_least_one(text: str) -> int:
    """A count."""
    return _whole(text, 1)


def seed(text: str) -> int:
    """Of random numbers."""
    return _whole(text, 0)


def _whole(text: str, least: int) -> int:
    if not (text.isascii() and text.isdecimal()) or int(text) < least:
        raise argparse.ArgumentTypeError(f"{text!r}: a whole number from {least} is needed")
    return int(text)
