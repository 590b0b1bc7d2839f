"""`python -m firmware_sim g350 nmea --scenario car`: the emulator by itself."""

import argparse
import sys

from . import cli


def main() -> int:
    parser = argparse.ArgumentParser(prog="firmware_sim", description="Emulated sensors on pseudo-terminals.")
    cli.add_arguments(parser)
    try:
        return cli.run(parser.parse_args())
    except SystemExit as done:
        return cli.EXIT_USAGE if done.code else 0
    except KeyboardInterrupt:
        return cli.EXIT_INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
