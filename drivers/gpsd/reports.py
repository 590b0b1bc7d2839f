"""gpsd's reports: lines of JSON to checked values. What has another type, or is not finite, counts as missing.

Source: gpsd_json(5) of gpsd 3.22 and 3.27.
"""

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from ..fix import Satellite, Sky

LINE_MAX = 65536  # bytes; gpsd's own longest are 10240
NUMBER_MAX = 1e12
SBAS, SBAS_OFFSET, SYSTEMS = 1, -87, (0, 1, 2, 3, 5, 6)  # to NMEA's numbers; systems as in `Satellite`
QUALITIES = {2: 2, 3: 4, 4: 5, 5: 6, 6: 1, 7: 7, 8: 8, 9: 3}  # of TPV's status; any other: 1


@dataclass(frozen=True)
class Report:
    """One object with its class. arrival_ns: of the first byte of its line."""

    kind: str
    device: str
    values: Mapping[str, Any]
    arrival_ns: int

    def number(self, name: str, least: float = -NUMBER_MAX, most: float = NUMBER_MAX) -> float | None:
        """A number within [least, most]; None: there is none."""
        value = self.values.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
            return None
        return float(value)

    def time(self) -> datetime | None:
        """UTC of the epoch."""
        text = self.values.get("time")
        try:
            found = datetime.fromisoformat(text.replace("Z", "+00:00")) if isinstance(text, str) else None
            return found.astimezone(UTC).replace(tzinfo=None) if found and found.tzinfo else None
        except (ValueError, OverflowError):
            return None


class Lines:
    """Bytes to reports. Counts `no JSON` and `too long`. Any chunking gives the same reports. Not thread-safe."""

    def __init__(self, counters: Counter[str]) -> None:
        self._counters = counters
        self._line = bytearray()
        self._arrival_ns = 0

    def feed(self, data: bytes, arrival_ns: int) -> Iterator[Report]:
        """Yield the reports that `data` completes."""
        for piece in data.splitlines(keepends=True):
            if not self._line:
                self._arrival_ns = arrival_ns
            self._line += piece[: LINE_MAX + 2 - len(self._line)]
            if piece.endswith((b"\n", b"\r")):
                line, self._line = bytes(self._line).strip(), bytearray()
                if found := self._read(line):
                    yield found

    def _read(self, line: bytes) -> Report | None:
        if not line:
            return None
        if len(line) > LINE_MAX:
            self._counters["too long"] += 1
            return None
        try:
            values = json.loads(line)
        except (ValueError, RecursionError):
            values = None
        kind = values.get("class") if isinstance(values, dict) else None
        if not isinstance(kind, str):
            self._counters["no JSON"] += 1
            return None
        device = values.get("device")
        return Report(kind, device if isinstance(device, str) else "", values, self._arrival_ns)


def quality(report: Report) -> int:
    """Of a TPV, as in `Fix`."""
    if (report.number("mode") or 0) < 2:
        return 0
    return QUALITIES.get(int(report.number("status", 0, 100) or 0), 1)


def sky(report: Report) -> Sky | None:
    """Of a SKY that lists satellites; None: it lists none."""
    rows = report.values.get("satellites")
    if not isinstance(rows, list):
        return None
    found = (_satellite(Report("", "", row, 0)) for row in rows if isinstance(row, dict))
    pdop, vdop = report.number("pdop", 0.01, 99.0), report.number("vdop", 0.01, 99.0)
    return Sky(tuple(one for one in found if one), pdop, vdop, report.arrival_ns, report.arrival_ns)


def _satellite(row: Report) -> Satellite | None:
    system, number = row.number("gnssid", 0, 6), row.number("svid", 1, 255)
    if system not in SYSTEMS or number is None:
        return None
    limits = (("el", -90.0, 90.0), ("az", 0.0, 360.0), ("ss", 0.5, 99.0))
    up, around, signal = (None if (value := row.number(*one)) is None else round(value) for one in limits)
    offset = SBAS_OFFSET if system == SBAS else 0
    return Satellite(int(system), int(number) + offset, up, around, signal, row.values.get("used") is True)
