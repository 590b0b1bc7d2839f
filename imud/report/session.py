"""The files of a report, each recognised by its header, on one time axis: seconds since the earliest of them."""

import io
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imud.errors import BadDataError, InputMissingError
from imud.figures import MOST_POINTS
from imud.tables import (
    ESTIMATE_HEADER,
    IMU_COLUMNS,
    INNOVATION_COLUMNS,
    INNOVATION_KINDS,
    EstimateWriter,
    read_fixes,
    read_imu,
)

from .recording import Recorded, is_recording, thinned

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Estimates:
    """One est.csv, thinned to what a page can show. columns: by their names in the file; unknown is NaN."""

    name: str
    columns: dict[str, Floats]


@dataclass(frozen=True)
class Innovations:
    """Of one quantity (`pn_m`, …) from one file: value and its predicted 1 sigma in the unit of the name."""

    name: str
    kind: str
    t: Floats
    value: Floats
    sigma: Floats
    used: NDArray[np.bool_]

    @property
    def normalised(self) -> Floats:
        """Value over sigma: standard normal and white if the filter is right."""
        return self.value / self.sigma


@dataclass(frozen=True)
class Samples:
    """An imu.csv. rows: SAMPLE, its t_ns since the report's time 0."""

    name: str
    rows: NDArray[np.void]
    rate_hz: float


@dataclass(frozen=True)
class Fixes:
    """A gnss.csv. rows: FIX, times since the report's time 0."""

    name: str
    rows: NDArray[np.void]


@dataclass(frozen=True)
class Session:
    """Everything that the files tell."""

    estimates: tuple[Estimates, ...]
    innovations: tuple[Innovations, ...]
    samples: tuple[Samples, ...]
    fixes: tuple[Fixes, ...]


def _header(path: Path) -> list[str]:
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            return [name.strip() for name in file.readline().strip().split(",")]
    except FileNotFoundError as error:
        raise InputMissingError(f"{path}: no such file") from error
    except OSError as error:
        raise InputMissingError(f"{path}: cannot be read: {error.strerror}") from error


def _kind(path: Path) -> str:
    header = _header(path)
    if is_recording(path):
        return "recording"
    kinds = (
        ("estimates", ESTIMATE_HEADER.split(",")),
        ("innovations", INNOVATION_COLUMNS),
        ("samples", IMU_COLUMNS),
        ("fixes", ("t_s", "lat_deg", "lon_deg", "height_m")),
    )
    for kind, names in kinds:
        if set(names) <= set(header):
            return kind
    raise BadDataError(
        f"{path} line 1: neither a recording nor an est.csv, innovations, imu.csv or gnss.csv; `imud replay -o est.csv "
        "--innovations innovations.csv` writes the first two"
    )


