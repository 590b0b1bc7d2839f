"""The pulse per second that the kernel stamps (/dev/pps0), from sysfs: `seconds.nanoseconds#number`, real time.

Source: Documentation/driver-api/pps.rst of the Linux kernel. Reading needs no permission and never waits.
"""

import re
import time
from collections.abc import Callable
from pathlib import Path

from ..errors import PortAbsentError

_SYSFS = Path("/sys/class/pps")
_STAMP = re.compile(r"(\d+)\.(\d{9})#(\d+)")
_OLD_NS = 1_500_000_000  # a pulse this old is not the last second's: it stopped, or the clock was stepped since


def _clocks() -> tuple[int, int]:
    """Real time and CLOCK_MONOTONIC, ns, of one instant."""
    return time.time_ns(), time.monotonic_ns()


class PulsePerSecond:
    """The newest pulse of one source. Raises PortAbsentError if there is no such source."""

    def __init__(self, device: str, sysfs: Path = _SYSFS, clocks: Callable[[], tuple[int, int]] = _clocks) -> None:
        path = sysfs / Path(device).name / "assert"
        try:
            self._file = path.open("rb", buffering=0)
        except OSError as error:
            present = ", ".join(f"/dev/{found.name}" for found in sorted(sysfs.glob("pps*"))) or "none"
            raise PortAbsentError(
                device, f"there is no {device}; present: {present}. On a Raspberry Pi: dtoverlay=pps-gpio,gpiopin=18"
            ) from error
        self._clocks = clocks

    def newest_ns(self) -> int | None:
        """When the last pulse was, on CLOCK_MONOTONIC; None if there was none just now."""
        try:
            self._file.seek(0)
            found = _STAMP.match(self._file.read(64).decode("ascii", "replace"))
        except OSError:
            return None
        if found is None:
            return None
        real_ns, monotonic_ns = self._clocks()
        age_ns = real_ns - (int(found[1]) * 1_000_000_000 + int(found[2]))
        return monotonic_ns - age_ns if 0 <= age_ns < _OLD_NS else None

    def close(self) -> None:
        self._file.close()
