"""The CSV files of a report, each recognised by its header, read block by block."""

import io
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imud.drivers.sample import SAMPLE
from imud.errors import BadDataError
from imud.tables.estimates import ESTIMATE_HEADER, INNOVATION_COLUMNS
from imud.tables.filter_states import STATES_HEADER
from imud.tables.inputs import IMU_COLUMNS, TEMPERATURE, header_of, read_fixes

from ...math.arrays import Floats
from .reduction import EstimateReduction, SensorReduction
from .session import Fixes, Innovations, Part, Session, States

_BLOCK_BYTES = 4 << 20
_LATEST_S = 9e9  # some 285 years after 1970; in ns it fits 64 bits
Progress = Callable[[int], None]


def read_table(path: Path, name: str, progress: Progress) -> Part:
    """The file's data, labelled `name`. progress: called with bytes read. Raises InputMissingError, BadDataError."""
    present = set(header_of(path))
    for names, reader in _READERS:
        if set(names) <= present:
            return reader(path, name, progress)
    raise BadDataError(
        f"{path} line 1: neither a recording nor an est.csv, innovations, states, imu.csv or gnss.csv; `imud replay "
        "-o est.csv --innovations innovations.csv --states states.csv` writes the first three"
    )


def _blocks(path: Path, names: Sequence[str], progress: Progress) -> Iterator[dict[str, Floats]]:
    """The columns `names`, a few thousand rows at a time; an empty cell is NaN. Raises BadDataError."""
    header = header_of(path)
    columns, line = [header.index(name) for name in names], 2
    with path.open("rb") as file:
        progress(len(file.readline()))
        while lines := file.readlines(_BLOCK_BYTES):
            text = b"".join(lines).replace(b"\r\n", b"\n").rstrip(b"\n") + b"\n"
            text = text.replace(b",,", b",nan,").replace(b",,", b",nan,").replace(b",\n", b",nan\n")
            try:
                block = np.loadtxt(io.BytesIO(text), delimiter=",", ndmin=2, comments=None, usecols=columns)
            except ValueError:
                rows = [row.decode(errors="replace").rstrip("\n").split(",") for row in lines]
                _parsed(path, header, rows, line, ())  # says where
                raise BadDataError(f"{path} lines {line} to {line + len(lines) - 1}: not a table of numbers") from None
            _check_times(path, block[:, names.index("t_s")], line)
            progress(sum(map(len, lines)))
            line += len(lines)
            yield {name: block[:, i] for i, name in enumerate(names)}
    if line == 2:
        raise BadDataError(f"{path}: a header and no rows")


def _check_times(path: Path, t_s: Floats, line: int) -> None:
    """Raises BadDataError for the first that is no time in seconds; line: number of the first row."""
    (wrong,) = np.nonzero(~(np.abs(t_s) < _LATEST_S))
    if len(wrong):
        raise BadDataError(f"{path} line {line + wrong[0]}: t_s is {t_s[wrong[0]]:g}, no time in seconds")


def _number(path: Path, line: int, name: str, text: str) -> float:
    try:
        return float(text) if text else math.nan
    except ValueError:
        raise BadDataError(f"{path} line {line}: {name} is {text!r}, not a number") from None


def _parsed(path: Path, header: list[str], rows: list[list[str]], line: int, texts: Sequence[str]) -> dict[str, Any]:
    """Columns by name: lists of text for `texts`, arrays for the others; slowly. line: number of the first row."""
    if not rows:
        raise BadDataError(f"{path}: a header and no rows")
    for number, row in enumerate(rows, line):
        if len(row) != len(header):
            raise BadDataError(f"{path} line {number}: {len(row)} columns instead of {len(header)}")
    return {
        name: [row[i] for row in rows]
        if name in texts
        else np.array([_number(path, k, name, row[i]) for k, row in enumerate(rows, line)])
        for i, name in enumerate(header)
    }


