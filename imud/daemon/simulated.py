"""`sim:SCENARIO` ports: emulated devices as processes of their own, which the daemon opens as if they were hardware.

Ports of the same scenario share one emulator, so that they measure the same motion from the same instant. It ends with
the block, and also when this process dies. Devices of the kernel (`iio`, and barometer and magnetometer by their names)
are in a folder that stands in for sysfs meanwhile. Programs (`pose`, …) send datagrams to `aiding.listen`.
"""

import contextlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from imud.drivers.errors import SpecError
from imud.drivers.registry import names
from imud.drivers.transport.iio_sysfs import ROOT
from imud.drivers.transport.portspec import PortSpec

from ..configuration.settings import Settings
from ..errors import ImudError, UsageError
from ..process.python import python_command
from .aiding_socket import address_of

SCHEME = "sim:"
DEVICES = {None: "g350", "epson": "g350", "crossbow": "rga300", "iio": "bmi160"}  # by driver; others have its name
OTHERS = ("wheel", "baro", "compass")  # devices that the user names themselves instead of a driver; all speak NMEA
POLLED = ("bmp280", "ak8975")  # of the kernel: no ports, but `aiding.iio`
PROGRAMS = ("pose", "velocity", "body_velocity", "wheels")  # no ports, but programs that send datagrams
_USAGE_ERROR = 64  # exit code of the emulator


@dataclass(frozen=True)
class Emulated:
    """ports: those to be opened; listen: where emulated programs send, empty if there are none."""

    ports: tuple[str, ...]
    listen: str = ""


@contextlib.contextmanager
def emulated(texts: Sequence[str], seed: int, listen: str = "") -> Iterator[Emulated]:
    """`texts` with those of emulated devices replaced by the ports on which they are now, without those of `polled`
    and of programs.

    seed: of the sensors' errors; listen: where programs send, empty: a socket of their own. Raises UsageError for a
    scenario or a speed that the emulator does not know.
    """
    specs = [_spec(text) for text in texts]
    scenarios = dict.fromkeys(spec.path for spec in specs if spec.path.startswith(SCHEME))
    if specs and all(_without_port(spec) for spec in specs):
        raise UsageError(f"port {texts[0]!r} aids an inertial sensor: name that, too, for example {SCHEME}car")
    if not scenarios:
        yield Emulated(tuple(map(str, specs)))
        return
    import tempfile  # for emulated devices only

    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="imud-sim-")))
        if any(_in_kernel(spec) for spec in specs):
            stack.enter_context(_sysfs_in(folder))
        send_to = address_of(listen).text.removeprefix("unix:") if listen else str(folder / "aiding")
        for scenario in scenarios:
            own = [i for i, spec in enumerate(specs) if spec.path == scenario]
            wanted = [specs[i] for i in own]
            for i in own:
                specs[i] = _on_its_port(specs[i], folder / f"{scenario[len(SCHEME) :]}-{_device(specs[i])}-{i}")
            without_link = [_in_kernel(spec) or spec.driver in PROGRAMS for spec in wanted]
            links = [specs[i].path for i, without in zip(own, without_link, strict=True) if not without]
            stack.enter_context(_emulator(wanted, links, seed, folder, send_to))
        sending = any(spec.driver in PROGRAMS for spec in specs)
        yield Emulated(tuple(str(spec) for spec in specs if not _without_port(spec)), send_to if sending else "")


def check(texts: Sequence[str]) -> None:
    """Raises UsageError for a port that is none, or a scenario or a device that is not emulated."""
    for text in texts:
        _spec(text)


def settings_of(settings: Settings, emulated: Emulated) -> Settings:
    """The settings with the ports that `emulated` has made of theirs, its barometers, magnetometers and programs."""
    iio = (*settings.aiding.iio, *polled(settings.ports))
    aiding = msgspec.structs.replace(settings.aiding, iio=iio, listen=emulated.listen or settings.aiding.listen)
    return msgspec.structs.replace(settings, ports=emulated.ports, aiding=aiding)


def polled(texts: Sequence[str]) -> tuple[str, ...]:
    """The emulated barometers and magnetometers of the kernel among ports."""
    return tuple(str(spec.driver) for spec in map(_spec, texts) if spec.driver in POLLED)


def _without_port(spec: PortSpec) -> bool:
    return spec.driver in (*POLLED, *PROGRAMS)


def _in_kernel(spec: PortSpec) -> bool:
    return spec.path.startswith(SCHEME) and spec.driver in ("iio", *POLLED)


@contextlib.contextmanager
def _sysfs_in(folder: Path) -> Iterator[None]:
    before = os.environ.get(ROOT)
    os.environ[ROOT] = str(folder)
    try:
        yield
    finally:
        os.environ.pop(ROOT)
        if before is not None:
            os.environ[ROOT] = before


def _on_its_port(spec: PortSpec, link: Path) -> PortSpec:
    """Where the emulated device of `spec` is: behind `link`, or in the kernel."""
    if spec.driver == "iio":
        return replace(spec, path=f"iio:{_device(spec)}", baud=None)
    return replace(spec, path=str(link), driver="nmea" if spec.driver in OTHERS else spec.driver)


def _spec(text: str) -> PortSpec:
    try:
        spec = PortSpec.parse(text, (*names(), *OTHERS, *POLLED, *PROGRAMS) if text.startswith(SCHEME) else None)
    except SpecError as error:
        raise UsageError(str(error)) from error
    if spec.path.startswith(SCHEME):
        from imud.firmware_sim.cli import SCENARIO_NAMES  # for emulated devices only

        scenario = spec.path[len(SCHEME) :]
        if scenario not in SCENARIO_NAMES:
            raise UsageError(f"port {text!r}: there is no scenario {scenario!r}; there are {', '.join(SCENARIO_NAMES)}")
    return spec


def _device(spec: PortSpec) -> str:
    """What the emulator calls the device of a driver."""
    return DEVICES.get(spec.driver) or str(spec.driver)


@contextlib.contextmanager
def _emulator(specs: Sequence[PortSpec], links: Sequence[str], seed: int, folder: Path, send_to: str) -> Iterator[None]:
    """A process with a device for each of `specs`, all of one scenario, at `links`, the kernel's in `folder`.

    send_to: where its programs send.
    """
    import subprocess

    log, scenario = folder / "log", specs[0].path[len(SCHEME) :]
    command = python_command("imud.firmware_sim", f"--scenario={scenario}", f"--seed={seed}")
    command += [f"--parent={os.getpid()}", f"--iio-root={folder}", f"--send={send_to}"]
    command += [*(f"--link={link}" for link in links), "--"]
    command += [_device(spec) + (f"@{spec.baud}" if spec.baud else "") for spec in specs]
    with log.open("w") as errors:
        # a session of its own, so that Ctrl-C reaches this process only, which then ends the emulator
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=errors, stdin=subprocess.DEVNULL, start_new_session=True
        )
    with process:
        try:
            assert process.stdout is not None
            if not all(process.stdout.readline() for _ in specs):
                kind = UsageError if process.wait() == _USAGE_ERROR else ImudError
                why = log.read_text().strip().rpartition("\n")[2].rpartition("error: ")[2]
                raise kind(f"port {specs[0].path!r}: {why}")
            yield
        finally:
            process.terminate()
