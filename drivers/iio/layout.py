"""How the scans of an IIO device are laid out, from its attributes, and what their numbers mean.

    TYPE = [be|le]:[s|u]BITS/STORAGEBITS[Xrepeat]>>SHIFT

Enabled channels follow each other by their index, each at a multiple of its own size; a scan is as long as a multiple
of the largest. Value in SI = (number + offset) * scale, temperatures in 1/1000 degC. A mount matrix rotates the chip's
axes to the device's.

Sources: Documentation/iio/iio_devbuf.rst, Documentation/ABI/testing/sysfs-bus-iio, Documentation/devicetree/bindings/
iio/mount-matrix.txt of the kernel; `iio_compute_scan_bytes` of its industrialio-buffer.c.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

AXES = ("x", "y", "z")
GYRO, FORCE = "anglvel", "accel"
STAMP = "in_timestamp"
TYPE = re.compile(r"(be|le):([su])(\d{1,4})/(\d{1,4})(?:X(\d{1,4}))?(?:>>(\d{1,4}))?", re.IGNORECASE)
BITS_MAX = 62
SCAN_MAX = 1024  # bytes
NUMBER_MAX = float(1 << BITS_MAX)  # scales and offsets
MILLI = 1e-3
ROTATION_TOLERANCE = 0.02  # of M M' from the unit matrix: device trees have two or three digits

Attributes = Mapping[str, str]
Row = tuple[float, float, float]
FLU_TO_FRD: tuple[Row, Row, Row] = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))


class LayoutError(ValueError):
    """The attributes describe no scan that can be decoded. The message says why."""


@dataclass(frozen=True)
class Channel:
    """One number of a scan."""

    device: int
    at: int  # first byte in the scan of its device
    size: int  # bytes
    bits: int
    shift: int
    twos_complement: bool
    big: bool  # endian
    scale: float = 1.0
    offset: float = 0.0

    @property
    def range(self) -> float:
        """The greatest value."""
        return float((1 << self.bits - self.twos_complement) - 1 + self.offset) * self.scale


@dataclass(frozen=True)
class Layout:
    """The layout of the scans of one device, or of two: angular rates first, then specific forces."""

    sizes: tuple[int, ...] = ()  # bytes of a scan, by device
    stamps: tuple[int, ...] = ()  # where its time stamp is; -1: it has none
    monotonic: bool = False  # they are on CLOCK_MONOTONIC
    periods_ns: tuple[int, ...] = ()  # between scans
    gyros: tuple[Channel | None, ...] = (None, None, None)  # by the chip's axes; None: it has no such axis
    forces: tuple[Channel | None, ...] = (None, None, None)
    temperature: Channel | None = None
    gyro_rotation: tuple[Row, Row, Row] = FLU_TO_FRD  # from the chip's axes to FRD
    force_rotation: tuple[Row, Row, Row] = FLU_TO_FRD

    def to_text(self) -> str:
        """For `ImuConfigured.layout`."""
        return json.dumps(asdict(self))

    @classmethod
    def from_text(cls, text: str) -> "Layout":
        """What `to_text` made; empty: the default."""
        known = json.loads(text) if text else {}
        for name in ("gyros", "forces"):
            if name in known:
                known[name] = tuple(one and Channel(**one) for one in known[name])
        if known.get("temperature"):
            known["temperature"] = Channel(**known["temperature"])
        return cls(**known)


def elements(device: Attributes) -> dict[str, str]:
    """The channels of a device that can be in a scan, by name, each with its type."""
    found = (re.fullmatch(r"scan_elements/(\w+)_en", name) for name in device)
    names = [match[1] for match in found if match]
    return {name: device.get(f"scan_elements/{name}_type", "") for name in names}


def wanted(device: Attributes, quantities: Sequence[str]) -> list[str]:
    """The channels that are needed, of those that a device has."""
    available = elements(device)
    found = [
        f"in_{quantity}_{axis}" for quantity in quantities for axis in AXES if f"in_{quantity}_{axis}" in available
    ]
    found += [name for name in available if re.fullmatch(r"in_temp\d*", name)][:1]
    return found + [STAMP] * (STAMP in available)


def scan_of(device: Attributes, number: int) -> tuple[dict[str, Channel], int]:
    """The enabled channels and the size of a scan. Raises LayoutError."""
    available = elements(device)
    enabled = [name for name in available if device.get(f"scan_elements/{name}_en") == "1"]
    found, at, largest = {}, 0, 1
    for name in sorted(enabled, key=lambda name: _index(device, name)):
        parts = TYPE.fullmatch(available[name])
        if not parts:
            raise LayoutError(f"the type {available[name]!r} of its channel {name} is not known")
        bits, storage, repeat, shift = (
            int(part or default) for part, default in zip(parts.groups()[2:], "0010", strict=True)
        )
        size = storage // 8 * max(repeat, 1)
        if size == 0 or storage % 8 or bits + shift > storage:
            raise LayoutError(f"the type {available[name]!r} of its channel {name} makes no sense")
        at += -at % size
        found[name] = Channel(number, at, size, bits, shift, parts[2].lower() == "s", parts[1].lower() == "be")
        at += size
        largest = max(largest, size)
    if at > SCAN_MAX:
        raise LayoutError(f"its scans have {at} bytes")
    return found, at + -at % largest


def _index(device: Attributes, name: str) -> int:
    text = device.get(f"scan_elements/{name}_index", "")
    if not re.fullmatch(r"[0-9]{1,9}", text):
        raise LayoutError(f"its channel {name} has no index")
    return int(text)


def scaled(channel: Channel, device: Attributes, name: str, unit: float = 1.0) -> Channel:
    """With the scale and offset of the channel `name`. Raises LayoutError."""
    general = re.sub(r"(?:_[xyz]|\d+)$", "", name)
    scale = device.get(f"{name}_scale", device.get(f"{general}_scale"))
    if scale is None:
        raise LayoutError(f"its channel {name} has no scale")
    offset = device.get(f"{name}_offset", device.get(f"{general}_offset", "0"))
    if channel.bits > BITS_MAX:
        raise LayoutError(f"its channel {name} has {channel.bits} bits")
    if not _number(scale, name):
        raise LayoutError(f"the scale of its channel {name} is 0")
    fields = asdict(channel) | {"scale": _number(scale, name) * unit, "offset": _number(offset, name)}
    return Channel(**fields)


def _number(text: str, name: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not abs(number) <= NUMBER_MAX:
        raise LayoutError(f"{text!r} is no scale or offset of its channel {name}")
    return number


def rotation_of(device: Attributes, quantity: str) -> tuple[Row, Row, Row]:
    """The matrix from the chip's axes to FRD. Raises LayoutError if the mount matrix is no rotation."""
    names = (f"in_{quantity}_mount_matrix", "in_mount_matrix", "mount_matrix")
    text = next((device[name] for name in names if name in device), "1, 0, 0; 0, 1, 0; 0, 0, 1")
    numbers = re.findall(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?", text)
    if len(numbers) != 9:
        raise LayoutError(f"its mount matrix {text!r} has not nine numbers")
    matrix = [[float(number) for number in numbers[place : place + 3]] for place in (0, 3, 6)]
    if not _is_rotation(matrix):
        raise LayoutError(f"its mount matrix {text!r} is no rotation: mend it in the device tree or the ACPI table")
    (a, b, c), (d, e, f), (g, h, k) = matrix
    return (0.0 + a, 0.0 + b, 0.0 + c), (0.0 - d, 0.0 - e, 0.0 - f), (0.0 - g, 0.0 - h, 0.0 - k)  # and no -0.0


def _is_rotation(matrix: Sequence[Sequence[float]]) -> bool:
    """Whether its rows are of length 1 and right angles apart, as well as its digits allow, and it mirrors nothing."""
    rows = range(3)
    if max(abs(value) for row in matrix for value in row) > 1.0 + ROTATION_TOLERANCE:
        return False
    errors = [sum(a * b for a, b in zip(matrix[i], matrix[j], strict=True)) - (i == j) for i in rows for j in rows]
    (a, b, c), (d, e, f), (g, h, k) = matrix
    determinant = a * (e * k - f * h) + b * (f * g - d * k) + c * (d * h - e * g)
    return max(map(abs, errors)) <= ROTATION_TOLERANCE and determinant > 0.0


def layout_of(devices: Sequence[Attributes]) -> Layout:
    """Of the devices as they are set up: one, or that with gyros and that with forces. Raises LayoutError."""
    scans = [scan_of(device, number) for number, device in enumerate(devices)]
    last = len(devices) - 1
    gyros = _vector(scans[0][0], devices[0], GYRO)
    forces = _vector(scans[last][0], devices[last], FORCE)
    if None in forces:
        raise LayoutError("it has no accelerometers about three axes in its buffer")
    stamps = tuple(channels[STAMP].at if STAMP in channels else -1 for channels, _ in scans)
    if last and -1 in stamps:
        raise LayoutError("two devices without time stamps cannot be put together")
    temperatures = [(name, one) for name, one in scans[0][0].items() if re.fullmatch(r"in_temp\d*", name)]
    return Layout(
        sizes=tuple(size for _, size in scans),
        stamps=stamps,
        monotonic=-1 not in stamps and all(one.get("current_timestamp_clock") == "monotonic" for one in devices),
        gyros=gyros,
        forces=forces,
        temperature=scaled(temperatures[0][1], devices[0], temperatures[0][0], MILLI) if temperatures else None,
        gyro_rotation=rotation_of(devices[0], GYRO),
        force_rotation=rotation_of(devices[last], FORCE),
    )


def _vector(channels: Mapping[str, Channel], device: Attributes, quantity: str) -> tuple[Channel | None, ...]:
    names = [f"in_{quantity}_{axis}" for axis in AXES]
    return tuple(scaled(channels[name], device, name) if name in channels else None for name in names)
