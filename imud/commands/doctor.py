"""`imud doctor`: why imud would not work on this machine, and what to do. It opens no port and changes nothing.

Each check is a function of the file system's root, so that tests can imitate any machine in a folder.
"""

import argparse
import contextlib
import grp
import importlib.util
import json
import os
import pwd
import re
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from imud.drivers.transport import iio_sysfs

from ..compile import library
from .probe import candidates

_MARKS = {"ok": "ok  ", "note": "note", "problem": "FAIL"}
_LATENCY_MS = 1
_UDEV = (
    "in /etc/udev/rules.d/60-imud-iio.rules: "
    """SUBSYSTEM=="iio", GROUP="dialout", MODE="0660", """
    """RUN+="/bin/sh -c 'chgrp -R dialout /sys%p; chmod -R g+rwX /sys%p'" """
    "then: sudo udevadm control --reload && sudo udevadm trigger -s iio; and join group dialout"
)
_TRIGGER = (
    "connect its interrupt line and name it in the device tree; or a timer: sudo modprobe iio-trig-hrtimer && "
    "sudo mkdir /sys/kernel/config/iio/triggers/hrtimer/imud"
)
_UARTS = re.compile(r"console=(serial0|ttyAMA\d+|ttyS\d+|ttyUSB\d+)")


@dataclass(frozen=True)
class Finding:
    """The result of one check. A note may matter, a problem does. `remedy` says what to do."""

    grade: Literal["ok", "note", "problem"]
    what: str
    remedy: str = ""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="one JSON object per finding")


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""


def _processes(root: Path, names: set[str]) -> dict[str, str]:
    """Running processes with one of the names: name -> pid."""
    found = {}
    for entry in (root / "proc").glob("[0-9]*/comm"):
        name = _text(entry).strip()
        if name in names:
            found[name] = entry.parent.name
    return found


def ports(root: Path) -> Iterator[Finding]:
    """Is there a serial port, and may this user open it?"""
    found = candidates(root)
    if not found:
        yield Finding(
            "note",
            "no serial port (/dev/ttyUSB*, ttyACM*, ttyAMA*, serial*)",
            "plug in the adapter; on a Raspberry Pi set enable_uart=1 in /boot/firmware/config.txt and reboot",
        )
    for port in found:
        yield _may_open(root, port)


def _may_open(root: Path, port: str) -> Finding:
    path = root / port.lstrip("/")
    if os.access(path, os.R_OK | os.W_OK):
        return Finding("ok", f"{port} may be opened")
    group = _group_of(path)
    user = pwd.getpwuid(os.geteuid()).pw_name
    remedy = f"sudo usermod -aG {group} {user}, then log in again" if group else f"sudo chmod a+rw {port}"
    return Finding("problem", f"{port} may not be opened by {user}", remedy)


def _group_of(path: Path) -> str:
    try:
        return grp.getgrgid(path.stat().st_gid).gr_name
    except (OSError, KeyError):
        return ""


def console(root: Path) -> Iterator[Finding]:
    """Does the kernel's console, or a login prompt, use a UART? A problem only where a sensor is to be on it."""
    ports = _service_ports(root)

    def finding(uart: str, what: str, remedy: str) -> Finding:
        if os.path.realpath(root / "dev" / uart) in ports:
            return Finding("problem", f"{what} and a service of imud uses that port", remedy)
        return Finding("note", what, f"if a sensor is to be on {uart}: {remedy}")

    for uart in _UARTS.findall(_text(root / "proc/cmdline")):
        remove = (
            f"remove console={uart},… from /boot/firmware/cmdline.txt, reboot (raspi-config: serial login shell off)"
        )
        yield finding(uart, f"the kernel's console is on {uart}: it would write to a sensor there", remove)
    for unit in (root / "etc/systemd/system/getty.target.wants").glob("serial-getty@*.service"):
        port = unit.name.partition("@")[2].removesuffix(".service")
        yield finding(port, f"a login prompt waits on {port}", f"sudo systemctl disable --now {unit.name}")


def _service_ports(root: Path) -> set[str]:
    """The device files that the settings of imud's services name, links followed; unreadable settings name none."""
    named = set()
    for path in (root / "etc/imud").glob("*.toml"):
        with contextlib.suppress(OSError, ValueError):
            for port in tomllib.loads(path.read_text()).get("ports", ()):
                named.add(os.path.realpath(root / str(port).partition(":")[0].lstrip("/")))
    return named


def competing_programs(root: Path) -> Iterator[Finding]:
    """Programs that open serial ports without being asked to."""
    running = _processes(root, {"ModemManager", "gpsd", "brltty", "iio-sensor-prox", "iiod"})
    remedies = {
        "ModemManager": "sudo systemctl disable --now ModemManager, or a udev rule with ID_MM_DEVICE_IGNORE=1",
        "gpsd": 'give imud another address (--listen 127.0.0.1:2948) and keep gpsd off imud\'s ports (USBAUTO="false")',
        "iio-sensor-prox": "sudo systemctl disable --now iio-sensor-proxy, if imud is to have the kernel's IMU",
        "iiod": "sudo systemctl disable --now iiod, if imud is to have the kernel's IMU",
        "brltty": "sudo apt remove brltty (it takes USB adapters for Braille displays)",
    }
    for name, pid in running.items():
        yield Finding("note", f"{name} is running (pid {pid}) and may open imud's ports", remedies[name])


