"""The kernel's side of Industrial I/O for one chip: a folder that looks like sysfs, and a FIFO for each buffer.

A host sees `ROOT/sys/bus/iio/devices/iio:deviceN` and reads `ROOT/dev/iio:deviceN`. What it writes to attributes is
looked at 50 times a second. Unlike the kernel a file accepts any text, and a FIFO ends where a buffer says ENODEV. A
buffer without room loses scans. Sources: those of `iio_chips`, Documentation/ABI/testing/sysfs-bus-iio and
Documentation/iio/iio_devbuf.rst.
"""

import contextlib
import logging
import math
import os
import shutil
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from .faults.spec import Fault
from .iio_chips import ACCEL, GYRO, STAMP, TEMPERATURE, Chip, Part
from .noise import ImuErrors, Signal

LOOK_S = 0.02
BLOCK = 64  # scans computed at a time, at most: with few, an emulator that is behind would stay behind
PHASE = 0.3  # of a period, by which a second part samples later
TEMPERATURE_SCALE = 100.0  # 1/1000 degC per count
AXES = "xyz"
FRD = np.array([1.0, -1.0, -1.0])  # to axes x forward, y left, z up

_log = logging.getLogger("firmware_sim.iio")


class Device:
    """One IIO device: its attributes, and its scans while the buffer is enabled."""

    def __init__(
        self, number: int, chip: Chip, part: Part, signal: Signal, errors: Callable[[float], ImuErrors], root: Path
    ) -> None:
        self.chip, self.part, self._signal, self._new_errors = chip, part, signal, errors
        self.lost = 0  # scans for which the buffer had no room
        self._number, self._late = number, PHASE * (number % 2)
        self._folder = root / f"sys/bus/iio/devices/iio:device{number}"
        self._trigger = root / f"sys/bus/iio/devices/trigger{number}"
        self._node = root / f"dev/iio:device{number}"
        self._fd = -1
        self._next = math.inf  # time of the next scan
        self._skip = 0
        self.plug()

    @property
    def _quantities(self) -> list[str]:
        return [name for name, _, _ in self.part.channels if name in (GYRO, ACCEL)]

    def _attributes(self) -> dict[str, str]:
        chip = self.chip
        found = {"name": self.part.name, "current_timestamp_clock": "realtime", "buffer/enable": "0"}
        found |= {"buffer/length": "2", "buffer/watermark": "1", "buffer/data_available": "0"}
        rates = [f"in_{name}_sampling_frequency" for name in self._quantities]
        available = " ".join(f"{rate:.6f}" for rate in chip.rates)
        for name in rates if chip.per_quantity else ["sampling_frequency"]:
            found[name] = f"{chip.rates[0] if chip.rates else 2000.0:.6f}"
            found |= {f"{name}_available": available} if available else {}
        if not chip.per_quantity and available:
            found["sampling_frequency_available"] = available
        for name in self._quantities:
            found[f"in_{name}_scale"] = f"{chip.gyro_scale if name == GYRO else chip.accel_scale:.9f}"
            found[f"in_{name}_mount_matrix"] = "; ".join(", ".join(f"{x:g}" for x in row) for row in chip.mount)
        for name, index, kind in self.part.channels:
            channels = [f"in_{name}_{axis}" for axis in AXES] if name in (GYRO, ACCEL) else [f"in_{name}"]
            for place, channel in enumerate(channels):
                found[f"scan_elements/{channel}_en"] = "0"
                found[f"scan_elements/{channel}_index"] = str(index + place)
                found[f"scan_elements/{channel}_type"] = kind
            if name == TEMPERATURE:
                found[f"in_{name}_scale"] = f"{TEMPERATURE_SCALE:g}"
        if chip.trigger:
            found["trigger/current_trigger"] = ""
        return found

    def plug(self) -> None:
        """The driver was bound."""
        for name, value in self._attributes().items():
            path = self._folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(value + "\n")
        self._node.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileNotFoundError):
            self._node.unlink()
        os.mkfifo(self._node)
        self._fd = os.open(self._node, os.O_RDWR | os.O_NONBLOCK)
        self.set_trigger(there=True)

    def unplug(self) -> None:
        """The driver was unbound: sysfs has it no more, and the buffer ends."""
        if self._fd >= 0:
            os.close(self._fd)
            self._node.unlink(missing_ok=True)
        self._fd, self._next = -1, math.inf
        for folder in (self._folder, self._trigger):
            shutil.rmtree(folder, ignore_errors=True)

    def set_trigger(self, there: bool) -> None:
        """The trigger of its data-ready line is registered, or not."""
        if not self.chip.trigger:
            return
        if there:
            self._trigger.mkdir(parents=True, exist_ok=True)
            (self._trigger / "name").write_text(f"{self.part.name}-dev{self._number}\n")
        else:
            (self._folder / "trigger/current_trigger").write_text("\n")
            shutil.rmtree(self._trigger, ignore_errors=True)

    def _read(self, name: str) -> str:
        try:
            return (self._folder / name).read_text().strip("\0 \n")  # libiio writes the end of a C string, too
        except OSError:
            return ""

    def look(self, t: float, start: float) -> None:
        """See what the host has set. start: CLOCK_MONOTONIC of time 0 in s."""
        if self._fd < 0:
            return
        enabled = self._read("buffer/enable") == "1"
        if enabled and math.isinf(self._next):
            self._begin(t, start)
        elif not enabled:
            self._next = math.inf

    def _begin(self, t: float, start: float) -> None:
        trigger = self._read("trigger/current_trigger") == f"{self.part.name}-dev{self._number}"
        if self.chip.trigger and not trigger:
            return
        with contextlib.suppress(BlockingIOError):  # what was left in the buffer
            while os.read(self._fd, 65536):
                pass
        names = [f"in_{name}_sampling_frequency" for name in self._quantities] + ["sampling_frequency"]
        self._rate = next(float(text) for name in names if (text := self._read(name)))
        self._clock_s = start + (time.time() - time.monotonic() if self._stamps_realtime() else 0.0)
        self._errors = self._new_errors(self._rate)
        self._layout = self._scan_layout()
        self._next = t + (1.0 + self._late) / self._rate
        _log.info("%s: buffer enabled, %g/s, %d bytes a scan", self.part.name, self._rate, self._layout.itemsize)

    def _stamps_realtime(self) -> bool:
        """Kernels before 4.5 do, which lack the attribute; others as it says."""
        return self._read("current_timestamp_clock") in ("realtime", "")

    def _scan_layout(self) -> np.dtype[np.void]:
        """The enabled channels by their index, each aligned to its size, as a record."""
        rows = []
        for path in (self._folder / "scan_elements").glob("*_en"):
            name = path.name.removesuffix("_en")
            if self._read(f"scan_elements/{path.name}") == "1":
                rows.append(
                    (int(self._read(f"scan_elements/{name}_index")), name, self._read(f"scan_elements/{name}_type"))
                )
        names, formats, offsets, at, largest = [], [], [], 0, 1
        for _, name, kind in sorted(rows):
            size = int(kind.partition("/")[2].partition(">>")[0]) // 8
            at = -(-at // size) * size
            names.append(name)
            formats.append(f"{'>' if kind.startswith('be') else '<'}{'i' if ':s' in kind else 'u'}{size}")
            offsets.append(at)
            at, largest = at + size, max(largest, size)
        size = -(-at // largest) * largest
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})

    def step(self, t: float, silent: bool) -> None:
        """Deliver what is due; silent: the trigger does not fire."""
        while self._next <= t:
            n = min(BLOCK, 1 + int((t - self._next) * self._rate))
            times = self._next + np.arange(n) / self._rate
            self._next = float(times[-1]) + 1.0 / self._rate
            scans = self._scans(times)
            if not silent:
                self._deliver(scans[min(self._skip, n) :])
                self._skip = max(0, self._skip - n)

    def skip(self, scans: int) -> None:
        """The buffer has no room for the next scans."""
        self._skip += scans

    def _deliver(self, scans: "np.ndarray[tuple[int], np.dtype[np.void]]") -> None:
        for scan in scans:
            try:
                os.write(self._fd, scan.tobytes())
            except BlockingIOError:
                self.lost += 1

    def _scans(
        self, times: "np.ndarray[tuple[int], np.dtype[np.float64]]"
    ) -> "np.ndarray[tuple[int], np.dtype[np.void]]":
        measured = self._errors.measure(self._signal, times)
        chip_axes = np.array(self.chip.mount).T
        values = {
            GYRO: measured[:, :3] * FRD @ chip_axes.T / self.chip.gyro_scale,
            ACCEL: measured[:, 3:] * FRD @ chip_axes.T / self.chip.accel_scale,
        }
        scans = np.zeros(len(times), self._layout)
        for name, _, kind in self.part.channels:
            shift, bits = int(kind.rpartition(">>")[2]), int(kind.partition(":")[2][1:].partition("/")[0])
            if name == STAMP:
                fields = {"in_timestamp": np.rint((self._clock_s + times) * 1e9)}
            elif name == TEMPERATURE:
                fields = {
                    f"in_{name}": np.array([self._errors.temperature(t) for t in times]) * 1e3 / TEMPERATURE_SCALE
                }
            else:
                fields = {f"in_{name}_{axis}": values[name][:, i] for i, axis in enumerate(AXES)}
            most = 2 ** (bits - 1) - 1
            for field, numbers in fields.items():
                if field in (self._layout.names or ()):
                    counts = np.rint(numbers).astype(np.int64)
                    counts = counts if name == STAMP else np.clip(counts, -most - 1, most)
                    scans[field] = counts << shift
        return scans

    @property
    def deadline(self) -> float:
        return self._next


