"""Barometers and magnetometers of Linux's Industrial I/O: single readings of their attributes in sysfs.

A reading makes the kernel's driver measure, which takes some 10 ms on I2C: not for a thread that has other work.
Source: Documentation/ABI/testing/sysfs-bus-iio of the kernel: in_pressure_input and (in_pressure_raw + offset) * scale
are in kilopascal, (in_magn_x_raw + offset) * scale in Gauss; a scale or offset may be one for all axes.
"""

from dataclasses import dataclass
from pathlib import Path

from ..errors import PortAbsentError
from ..iio.layout import rotation_of
from . import iio_sysfs as sysfs

BAROMETER, MAGNETOMETER = "barometer", "magnetometer"
SIGNS = {BAROMETER: ("in_pressure_raw", "in_pressure_input"), MAGNETOMETER: ("in_magn_x_raw",)}
_KILO, _GAUSS = 1e3, 1e-4  # Pa, T
AXES = "xyz"


@dataclass(frozen=True)
class PolledSensor:
    """One quantity of one device. folder: `iio:deviceN`; kind: BAROMETER or MAGNETOMETER."""

    folder: str
    name: str
    kind: str

    def read(self) -> tuple[float, ...]:
        """The air pressure, Pa; or the magnetic field, T, forward, right, down.

        A chip's axes are taken as x forward, y left, z up, after the mount matrix that the kernel may have of it.
        Raises OSError, ValueError.
        """
        base = sysfs.root() / sysfs.DEVICES / self.folder
        if self.kind == BAROMETER:
            return (_KILO * _value(base, "in_pressure", "in_pressure"),)
        x, y, z = (_GAUSS * _value(base, f"in_magn_{axis}", "in_magn") for axis in AXES)
        rows = rotation_of(sysfs.attributes(self.folder), "magn")
        return tuple(row[0] * x + row[1] * y + row[2] * z for row in rows)


def _value(base: Path, channel: str, shared: str) -> float:
    """A channel's processed value, or its raw one, scaled."""
    processed = base / f"{channel}_input"
    if processed.exists():
        return float(processed.read_text())
    factor, offset = (
        next((float(path.read_text()) for one in (channel, shared) if (path := base / f"{one}_{what}").exists()), usual)
        for what, usual in (("scale", 1.0), ("offset", 0.0))
    )
    return (float((base / f"{channel}_raw").read_text()) + offset) * factor


def polled_sensors(base: Path | None = None) -> list[PolledSensor]:
    """All that there are, in their order; base: the folder in which `sys` is."""
    folder = (base or sysfs.root()) / sysfs.DEVICES
    return [
        PolledSensor(path.name, sysfs.text(path / "name") or path.name, kind)
        for path in sorted(folder.glob("iio:device*"))
        for kind, names in SIGNS.items()
        if any((path / name).exists() for name in names)
    ]


def find_polled(wanted: str) -> list[PolledSensor]:
    """Those of the device with this name, label, or folder (`iio:deviceN`). Raises PortAbsentError."""
    there, devices = polled_sensors(), sysfs.root() / sysfs.DEVICES
    names = {
        one.folder: (one.folder, one.folder.removeprefix("iio:"), one.name, sysfs.text(devices / one.folder / "label"))
        for one in there
    }
    found = [each for each in there if wanted in names[each.folder]]
    if not found:
        present = ", ".join(f"{each.name} ({each.folder}, {each.kind})" for each in there) or "none"
        raise PortAbsentError(f"iio:{wanted}", f"no IIO barometer or magnetometer {wanted!r}; there are: {present}")
    return found
