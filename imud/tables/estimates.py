"""The tables that `imud replay` writes: estimates, a row for each solution, and innovations."""

import math
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..compile.entry import entry
from ..compile.jit import kernel
from ..estimators.innovation_kinds import KINDS
from ..estimators.records import POSITION_VALID
from ..math.arrays import Floats, Records
from ..math.decimal import MAX_WIDTH, write_fixed, write_seconds
from ..math.rotation import euler_of_quat

# what stands in an estimate's row after t_s: name, decimals. Angles in deg; 1e-10 deg is 11 um.
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
_CELLS = len(ESTIMATE_COLUMNS)
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


@entry
def _format(solutions: Any, origin: int, decimals: NDArray[np.int64], buffer: NDArray[np.uint8]) -> int:
    cells = np.empty(_CELLS)
    before = np.empty(_CELLS)  # the row before, and where the text of each of its cells is, with the comma before it
    begin = np.empty(_CELLS, np.int64)
    end = np.empty(_CELLS, np.int64)
    for i in range(_CELLS):
        before[i] = math.nan
    at = 0
    for k in range(len(solutions)):
        at = write_seconds(buffer, at, origin * 1_000_000_000 + solutions[k].t_ns)
        _fill(cells, solutions[k])
        i = 0
        while i < _CELLS:
            first = i
            while i < _CELLS and cells[i] == before[i]:  # as sigmas and biases mostly
                i += 1
            if i > first:
                start, shift = begin[first], at - begin[first]
                for j in range(end[i - 1] - start):
                    buffer[at + j] = buffer[start + j]
                for j in range(first, i):
                    begin[j] += shift
                    end[j] += shift
                at = end[i - 1]
            else:
                before[i], begin[i] = cells[i], at
                buffer[at] = _COMMA
                at = write_fixed(buffer, at + 1, cells[i], decimals[i])
                end[i] = at
                i += 1
        buffer[at] = _NEWLINE
        at += 1
    return at


@entry
def _fill_all(solutions: Any, cells: Floats) -> None:
    for k in range(len(solutions)):
        _fill(cells[k * _CELLS :], solutions[k])


def estimate_cells(solutions: Records) -> dict[str, Floats]:
    """Columns of est.csv behind t_s, by name, of solutions (array of SOLUTION); unknown is NaN."""
    cells = np.empty((len(solutions), _CELLS))
    _fill_all(solutions, cells.reshape(-1))
    return {name: cells[:, i] for i, (name, _) in enumerate(ESTIMATE_COLUMNS)}


INNOVATION_COLUMNS = ("t_s", "kind", "value", "sigma", "used")
_INNOVATION_FIELDS = ("t_ns", "kind", "value", "variance", "used")


def write_innovations(path: Path, origin: int, innovations: Records) -> None:
    """An array of INNOVATION as a table. Raises OSError."""
    with path.open("wb") as file:
        InnovationWriter(file, origin).write(innovations)


class InnovationWriter:
    """Writes innovations as a table to a binary file; sigma is the predicted one, in the unit of the kind's name."""

    def __init__(self, file: BinaryIO, origin: int) -> None:
        self._file, self._origin = file, origin
        file.write(f"{','.join(INNOVATION_COLUMNS)}\n".encode())

    def write(self, innovations: Records) -> None:
        """Append one row for each innovation (array of INNOVATION)."""
        for t_ns, kind, value, variance, used in innovations[list(_INNOVATION_FIELDS)].tolist():
            t_s, ns = divmod(t_ns, 1_000_000_000)
            cells = f"{self._origin + t_s}.{ns:09d}", KINDS[kind].column, f"{value:.9g}", f"{math.sqrt(variance):.9g}"
            self._file.write(f"{','.join(cells)},{used}\n".encode())


class EstimateWriter:
    """Writes solutions as `est.csv` to a binary file; one per file."""

    def __init__(self, file: BinaryIO, origin: int, rows: int = 4096) -> None:
        self._file, self._origin = file, origin
        self._buffer = np.empty(rows * (len(_DECIMALS) + 2) * MAX_WIDTH, np.uint8)
        self._rows = rows
        file.write(f"{ESTIMATE_HEADER}\n".encode())

    def write(self, solutions: Records) -> None:
        """Append one row for each solution (array of SOLUTION)."""
        for start in range(0, len(solutions), self._rows):
            n = _format(solutions[start : start + self._rows], self._origin, _DECIMALS, self._buffer)
            self._file.write(self._buffer[:n].data)
