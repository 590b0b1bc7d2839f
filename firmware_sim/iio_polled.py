"""Barometers and magnetometers behind the kernel's Industrial I/O: attributes in a folder that looks like sysfs.

The kernel's driver measures when an attribute is read. Here each reading is written RATE_HZ times a second, and a host
reads the newest one; what it writes to an attribute has no effect. The chips' buffers are not emulated.

Sources: Documentation/ABI/testing/sysfs-bus-iio of the kernel (units: kilopascal, Gauss, 1/1000 degC; mount_matrix);
drivers/iio/pressure/bmp280-core.c (in_pressure_input in steps of 1/256 Pa), drivers/iio/magnetometer/ak8975.c (a scale
for each axis, -4096 to 4095 counts). Noise: data sheet of the BMP280, 1.3 Pa; AK8975: a count. Field: World Magnetic
Model 2025, mid-2027, at the start of all scenarios.
"""

import logging
import math
import os
import shutil
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .ellipsoid import Array
from .faults.readings import FaultyReadings
from .faults.spec import Fault, of_layer
from .faults.wire import Wire
from .motion import Trajectory, Truth, rotation
from .other_sensors import pressure_pa

RATE_HZ = 50.0
EARTH_FIELD_UT = np.array([30.142, -4.208, 35.660])  # north, east, down
TEMPERATURE_C = 25.0
FRD = np.array([1.0, -1.0, -1.0])  # to axes x forward, y left, z up
QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # mount matrix: chip's axes to those
PASCAL_STEPS = 256.0
GAUSS_PER_COUNT, COUNTS_MAX = 0.003, 4095
UT_PER_GAUSS = 100.0
FAILS = Path("/proc/self/mem")  # the kernel refuses to read its beginning: EIO, as from a chip that does not answer

_log = logging.getLogger("firmware_sim.iio")


@dataclass(frozen=True)
class PolledChip:
    """One row. values: what an ideal one measures, Pa or uT, along its own axes; sigma: of each reading; lasting: sigma
    of an error that stays; texts: of values, by attribute."""

    attributes: Mapping[str, str]
    values: Callable[[Truth], Array]
    sigma: float
    lasting: float
    texts: Callable[[Array], dict[str, str]]


def _field(truth: Truth) -> Array:
    in_body: Array = EARTH_FIELD_UT @ rotation(truth.rpy)[0]
    return np.asarray((in_body * FRD) @ QUARTER_TURN)


def _pressure_texts(values: Array) -> dict[str, str]:
    kilopascal = round(float(values[0]) * PASCAL_STEPS) / PASCAL_STEPS * 1e-3
    return {"in_pressure_input": f"{kilopascal:.9f}"}


def _field_texts(values: Array) -> dict[str, str]:
    counts = np.clip(np.rint(values / UT_PER_GAUSS / GAUSS_PER_COUNT), -COUNTS_MAX - 1, COUNTS_MAX)
    return {f"in_magn_{axis}_raw": f"{count:.0f}" for axis, count in zip("xyz", counts, strict=True)}


POLLED_CHIPS = {
    "bmp280": PolledChip(
        attributes={
            "in_pressure_oversampling_ratio": "16",
            "in_pressure_oversampling_ratio_available": "1 2 4 8 16",
            "in_temp_input": f"{1000.0 * TEMPERATURE_C:.0f}",
            "in_temp_oversampling_ratio": "2",
            "in_temp_oversampling_ratio_available": "1 2 4 8 16",
        },
        values=lambda truth: np.array([pressure_pa(truth)]),
        sigma=1.3,
        lasting=350.0,
        texts=_pressure_texts,
    ),
    "ak8975": PolledChip(
        attributes={
            **{f"in_magn_{axis}_scale": f"{GAUSS_PER_COUNT:.6f}" for axis in "xyz"},
            "in_mount_matrix": "; ".join(", ".join(f"{x:g}" for x in row) for row in QUARTER_TURN),
        },
        values=_field,
        sigma=0.3,
        lasting=1.0,
        texts=_field_texts,
    ),
}


