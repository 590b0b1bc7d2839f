"""`imud sensor`: has a device do something once. Says what that will be, asks, does it, and tells how it ended."""

import argparse
import sys
import time
from collections.abc import Sequence

from drivers.detect import search
from drivers.driver import Done, Identity, Service, ServiceDriver
from drivers.errors import PortError, SpecError
from drivers.registry import by_name, drivers
from drivers.transport.conversation import run_dialogue
from drivers.transport.line import Known, Line, open_line
from drivers.transport.portspec import PortSpec

from ..daemon.ports import failure
from ..errors import DeviceAbsentError, ImudError, UsageError
from ..progress import Progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("port", metavar="DEV[:DRIVER[@BAUD]]", help="no daemon may have it open")
    parser.add_argument("service", choices=sorted(_offered()), metavar="SERVICE", help="; ".join(_offered().values()))
    parser.add_argument("value", nargs="?", type=int, metavar="N", help="seconds, or the baud rate")
    parser.add_argument("--yes", action="store_true", help="do not ask")


def _offered() -> dict[str, str]:
    """A text with every service, and which drivers offer it with which values."""
    found: dict[str, list[str]] = {}
    for driver in drivers():
        if isinstance(driver, ServiceDriver):
            for name, service in driver.services.items():
                found.setdefault(name, []).append(f"{driver.name}, {_values(service)}")
    return {name: f"{name} ({'; '.join(told)})" for name, told in found.items()}


def _values(service: Service) -> str:
    usual = "" if service.usual is None else f", usually {service.usual}"
    return f"{_listed(service.values)} {service.unit}{usual}"


def _listed(values: Sequence[int]) -> str:
    return f"{values[0]} to {values[-1]}" if isinstance(values, range) else ", ".join(map(str, values))


def run(args: argparse.Namespace) -> int:
    try:
        spec = PortSpec.parse(args.port)
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
        raise ImudError(f"{spec.path}: {done.told}")
    print(f"{spec.path}: {done.told}")
    return 0


def _serve(line: Line, spec: PortSpec, args: argparse.Namespace) -> Done:
    if isinstance(line, Known):
        raise UsageError(f"{spec.path}: a recording does nothing; name the port of a device")
    found = run_dialogue(line, search(spec))
    if not isinstance(found, Identity):
        raise DeviceAbsentError(f"{spec.path}: {found}")
    who = f"{found.model or found.driver}{found.serial and f', serial {found.serial},'} on {spec.path}"
    service = _service(found, args.service, who)
    value = _value(service, args.value, args.service)
    _agree(f"{who} {service.what.format(value)}", args.yes)
    if service.unit != "s":
        return run_dialogue(line, service.act(value))
    progress, begin_s = Progress(value), time.monotonic()
    done = run_dialogue(line, service.act(value), lambda: progress.at(min(int(time.monotonic() - begin_s), value)))
    progress.clear()
    return done


def _service(found: Identity, name: str, who: str) -> Service:
    driver = by_name(found.driver)
    if isinstance(driver, ServiceDriver) and name in driver.services:
        return driver.services[name]
    raise UsageError(f"{who} offers no {name!r}; there is {', '.join(_offered().values())}")


def _value(service: Service, given: int | None, name: str) -> int:
    value = service.usual if given is None else given
    if value is None or value not in service.values:
        told = "no value" if value is None else value
        raise UsageError(f"{name}: {told}; write {_listed(service.values)} {service.unit}")
    return value


def _agree(what: str, yes: bool) -> None:
    """Say what is to be done, and ask the user. Raises UsageError if the answer is no, or nobody can be asked."""
    print(what, file=sys.stderr)
    if yes:
        return
    if not sys.stdin.isatty():
        raise UsageError("nobody is here to be asked: say --yes")
    print("go on? [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise ImudError("nothing was done")
