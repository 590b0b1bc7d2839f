"""`python -m imud.firmware_sim g350 nmea --scenario car`: the emulator by itself."""

import argparse
import os
import signal
import sys


def main() -> int:
    signal.signal(signal.SIGTERM, lambda number, frame: os._exit(0))  # until there is something to tidy up
    signal.signal(signal.SIGINT, lambda number, frame: os._exit(130))
    from . import cli

    parser = argparse.ArgumentParser(
        prog="firmware_sim", description="Emulated sensors on pseudo-terminals.", allow_abbrev=False
    )
    cli.add_arguments(parser)
    try:
        return cli.run(parser.parse_args())
    except SystemExit as done:
        return cli.EXIT_USAGE if done.code else 0


if __name__ == "__main__":
    sys.exit(main())
