"""Tables of inertial samples and fixes, as `imud replay` and others take them: CSV to records, or what is wrong where.

Inside, time is int64 ns since an origin (a whole second at or before the first sample), so that 1 ns is exact.
"""

import contextlib
import csv
import math
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.sample import SAMPLE

from .errors import BadDataError, InputMissingError
from .estimators.records import FIX
from .progress import Progress

_LOOK = 8192  # lines
_LONGEST_HEADER = 1 << 16  # bytes
_MCAP = b"\x89MCAP0\r\n"
IMU_COLUMNS = ("t_s", "gx_radps", "gy_radps", "gz_radps", "ax_mps2", "ay_mps2", "az_mps2")
_FIX_REQUIRED = ("t_s", "lat_deg", "lon_deg", "height_m")
_FIX_OPTIONAL = (
    *("arrival_s", "sn_m", "se_m", "sd_m", "hdop", "vn_mps", "ve_mps", "vd_mps", "speed_mps", "course_deg"),
    *("quality", "satellites"),
)

Floats = NDArray[np.float64]


def header_of(path: Path) -> list[str]:
    """The names in the first line of a table. Raises InputMissingError, BadDataError if the file is empty."""
    text = first_bytes(path, _LONGEST_HEADER)
    if not text:
        raise BadDataError(f"{path}: the file is empty")
    line = text.split(b"\n")[0].decode("utf-8-sig", errors="replace")
    return [name.strip().lstrip("#").strip() for name in line.split(",")]


def _column_numbers(path: Path, wanted: Sequence[str], present: Sequence[str]) -> list[int]:
    if missing := [name for name in wanted if name not in present]:
        raise BadDataError(f"{path} line 1: no column {', '.join(missing)}; the header must name {', '.join(wanted)}")
    return [present.index(name) for name in wanted]


def _first_bad_line(path: Path, columns: Sequence[int], names: Sequence[str]) -> str:
    """Where the fast reader stumbled, in words; read slowly, once."""
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        for number, row in enumerate(csv.reader(file), 1):
            for column, name in zip(columns, names, strict=True):
                if number == 1 or not row:
                    continue
                if column >= len(row):
                    return f"line {number}: {len(row)} columns, {name} is missing"
                try:
                    if not math.isfinite(float(row[column])):
                        return f"line {number}: {name} is {row[column]}"
                except ValueError:
                    return f"line {number}: {name} is {row[column]!r}, not a number"
    return "not a table of numbers"


def first_bytes(path: Path, n: int) -> bytes:
    """At most so many, by which one sees what a file is. Raises InputMissingError."""
    try:
        with path.open("rb") as file:
            return file.read(n)
    except FileNotFoundError as error:
        raise InputMissingError(f"{path}: no such file") from error
    except OSError as error:
        raise InputMissingError(f"{path}: cannot be read: {error.strerror}") from error


def is_recording(path: Path) -> bool:
    """Whether it is a recording (MCAP) and no table. Raises InputMissingError."""
    return first_bytes(path, len(_MCAP)) == _MCAP


def read_samples(path: Path) -> tuple[NDArray[np.void], int, int]:
    """As `read_imu`, from a CSV file or a recording (MCAP): what it is, its first bytes say."""
    if is_recording(path):
        from .recording.samples import samples_of

        return samples_of(path)
    return read_imu(path)


