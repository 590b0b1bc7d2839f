"""The result of an experiment: a table of the paper's numbers beside ours, and figures as plain values."""

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any

import numpy as np

from ..figures import Figure
from ..math.arrays import Floats


@dataclass(frozen=True)
class Row:
    """One line of the table. holds: whether its claim holds; None: a number without a claim."""

    quantity: str
    paper: str
    ours: str
    holds: bool | None = None


@dataclass(frozen=True)
class Report:
    """One paper, reproduced."""

    title: str
    rows: Sequence[Row]
    figures: Sequence[Figure] = field(default_factory=tuple)
    ours: bool = True  # of our simulation, where each claim must hold; else of a user's recording

    @property
    def failed(self) -> list[Row]:
        """The claims that do not hold."""
        return [row for row in self.rows if row.holds is False]

    @property
    def table(self) -> list[tuple[str, str, str, str]]:
        """Head and rows: whether the claim holds, quantity, the paper's number, ours."""
        marks = {True: "ok", False: "FAIL" if self.ours else "no", None: ""}
        head = ("", "quantity", "paper", "ours" if self.ours else "data")
        return [head, *((marks[row.holds], row.quantity, row.paper, row.ours) for row in self.rows)]

    def lines(self, width: int) -> list[str]:
        """The table as text, of lines no longer than `width`: cells that do not fit go on in the next line."""
        table = self.table
        widths = _fitted([max(1, *(len(line[i]) for line in table)) for i in range(4)], width - 2 * 3)
        text = [line for row in table for line in _wrapped(row, widths)]
        no = "FAIL: it does not" if self.ours else "no: it does not, on these data"
        legend = f"ok: the paper's claim holds; {no}; no mark: a number without a claim"
        return [self.title, "", text[0], "-" * sum(widths, 6), *text[1:], "", *textwrap.wrap(legend, width)]

    def as_dict(self) -> dict[str, Any]:
        """The table for machines."""
        rows = [{"quantity": r.quantity, "paper": r.paper, "ours": r.ours, "holds": r.holds} for r in self.rows]
        return {"title": self.title, "holds": not self.failed, "rows": rows}


def _fitted(widths: Sequence[int], most: int) -> list[int]:
    """Widths of columns, the widest made narrower until their sum is `most`."""
    fitted = list(widths)
    while sum(fitted) > most:
        fitted[fitted.index(max(fitted))] -= 1
    return fitted


def _wrapped(row: Sequence[str], widths: Sequence[int]) -> Iterator[str]:
    """The lines of a row of the table."""
    cells = [textwrap.wrap(cell, width, subsequent_indent="  ") for cell, width in zip(row, widths, strict=True)]
    for line in zip_longest(*cells, fillvalue=""):
        yield "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()


def at_most(quantity: str, paper: str, value: float, limit: float, unit: str = "") -> Row:
    """A claim that `value` does not exceed `limit`."""
    return Row(quantity, paper, f"{value:.4g} {unit}".rstrip() + f" (limit {limit:.3g})", bool(value <= limit))


def within(quantity: str, paper: str, value: float, low: float, high: float, unit: str = "") -> Row:
    """A claim that `value` lies between `low` and `high`."""
    return Row(
        quantity, paper, f"{value:.4g} {unit}".rstrip() + f" ({low:.3g} to {high:.3g})", bool(low <= value <= high)
    )


def circles(p: Floats, sigma: Floats, every: int) -> tuple[Floats, Floats]:
    """East and north in m of circles of radius sigma about every so many points p (north, east), for a map."""
    angle = np.append(np.linspace(0.0, 2.0 * np.pi, 25), np.nan)
    chosen = range(0, len(p), every)
    east = np.concatenate([p[k, 1] + sigma[k] * np.cos(angle) for k in chosen])
    north = np.concatenate([p[k, 0] + sigma[k] * np.sin(angle) for k in chosen])
    return east, north


def rms(values: Floats) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
