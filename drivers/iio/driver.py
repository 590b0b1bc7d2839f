"""The driver of inertial sensors that the Linux kernel has: Industrial I/O, their buffers and attributes.

Its dialogues are lines of text that `transport/iio.py` carries out in sysfs. A chip's axes are taken as x forward, y
left, z up, after the mount matrix that the kernel may have of it.
"""

import errno
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..dialogue import Dialogue, Exchange
from ..driver import Identity, ImuConfigured, Options, Unsupported
from .layout import Attributes, Channel, Layout, LayoutError, layout_of
from .setup import Commands, NoTriggerError, commands, rate_hz, trigger_of

ANSWER_S = 2.0
RATE_S, ENOUGH_SCANS = 1.0, 64  # of listening for the rate
LEAST_SCANS = 3
REMEDIES = {  # of what the system says to an attribute that is set
    os.strerror(errno.EACCES): "be root, or set the udev rule that `imud doctor` prints",
    os.strerror(errno.EROFS): "if systemd runs imud: `systemctl edit` its unit, [Service], ProtectKernelTunables=no",
}
RATE_TOLERANCE = 0.02  # share by which the measured rate may differ from the one that the kernel reports


@dataclass(frozen=True)
class Listing:
    """The attributes of the devices and of the triggers, by their folders."""

    devices: Mapping[str, Attributes]
    triggers: Mapping[str, Attributes]

    @property
    def model(self) -> str:
        """The names of the devices."""
        return " + ".join(device.get("name") or folder for folder, device in self.devices.items())


class Iio:
    """The driver."""

    name = "iio"
    bauds: Sequence[int] = ()  # it is on no serial line
    timeout_s = 1.0
    interrupts = False
    fault_texts = MappingProxyType[int, str]({})

    @property
    def kind(self) -> Literal["imu"]:
        """The kind of device."""
        return "imu"

    def recognise(self, received: bytes) -> None:
        """On no serial line."""

    def identify(self) -> Dialogue[Identity | Unsupported | None]:
        """Ask for the attributes."""
        found = yield from _listing()
        if found is None:
            return None
        serials = [device["serialnumber"] for device in found.devices.values() if "serialnumber" in device]
        return Identity(self.name, found.model, serial=serials[0] if serials else "")

    def configure(self, identity: Identity, options: Options) -> Dialogue[ImuConfigured | Unsupported | None]:
        """Set rate, trigger, channels and clock, begin the buffers, and measure the rate."""
        found = yield from _listing()
        if found is None:
            return None
        try:
            if not options.readonly:
                before, begin = commands(found.devices, found.triggers, options.rate_hz)
                refused = yield from _set(before)
                for name, error in refused.items():
                    if remedy := REMEDIES.get(error):
                        return Unsupported(self.name, identity.model, f"{name} says: {error}; {remedy}")
                found = (yield from _listing()) or found
                layout = layout_of(list(found.devices.values()))
                refused |= yield from _set(begin)
                if failed := [f"{name} says: {refused[name]}" for name, _ in begin if name in refused]:
                    return Unsupported(self.name, identity.model, _cannot_begin(failed, refused))
            elif idle := [one for one, device in found.devices.items() if device.get("buffer/enable") != "1"]:
                return Unsupported(self.name, identity.model, f"its port is readonly, and {idle[0]}/buffer/enable is 0")
            else:
                layout = layout_of(list(found.devices.values()))
        except (LayoutError, NoTriggerError) as error:
            return Unsupported(self.name, identity.model, str(error))
        return (yield from self._measured(identity, options, found, layout))

    def _measured(
        self, identity: Identity, options: Options, found: Listing, layout: Layout
    ) -> Dialogue[ImuConfigured | Unsupported]:
        """How it streams, from its first scans."""
        setup = {"sizes": layout.sizes, "stamps": layout.stamps, "monotonic": layout.monotonic}
        sizes = layout.sizes
        received = yield Exchange(
            f"stream {json.dumps(setup)}\n".encode(),
            RATE_S,
            lambda received: all(len(one) >= ENOUGH_SCANS for one in scans_in(received, sizes)),
            discard=True,
        )
        scans = scans_in(received, sizes)
        set_hz = [_set_rate(device, found) for device in found.devices.values()]
        for (folder, device), received_scans in zip(found.devices.items(), scans, strict=True):
            if len(received_scans) < LEAST_SCANS:
                return Unsupported(self.name, identity.model, _silent(folder, device))
        periods = [_period_ns(one, at, hz) for one, at, hz in zip(scans, layout.stamps, set_hz, strict=True)]
        layout = replace(layout, periods_ns=tuple(periods))
        hz, period_ns = 1e9 / periods[0], 1 if layout.stamps[0] >= 0 else periods[0]
        axes = _axes(layout)
        return ImuConfigured(
            identity,
            hz if not abs(hz / set_hz[0] - 1.0) < RATE_TOLERANCE else set_hz[0],
            period_ns,
            0,
            1 + sizes[0],
            _warnings(found, layout, options, hz, set_hz[0]),
            axes,
            _range(layout.gyros),
            _range(layout.forces),
            layout=layout.to_text(),
        )

    def new_state(self, configured: ImuConfigured) -> NDArray[np.void]:
        """See `ImuDriver`."""
        from .scans import new_state

        return new_state(Layout.from_text(configured.layout))

    @property
    def decode(self) -> Callable[[NDArray[np.uint8], int, NDArray[np.void], NDArray[np.void]], int]:
        """See `ImuDriver`."""
        from .scans import decode

        return decode