class IioChip:
    """All devices of one chip, as a task of the emulator's loop. Context manager: they are there inside."""

    def __init__(self, name: str, devices: Sequence[Device], start: float, faults: Sequence[Fault] = ()) -> None:
        """start: CLOCK_MONOTONIC of time 0 in s; faults: of the layers "plug" and "buffer"."""
        self.name, self.path = name, f"iio:{name}"
        self._devices, self._start, self._looked = devices, start, -math.inf
        self._faults = {kind: [one for one in faults if one.name == kind] for kind in ("unplug", "trigger", "overflow")}
        self._plugged, self._fires = True, True
        self._overflows = [0] * len(self._faults["overflow"])

    def __enter__(self) -> "IioChip":
        return self

    def __exit__(self, *_: object) -> None:
        for device in self._devices:
            device.unplug()

    def step(self, t: float) -> None:
        self._apply_faults(t)
        if t - self._looked >= LOOK_S:
            self._looked = t
            for device in self._devices:
                device.look(t, self._start)
        for device in self._devices:
            device.step(t, silent=not self._fires)

    def _apply_faults(self, t: float) -> None:
        plugged = not any(fault.span.holds(t) for fault in self._faults["unplug"])
        if plugged != self._plugged:
            self._plugged = plugged
            _log.info("%s: %s", self.name, "plugged in again" if plugged else "unplugged")
            for device in self._devices:
                (device.plug if plugged else device.unplug)()
        fires = not any(fault.span.holds(t) for fault in self._faults["trigger"])
        if fires != self._fires and self._plugged:
            self._fires = fires
            for device in self._devices:
                device.set_trigger(there=fires)
        for place, fault in enumerate(self._faults["overflow"]):
            if fault.span.beginnings(t) > self._overflows[place]:
                self._overflows[place] = fault.span.beginnings(t)
                for device in self._devices:
                    device.skip(round(fault.value))

    def idle(self) -> None:
        """Nothing to compute ahead."""

    def deadline(self) -> float:
        return min(self._looked + LOOK_S, *(device.deadline for device in self._devices))
