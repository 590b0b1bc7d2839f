"""A recording as Parquet files, with the columns of the CSV files. Needs pyarrow (`pip install 'imud[parquet]'`)."""

import importlib
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import CannotCreateError
from ...recording.thinner import Thinner
from .rows import FIX_COLUMNS, fix_cells, source_names, tilt_deg

if TYPE_CHECKING:
    from ...estimators.aiding_source import AidingSource
    from ...math.arrays import Records

GROUP_ROWS = 65536  # of a row group, at least: what readers take at a time
_INTEGERS = ("quality", "satellites", "status")


class _Table:
    """One file. Rows are collected until they make a row group."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._parts: list[dict[str, Any]] = []
        self._rows = 0
        self._writer: Any = None

    def write(self, columns: dict[str, Any]) -> None:
        """Columns of equal length by name; NaN: not known, null in the file."""
        self._parts.append(columns)
        self._rows += len(columns["t_s"])
        if self._rows >= GROUP_ROWS:
            self._flush()

    def _flush(self) -> None:
        import pyarrow
        from pyarrow import parquet

        if not self._parts:
            return
        joined = {name: np.concatenate([part[name] for part in self._parts]) for name in self._parts[0]}
        types = {name: pyarrow.int32() if name in _INTEGERS else pyarrow.float64() for name in joined}
        arrays = [pyarrow.array(values, types[name], from_pandas=True) for name, values in joined.items()]
        table = pyarrow.Table.from_arrays(arrays, names=list(joined))
        if self._writer is None:
            self._writer = parquet.ParquetWriter(self._path, table.schema, compression="zstd")
        self._writer.write_table(table)
        self._parts, self._rows = [], 0

    def close(self) -> None:
        """Write what is left. A table without a row makes no file."""
        self._flush()
        if self._writer is not None:
            self._writer.close()


class ParquetFolder:
    """imu, gnss, est, states and a table of each aiding source as .parquet; all on the same clock."""

    def __init__(self, folder: Path, rate_hz: float, stack: ExitStack) -> None:
        importlib.import_module("pyarrow")  # if it is missing, that is said before the recording is replayed
        try:
            folder.mkdir(exist_ok=True)
            for name in ("imu", "gnss", "est", "states", *source_names()):
                (folder / f"{name}.parquet").unlink(missing_ok=True)
        except OSError as error:
            raise CannotCreateError(f"cannot write in {folder}: {error.strerror}") from error
        tables = [_Table(folder / f"{name}.parquet") for name in ("imu", "gnss", "est", "states")]
        self._imu, self._gnss, self._est, self._states = tables
        self._thinner = Thinner(rate_hz)
        self._folder, self._stack = folder, stack
        self._aiding: dict[str, _Table] = {}  # by source
        self.fixes = 0
        for table in tables:
            stack.callback(table.close)

    def step(self, samples: "Records", solutions: "Records") -> None:
        """Rows of SAMPLE and SOLUTION."""
        from ...tables.estimates import estimate_cells
        from ...tables.inputs import DEVICE_TILT, IMU_COLUMNS, TEMPERATURE

        values = np.column_stack([samples["w"], samples["f"], samples["temperature"], tilt_deg(samples["down"])])
        names = (*IMU_COLUMNS[1:], TEMPERATURE, *DEVICE_TILT)
        self._imu.write({"t_s": samples["t_ns"] * 1e-9, **dict(zip(names, values.T, strict=True))})
        kept = self._thinner.kept(solutions)
        if len(kept):
            self._est.write({"t_s": kept["t_ns"] * 1e-9, **estimate_cells(kept)})

    def write_fix(self, fix: "Records") -> None:
        """A FIX."""
        self.fixes += 1
        row = dict(zip(FIX_COLUMNS, [fix[0]["t_ns"] * 1e-9, *fix_cells(fix)], strict=True))
        row["arrival_s"] *= 1e-9
        self._gnss.write({name: np.array([value]) for name, value in row.items()})

    def write_measurement(self, source: "AidingSource", measurement: "Records") -> None:
        """A MEASUREMENT. A source of which none comes has no file."""
        row = measurement[0]
        if source.name not in self._aiding:
            self._aiding[source.name] = _Table(self._folder / f"{source.name}.parquet")
            self._stack.callback(self._aiding[source.name].close)
        times = {"t_s": 1e-9 * row["t_ns"], "arrival_s": 1e-9 * row["arrival_ns"]}
        cells = times | source.cells(row)
        self._aiding[source.name].write({name: np.array([value]) for name, value in cells.items()})

    def write_states(self, rows: "Records") -> None:
        """All rows of FILTER_STATES; none: the estimator has no such, and there is no file."""
        from ...estimators.filter_states import cells

        if len(rows):
            self._states.write({"t_s": rows["t_ns"] * 1e-9, **cells(rows)})
