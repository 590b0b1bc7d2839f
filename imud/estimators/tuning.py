"""Tunables: the constants of an estimator that a user may change without a rebuild.

An estimator lists them in one table. The table makes the fields of a record, which is nested in the estimator's
parameters and read by its kernels; the keys of the settings' table `ESTIMATOR.tuning`; and the rows of
`imud reference tuning`. A constant that is a definition (an index, the size of an array, a unit) is no tunable.

    TUNABLES = (Tunable("rest_time_s", 1.0, "s", "How long the body must show no motion.", "BROAD recordings."),)
    PARAMETERS = np.dtype([("tuning", dtype_of(TUNABLES))], align=True)
    parameters["tuning"] = values_of(TUNABLES, settings.attitude.tuning)
"""

import reprlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Tunable:
    """One constant: its default, its unit ("": a pure number), its meaning, and where the default comes from.

    A default that is an int makes an integer. Values from `least` to `most` are accepted, both included: `low` and
    `high`, else a thousandth and a thousand times the default, so that every number is finite and none divides by zero.
    """

    name: str
    default: float
    unit: str
    meaning: str
    source: str
    low: float | None = None
    high: float | None = None

    @property
    def least(self) -> float:
        if self.low is not None:
            return self.low
        return 1 if isinstance(self.default, int) else self.default / 1000.0

    @property
    def most(self) -> float:
        return 1000.0 * self.default if self.high is None else self.high

    @property
    def kind(self) -> str:
        """The values it takes, in words."""
        kind = "integer" if isinstance(self.default, int) else "number"
        return f"{kind} from {self.least:g} to {self.most:g}"

    def accepts(self, value: float) -> bool:
        return self.least <= value <= self.most and (not isinstance(self.default, int) or float(value).is_integer())


def dtype_of(tunables: Iterable[Tunable]) -> np.dtype[np.void]:
    """The record with one field for each tunable, under its name."""
    return np.dtype([(t.name, "<i8" if isinstance(t.default, int) else "<f8") for t in tunables], align=True)


def values_of(tunables: Iterable[Tunable], changed: Mapping[str, float]) -> tuple[float, ...]:
    """What a `dtype_of` holds: the defaults, and the user's changes, which `problems` has accepted."""
    return tuple(changed.get(tunable.name, tunable.default) for tunable in tunables)


def problems(tunables: Iterable[Tunable], changed: Mapping[str, float]) -> Iterator[tuple[str, str]]:
    """(name, what is wrong) for every change that the tunables do not take."""
    known = {tunable.name: tunable for tunable in tunables}
    for name, value in changed.items():
        if name not in known:
            yield name, "there is no such tunable; `imud reference tuning` lists them"
        elif not known[name].accepts(value):
            article = "an" if isinstance(known[name].default, int) else "a"
            wanted = f"{known[name].kind} {known[name].unit}".strip()
            yield name, f"must be {article} {wanted}, not {reprlib.repr(value)}"