def latency(root: Path) -> Iterator[Finding]:
    """FTDI adapters deliver bytes only after their latency timer."""
    for timer in (root / "sys/bus/usb-serial/devices").glob("*/latency_timer"):
        value = _text(timer).strip()
        if value.isdecimal() and int(value) > _LATENCY_MS:
            yield Finding(
                "note",
                f"{timer.parent.name} delivers bytes up to {value} ms late",
                'imud asks for low latency when it opens the port; for good: a udev rule with ATTR{latency_timer}="1"',
            )


def spi(root: Path) -> Iterator[Finding]:
    """Is the SPI bus of a Raspberry Pi switched on, may this user open it, and are the packages for it there?"""
    buses = sorted((root / "dev").glob("spidev*"))
    config = _text(root / "boot/firmware/config.txt") or _text(root / "boot/config.txt")
    if config and not buses:
        yield Finding("note", "SPI is off", "for a sensor on SPI: dtparam=spi=on in /boot/firmware/config.txt, reboot")
    if not buses:
        return
    yield Finding("ok", "SPI is on")
    for node in (*buses, *sorted((root / "dev").glob("gpiochip*"))):
        yield _may_open(root, f"/{node.relative_to(root)}")
    for package, purpose in (("spidev", "SPI"), ("gpiod", "a data-ready line")):
        if importlib.util.find_spec(package) is None:
            yield Finding("note", f"the Python package {package} is missing, for {purpose}", "pip install 'imud[spi]'")


def _kernels_root(root: Path) -> Path:
    """On this machine an emulated kernel may stand in for its own."""
    return iio_sysfs.root() if root == Path("/") else root


def iio(root: Path) -> Iterator[Finding]:
    """IMUs that the kernel has: may this user open and set them up, and have they triggers?"""
    root = _kernels_root(root)
    for folder, name in iio_sysfs.devices(root).items():
        device = root / iio_sysfs.DEVICES / folder
        what = f"IIO device {name or folder} ({folder})"
        paths = (root / "dev" / folder, device / "buffer/enable")
        if all(os.access(path, os.R_OK | os.W_OK) for path in paths):
            yield Finding("ok", f"{what} may be opened")
        else:
            yield Finding("problem", f"{what} may not be opened and set up by this user", _UDEV)
        if _text(device / "buffer/enable").strip() == "1":
            yield Finding("note", f"{what} is streaming: imud, or another program, has set it up")
        if (device / "trigger").is_dir() and not list(device.parent.glob("trigger*")):
            yield Finding("problem", f"{what} needs a trigger, and the kernel has none", _TRIGGER)


def iio_polled(root: Path) -> Iterator[Finding]:
    """Barometers and magnetometers that the kernel has: may this user read them?"""
    from imud.drivers.transport.iio_polled import SIGNS, polled_sensors

    root = _kernels_root(root)
    for sensor in polled_sensors(root):
        what = f"IIO {sensor.kind} {sensor.name} ({sensor.folder})"
        paths = [root / iio_sysfs.DEVICES / sensor.folder / name for name in SIGNS[sensor.kind]]
        if any(os.access(path, os.R_OK) for path in paths):
            yield Finding("ok", f'{what} may be read: --set aiding.iio=["{sensor.name}"]')
        else:
            yield Finding("problem", f"{what} may not be read by this user", _UDEV)


def kernels(root: Path) -> Iterator[Finding]:
    """Are they compiled, and if not, can they be?"""
    are_compiled, text = library.outlook()
    remedy = "unset IMUD_JIT" if library.numba_is_wanted() else "sudo apt install gcc; or pip install ziglang"
    if are_compiled:
        yield Finding("ok", text)
    elif importlib.util.find_spec("numba"):
        yield Finding("note", text, remedy)
    else:
        yield Finding("problem", f"{text}; but there is no numba: nothing can run", remedy)


CHECKS: tuple[Callable[[Path], Iterator[Finding]], ...] = (
    ports,
    console,
    competing_programs,
    latency,
    spi,
    iio,
    iio_polled,
    kernels,
)


def examine(root: Path = Path("/")) -> list[Finding]:
    """The findings of all checks of the machine below `root`."""
    return [finding for check in CHECKS for finding in check(root)]


def run(args: argparse.Namespace) -> int:
    findings = examine()
    for finding in findings:
        if args.json:
            print(json.dumps(asdict(finding)))
        else:
            print(f"{_MARKS[finding.grade]}  {finding.what}" + (f"\n      {finding.remedy}" if finding.remedy else ""))
    return int(any(finding.grade == "problem" for finding in findings))
