"""What the outside knows of an aiding source: its name, its columns in a table, the names of its innovations."""

import math
from dataclasses import dataclass, field

from .innovation_kinds import Kind


@dataclass(frozen=True)
class AidingSource:
    """A source of measurements beside GNSS.

    name: what the user calls it. kind: its code in MEASUREMENT. columns: those of a table that become `value`, each
    with its factor to SI units; sigmas: those that become `sigma`, which may be absent. innovations: kind in INNOVATION
    to its names; the first stands for a measurement that came too late.

        AidingSource("heading", HEADING_SOURCE, {"heading_deg": DEGREE}, {"sigma_deg": DEGREE}, {HEADING: Kind(...)})
    """

    name: str
    kind: int
    columns: dict[str, float]
    sigmas: dict[str, float] = field(default_factory=dict)
    innovations: dict[int, Kind] = field(default_factory=dict)


DEGREE = math.pi / 180.0  # rad
