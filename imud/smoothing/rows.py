"""Rows of one dtype in a temporary file: a whole drive need not fit into memory. `TMPDIR` chooses the disk."""

import tempfile
from typing import Any

import numpy as np

from ..math.arrays import Records


class Rows:
    """Rows of one dtype in a temporary file without a name; written first, then read."""

    def __init__(self, kind: "np.dtype[Any]") -> None:
        self._file, self._kind = tempfile.TemporaryFile(), kind  # noqa: SIM115

    def append(self, rows: Records) -> None:
        """Write copies of the rows."""
        self._file.write(np.ascontiguousarray(rows).tobytes())

    def array(self) -> Records:
        """All rows, in the file; so are changes of them. After that none can be written."""
        with self._file as file:
            file.flush()
            count = file.tell() // self._kind.itemsize
            return np.memmap(file, self._kind, "r+", shape=(count,)) if count else np.zeros(0, self._kind)
