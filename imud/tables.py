"""The CSV files of `imud replay`: inertial samples and fixes in, estimates out. Text and units; no filter.

Inside, time is int64 ns since an origin (a whole second at or before the first sample), so that 1 ns is exact.
"""

import csv
import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from drivers.sample import SAMPLE

from .errors import BadDataError, InputMissingError
from .estimators.records import (
    FIX,
    HEADING,
    HOP,
    POSITION_D,
    POSITION_E,
    POSITION_N,
    POSITION_VALID,
    REST_D,
    REST_E,
    REST_N,
    REST_X,
    REST_Y,
    REST_Z,
    SLIP,
    VELOCITY_D,
    VELOCITY_E,
    VELOCITY_N,
)
from .kernels.decimal import MAX_WIDTH, write_fixed, write_seconds
from .kernels.jit import kernel
from .kernels.rotation import euler_of_quat

_MCAP = b"\x89MCAP0\r\n"
IMU_COLUMNS = ("t_s", "gx_radps", "gy_radps", "gz_radps", "ax_mps2", "ay_mps2", "az_mps2")
_FIX_REQUIRED = ("t_s", "lat_deg", "lon_deg", "height_m")
_FIX_OPTIONAL = (
    *("arrival_s", "sn_m", "se_m", "sd_m", "hdop", "vn_mps", "ve_mps", "vd_mps", "speed_mps", "course_deg"),
    *("quality", "satellites"),
)

Floats = NDArray[np.float64]


def _header(path: Path) -> list[str]:
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            line = file.readline()
    except FileNotFoundError as error:
        raise InputMissingError(f"{path}: no such file") from error
    except OSError as error:
        raise InputMissingError(f"{path}: cannot be read: {error.strerror}") from error
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


def is_recording(path: Path) -> bool:
    """Whether it is a recording (MCAP) and no table, by its first bytes. Raises InputMissingError."""
    try:
        with path.open("rb") as file:
            return file.read(len(_MCAP)) == _MCAP
    except FileNotFoundError as error:
        raise InputMissingError(f"{path}: no such file") from error
    except OSError as error:
        raise InputMissingError(f"{path}: cannot be read: {error.strerror}") from error


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
    header = _header(path)
    names = (*IMU_COLUMNS, "temperature_c") if "temperature_c" in header else IMU_COLUMNS
    columns = _column_numbers(path, names, header)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty file: said below
            table = np.loadtxt(path, delimiter=",", skiprows=1, usecols=columns, ndmin=2, comments=None)
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


def _fix_rows(path: Path) -> list[dict[str, float]]:
    header = _header(path)
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


# what stands in an estimate's row after t_s: name, decimals. Angles and rates in deg; 1e-10 deg is 11 um.
ESTIMATE_COLUMNS: tuple[tuple[str, int], ...] = (
    *(("lat_deg", 10), ("lon_deg", 10), ("height_m", 4)),
    *((f"v{axis}_mps", 5) for axis in "ned"),
    *((f"{angle}_deg", 5) for angle in ("roll", "pitch", "yaw")),
    *((f"s{axis}_m", 4) for axis in "ned"),
    *((f"sv{axis}_mps", 5) for axis in "ned"),
    *((f"s{angle}_deg", 5) for angle in ("roll", "pitch", "yaw")),
    *((f"q{i}", 9) for i in range(4)),
    *((f"bg{axis}_radps", 9) for axis in "xyz"),
    *((f"ba{axis}_mps2", 7) for axis in "xyz"),
    *((f"sbg{axis}_radps", 9) for axis in "xyz"),
    *((f"sba{axis}_mps2", 7) for axis in "xyz"),
    ("status", 0),
)
_DECIMALS = np.array([decimals for _, decimals in ESTIMATE_COLUMNS])
ESTIMATE_HEADER = ",".join(["t_s", *(name for name, _ in ESTIMATE_COLUMNS)])
_COMMA, _NEWLINE = ord(","), ord("\n")
_DEG = 180.0 / math.pi


@kernel
def _put(cells: Floats, at: int, values: Any, factor: float) -> int:
    for i in range(len(values)):
        cells[at + i] = values[i] * factor
    return at + len(values)


