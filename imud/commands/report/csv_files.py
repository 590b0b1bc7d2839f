"""The CSV files of a report, each recognised by its header, read block by block."""

import io
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imud.drivers.sample import SAMPLE

from ...errors import BadDataError
from ...math.arrays import Floats
from ...tables.estimates import ESTIMATE_HEADER, INNOVATION_COLUMNS
from ...tables.filter_states import STATES_HEADER
from ...tables.inputs import IMU_COLUMNS, TEMPERATURE, read_fixes
from ...tables.lines import Table, table_of
from .reduction import EstimateReduction, SensorReduction
from .session import Fixes, Innovations, Part, Session, States

_BATCH = 32_768  # rows
_LATEST_S = 9e9  # some 285 years after 1970; in ns it fits 64 bits
Progress = Callable[[int], None]


def read_table(path: Path, name: str, progress: Progress) -> Part:
    """The file's data, labelled `name`. progress: called with bytes read. Raises InputMissingError, BadDataError."""
    for names, reader in _READERS:
        table = table_of(path, names)
        if set(names) <= set(table.names):
            return reader(table, name, progress)
    raise BadDataError(
        f"{path} line 1: neither a recording nor an est.csv, innovations, states, imu.csv or gnss.csv; `imud replay "
        "-o est.csv --innovations innovations.csv --states states.csv` writes the first three"
    )


def _blocks(table: Table, names: Sequence[str], progress: Progress) -> Iterator[dict[str, Floats]]:
    """The columns `names`, a few thousand rows at a time; an empty cell is NaN. Raises BadDataError."""
    columns, line = table.column_numbers(names), table.first_row
    for lines in _batches(table, progress):
        text = b"".join(lines).replace(b"\r\n", b"\n").rstrip(b"\n") + b"\n"
        text = text.replace(b",,", b",nan,").replace(b",,", b",nan,").replace(b",\n", b",nan\n")
        try:
            block = np.loadtxt(io.BytesIO(text), delimiter=",", ndmin=2, comments=None, usecols=columns)
        except ValueError:
            _parsed(table, _cells(lines), line, ())  # says where
            where = f"{table.path} lines {line} to {line + len(lines) - 1}"
            raise BadDataError(f"{where}: not a table of numbers") from None
        _check_times(table.path, block[:, names.index("t_s")], line)
        line += len(lines)
        yield {name: block[:, i] for i, name in enumerate(names)}
    if line == table.first_row:
        raise BadDataError(f"{table.path}: a header and no rows")


def _batches(table: Table, progress: Progress) -> Iterator[list[bytes]]:
    """The rows as plain CSV, some thousands at a time. A last one that was cut off is left out."""
    done = 0

    def advance(read: int) -> None:
        nonlocal done
        progress(read - done)
        done = read

    rows = table.rows(advance)
    while batch := list(itertools.islice(rows, _BATCH)):
        if not batch[-1].endswith((b"\n", b"\r")):
            batch[-1] = batch[-1].rstrip(b"\0")
            if batch[-1].count(b",") < len(table.names) - 1:
                del batch[-1]
        if batch:
            yield batch
    advance(table.path.stat().st_size)


def _cells(lines: Sequence[bytes]) -> list[list[str]]:
    return [line.decode(errors="replace").rstrip("\r\n").split(",") for line in lines]


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


def _parsed(table: Table, rows: list[list[str]], line: int, texts: Sequence[str]) -> dict[str, Any]:
    """Columns by name: lists of text for `texts`, arrays for the others; slowly. line: number of the first row."""
    path, header = table.path, table.names
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


def _estimates(table: Table, name: str, progress: Progress) -> Part:
    watch, origin, first, last = EstimateReduction(name), 0, math.nan, math.nan
    for block in _blocks(table, ESTIMATE_HEADER.split(","), progress):
        if math.isnan(first):
            first = float(block["t_s"][0])
            origin = math.floor(first)
        last = float(block["t_s"][-1])
        watch.add(block | {"t_s": block["t_s"] - origin})
    return Part(origin, first, last, Session(estimates=(watch.close(),)))


def _samples(table: Table, name: str, progress: Progress) -> Part:
    watch, origin, first, last = SensorReduction(name), 0, math.nan, -math.inf
    names = (*IMU_COLUMNS, *({TEMPERATURE} & set(table.names)))
    for block in _blocks(table, names, progress):
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
        raise BadDataError(f"{table.path}: fewer than two samples")
    return Part(origin, first, last, Session(sensors=(sensor,)))


def _innovations(table: Table, name: str, progress: Progress) -> Part:
    rows = [row for batch in _batches(table, progress) for row in _cells(batch)]
    columns = _parsed(table, rows, table.first_row, ("kind",))
    kinds, t_s = np.array(columns["kind"]), columns["t_s"]
    _check_times(table.path, t_s, table.first_row)
    first, last = float(t_s.min()), float(t_s.max())
    origin = math.floor(first)
    found = []
    for kind in dict.fromkeys(columns["kind"]):
        at = (kinds == kind) & (columns["sigma"] > 0.0)
        t, value, sigma, used = (columns[column][at] for column in ("t_s", "value", "sigma", "used"))
        found.append(Innovations(name, kind, t - origin, value, sigma, used > 0.0))
    return Part(origin, first, last, Session(innovations=tuple(found)))


def _states(table: Table, name: str, progress: Progress) -> Part:
    blocks = list(_blocks(table, table.names, progress))
    columns = {column: np.concatenate([block[column] for block in blocks]) for column in blocks[0]}
    first, last = float(columns["t_s"].min()), float(columns["t_s"].max())
    origin = math.floor(first)
    return Part(origin, first, last, Session(states=(States(name, columns | {"t_s": columns["t_s"] - origin}),)))


def _fixes(table: Table, name: str, progress: Progress) -> Part:
    rows = read_fixes(table.path, 0)
    progress(table.path.stat().st_size)
    if not len(rows):
        raise BadDataError(f"{table.path}: a header and no rows")
    t_s = rows["t_ns"] * 1e-9
    return Part(0, float(t_s.min()), float(t_s.max()), Session(fixes=(Fixes(name, rows),)))


_READERS: tuple[tuple[Sequence[str], Callable[[Table, str, Progress], Part]], ...] = (
    (ESTIMATE_HEADER.split(","), _estimates),
    (INNOVATION_COLUMNS, _innovations),
    (STATES_HEADER, _states),
    (IMU_COLUMNS, _samples),
    (("t_s", "lat_deg", "lon_deg", "height_m"), _fixes),
)
