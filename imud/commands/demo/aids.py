"""The emulated sensors beside GNSS of a demo: on which ports they are, and what came of their measurements."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from imud.drivers.transport.iio_sysfs import ROOT
from imud.firmware_sim.device import OTHERS, POLLED, PROGRAMS

from ...errors import UsageError
from .. import status

DEVICES = (*OTHERS, *POLLED, *PROGRAMS)
WITHOUT_LINE = (*POLLED, *PROGRAMS)


class Aids:
    """Those of `--aiding`. Raises UsageError for a name that is none."""

    def __init__(self, names: Sequence[str]) -> None:
        for name in names:
            if name not in DEVICES:
                raise UsageError(f"--aiding: {name!r}: there are {', '.join(DEVICES)}")
        self.devices = tuple(dict.fromkeys(names))

    def driver(self, name: str) -> str:
        """What follows the path of the port of a device."""
        return ":nmea" if name in OTHERS else ""

    def options(self, folder: Path, listen: str) -> tuple[list[str], list[str]]:
        """(settings of the daemon, options of the emulator). listen: where the daemon listens already; or empty."""
        polled = [name for name in self.devices if name in POLLED]
        assignments = [f"aiding.iio={json.dumps(polled)}"] if polled else []
        if "ak8975" in polled:
            assignments.append("aiding.magnetometer=true")
        emulation = [f"--iio-root={folder}"] if polled else []
        if any(name in PROGRAMS for name in self.devices):
            send_to = listen or str(folder / "aiding")
            assignments.append(f"aiding.listen={json.dumps(send_to)}")
            emulation.append(f"--send={send_to}")
        return assignments, emulation

    def environment(self, folder: Path) -> dict[str, str]:
        """Variables of the daemon: where it finds the devices of the kernel."""
        return {ROOT: str(folder)} if any(name in POLLED for name in self.devices) else {}

    def report(self, answer: Mapping[str, Any]) -> str:
        """What the daemon says of the sources, as `imud status` shows it."""
        return "\n".join(["", "Measurements beside GNSS:", *(f"  {line}" for line in status.aiding_lines(answer))])
