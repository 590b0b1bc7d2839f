"""The `imud` command: finds the sub-command, and turns its failures into messages and exit codes."""

import argparse
import contextlib
import errno
import functools
import importlib
import io
import itertools
import os
import sys
from collections.abc import Collection, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

from .. import __version__
from ..errors import ImudError, InputOutputError

COMMANDS = {
    "run": "the daemon: sensors in, attitude and position out (default)",
    "demo": "try it without hardware: emulated sensors against the truth",
    "sim": "emulate sensors on pseudo-terminals",
    "web": "show a running daemon live in the browser",
    "foxglove": "show a running daemon live in Foxglove: plots, map, 3D",
    "ros2": "publish a running daemon's estimates as a node of ROS 2",
    "probe": "find which device is on which port, at which baud rate",
    "sensor": "have a Crossbow find its zero, or change its baud rate",
    "status": "show a running daemon's estimates and health",
    "doctor": "check what would keep imud from working on this machine",
    "replay": "run the filter on recorded data, as fast as it goes",
    "record": "record the bytes of ports as they are received, for replay",
    "export": "write a recording as tables, for ROS 2, or as map tracks",
    "report": "write a page about a run: estimates, and what looks wrong",
    "reproduce": "repeat a paper's experiment, its numbers beside ours",
    "soak": "run the daemon for hours with faults; count what it lost",
    "bench": "measure imud's speed on this machine, against C and numpy",
    "warmup": "compile everything now, so that the first start is fast",
    "allan": "measure a sensor's noise, from a recording at rest",
    "calibrate": "find a sensor's biases, scale and mounting, from recordings",
    "reference": "print every setting as a sample file; the man pages",
    "completion": "print a script that completes imud's arguments: bash, zsh",
    "install-service": "run imud as a systemd service",
}
_USAGE, _INTERRUPTED = 64, 130
_FULL = 65536  # bytes: less room is none
_UNNAMED = {  # what an error without a file's name is about
    errno.ENOENT: "the current folder",  # which has been deleted
    errno.EMFILE: "the limit of descriptors for a process (ulimit -n)",
    errno.ENFILE: "the limit of descriptors for all processes (sysctl fs.file-max)",
}
_EXTRAS = {  # package: extra
    "mcap": "record",
    "plotly": "plots",
    "pyarrow": "parquet",
    "aiohttp": "web",
    "foxglove": "foxglove",
    "pygeomag": "magnetometer",
    "distributed": "cluster",
    "shtab": "completion",
}


class _Formatter(argparse.HelpFormatter):
    """argparse makes one for each argument. This one asks for the terminal's width once, and without `shutil`, which
    would cost 0.5 MB.
    """

    def __init__(self, prog: str) -> None:
        super().__init__(prog, width=_columns() - 2)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        """As argparse, but lines that begin with two spaces are commands, which stay whole for who copies them."""
        parts = itertools.groupby(text.splitlines(), key=lambda line: line.startswith("  "))
        wrap = super()._fill_text
        return "\n".join("\n".join(lines) if raw else wrap("\n".join(lines), width, indent) for raw, lines in parts)


@functools.cache
def _columns() -> int:
    with contextlib.suppress(ValueError, KeyError):
        return int(os.environ["COLUMNS"])
    with contextlib.suppress(ValueError, AttributeError, OSError):
        return os.get_terminal_size(sys.stdout.fileno()).columns
    return 80


class _Parser(argparse.ArgumentParser):
    """An argument parser whose usage errors exit with 64 (EX_USAGE), and which takes options by their whole names only:
    an abbreviation would change its meaning with the next option.
    """

    def __init__(self, **arguments: Any) -> None:
        super().__init__(**arguments, allow_abbrev=False, formatter_class=_Formatter)

    def error(self, message: str) -> NoReturn:
        self.print_usage(sys.stderr)
        self.exit(_USAGE, f"{self.prog}: {message}\n")


