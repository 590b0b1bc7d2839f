"""Steps a sensor's filter through recorded reads, many in one compiled call, and hands on its solutions in blocks."""

from collections.abc import Callable

import numpy as np

from imud.drivers.capture_messages import Reads
from imud.drivers.sample import SAMPLE

from ..estimators.records import SOLUTION
from ..math.arrays import Records
from ..pipeline import InertialPipeline
from ..stages import BATCH, BYTE, READ_CURSOR, ingest_reads

_ROWS = 8 * BATCH


class Steps:
    """Not thread-safe. on_step(samples, solutions): given rows of SAMPLE and SOLUTION, valid until it returns."""

    def __init__(self, on_step: Callable[[Records, Records], None]) -> None:
        self._on_step = on_step
        self._samples, self._solutions = np.zeros(_ROWS, SAMPLE), np.zeros(_ROWS, SOLUTION)
        self._cursor = np.zeros(1, READ_CURSOR)
        self.begin(Reads.of([]))

    def begin(self, reads: Reads) -> None:
        """The runs that follow are of these reads."""
        self._data = np.frombuffer(bytearray(reads.data), BYTE)
        self._size, self._t_ns = reads.size.astype(np.int64), reads.t_ns.astype(np.int64)

    def run(self, pipeline: InertialPipeline, first: int, last: int, first_byte: int) -> None:
        """Step through the reads from `first` to before `last`, which are of this sensor."""
        cursor = self._cursor
        cursor["read"], cursor["byte"], cursor["end"] = first, first_byte, last
        while True:
            ingest_reads(pipeline.record, self._data, self._size, self._t_ns, cursor, self._samples, self._solutions)
            if cursor["read"][0] >= last:
                return
            self.flush()

    def flush(self) -> None:
        """Hand on what is not handed on yet."""
        n = int(self._cursor["filled"][0])
        self._cursor["filled"] = 0
        if n:
            self._on_step(self._samples[:n], self._solutions[:n])