def read_imu(path: Path) -> tuple[NDArray[np.void], int, int]:
    """Samples (array of SAMPLE), the origin in whole s, and how many rows were skipped because time stood or ran back.

    A column temperature_c may stand beside the required ones. Raises InputMissingError, BadDataError (with line and
    column).
    """
    header = header_of(path)
    names = (*IMU_COLUMNS, "temperature_c") if "temperature_c" in header else IMU_COLUMNS
    columns = _column_numbers(path, names, header)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty file: said below
            table = np.loadtxt(_lines(path), delimiter=",", skiprows=1, usecols=columns, ndmin=2, comments=None)
    except ValueError as error:
        raise BadDataError(f"{path} {_first_bad_line(path, columns, names)}") from error
    if len(table) < 2:
        raise BadDataError(f"{path}: {len(table)} samples; at least two are needed")
    if not np.isfinite(table).all():
        raise BadDataError(f"{path} {_first_bad_line(path, columns, names)}")
    t = table[:, 0]
    forward = np.concatenate([[True], t[1:] > np.maximum.accumulate(t)[:-1]])
    table = table[forward]
    origin = math.floor(table[0, 0])
    samples = np.zeros(len(table), SAMPLE)
    samples["t_ns"] = np.rint((table[:, 0] - origin) * 1e9).astype(np.int64)
    samples["tick"] = np.arange(len(table))
    samples["w"], samples["f"] = table[:, 1:4], table[:, 4:7]
    samples["temperature"] = table[:, 7] if len(names) > len(IMU_COLUMNS) else np.nan
    return samples, origin, int((~forward).sum())


def _lines(path: Path) -> Iterator[bytes]:
    """Of a file that may be large: with a bar."""
    progress = Progress(path.stat().st_size)
    with path.open("rb") as file, contextlib.ExitStack() as stack:
        stack.callback(progress.clear)
        for number, line in enumerate(file):
            if number % _LOOK == 0:
                progress.at(file.tell())
            yield line


def _fix_rows(path: Path) -> list[dict[str, float]]:
    header = header_of(path)
    _column_numbers(path, _FIX_REQUIRED, header)
    known = {name: i for i, name in enumerate(header) if name in (*_FIX_REQUIRED, *_FIX_OPTIONAL)}
    rows = []
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        for number, row in enumerate(csv.reader(file), 1):
            if number == 1 or not any(cell.strip() for cell in row):
                continue
            try:
                fix = {name: float(row[i]) if row[i].strip() else math.nan for name, i in known.items()}
            except (ValueError, IndexError) as error:
                raise BadDataError(f"{path} line {number}: {error}") from error
            for name, low, high in (("lat_deg", -90.0, 90.0), ("lon_deg", -360.0, 360.0)):
                if not low <= fix[name] <= high:
                    raise BadDataError(f"{path} line {number}: {name} is {fix[name]}, outside {low} to {high}")
            if not math.isfinite(fix["t_s"]):
                raise BadDataError(f"{path} line {number}: t_s is empty")
            rows.append(fix)
    return rows


def read_fixes(path: Path, origin: int) -> NDArray[np.void]:
    """Fixes (array of FIX) in order of arrival. Raises InputMissingError, BadDataError (with line)."""
    rows = _fix_rows(path)
    fixes = np.zeros(len(rows), FIX)
    for fix, row in zip(fixes, rows, strict=True):
        fix["t_ns"] = round((row["t_s"] - origin) * 1e9)
        arrival = row.get("arrival_s", math.nan)
        fix["arrival_ns"] = round((arrival - origin) * 1e9) if math.isfinite(arrival) else fix["t_ns"]
        fix["lat"], fix["lon"] = math.radians(row["lat_deg"]), math.radians(row["lon_deg"])
        fix["height"] = row["height_m"]
        fix["sigma"] = [row.get(name, math.nan) for name in ("sn_m", "se_m", "sd_m")]
        fix["v"] = [row.get(name, math.nan) for name in ("vn_mps", "ve_mps", "vd_mps")]
        fix["hdop"], fix["speed"] = row.get("hdop", math.nan), row.get("speed_mps", math.nan)
        fix["course"] = math.radians(row.get("course_deg", math.nan))
        quality, satellites = row.get("quality", math.nan), row.get("satellites", math.nan)
        fix["quality"] = 1 if math.isnan(quality) else int(quality)
        fix["satellites"] = -1 if math.isnan(satellites) else int(satellites)
    return fixes[np.argsort(fixes["arrival_ns"], kind="stable")]
