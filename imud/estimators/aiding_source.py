"""What the outside knows of an aiding source: its name, its columns in a table, the names of its innovations."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from .innovation_kinds import InnovationKind

DEGREE = math.pi / 180.0  # rad


class ImpossibleValueError(ValueError):
    """A number of a measurement is outside what its column allows."""


class Column(NamedTuple):
    """A number of a measurement, as users write it. low, high: what is possible, in that unit."""

    factor: float  # to SI units
    low: float
    high: float


@dataclass(frozen=True)
class AidingSource:
    """A source of measurements beside GNSS.

    name: what the user calls it. kind: its code in MEASUREMENT. message: the class of its datagrams. columns: those of
    a table that become `value`, in this order; sigmas: those that become `sigma`, which may be absent. In a datagram
    they are called the same, without the unit: `heading_deg` is `heading`. innovations: kind in INNOVATION to its
    names; the first stands for a measurement that came too late. reversed_sign: -1.0 for what changes its sign if time
    runs backward, as a speed does. alternatives: what may stand instead of a column: its name to the column, the
    conversion, and what is possible. optional: the columns that may be absent. short_names: of columns that have
    another name in a datagram. parts: columns that together may stand for others, which `combine` makes of them, in
    their order.

        degrees = Column(DEGREE, -360.0, 360.0)
        AidingSource("heading", HEADING_SOURCE, "HDG", {"heading_deg": degrees}, …, {HEADING: KINDS[HEADING]})
    """

    name: str
    kind: int
    message: str
    columns: dict[str, Column]
    sigmas: dict[str, Column] = field(default_factory=dict)
    innovations: dict[int, InnovationKind] = field(default_factory=dict)
    reversed_sign: float = 1.0
    alternatives: dict[str, tuple[str, Callable[[float], float], float, float]] = field(default_factory=dict)
    optional: tuple[str, ...] = ()
    short_names: dict[str, str] = field(default_factory=dict)
    parts: tuple[str, ...] = ()
    combine: Callable[..., dict[str, float]] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """All columns that a table may have of it."""
        return (*self.columns, *self.alternatives, *self.parts, *self.sigmas)

    def short_name(self, column: str) -> str:
        """What a column is called in a datagram."""
        return self.short_names.get(column, column.rpartition("_")[0])

    def missing(self, names: Iterable[str]) -> list[str]:
        """The columns that are missing among these, and have no alternative among them."""
        there = set(names)
        there |= {column for name, (column, *_) in self.alternatives.items() if name in there}
        if self.combine is not None and there.issuperset(self.parts):
            there |= self.combine(*[0.0] * len(self.parts)).keys()
        return [column for column in self.columns if column not in there and column not in self.optional]

    def _converted(self, row: Mapping[str, float]) -> Mapping[str, float]:
        """The row with its columns made of alternatives. Raises ImpossibleValueError."""
        found = dict(row)
        for name, (column, convert, low, high) in self.alternatives.items():
            number = row.get(name, math.nan)
            if math.isnan(number) or not math.isnan(row.get(column, math.nan)):
                continue
            if not low <= number <= high:
                raise ImpossibleValueError(f"{name} is {number:g}, outside {low:g} to {high:g}")
            found[column] = convert(number)
        if self.combine is not None and all(not math.isnan(row.get(part, math.nan)) for part in self.parts):
            found |= self.combine(*(row[part] for part in self.parts))
        return found

    def fill(self, measurement: Any, row: Mapping[str, float]) -> None:
        """Write kind, values and sigmas to a row of MEASUREMENT; row: numbers by column, absent or NaN if not known.

        Raises ImpossibleValueError.
        """
        measurement["kind"] = self.kind
        row = self._converted(row)
        for target, columns in (("value", self.columns), ("sigma", self.sigmas)):
            numbers = [math.nan] * measurement.dtype[target].shape[0]
            for i, (name, column) in enumerate(columns.items()):
                number = row.get(name, math.nan)
                if not math.isnan(number) and not column.low <= number <= column.high:
                    raise ImpossibleValueError(f"{name} is {number:g}, outside {column.low:g} to {column.high:g}")
                numbers[i] = column.factor * number
            measurement[target] = numbers

    def cells(self, measurement: Any) -> dict[str, float]:
        """The numbers of a row of MEASUREMENT by columns and sigmas, as `fill` reads them; NaN: not known."""
        columns = [(name, column, "value", i) for i, (name, column) in enumerate(self.columns.items())]
        columns += [(name, column, "sigma", i) for i, (name, column) in enumerate(self.sigmas.items())]
        return {name: float(measurement[target][i]) / column.factor for name, column, target, i in columns}