def _lines(path: Path, most: int | None) -> tuple[list[str], list[list[str]], int]:
    """Header, the cells of at most about so many lines, and every which of them."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        header = file.readline().strip().split(",")
        count = sum(1 for _ in file)
        every = 1 if most is None else max(1, math.ceil(count / most))
        file.seek(0)
        return header, [line.rstrip("\n").split(",") for line in itertools.islice(file, 1, None, every)], every


def _number(path: Path, line: int, name: str, text: str) -> float:
    try:
        return float(text) if text else math.nan
    except ValueError:
        raise BadDataError(f"{path} line {line}: {name} is {text!r}, not a number") from None


def _columns(path: Path, most: int | None, texts: Sequence[str] = ()) -> dict[str, Any]:
    """Columns by name: lists of text for `texts`, arrays for the others. Raises BadDataError."""
    return _parsed(path, *_lines(path, most), texts)


def _parsed(path: Path, header: list[str], rows: list[list[str]], every: int, texts: Sequence[str]) -> dict[str, Any]:
    if not rows:
        raise BadDataError(f"{path}: a header and no rows")
    for number, row in enumerate(rows):
        if len(row) != len(header):
            raise BadDataError(f"{path} line {2 + number * every}: {len(row)} columns instead of {len(header)}")
    return {
        name: [row[i] for row in rows]
        if name in texts
        else np.array([_number(path, 2 + k * every, name, row[i]) for k, row in enumerate(rows)])
        for i, name in enumerate(header)
    }


def _read_innovations(path: Path, origin_s: float) -> list[Innovations]:
    table = _columns(path, None, ("kind",))
    kinds = np.array(table["kind"])
    found = []
    for kind in dict.fromkeys(table["kind"]):
        at = (kinds == kind) & (table["sigma"] > 0.0)
        t, value, sigma, used = (table[name][at] for name in ("t_s", "value", "sigma", "used"))
        found.append(Innovations(path.stem, kind, t - origin_s, value, sigma, used > 0.0))
    return found


def _recorded(recorded: Recorded, path: Path, origin_s: int) -> "Session":
    """As if it had been written to tables."""
    name, origin_ns = path.stem, origin_s * 1_000_000_000
    for rows in (recorded.estimates, recorded.innovations, recorded.samples, recorded.fixes):
        rows["t_ns"] -= origin_ns
    recorded.fixes["arrival_ns"] -= origin_ns
    table = io.BytesIO()
    EstimateWriter(table, 0).write(thinned(recorded.estimates, MOST_POINTS))
    header, *lines = (line.split(",") for line in table.getvalue().decode().splitlines())
    innovations = []
    for code, kind in INNOVATION_KINDS.items():
        rows = recorded.innovations[recorded.innovations["kind"] == code]
        rows = rows[rows["variance"] > 0.0]
        if len(rows):
            sigma = np.sqrt(rows["variance"])
            innovations.append(Innovations(name, kind, rows["t_ns"] * 1e-9, rows["value"], sigma, rows["used"] > 0))
    rate_hz = 1e9 / float(np.median(np.diff(recorded.samples["t_ns"]))) if len(recorded.samples) > 1 else 0.0
    return Session(
        (Estimates(name, _parsed(path, header, lines, 1, ())),),
        tuple(innovations),
        (Samples(name, recorded.samples, rate_hz),) if rate_hz else (),
        (Fixes(name, recorded.fixes),) if len(recorded.fixes) else (),
    )


def _first_s(path: Path) -> float:
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        header, first = file.readline().strip().split(","), file.readline().strip().split(",")
    at = header.index("t_s")
    return _number(path, 2, "t_s", first[at]) if at < len(first) else math.nan


def read(paths: Sequence[Path]) -> Session:
    """Raises InputMissingError, BadDataError (with line)."""
    kinds = [(path, _kind(path)) for path in paths]
    recordings = {path: Recorded(path) for path, kind in kinds if kind == "recording"}
    firsts = [recorded.first_s for recorded in recordings.values()]
    firsts += [first for path in paths if path not in recordings and math.isfinite(first := _first_s(path))]
    origin = math.floor(min(firsts, default=0.0))
    estimates: list[Estimates] = []
    innovations: list[Innovations] = []
    samples: list[Samples] = []
    fixes: list[Fixes] = []
    for path, kind in kinds:
        if kind == "recording":
            of = _recorded(recordings[path], path, origin)
            estimates += of.estimates
            innovations += of.innovations
            samples += of.samples
            fixes += of.fixes
        elif kind == "estimates":
            columns = _columns(path, MOST_POINTS)
            estimates.append(Estimates(path.stem, {**columns, "t_s": columns["t_s"] - origin}))
        elif kind == "innovations":
            innovations += _read_innovations(path, origin)
        elif kind == "samples":
            rows, own_origin, _ = read_imu(path)
            rows["t_ns"] += (own_origin - origin) * 1_000_000_000
            samples.append(Samples(path.stem, rows, 1e9 / float(np.median(np.diff(rows["t_ns"])))))
        else:
            fixes.append(Fixes(path.stem, read_fixes(path, origin)))
    return Session(tuple(estimates), tuple(innovations), tuple(samples), tuple(fixes))
