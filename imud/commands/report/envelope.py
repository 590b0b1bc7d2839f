"""Any number of rows as a few thousand points that lose no spike: least and greatest of each column over spans of rows.

The spans double whenever there are too many, so that memory is bounded and nobody needs to know the number beforehand.
"""

import numpy as np
from numpy.typing import NDArray

from ...math.arrays import Floats

Bits = NDArray[np.int64]
SPANS = 1000  # at least, once there are so many rows; at most twice as many


class Envelope:
    """Takes blocks of rows (n x columns) in order, with bits of each (n); NaN is unknown."""

    def __init__(self, columns: int, spans: int = SPANS) -> None:
        shape = (2 * spans, columns)
        self._low, self._high, self._first, self._last = (np.empty(shape) for _ in range(4))
        self._bits = np.zeros(2 * spans, np.int64)
        self._count, self._every = 0, 1
        self._rest = np.empty((0, columns))
        self._rest_bits = np.empty(0, np.int64)

    def add(self, rows: Floats, bits: Bits) -> None:
        """The next rows."""
        rows, bits = np.concatenate([self._rest, rows]), np.concatenate([self._rest_bits, bits])
        done = 0
        while (whole := (len(rows) - done) // self._every) > 0:
            if self._count == len(self._low):
                self._merge()
                continue
            stop = done + min(whole, len(self._low) - self._count) * self._every
            self._put(rows[done:stop], bits[done:stop], self._every)
            done = stop
        self._rest, self._rest_bits = rows[done:].copy(), bits[done:].copy()

    def _put(self, rows: Floats, bits: Bits, every: int) -> None:
        spans = rows.reshape(-1, every, rows.shape[1])
        at = slice(self._count, self._count + len(spans))
        self._low[at], self._high[at] = np.fmin.reduce(spans, axis=1), np.fmax.reduce(spans, axis=1)
        self._first[at], self._last[at] = spans[:, 0], spans[:, -1]
        self._bits[at] = np.bitwise_or.reduce(bits.reshape(-1, every), axis=1)
        self._count += len(spans)

    def _merge(self) -> None:
        """Each two spans become one."""
        half = self._count // 2
        self._low[:half] = np.fmin(self._low[0::2], self._low[1::2])
        self._high[:half] = np.fmax(self._high[0::2], self._high[1::2])
        self._first[:half], self._last[:half] = self._first[0::2].copy(), self._last[1::2].copy()
        self._bits[:half] = self._bits[0::2] | self._bits[1::2]
        self._count, self._every = half, 2 * self._every

    def close(self) -> tuple[Floats, Floats, Floats, Bits]:
        """Points, two for each span, in order: its least and greatest values; its first and last row; the greatest
        values for both; its bits for both. Where no row had to be left out, the rows themselves, once."""
        if len(self._rest):
            if self._count == len(self._low):
                self._merge()
            self._put(self._rest, self._rest_bits, len(self._rest))
            self._rest = self._rest[:0]
        n = self._count
        if self._every == 1:
            return self._first[:n], self._first[:n], self._first[:n], self._bits[:n]
        columns = self._low.shape[1]
        extremes = np.stack([self._low[:n], self._high[:n]], axis=1).reshape(2 * n, columns)
        ends = np.stack([self._first[:n], self._last[:n]], axis=1).reshape(2 * n, columns)
        return extremes, ends, np.repeat(self._high[:n], 2, axis=0), np.repeat(self._bits[:n], 2)
