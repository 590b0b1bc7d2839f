"""Figures and their goals, on one screen or as JSON."""

import json
import math
import textwrap
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Figure:
    """One thing measured.

    most, least: the goal, if any; reason: why it is missed, if it is; note: why there is no value, or a remark.
    """

    name: str
    value: float
    unit: str
    most: float | None = None
    least: float | None = None
    note: str = ""
    reason: str = ""

    @property
    def verdict(self) -> str:
        if not math.isfinite(self.value):
            return "not measured"
        if self.most is None and self.least is None:
            return ""
        good = (self.most is None or self.value <= self.most) and (self.least is None or self.value >= self.least)
        return "ok" if good else "MISSED"

    @property
    def why(self) -> str:
        """The reason, if the goal is missed."""
        return self.reason if self.verdict == "MISSED" else ""

    @property
    def goal(self) -> str:
        if self.most is not None:
            return f"<= {self.most:g}"
        return f">= {self.least:g}" if self.least is not None else ""

    @property
    def shown(self) -> str:
        if not math.isfinite(self.value):
            return "-"
        digits = 0 if self.value == round(self.value) and abs(self.value) < 1e6 else 3
        return f"{self.value:.{digits}g}" if digits and abs(self.value) < 1000 else f"{self.value:,.0f}"


@dataclass
class Section:
    """Figures that belong together."""

    title: str
    figures: list[Figure] = field(default_factory=list)

    def add(self, name: str, value: float, unit: str, **goal: Any) -> None:
        self.figures.append(Figure(name, value, unit, **goal))


def as_text(sections: list[Section]) -> str:
    """The table."""
    lines = []
    for section in sections:
        lines.append(section.title)
        for f in section.figures:
            left = f"  {f.name:<44}{f.shown:>10} {f.unit:<14}{f.goal:>9}  {f.verdict}"
            lines.append(f"{left}{': ' if f.verdict else ''}{f.note}" if f.note else left.rstrip())
            lines += textwrap.wrap(f.why, 112, initial_indent="    because ", subsequent_indent=" " * 12)
    return "\n".join(lines)


def as_json(sections: list[Section]) -> str:
    """One object; a value that is not a number is null."""
    rows = [
        {
            **asdict(f),
            "section": s.title,
            "verdict": f.verdict,
            "value": f.value if math.isfinite(f.value) else None,
            "reason": f.why,
        }
        for s in sections
        for f in s.figures
    ]
    return json.dumps({"figures": rows}, indent=1)
