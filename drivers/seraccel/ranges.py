"""The board's accelerometer in its selectable ranges, one row each.

Source: Freescale MMA7260QT data sheet, rev. 5 (2008); 10-bit converter and 3.3 V supply after the firmware of the
board's successor (ryowens84/Serial-Accelerometer-Dongle).
"""

from dataclasses import dataclass

from ..sample import STANDARD_GRAVITY

SUPPLY_MV = 3300.0
FULL_COUNT = 1023  # the converter's answer to the supply
SWING_MV = SUPPLY_MV / 2.0 - 250.0  # the output comes no nearer to supply and ground than 0.25 V
LOW_PASS_NS = 1_060_000  # delay of the 150 Hz pole on z; x and y have 350 Hz


@dataclass(frozen=True)
class Range:
    """One row."""

    g: float
    mv_per_g: float

    @property
    def model(self) -> str:
        """What `Identity.model` says of a board in this range."""
        return f"SerAccel (±{self.g:g} g)"

    @property
    def scale(self) -> float:
        """m/s^2 per count."""
        return SUPPLY_MV / FULL_COUNT / self.mv_per_g * STANDARD_GRAVITY

    @property
    def end_g(self) -> float:
        """Where the output is at its end."""
        return SWING_MV / self.mv_per_g


RANGES = (Range(1.5, 800.0), Range(2.0, 600.0), Range(4.0, 300.0), Range(6.0, 200.0))
MODEL = "SerAccel"  # range unknown


def range_of(model: str) -> Range:
    """The row of a model; the widest, at whose ends nothing good is refused, if the range is unknown."""
    return next((row for row in RANGES if row.model == model), RANGES[-1])