@kernel
def _fill(cells: Floats, row: Any) -> None:
    positioned = (row.status & POSITION_VALID) != 0
    cells[0] = row.lat * _DEG if positioned else math.nan
    cells[1] = row.lon * _DEG if positioned else math.nan
    cells[2] = row.height if positioned else math.nan
    blank = 1.0 if positioned else math.nan
    at = _put(cells, 3, row.v, blank)
    q = row.q_nb
    at = _put(cells, at, euler_of_quat((q[0], q[1], q[2], q[3])), _DEG)
    at = _put(cells, at, row.sigma_p, blank)
    at = _put(cells, at, row.sigma_v, blank)
    at = _put(cells, at, row.sigma_rpy, _DEG)
    at = _put(cells, at, q, 1.0)
    at = _put(cells, at, row.bg, 1.0)
    at = _put(cells, at, row.ba, 1.0)
    at = _put(cells, at, row.sigma_bg, 1.0)
    at = _put(cells, at, row.sigma_ba, 1.0)
    cells[at] = row.status


@kernel
def _format(solutions: Any, origin: int, decimals: NDArray[np.int64], buffer: NDArray[np.uint8]) -> int:
    cells = np.empty(len(decimals))
    at = 0
    for k in range(len(solutions)):
        at = write_seconds(buffer, at, origin * 1_000_000_000 + solutions[k].t_ns)
        _fill(cells, solutions[k])
        for i in range(len(decimals)):
            buffer[at] = _COMMA
            at = write_fixed(buffer, at + 1, cells[i], decimals[i])
        buffer[at] = _NEWLINE
        at += 1
    return at


@kernel
def _fill_all(solutions: Any, cells: Floats) -> None:
    for k in range(len(solutions)):
        _fill(cells[k], solutions[k])


def estimate_cells(solutions: NDArray[np.void]) -> dict[str, Floats]:
    """Columns of est.csv behind t_s, by name, of solutions (array of SOLUTION); unknown is NaN."""
    cells = np.empty((len(solutions), len(ESTIMATE_COLUMNS)))
    _fill_all(solutions, cells)
    return {name: cells[:, i] for i, (name, _) in enumerate(ESTIMATE_COLUMNS)}


INNOVATION_COLUMNS = ("t_s", "kind", "value", "sigma", "used")
INNOVATION_KINDS = {
    POSITION_N: "pn_m", POSITION_E: "pe_m", POSITION_D: "pd_m",
    VELOCITY_N: "vn_mps", VELOCITY_E: "ve_mps", VELOCITY_D: "vd_mps", HEADING: "yaw_rad",
    REST_N: "rest_vn_mps", REST_E: "rest_ve_mps", REST_D: "rest_vd_mps",
    REST_X: "rest_wx_radps", REST_Y: "rest_wy_radps", REST_Z: "rest_wz_radps",
    SLIP: "slip_mps", HOP: "hop_mps",
}  # fmt: skip


def write_innovations(path: Path, origin: int, innovations: NDArray[np.void]) -> None:
    """An array of INNOVATION as a table: sigma is the predicted one, in the unit of the kind's name. Raises OSError."""
    with path.open("w", encoding="ascii", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(INNOVATION_COLUMNS)
        for i in innovations:
            t_s, ns = divmod(int(i["t_ns"]), 1_000_000_000)
            sigma = math.sqrt(i["variance"])
            rows.writerow(
                (
                    f"{origin + t_s}.{ns:09d}",
                    INNOVATION_KINDS[int(i["kind"])],
                    f"{i['value']:.9g}",
                    f"{sigma:.9g}",
                    i["used"],
                )
            )


class EstimateWriter:
    """Writes solutions as `est.csv` to a binary file; one per file."""

    def __init__(self, file: BinaryIO, origin: int, rows: int = 4096) -> None:
        self._file, self._origin = file, origin
        self._buffer = np.empty(rows * (len(_DECIMALS) + 2) * MAX_WIDTH, np.uint8)
        self._rows = rows
        file.write(f"{ESTIMATE_HEADER}\n".encode())

    def write(self, solutions: NDArray[np.void]) -> None:
        """Append one row for each solution (array of SOLUTION)."""
        for start in range(0, len(solutions), self._rows):
            n = _format(solutions[start : start + self._rows], self._origin, _DECIMALS, self._buffer)
            self._file.write(self._buffer[:n].tobytes())
