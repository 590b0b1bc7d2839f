"""Tables of inertial samples and fixes, as `imud replay` takes them: CSV to records, or what is wrong and where.

Inside, time is int64 ns since an origin (a whole second at or before the first sample), so that 1 ns is exact.
"""

import bisect
import math
import warnings
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from imud.drivers.sample import SAMPLE

from ..errors import BadDataError
from ..estimators.aiding_source import AidingSource
from ..estimators.records import FIX, MEASUREMENT
from ..math.arrays import Floats, Records
from ..sensors.gnss import HEIGHT_MAX_M, SPEED_MAX_MPS, forget_implausible
from .lines import Table, first_bytes, table_of

_SHOWN = 40  # characters of what is no number
_LARGEST = 1e20  # of any number; a time in ns since 1970 is 2e18, and what it means is said of it
_LONGEST_S = 9e9  # from the origin: in ns it fits 64 bits
_EARLY_S = 1.0  # before its epoch no fix arrives, but clocks differ
_FARTHEST_S = 2.0  # between samples
_LIMITS = {
    **{"lat_deg": (-90.0, 90.0), "lon_deg": (-360.0, 360.0), "height_m": (-HEIGHT_MAX_M, HEIGHT_MAX_M)},
    **{"quality": (-1.0, 99.0), "satellites": (-1.0, 999.0)},
    **dict.fromkeys(("vn_mps", "ve_mps", "vd_mps", "speed_mps"), (-SPEED_MAX_MPS, SPEED_MAX_MPS)),
}
_MCAP = b"\x89MCAP0\r\n"
IMU_COLUMNS = ("t_s", "gx_radps", "gy_radps", "gz_radps", "ax_mps2", "ay_mps2", "az_mps2")
TEMPERATURE = "temperature_c"  # may stand beside them; an empty cell is not known
DEVICE_TILT = ("device_roll_deg", "device_pitch_deg")  # so may these: what the device itself computes
_OPTIONAL = (TEMPERATURE, *DEVICE_TILT)
_FIX_REQUIRED = ("t_s", "lat_deg", "lon_deg", "height_m")
_FIX_OPTIONAL = (
    *("arrival_s", "sn_m", "se_m", "sd_m", "hdop", "vn_mps", "ve_mps", "vd_mps", "speed_mps", "course_deg"),
    *("svn_mps", "sve_mps", "svd_mps", "quality", "satellites"),
)

FIX_COLUMNS = (*_FIX_REQUIRED, *_FIX_OPTIONAL)

Row = TypeVar("Row")


@dataclass
class SkippedRows:
    """Gathers the rows of a table that cannot be used, so that the others can."""

    path: Path
    count: int = 0
    first: str = ""

    def add(self, why: str) -> None:
        """Count one more."""
        self.count += 1
        self.first = self.first or why

    def judge(self, used: int) -> None:
        """Raises BadDataError if there were any; used: rows that were not."""
        if self.count:
            raise BadDataError(f"{self}; {'the others were used' if used else 'there is no other'}")

    def __str__(self) -> str:
        rows = f"{self.count} rows left out, the first of them is" if self.count > 1 else "a row left out,"
        return f"{self.path}: {rows} {self.first}"


def _rows(table: Table, read: Callable[[int, list[str]], Row], left_out: SkippedRows | None) -> Iterator[Row]:
    """What `read` makes of line number and cells, row by row. A row that it refuses (ValueError) is left out, or raises
    BadDataError.

    The last line may be cut off: then it is no row.
    """
    for number, line in enumerate(table.lines(), table.first_row):
        cells = line.rstrip(b"\0").decode("utf-8", "replace").split(",")
        if not any(cell.strip() for cell in cells):
            continue
        try:
            yield read(number, cells)
        except ValueError as error:
            if not line.endswith((b"\n", b"\r")):
                return
            if left_out is None:
                raise BadDataError(f"{table.path} {error}") from error
            left_out.add(str(error))


