"""The table of what a filter estimates beside its solution, a row a second; see `estimators.filter_states`."""

from pathlib import Path

import numpy as np

from ..errors import CannotCreateError
from ..estimators.filter_states import FILTER_STATES, OncePerPeriod, cells
from ..filter_state_names import COVARIANCES
from ..math.arrays import Records
from ..pipeline import Filter

STATES_HEADER = ("t_s", *COVARIANCES)  # every such table has these columns


class FilterStates:
    """Collects rows, a kilobyte each, as only the end shows which columns there are. Not thread-safe."""

    def __init__(self) -> None:
        self._rows: list[Records] = []
        self._period = OncePerPeriod()

    def take(self, filter_: Filter, t_ns: int) -> None:
        """A row of this filter, if it is due; t_ns: time of its newest solution."""
        if self._period.is_due(t_ns):
            self._rows.append(filter_.filter_states())

    @property
    def rows(self) -> Records:
        """All of them (FILTER_STATES)."""
        return np.concatenate([np.zeros(0, FILTER_STATES), *self._rows])


def write_states(path: Path, origin: int, rows: Records) -> None:
    """Rows of FILTER_STATES as a table, without what was never estimated. Raises CannotCreateError."""
    columns = cells(rows)
    lines = [",".join(("t_s", *columns))]
    for t_ns, values in zip(rows["t_ns"].tolist(), np.column_stack([*columns.values()]).tolist(), strict=True):
        t_s, ns = divmod(t_ns, 1_000_000_000)
        texts = ("" if value != value else f"{value:.9g}" for value in values)  # noqa: PLR0124 - NaN is left empty
        lines.append(f"{origin + t_s}.{ns:09d},{','.join(texts)}")
    try:
        path.write_text("\n".join([*lines, ""]))
    except OSError as error:
        raise CannotCreateError(f"cannot write {path}: {error.strerror}") from error