def _estimates(path: Path, name: str, progress: Progress) -> Part:
    watch, origin, first, last = EstimateReduction(name), 0, math.nan, math.nan
    for block in _blocks(path, ESTIMATE_HEADER.split(","), progress):
        if math.isnan(first):
            first = float(block["t_s"][0])
            origin = math.floor(first)
        last = float(block["t_s"][-1])
        watch.add(block | {"t_s": block["t_s"] - origin})
    return Part(origin, first, last, Session(estimates=(watch.close(),)))


def _samples(path: Path, name: str, progress: Progress) -> Part:
    watch, origin, first, last = SensorReduction(name), 0, math.nan, -math.inf
    names = (*IMU_COLUMNS, *({TEMPERATURE} & set(header_of(path))))
    for block in _blocks(path, names, progress):
        t = block["t_s"]
        if math.isnan(first):
            first = float(t[0])
            origin = math.floor(first)
        forward = t > np.maximum.accumulate(np.concatenate([[last], t[:-1]]))
        rows = np.zeros(np.count_nonzero(forward), SAMPLE)
        rows["t_ns"] = np.rint((t[forward] - origin) * 1e9).astype(np.int64)
        rows["w"] = np.stack([block[name][forward] for name in IMU_COLUMNS[1:4]], axis=1)
        rows["f"] = np.stack([block[name][forward] for name in IMU_COLUMNS[4:7]], axis=1)
        rows["temperature"] = block[TEMPERATURE][forward] if TEMPERATURE in block else math.nan
        if len(rows):
            last = float(t[forward][-1])
            watch.add(rows)
    sensor = watch.close()
    if sensor is None:
        raise BadDataError(f"{path}: fewer than two samples")
    return Part(origin, first, last, Session(sensors=(sensor,)))


def _innovations(path: Path, name: str, progress: Progress) -> Part:
    header = header_of(path)
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        rows = [line.rstrip("\n").split(",") for line in itertools.islice(file, 1, None)]
    table = _parsed(path, header, rows, 2, ("kind",))
    progress(path.stat().st_size)
    kinds, t_s = np.array(table["kind"]), table["t_s"]
    _check_times(path, t_s, 2)
    first, last = float(t_s.min()), float(t_s.max())
    origin = math.floor(first)
    found = []
    for kind in dict.fromkeys(table["kind"]):
        at = (kinds == kind) & (table["sigma"] > 0.0)
        t, value, sigma, used = (table[column][at] for column in ("t_s", "value", "sigma", "used"))
        found.append(Innovations(name, kind, t - origin, value, sigma, used > 0.0))
    return Part(origin, first, last, Session(innovations=tuple(found)))


def _states(path: Path, name: str, progress: Progress) -> Part:
    blocks = list(_blocks(path, header_of(path), progress))
    columns = {column: np.concatenate([block[column] for block in blocks]) for column in blocks[0]}
    first, last = float(columns["t_s"].min()), float(columns["t_s"].max())
    origin = math.floor(first)
    return Part(origin, first, last, Session(states=(States(name, columns | {"t_s": columns["t_s"] - origin}),)))


def _fixes(path: Path, name: str, progress: Progress) -> Part:
    rows = read_fixes(path, 0)
    progress(path.stat().st_size)
    if not len(rows):
        raise BadDataError(f"{path}: a header and no rows")
    t_s = rows["t_ns"] * 1e-9
    return Part(0, float(t_s.min()), float(t_s.max()), Session(fixes=(Fixes(name, rows),)))


_READERS: tuple[tuple[Sequence[str], Callable[[Path, str, Progress], Part]], ...] = (
    (ESTIMATE_HEADER.split(","), _estimates),
    (INNOVATION_COLUMNS, _innovations),
    (STATES_HEADER, _states),
    (IMU_COLUMNS, _samples),
    (("t_s", "lat_deg", "lon_deg", "height_m"), _fixes),
)
