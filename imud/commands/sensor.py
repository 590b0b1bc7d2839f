"""`imud sensor`: runs one service of a device. Prints what the service does, asks, runs it, and prints the outcome."""

import argparse
import sys
import time
from collections.abc import Sequence

from imud.drivers.detect import search
from imud.drivers.driver import Done, Identity, Service, ServiceDriver
from imud.drivers.errors import PortError, SpecError
from imud.drivers.registry import by_name, drivers
from imud.drivers.transport.dialogue_runner import run_dialogue
from imud.drivers.transport.line import KnownDevice, Line, check_port, open_line
from imud.drivers.transport.portspec import PortSpec

from ..daemon.ports import failure
from ..errors import DeviceAbsentError, ImudError, UsageError
from ..progress import Progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("port", metavar="DEV[:DRIVER[@BAUD]]", help="no daemon may have it open")
    parser.add_argument("service", choices=sorted(_services()), metavar="SERVICE", help="; ".join(_services().values()))
    parser.add_argument("value", nargs="?", type=int, metavar="N", help="seconds, or the baud rate")
    parser.add_argument("--yes", action="store_true", help="do not ask")


def _services() -> dict[str, str]:
    """A text for every service: which drivers have it, with which values."""
    found: dict[str, list[str]] = {}
    for driver in drivers():
        if isinstance(driver, ServiceDriver):
            for name, service in driver.services.items():
                found.setdefault(name, []).append(f"{driver.name}, {_values(service)}")
    return {name: f"{name} ({'; '.join(texts)})" for name, texts in found.items()}


def _values(service: Service) -> str:
    default = "" if service.default is None else f", default {service.default}"
    return f"{_listed(service.values)} {service.unit}{default}"


def _listed(values: Sequence[int]) -> str:
    return f"{values[0]} to {values[-1]}" if isinstance(values, range) else ", ".join(map(str, values))


def run(args: argparse.Namespace) -> int:
    try:
        spec = PortSpec.parse(args.port)
        check_port(spec)
        line = open_line(spec)
    except SpecError as error:
        raise UsageError(str(error)) from error
    except PortError as error:
        raise failure(error) from error
    try:
        done = _serve(line, spec, args)
    except PortError as error:
        raise failure(error) from error
    finally:
        line.close()
    if not done.ok:
        raise ImudError(f"{spec.path}: {done.message}")
    print(f"{spec.path}: {done.message}")
    return 0


def _serve(line: Line, spec: PortSpec, args: argparse.Namespace) -> Done:
    if isinstance(line, KnownDevice):
        raise UsageError(f"{spec.path}: a recording has no services; name the port of a device")
    found = run_dialogue(line, search(spec))
    if not isinstance(found, Identity):
        raise DeviceAbsentError(f"{spec.path}: {found}")
    who = f"{found.model or found.driver}{found.serial and f', serial {found.serial},'} on {spec.path}"
    service = _service(found, args.service, who)
    value = _value(service, args.value, args.service)
    _confirm(f"{who} {service.description.format(value)}", args.yes)
    if service.unit != "s":
        return run_dialogue(line, service.run(value))
    progress, begin_s = Progress(value), time.monotonic()
    done = run_dialogue(line, service.run(value), lambda: progress.at(min(int(time.monotonic() - begin_s), value)))
    progress.clear()
    return done


def _service(found: Identity, name: str, who: str) -> Service:
    driver = by_name(found.driver)
    if isinstance(driver, ServiceDriver) and name in driver.services:
        return driver.services[name]
    raise UsageError(f"{who} offers no {name!r}; there is {', '.join(_services().values())}")


def _value(service: Service, given: int | None, name: str) -> int:
    value = service.default if given is None else given
    if value is None or value not in service.values:
        problem = "no value" if value is None else value
        raise UsageError(f"{name}: {problem}; write {_listed(service.values)} {service.unit}")
    return value


def _confirm(what: str, yes: bool) -> None:
    """Print what the service does, and ask the user. Raises UsageError without a terminal, ImudError for a no."""
    print(what, file=sys.stderr)
    if yes:
        return
    if not sys.stdin.isatty():
        raise UsageError("there is no terminal to ask on: write --yes")
    print("go on? [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise ImudError("nothing was done")
