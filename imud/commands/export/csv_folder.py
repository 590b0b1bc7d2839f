"""A recording as CSV files, which `imud replay` reads."""

from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from ...errors import CannotCreateError
from .rows import FIX_COLUMNS, fix_cells, source_names, tilt_deg

if TYPE_CHECKING:
    from ...estimators.aiding_source import AidingSource
    from ...math.arrays import Records

_ARRIVAL = FIX_COLUMNS.index("arrival_s") - 1  # behind t_s


class CsvFolder:
    """imu.csv, gnss.csv and a table of each aiding source (odometer.csv, …) as `imud replay` reads them, est.csv and
    states.csv as it writes them; all on one clock."""

    def __init__(self, folder: Path, rate_hz: float, stack: ExitStack) -> None:
        from ...recording.thinner import Thinner
        from ...tables.estimates import EstimateWriter
        from ...tables.inputs import IMU_COLUMNS, TEMPERATURE

        try:
            folder.mkdir(exist_ok=True)
            for name in ("states", *source_names()):
                (folder / f"{name}.csv").unlink(missing_ok=True)
            files = {name: stack.enter_context((folder / f"{name}.csv").open("wb")) for name in ("imu", "gnss", "est")}
        except OSError as error:
            raise CannotCreateError(f"cannot write in {folder}: {error.strerror}") from error
        self._folder, self._stack = folder, stack
        self._aiding: dict[str, BinaryIO] = {}  # by source
        self._imu: BinaryIO = files["imu"]
        self._gnss: BinaryIO = files["gnss"]
        self._est = EstimateWriter(files["est"], 0, 256)
        self._thinner = Thinner(rate_hz)
        self.fixes = 0
        self._columns: tuple[str, ...] = (*IMU_COLUMNS, TEMPERATURE)
        self._begun = self._has_tilt = False
        self._gnss.write(f"{','.join(FIX_COLUMNS)}\n".encode())
        stack.callback(self.close)

    def step(self, samples: "Records", solutions: "Records") -> None:
        """Rows of SAMPLE and SOLUTION."""
        from ...tables.imu_table import write_rows

        if not self._begun:
            self._begin(bool(samples["down"].any()))
        tilt = [tilt_deg(samples["down"])] if self._has_tilt else []
        cells = np.column_stack([samples["w"], samples["f"], samples["temperature"], *tilt])
        write_rows(self._imu, samples["t_ns"], cells)
        self._est.write(self._thinner.kept(solutions))

    def _begin(self, has_tilt: bool) -> None:
        """The head of imu.csv, once it is known whether the device computes its own tilt."""
        from ...tables.inputs import DEVICE_TILT

        self._begun, self._has_tilt = True, has_tilt
        self._imu.write(f"{','.join((*self._columns, *(DEVICE_TILT if has_tilt else ())))}\n".encode())

    def close(self) -> None:
        """Also a table without a row has a head."""
        if not self._begun:
            self._begin(False)

    def write_fix(self, fix: "Records") -> None:
        """A FIX."""
        self.fixes += 1
        cells: list[float | str] = [*fix_cells(fix)]
        cells[_ARRIVAL] = _seconds(int(cells[_ARRIVAL]))
        self._gnss.write(_row(int(fix[0]["t_ns"]), cells))

    def write_measurement(self, source: "AidingSource", measurement: "Records") -> None:
        """A MEASUREMENT. A source of which none comes has no file."""
        row = measurement[0]
        cells = source.cells(row)
        if source.name not in self._aiding:
            file = self._stack.enter_context((self._folder / f"{source.name}.csv").open("wb"))
            file.write(f"t_s,arrival_s,{','.join(cells)}\n".encode())
            self._aiding[source.name] = file
        self._aiding[source.name].write(_row(int(row["t_ns"]), [_seconds(int(row["arrival_ns"])), *cells.values()]))

    def write_states(self, rows: "Records") -> None:
        """All rows of FILTER_STATES; none: the estimator has no such, and there is no file."""
        from ...tables.filter_states import write_states

        if len(rows):
            write_states(self._folder / "states.csv", 0, rows)


def _seconds(t_ns: int) -> str:
    return f"{int(t_ns) // 1_000_000_000}.{int(t_ns) % 1_000_000_000:09d}"


def _row(t_ns: int, cells: Iterable[float | str]) -> bytes:
    texts = ["" if cell != cell else str(cell) for cell in cells]  # noqa: PLR0124 - NaN is unknown, and left empty
    return f"{_seconds(t_ns)},{','.join(texts)}\n".encode()
