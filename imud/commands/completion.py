"""`imud completion`: a script with which a shell completes imud's commands, options and files; made of its parsers."""

import argparse
from pathlib import Path

from .files import input_file

SHELLS = ("bash", "zsh")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "shell",
        choices=SHELLS,
        help="bash: to ~/.local/share/bash-completion/completions/imud; zsh: to _imud in a folder of $fpath",
    )


def script(shell: str) -> str:
    """For that shell."""
    import shtab

    from . import completed_parser

    parser, commands = completed_parser()
    for action in [action for one in (parser, *commands) for action in one._actions]:
        if action.type in (Path, input_file):
            action.complete = shtab.FILE  # type: ignore[attr-defined]
        elif isinstance(action.choices, dict) and action.dest != "command":
            action.choices = tuple(action.choices)  # a mapping is a table of commands for shtab
    return str(shtab.complete(parser, shell))


def run(args: argparse.Namespace) -> int:
    print(script(args.shell))
    return 0