def _is_answered(received: bytes, lines: int = 1) -> bool:
    return received.count(b"\n") >= lines


def _listing() -> Dialogue[Listing | None]:
    received = yield Exchange(b"list\n", ANSWER_S, _is_answered, discard=True)
    return Listing(**json.loads(received)) if _is_answered(received) else None


def _set(attributes: Commands) -> Dialogue[dict[str, str]]:
    """Set them; returns the errors, by attribute."""
    sent = "".join(f"set {name} {value}\n" for name, value in attributes)
    received = yield Exchange(sent.encode(), ANSWER_S, lambda got: _is_answered(got, len(attributes)), discard=True)
    errors = [json.loads(line) for line in received.splitlines()]
    return {name: error for (name, _), error in zip(attributes, errors, strict=False) if error}


def _cannot_begin(failed: list[str], refused: Mapping[str, str]) -> str:
    earlier = [f"{name}: {error}" for name, error in refused.items() if not name.endswith("/enable")]
    return f"its buffer does not begin: {'; '.join(failed + earlier)}"


def _silent(folder: str, device: Attributes) -> str:
    trigger = device.get("trigger/current_trigger")
    why = "" if trigger is None else f": its trigger {trigger or '(none)'} does not fire"
    return f"the buffer of {folder} is enabled, and hardly a scan comes{why}; see dmesg"


def scans_in(received: bytes, sizes: Sequence[int]) -> list[list[bytes]]:
    """The whole scans, by device."""
    found: list[list[bytes]] = [[] for _ in sizes]
    at = 0
    while at < len(received) and received[at] < len(sizes) and at + 1 + sizes[received[at]] <= len(received):
        device = received[at]
        found[device].append(received[at + 1 : at + 1 + sizes[device]])
        at += 1 + sizes[device]
    return found


def _set_rate(device: Attributes, found: Listing) -> float:
    try:
        trigger = trigger_of(device, found.triggers)
    except NoTriggerError:
        trigger = ""
    return rate_hz(device, found.triggers.get(trigger, {}))


def _period_ns(scans: list[bytes], stamp_at: int, set_hz: float) -> int:
    """The median step of the stamps; without any, what the kernel says; 10 ms if it says nothing."""
    if stamp_at < 0:
        return round(1e9 / set_hz) if math.isfinite(set_hz) else 10_000_000
    stamps = np.array([int.from_bytes(scan[stamp_at : stamp_at + 8], "little", signed=True) for scan in scans])
    return max(1, round(float(np.median(np.diff(stamps)))))


def _axes(layout: Layout) -> tuple[bool, bool, bool]:
    """The axes, FRD, about which there are gyros."""
    there = np.array([one is not None for one in layout.gyros])
    x, y, z = (bool(there[np.abs(row) > 0.1].all()) for row in np.array(layout.gyro_rotation))
    return x, y, z


def _range(channels: Sequence[Channel | None]) -> float:
    return min((one.range for one in channels if one is not None), default=math.inf)


def _warnings(found: Listing, layout: Layout, options: Options, hz: float, set_hz: float) -> tuple[str, ...]:
    clocks: set[Any] = {device.get("current_timestamp_clock") for device in found.devices.values()}
    cases = (
        (
            layout.stamps[0] >= 0 and not layout.monotonic,
            f"the kernel stamps its samples with the clock {'/'.join(sorted(map(str, clocks)))}, which cannot be "
            "changed to monotonic: a step of that clock disturbs them",
        ),
        (layout.stamps[0] < 0, "the kernel does not stamp its samples: their times are fitted to their arrival"),
        (abs(hz / set_hz - 1.0) > 0.1, f"{hz:.4g} samples/s come, the kernel says {set_hz:g}"),
        (hz < 0.5 * options.rate_hz and not options.readonly, f"{options.rate_hz:g} samples/s wanted, {hz:.4g} come"),
    )
    return tuple(text for holds, text in cases if holds)


DRIVER = Iio()
