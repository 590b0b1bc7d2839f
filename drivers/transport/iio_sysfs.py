"""Devices of Linux's Industrial I/O in sysfs: which there are, and their attributes.

Source: Documentation/ABI/testing/sysfs-bus-iio of the kernel. The environment variable IMUD_IIO_ROOT names a
folder in place of `/`: an emulated kernel's.
"""

import os
import re
from collections.abc import Iterator
from pathlib import Path

from ..errors import NotSerialError, PortAbsentError

ROOT = "IMUD_IIO_ROOT"
DEVICES = "sys/bus/iio/devices"
READ = re.compile(  # those that describe a device; reading `_raw` would take a measurement
    r"name|label|serialnumber|current_timestamp_clock|.*_scale|.*_offset|.*mount_matrix|.*sampling_frequency\w*|"
    r"scan_elements/.*|buffer/(?:enable|length|watermark)|trigger/current_trigger"
)
FOLDERS = ("", "scan_elements", "buffer", "trigger")
PARTS = re.compile(r"[-_](gyro|accel)$")  # of one chip that the kernel has as two devices
QUANTITIES = ("anglvel", "accel")

Attributes = dict[str, str]


def root() -> Path:
    """The folder in which `sys` and `dev` are."""
    return Path(os.environ.get(ROOT, "/"))


def node(folder: str) -> Path:
    """The character device that delivers the buffer of `iio:deviceN`."""
    return root() / "dev" / folder


def text(path: Path) -> str | None:
    """An attribute's value; None: it cannot be read."""
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return None


def devices(base: Path | None = None) -> dict[str, str]:
    """Folder and name of each device that has a buffer and measures force or angular rate, in their order."""
    paths = sorted(((base or root()) / DEVICES).glob("iio:device*"), key=_number)
    return {path.name: text(path / "name") or "" for path in paths if measures(path)}


def ports() -> list[str]:
    """The names of the ports that there are, each chip once."""
    found = []
    for folder, name in devices().items():
        chip = PARTS.sub("", name)
        try:
            find("", chip)
        except (PortAbsentError, NotSerialError):
            chip = folder.removeprefix("iio:")
        found.append(f"iio:{chip}")
    return list(dict.fromkeys(found))


def _number(path: Path) -> int:
    digits = re.search(r"\d+$", path.name)
    return int(digits[0]) if digits else 0


def attributes(folder: str) -> Attributes:
    """The attributes by which a device, or a trigger, is set up, by their paths inside its folder."""
    base = root() / DEVICES / folder
    found = {}
    for path in _files(base):
        name = str(path.relative_to(base))
        if READ.fullmatch(name) and (value := text(path)) is not None:
            found[name] = value
    return found


def _files(base: Path) -> Iterator[Path]:
    for sub in FOLDERS:
        if (base / sub).is_dir():
            yield from (path for path in sorted((base / sub).iterdir()) if path.is_file())


def triggers() -> dict[str, Attributes]:
    """The attributes of each trigger, by its folder."""
    paths = sorted((root() / DEVICES).glob("trigger*"), key=_number)
    return {path.name: attributes(path.name) for path in paths}


def write(name: str, value: str) -> str:
    """Set an attribute, named with its folder; returns the error in words, empty: none."""
    try:
        fd = os.open(root() / DEVICES / name, os.O_WRONLY | os.O_TRUNC)
        try:
            os.write(fd, value.encode())
        finally:
            os.close(fd)
    except OSError as error:
        return error.strerror or str(error)
    return ""


def find(path: str, wanted: str) -> list[str]:
    """The folders of the device that the user named: one, or the two parts of one chip, the gyros first.

    wanted: `iio:deviceN` or `deviceN`; a name, without -gyro or -accel, too; a label; two of them with + between.
    Raises PortAbsentError, NotSerialError if several fit.
    """
    there = devices()
    found = [folder for part in wanted.split("+") for folder in _named(path, part, there)]
    if "+" not in wanted:
        found = _with_other_part(found, there)
    measured = {folder: measures(root() / DEVICES / folder) for folder in found}
    if len(found) > 2 or len(set(measured.values())) < len(found):
        numbers = ", ".join(f"iio:{folder}" for folder in found)
        raise NotSerialError(path, f"several IIO devices fit {wanted!r}: name one of {numbers}, or two with + between")
    return sorted(found, key=lambda folder: "anglvel" not in measured[folder])


def measures(device: Path) -> tuple[str, ...]:
    """Those of QUANTITIES that the device with this folder has in its buffer."""
    return tuple(one for one in QUANTITIES if (device / "scan_elements" / f"in_{one}_x_en").exists())


def _named(path: str, wanted: str, there: dict[str, str]) -> list[str]:
    found = [folder for folder in there if folder in (wanted, f"iio:{wanted}")]
    found = found or [
        folder for folder in there if wanted in (there[folder], text(root() / DEVICES / folder / "label"))
    ]
    found = found or [folder for folder, name in there.items() if PARTS.sub("", name) == wanted]
    if found:
        return found
    present = ", ".join(f"iio:{name or folder} ({folder})" for folder, name in there.items()) or "none"
    raise PortAbsentError(
        path,
        f"no IIO device {wanted!r} with a buffer; inertial sensors that the kernel has: {present}. Is its driver "
        "loaded (dmesg | grep iio; on a Raspberry Pi a dtoverlay in /boot/firmware/config.txt)?",
    )


def _with_other_part(found: list[str], there: dict[str, str]) -> list[str]:
    """With the devices that the kernel made of the same chip."""
    chips = {PARTS.sub("", there[folder]) for folder in found if PARTS.search(there[folder])}
    others = [name for name in there if PARTS.search(there[name]) and PARTS.sub("", there[name]) in chips]
    return found + [folder for folder in others if folder not in found and len(found) == 1]