def _number(line: int, cells: Sequence[str], column: int, name: str) -> float:
    """Raises ValueError that says where."""
    if column >= len(cells):
        raise ValueError(f"line {line}: {len(cells)} columns, {name} is missing")
    text = cells[column].strip()
    shown = text if len(text) < _SHOWN else f"{text[:_SHOWN]}…"
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"line {line}: {name} is {shown!r}, not a number") from None
    if not abs(value) < _LARGEST:
        raise ValueError(f"line {line}: {name} is {shown}")
    return value


def is_recording(path: Path) -> bool:
    """Whether it is a recording (MCAP) and no table. Raises InputMissingError."""
    return first_bytes(path, len(_MCAP)) == _MCAP


def read_imu(path: Path, left_out: SkippedRows | None = None) -> tuple[Records, int, int]:
    """Samples (array of SAMPLE), the origin in whole s, and how many rows were skipped because time stood or ran back.

    left_out: gathers the rows that cannot be read; without it the first of them is an error. Raises InputMissingError,
    BadDataError (with line and column).
    """
    source = table_of(path, IMU_COLUMNS)
    tilt = DEVICE_TILT if set(DEVICE_TILT) <= set(source.names) else ()
    names = (*IMU_COLUMNS, *((TEMPERATURE,) if TEMPERATURE in source.names else ()), *tilt)
    table = _numbers(source, source.column_numbers(names), names, left_out)
    if len(table) < 2:
        why = f"{left_out}; " if left_out and left_out.count else f"{path}: "
        raise BadDataError(f"{why}{len(table)} samples; at least two are needed")
    every = len(table)
    table = table[_in_order(table[:, 0])]
    if len(table) > every / 2 and (apart_s := float(np.median(np.diff(table[:, 0])))) > _FARTHEST_S:
        raise BadDataError(f"{path}: the samples are {apart_s:g} s apart, if t_s is in s: is it in ms, us or ns?")
    origin = math.floor(table[0, 0])
    t_ns = ns_since(table[:, 0], origin)
    advances = np.diff(t_ns, prepend=t_ns[0] - 1) > 0  # two times may be the same nanosecond
    if not advances.all():
        table, t_ns = table[advances], t_ns[advances]
    if len(table) < max(2, every / 2):
        few = f"of {every} samples only {len(table)} have a later t_s than those before"
        raise BadDataError(f"{path}: {few}: has it too few digits, or are they not sorted by it?")
    samples = np.zeros(len(table), SAMPLE)
    samples["t_ns"] = t_ns
    samples["tick"] = np.arange(len(table))
    samples["w"], samples["f"] = table[:, 1:4], table[:, 4:7]
    samples["temperature"] = table[:, 7] if TEMPERATURE in names else np.nan
    if tilt:
        samples["down"] = _down(*np.radians(table[:, -2:].T))
    return samples, origin, every - len(table)


def _down(roll: Floats, pitch: Floats) -> Floats:
    """The vertical in the body, (n, 3), from angles in rad; zeros where they are not known."""
    level = np.cos(pitch)
    down = np.column_stack([-np.sin(pitch), np.sin(roll) * level, np.cos(roll) * level])
    down[~np.isfinite(down).all(axis=1)] = 0.0
    return down


def ns_since(t_s: float | Floats, origin: float) -> NDArray[np.int64]:
    """Times since the origin."""
    since_s = np.clip(np.subtract(t_s, origin), -_LONGEST_S, _LONGEST_S)
    return np.rint(since_s * 1e9).astype(np.int64)


