"""CDR, the serialisation of ROS 2 (OMG DDS-XTypes, plain CDR version 1, little-endian): many messages of one layout.

They are written front to back, all at once: a number is an array with an element for each message, or the same for all.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..math.arrays import Floats, Indices

Column = float | NDArray[np.generic]
Bytes = NDArray[np.uint8]
NS = 1_000_000_000


class Cdr:
    """n messages as they grow: each number aligned to its size, from behind the 4-byte header."""

    def __init__(self, n: int = 1) -> None:
        self._n, self._size = n, 0
        self._parts: list[Bytes] = []
        self._constant(b"\x00\x01\x00\x00")
        self._size = 0

    def _constant(self, data: bytes) -> None:
        self._append(np.broadcast_to(np.frombuffer(data, np.uint8), (self._n, len(data))))

    def _append(self, part: Bytes) -> None:
        self._parts.append(part)
        self._size += part.shape[1]

    def add(self, code: str, *columns: Column) -> "Cdr":
        """Numbers of the `struct` code."""
        numbers = np.empty((self._n, len(columns)), f"<{code}")
        for i, column in enumerate(columns):
            numbers[:, i] = column
        return self._aligned(numbers)

    def doubles(self, *tables: Floats) -> "Cdr":
        """Doubles, the columns of tables (n x any)."""
        return self._aligned(np.concatenate(tables, axis=1, dtype="<f8"))

    def _aligned(self, numbers: NDArray[np.generic]) -> "Cdr":
        if padding := -self._size % numbers.itemsize:
            self._constant(bytes(padding))
        self._append(numbers.view(np.uint8))
        return self

    def text(self, text: str) -> "Cdr":
        """A string."""
        data = text.encode() + b"\0"
        self.add("I", len(data))
        self._constant(data)
        return self

    def time(self, unix_ns: int | Indices) -> "Cdr":
        """builtin_interfaces/Time."""
        return self.add("i", unix_ns // NS).add("I", unix_ns % NS)

    def header(self, unix_ns: int | Indices, frame: str) -> "Cdr":
        """std_msgs/Header."""
        return self.time(unix_ns).text(frame)

    def quaternion(self, q: Any) -> "Cdr":
        """geometry_msgs/Quaternion, of one with the scalar first."""
        return self.add("d", *q[1:], q[0])

    def rows(self) -> Bytes:
        """All of them, one a row."""
        return np.concatenate(self._parts, axis=1)

    def bytes(self) -> bytes:
        """The only one."""
        return self.rows().tobytes()
