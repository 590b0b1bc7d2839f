"""`imud sim`: the emulator, which knows nothing of the rest."""

import argparse

from imud.firmware_sim import cli


def add_arguments(parser: argparse.ArgumentParser) -> None:
    cli.add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    return cli.run(args)
