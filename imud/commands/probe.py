"""`imud probe`: which device is on a port, at which baud rate. Writes no flash; leaves ports in use alone."""

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from imud.drivers.errors import PortError, SpecError
from imud.drivers.transport import iio_sysfs
from imud.drivers.transport.iio_polled import polled_sensors
from imud.drivers.transport.portspec import PortSpec

from ..errors import DeviceAbsentError, UsageError

_CANDIDATES = ("ttyUSB*", "ttyACM*", "ttyAMA*", "serial[0-9]*")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "port",
        nargs="*",
        metavar="DEV[:DRIVER[@BAUD]]",
        help="default: every serial port there is, and every IMU that the kernel has; SPI only if named (spi:0.0)",
    )
    parser.add_argument("--readonly", action="store_true", help="only listen, write nothing")
    parser.add_argument("--json", action="store_true", help="one JSON object per port")


def candidates(root: Path = Path("/")) -> list[str]:
    """Serial ports of the machine below `root`, each device once."""
    present = (path for pattern in _CANDIDATES for path in sorted((root / "dev").glob(pattern)))
    found = {path.resolve(): f"/{path.relative_to(root)}" for path in present}
    return sorted(found.values())


def examine(spec: PortSpec, readonly: bool) -> dict[str, Any]:
    """The device on the port: the identity's fields, or `problem` as text."""
    from imud.drivers.detect import search
    from imud.drivers.driver import Identity
    from imud.drivers.transport.dialogue_runner import run_dialogue
    from imud.drivers.transport.line import check_port, open_line

    try:
        check_port(spec)
        line = open_line(spec)
        try:
            found = run_dialogue(line, search(spec, readonly))
        finally:
            line.close()
    except PortError as error:
        return {"port": spec.path, "problem": str(error)}
    if isinstance(found, Identity):
        return {"port": spec.path, **asdict(found)}
    return {"port": spec.path, "problem": str(found)}


def _as_text(result: dict[str, Any]) -> str:
    if "problem" in result:
        return f"{result['port']}: {result['problem']}"
    properties = [f"serial {result['serial']}"] * bool(result["serial"])
    properties += [f"firmware {result['firmware']}"] * bool(result["firmware"])
    if result["baud"]:
        properties += [f"{result['baud']} baud", f"--port {result['port']}:{result['driver']}@{result['baud']}"]
    else:
        properties.append(f"--port {result['port']}" + f":{result['driver']}" * result["spi"])
    return f"{result['port']}: {result['model'] or result['driver']}, {', '.join(properties)}"


def run(args: argparse.Namespace) -> int:
    try:
        specs = [PortSpec.parse(text) for text in args.port or [*candidates(), *iio_sysfs.ports()]]
    except SpecError as error:
        raise UsageError(str(error)) from error
    polled = [] if args.port else polled_sensors()
    for sensor in polled:
        setting = f'--set aiding.iio=["{sensor.name}"]'
        result = {"sensor": sensor.name, "kind": sensor.kind, "folder": sensor.folder, "setting": setting}
        print(
            json.dumps(result) if args.json else f"{sensor.folder}: {sensor.name}, {sensor.kind}, {setting}", flush=True
        )
    if not specs and not polled:
        raise DeviceAbsentError(
            "no serial port found (looked for /dev/ttyUSB*, ttyACM*, ttyAMA*, serial*, and IIO devices); name one"
        )
    known = len(polled)
    for spec in specs:
        if sys.stderr.isatty():
            print(f"{spec.path}: listening …", end="\r", file=sys.stderr, flush=True)
        result = examine(spec, args.readonly)
        known += "problem" not in result
        print(json.dumps(result) if args.json else _as_text(result), flush=True)
    return 0 if known else DeviceAbsentError.exit_code