def _in_order(t: Floats) -> NDArray[np.int64]:
    """Which rows to keep so that each is later than the one before: as many as can be, whichever times are wrong.

    The longest increasing subsequence, after Fredman (1975).
    """
    if (np.diff(t) > 0.0).all():
        return np.arange(len(t))
    begins: list[float] = []  # latest time, negative, with which a subsequence one longer can begin
    rows: list[int] = []  # where that time is
    after = np.empty(len(t), np.int64)
    for row in range(len(t) - 1, -1, -1):
        time = -float(t[row])
        length = bisect.bisect_left(begins, time)
        after[row] = rows[length - 1] if length else -1
        if length == len(begins):
            begins.append(time)
            rows.append(row)
        elif time < begins[length]:
            begins[length], rows[length] = time, row
    kept = rows[-1:]
    while after[kept[-1]] >= 0:
        kept.append(int(after[kept[-1]]))
    return np.array(kept)


def _numbers(source: Table, columns: Sequence[int], names: Sequence[str], left_out: SkippedRows | None) -> Floats:
    """The rows of a table as numbers: all at once, or row by row if any of them cannot be read."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty file: said by the caller
            table = np.loadtxt(source.lines(), delimiter=",", usecols=columns, ndmin=2, comments=None)
        if (np.abs(table) < _LARGEST).all():
            return table
    except ValueError:
        pass

    def read(number: int, cells: list[str]) -> list[float]:
        wanted = zip(columns, names, strict=True)
        return [(_number_or_none if name in _OPTIONAL else _number)(number, cells, at, name) for at, name in wanted]

    return np.array(list(_rows(source, read, left_out))).reshape(-1, len(columns))


def _fix_rows(path: Path, left_out: SkippedRows | None) -> Iterator[dict[str, float]]:
    """The rows with a position; a receiver without a fix leaves rows without one, which are skipped."""
    source = table_of(path, _FIX_REQUIRED)
    source.column_numbers(_FIX_REQUIRED)
    known = {name: i for i, name in enumerate(source.names) if name in FIX_COLUMNS}

    def read(number: int, cells: list[str]) -> dict[str, float]:
        row = {name: _number_or_none(number, cells, i, name) for name, i in known.items()}
        return checked_fix(f"line {number}", row)

    rows = _rows(source, read, left_out)
    return (row for row in rows if math.isfinite(row["lat_deg"]) and row.get("quality") != 0.0)


def _number_or_none(
    line: int, cells: Sequence[str], column: int, name: str, below_zero_unknown: Collection[str] = ()
) -> float:
    """NaN for what is not known: an empty cell, nan, below zero in those columns. Raises ValueError that says where."""
    if column < len(cells) and cells[column].strip().lower() in ("", "nan"):
        return math.nan
    value = _number(line, cells, column, name)
    return math.nan if value < 0.0 and name in below_zero_unknown else value


def checked_fix(where: str, fix: dict[str, float]) -> dict[str, float]:
    """The fix, by names of `FIX_COLUMNS`, if its numbers are possible. Raises ValueError that says where."""
    if math.isnan(fix["lat_deg"]) and math.isnan(fix["lon_deg"]):
        return fix
    for name, (low, high) in _LIMITS.items():
        if not low <= fix.get(name, low) <= high and (name in ("lat_deg", "lon_deg") or not math.isnan(fix[name])):
            exchanged = name == "lat_deg" and low <= fix["lon_deg"] <= high
            question = ": are lat_deg and lon_deg exchanged?" if exchanged else ""
            raise ValueError(f"{where}: {name} is {fix[name]}, outside {low} to {high}{question}")
    if math.isnan(fix["t_s"]):
        raise ValueError(f"{where}: t_s is empty")
    for name, other in (("vn_mps", "ve_mps"), ("ve_mps", "vn_mps")):
        if math.isnan(fix.get(name, math.nan)) and not math.isnan(fix.get(other, math.nan)):
            raise ValueError(f"{where}: {other} without {name}")
    if fix.get("arrival_s", math.nan) < fix["t_s"] - _EARLY_S:
        raise ValueError(f"{where}: arrival_s is {fix['arrival_s']:.3f}, before t_s, which is {fix['t_s']:.3f}")
    return fix


def read_fixes(path: Path, origin: float, left_out: SkippedRows | None = None) -> Records:
    """Fixes (array of FIX) in order of arrival; left_out as in `read_imu`.

    Raises InputMissingError, BadDataError (with line).
    """
    return fixes_of(list(_fix_rows(path, left_out)), origin)


def fixes_of(rows: Sequence[dict[str, float]], origin: float) -> Records:
    """Fixes (array of FIX) in order of arrival, from values by column; a column may be absent, or NaN for unknown."""
    fixes = np.zeros(len(rows), FIX)
    for fix, row in zip(fixes, rows, strict=True):
        arrival = row.get("arrival_s", math.nan)
        fix["t_ns"] = ns_since(row["t_s"], origin)
        fix["arrival_ns"] = ns_since(arrival, origin) if math.isfinite(arrival) else fix["t_ns"]
        fix["lat"], fix["lon"] = math.radians(row["lat_deg"]), math.radians(row["lon_deg"])
        fix["height"] = row["height_m"]
        fix["sigma"] = [row.get(name, math.nan) for name in ("sn_m", "se_m", "sd_m")]
        fix["v"] = [row.get(name, math.nan) for name in ("vn_mps", "ve_mps", "vd_mps")]
        fix["sigma_v"] = [_above_zero(row, name) for name in ("svn_mps", "sve_mps", "svd_mps")]
        fix["hdop"], speed = row.get("hdop", math.nan), row.get("speed_mps", math.nan)
        fix["speed"] = math.nan if speed < 0.0 else speed
        fix["course"] = math.radians(row.get("course_deg", math.nan))
        quality, satellites = row.get("quality", math.nan), row.get("satellites", math.nan)
        fix["quality"] = int(quality) if quality >= 0.0 else 1  # NaN, below zero: not known
        fix["satellites"] = -1 if math.isnan(satellites) else int(satellites)
    forget_implausible(fixes)
    return fixes[np.argsort(fixes["arrival_ns"], kind="stable")]


def _above_zero(row: dict[str, float], name: str) -> float:
    """A sigma; programs write 0 or -1 for what they do not know: NaN."""
    value = row.get(name, math.nan)
    return value if value > 0.0 else math.nan


def read_aiding(source: AidingSource, path: Path, origin: int, left_out: SkippedRows | None = None) -> Records:
    """Measurements (array of MEASUREMENT) of a source in order of arrival; left_out as in `read_imu`.

    Columns: t_s, those of the source, and optionally its sigmas and arrival_s. Raises InputMissingError, BadDataError
    (with line).
    """
    table = table_of(path, ("t_s",))
    table.column_numbers(("t_s", *source.missing(table.names)))
    known = {name: i for i, name in enumerate(table.names) if name in ("t_s", *source.names, "arrival_s")}

    def read(number: int, cells: list[str]) -> dict[str, float]:
        row = {name: _number_or_none(number, cells, i, name, source.sigmas) for name, i in known.items()}
        if math.isnan(row["t_s"]):
            raise ValueError(f"line {number}: t_s is empty")
        try:
            source.fill(np.zeros(1, MEASUREMENT), row)
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from None
        return row

    return measurements_of(source, list(_rows(table, read, left_out)), origin)


def measurements_of(source: AidingSource, rows: Sequence[dict[str, float]], origin: int) -> Records:
    """Measurements (array of MEASUREMENT) of a source in order of arrival, from values by column.

    Raises ValueError for what is impossible.
    """
    measurements = np.zeros(len(rows), MEASUREMENT)
    for m, row in zip(measurements, rows, strict=True):
        arrival = row.get("arrival_s", math.nan)
        m["t_ns"] = ns_since(row["t_s"], origin)
        m["arrival_ns"] = ns_since(arrival, origin) if math.isfinite(arrival) else m["t_ns"]
        source.fill(m, row)
    return measurements[np.argsort(measurements["arrival_ns"], kind="stable")]