class _Version(argparse.Action):
    """Print the version, and end."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from ..compile import library

        print(f"imud {__version__}", library.outlook()[1], sep="\n")
        parser.exit()


def _parser(
    filled: Collection[str] = (), listed: Iterable[str] = COMMANDS
) -> tuple[argparse.ArgumentParser, list[argparse.ArgumentParser]]:
    """The parser, and those of the listed commands; only the modules of `filled` are imported for their arguments."""
    parser = _Parser(
        prog="imud",
        description="Inertial sensor daemon: attitude, velocity and position from an IMU and a GNSS receiver.",
        epilog="`imud --port /dev/ttyUSB0` alone is `imud run --port /dev/ttyUSB0`. See also `imud COMMAND --help`.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version, and what runs the kernels")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, prog="imud")
    for name in listed:
        summary = COMMANDS[name]
        sub = commands.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
        if name in filled:
            _module(name).add_arguments(sub)
    return parser, list(commands.choices.values())


def completed_parser() -> tuple[argparse.ArgumentParser, list[argparse.ArgumentParser]]:
    """The parser with all arguments, for their completion: those of `run` may also stand without a command."""
    parser, commands = _parser(COMMANDS)
    _module("run").add_arguments(parser)
    return parser, commands


def _module(command: str) -> ModuleType:
    return importlib.import_module(f"imud.commands.{command.replace('-', '_')}")


def arguments_of(command: str) -> argparse.ArgumentParser:
    """The parser of one command's arguments alone, from which its documentation is made."""
    parser = _Parser(prog=f"imud {command}")
    _module(command).add_arguments(parser)
    return parser


def _with_default_command(arguments: list[str]) -> list[str]:
    first = arguments[0] if arguments else ""
    return ["run", *arguments] if first.startswith("-") and first not in ("-h", "--help", "--version") else arguments


def _did_you_mean(word: str, known: Iterable[str]) -> str:
    import difflib

    near = difflib.get_close_matches(word, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


def _parsed(arguments: list[str]) -> argparse.Namespace:
    """The arguments; exits with 64 for what imud does not know, and says what may have been meant."""
    name = arguments[0]
    parser, _ = _parser([name], [name]) if name in COMMANDS else _parser()
    if not name.startswith("-") and name not in COMMANDS:
        near = _did_you_mean(name, COMMANDS) or f"; there are {', '.join(COMMANDS)}"
        parser.error(f"there is no command {name!r}{near}")
    args, unknown = parser.parse_known_args(arguments)
    if unknown:
        command = arguments_of(args.command)
        near = _did_you_mean(unknown[0].partition("=")[0], command._option_string_actions)
        command.error(f"unrecognized arguments: {' '.join(unknown)}{near}")
    return args


def _open_standard_streams() -> None:
    """Open standard streams that were closed: otherwise the next port or socket would get their number, and our output.

    A character that the user's encoding lacks is replaced.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode))  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal that has no ± is no reason to end


def _close_output() -> None:
    """After a failed write to stdout, redirect it to /dev/null: Python flushes the rest of the buffer at exit."""
    with contextlib.suppress(OSError):  # no descriptor is left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _on_a_full_disk(args: argparse.Namespace) -> Path | None:
    """An argument's file or folder on a full disk: an error of a write does not say which file it was."""
    for path in vars(args).values():
        if isinstance(path, Path) and path.parent.exists():
            disk = os.statvfs(path.parent)
            if disk.f_bavail * disk.f_frsize < _FULL:
                return path
    return None


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns the process's exit code (see `imud.errors`)."""
    _open_standard_streams()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # numpy: one thread and 57 MB of address space less
    arguments = _with_default_command(sys.argv[1:] if arguments is None else arguments)
    args = argparse.Namespace()
    try:
        if not arguments:
            _parser()[0].print_help(sys.stderr)
            return _USAGE
        args = _parsed(arguments)
        code = int(_module(args.command).run(args))
        sys.stdout.flush()
        return code
    except ImudError as error:
        print(f"imud: {error}", file=sys.stderr)
        return error.exit_code
    except ModuleNotFoundError as error:
        if error.name not in _EXTRAS:
            raise
        print(f"imud: this needs the package {error.name}: pip install 'imud[{_EXTRAS[error.name]}]'", file=sys.stderr)
        return _USAGE
    except KeyboardInterrupt:
        return _INTERRUPTED
    except BrokenPipeError:  # the reader of our output went away: `imud … | head`
        _close_output()
        return 0
    except MemoryError:
        print("imud: out of memory: process less data at a time", file=sys.stderr)
        return 1
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else error
        where = error.filename or _UNNAMED.get(error.errno or 0) or _on_a_full_disk(args) or "output"
        print(f"imud: {where}: {reason}", file=sys.stderr)
        _close_output()
        return InputOutputError.exit_code
