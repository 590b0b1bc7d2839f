"""Which attributes are set to have a device stream: rate, trigger, channels, clock, buffer, in the order they need.

Sources: as in `layout`; a channel or a rate can only be changed while the buffer is disabled, and `enable` is written
last (iio_devbuf.rst); triggers: Documentation/iio/iio_configfs.rst, Documentation/driver-api/iio/triggers.rst.
"""

import math
import re
from collections.abc import Mapping, Sequence

from .layout import FORCE, GYRO, Attributes, elements, wanted

BUFFER_S = 0.5  # time whose samples the buffer holds
LEAST_SCANS = 64
RATE_FACTOR = 1.05  # a rate within this factor of the wanted one counts as not higher
RATES = ("sampling_frequency", f"in_{GYRO}_sampling_frequency", f"in_{FORCE}_sampling_frequency")
NO_TRIGGER = (
    "it has no trigger, and the kernel has none that fits: `sudo modprobe iio-trig-hrtimer && "
    "sudo mkdir /sys/kernel/config/iio/triggers/hrtimer/imud` makes a timer"
)

Commands = list[tuple[str, str]]  # attribute with its folder, and value


class NoTriggerError(ValueError):
    """The device needs a trigger, and there is none."""


def nearest_rate(available: str, wanted_hz: float) -> float | None:
    """The highest of the available rates that is not above the wanted one, else the lowest; None: they are not known.

    available: rates, or `[LEAST STEP MOST]`.
    """
    numbers = [float(text) for text in re.findall(r"\d+(?:\.\d+)?", available)]
    numbers = [number for number in numbers if number > 0.0] if not available.startswith("[") else numbers
    if not numbers:
        return None
    if available.startswith("["):
        return min(max(wanted_hz, numbers[0]), numbers[-1])
    fitting = [number for number in numbers if number <= RATE_FACTOR * wanted_hz]
    return max(fitting) if fitting else min(numbers)


def rates(device: Attributes, wanted_hz: float) -> dict[str, str]:
    """The rates to set, by attribute."""
    found = {}
    for name in (name for name in RATES if name in device):
        available = device.get(f"{name}_available", device.get("sampling_frequency_available", ""))
        hz = nearest_rate(available, wanted_hz)
        if hz is None:
            hz = wanted_hz  # the kernel rounds it, or refuses it
        wanted_hz = hz
        found[name] = f"{hz:g}" if hz == round(hz, 3) else f"{hz:.6f}"
    return found


def rate_hz(device: Attributes, trigger: Attributes) -> float:
    """As the trigger, or the device itself, is set; NaN: not known."""
    texts = [trigger.get("sampling_frequency", ""), *(device.get(name, "") for name in RATES)]
    numbers = (re.match(r"\d+(?:\.\d+)?", text) for text in texts)
    return next((float(number[0]) for number in numbers if number and float(number[0]) > 0.0), math.nan)


def trigger_of(device: Attributes, triggers: Mapping[str, Attributes]) -> str:
    """Folder of the trigger that is to be used: that which is set, its own, a timer; empty: it needs none.

    Raises NoTriggerError.
    """
    current = device.get("trigger/current_trigger")
    if current is None:
        return ""
    if found := [folder for folder, one in triggers.items() if current and one.get("name") == current]:
        return found[0]
    own = [folder for folder, one in triggers.items() if one.get("name", "").startswith(f"{device.get('name')}-")]
    timers = [folder for folder, one in triggers.items() if "sampling_frequency" in one]
    if not own + timers:
        raise NoTriggerError(NO_TRIGGER)
    return (own + timers)[0]


def commands(
    devices: Mapping[str, Attributes], triggers: Mapping[str, Attributes], wanted_hz: float
) -> tuple[Commands, Commands]:
    """What is set before the buffers begin, and what begins them. Raises NoTriggerError."""
    found: Commands = [(f"{folder}/buffer/enable", "0") for folder in devices]
    for number, (folder, device) in enumerate(devices.items()):
        quantities = quantities_of(number, len(devices))
        set_rates = rates(device, wanted_hz)
        found += [(f"{folder}/{name}", text) for name, text in set_rates.items() if device[name] != text]
        if trigger := trigger_of(device, triggers):
            if "sampling_frequency" in triggers[trigger]:
                hz = next(iter(set_rates.values()), f"{wanted_hz:g}")
                found.append((f"{trigger}/sampling_frequency", hz))
            found.append((f"{folder}/trigger/current_trigger", triggers[trigger].get("name", "")))
        if "current_timestamp_clock" in device:
            found.append((f"{folder}/current_timestamp_clock", "monotonic"))
        names = wanted(device, quantities)
        switches = {name: str(int(name in names)) for name in elements(device)}
        found += [
            (f"{folder}/scan_elements/{name}_en", on) for name, on in sorted(switches.items(), key=lambda x: x[1])
        ]
        scans = max(LEAST_SCANS, 1 << math.ceil(math.log2(BUFFER_S * wanted_hz)))
        found += [(f"{folder}/buffer/length", str(scans)), (f"{folder}/buffer/watermark", "1")]
    return found, [(f"{folder}/buffer/enable", "1") for folder in devices]


def quantities_of(number: int, devices: int) -> Sequence[str]:
    """What is wanted of device `number` of so many."""
    return (GYRO, FORCE) if devices == 1 else ((GYRO, FORCE)[number],)