class Attribute:
    """A file that looks like an attribute of sysfs. It is rewritten in place: a new file for each text would have a
    disk's file system write it out, which takes milliseconds. A host may read half of a text once in a million."""

    def __init__(self, path: Path, text: str = "") -> None:
        """text: empty: reading it fails."""
        self._path, self._aside = path, path.with_name(f".{path.name}")
        self._fd = os.open(path, os.O_CREAT | os.O_RDWR | os.O_TRUNC | os.O_CLOEXEC, 0o644)
        self._length, self._readable = 0, True
        self.write(text)

    def write(self, text: str) -> None:
        """Set what a host reads."""
        if bool(text) != self._readable:
            self._readable = bool(text)
            if text:
                self._aside.replace(self._path)
            else:
                self._path.rename(self._aside)
                self._path.symlink_to(FAILS)
        if text:
            data = f"{text}\n".encode()
            os.pwrite(self._fd, data.ljust(self._length, b"\n"), 0)
            if len(data) < self._length:
                os.ftruncate(self._fd, len(data))
            self._length = len(data)

    def close(self) -> None:
        os.close(self._fd)


class PolledDevice:
    """One chip, as a task of the emulator's loop. Context manager: it is there inside."""

    def __init__(
        self,
        name: str,
        number: int,
        trajectory: Trajectory,
        rng: np.random.Generator,
        root: Path,
        faults: Sequence[Fault] = (),
        *,
        ideal: bool = False,
        wire: Wire | None = None,
    ) -> None:
        """number: of `iio:deviceN` below `root`; faults: of the layers "plug" and "reading"; wire: those of a line,
        whose messages are the readings: one that is lost cannot be read, one that is late is old."""
        self.name, self.path = name, f"iio:{name}"
        self._chip, self._trajectory, self._rng, self._wire = POLLED_CHIPS[name], trajectory, rng, wire
        self._folder = root / f"sys/bus/iio/devices/iio:device{number}"
        self._attributes: dict[str, Attribute] = {}  # none: it is unplugged
        self._outages = [fault.span for fault in of_layer("plug", faults)]
        size = len(self._chip.values(trajectory.at(np.array([0.0]))))
        self._faults = [FaultyReadings(of_layer("reading", faults)) for _ in range(size)]
        self._sigma = 0.0 if ideal else self._chip.sigma
        self._offset = (0.0 if ideal else self._chip.lasting) * rng.standard_normal(size)
        self._count = 0
        self._readings: deque[tuple[float, dict[str, str]]] = deque()  # when each can be read
        self._plug()

    def __enter__(self) -> "PolledDevice":
        return self

    def __exit__(self, *_: object) -> None:
        self._unplug()

    def step(self, t: float) -> None:
        """Measure what was due until time `t`, and let the newest be read."""
        plugged = not any(span.holds(t) for span in self._outages)
        if plugged != bool(self._attributes):
            _log.info("%s: %s", self.name, "plugged in again" if plugged else "unplugged")
            (self._plug if plugged else self._unplug)()
        self._count = max(self._count, math.floor(t * RATE_HZ))  # after a stall only the newest
        if self.deadline() <= t:
            self._measure(self.deadline())
            self._count += 1
        self._publish(t)

    def _measure(self, t: float) -> None:
        true = self._chip.values(self._trajectory.at(np.array([t])))
        values = true + self._offset + self._sigma * self._rng.standard_normal(len(true))
        texts = self._chip.texts(np.array([fault(t, value) for fault, value in zip(self._faults, values, strict=True)]))
        if self._wire is None:
            self._readings.append((t, texts))
            return
        arrived, until = self._wire(" ".join(texts.values()).encode(), t)
        after = self._readings[-1][0] if self._readings else t
        self._readings.append((max(t, until, after), texts if arrived else dict.fromkeys(texts, "")))

    def _publish(self, t: float) -> None:
        newest = None
        while self._readings and self._readings[0][0] <= t:
            _, newest = self._readings.popleft()
        if newest and self._attributes:
            for name, text in newest.items():
                self._attributes[name].write(text)

    def _plug(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        none_yet = dict.fromkeys(self._chip.texts(self._offset), "")
        texts = {"name": self.name, **self._chip.attributes, **none_yet}
        self._attributes = {name: Attribute(self._folder / name, text) for name, text in texts.items()}

    def _unplug(self) -> None:
        for attribute in self._attributes.values():
            attribute.close()
        self._attributes = {}
        shutil.rmtree(self._folder, ignore_errors=True)

    def idle(self) -> None:
        """Nothing to compute ahead."""

    def deadline(self) -> float:
        return self._count / RATE_HZ
