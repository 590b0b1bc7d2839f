"""CDR, the serialisation of ROS 2 (OMG DDS-XTypes, plain CDR version 1, little-endian): many messages of one layout.

They are written front to back, all at once: a number is an array with an element for each message, or the same for all.
"""

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..math.arrays import Floats, Indices

Column = float | NDArray[np.generic]
Bytes = NDArray[np.uint8]
NS = 1_000_000_000
_HEAD = b"\x00\x01\x00\x00"


class Cdr:
    """n messages as they grow: each number aligned to its size, from behind the 4-byte header."""

    def __init__(self, n: int = 1) -> None:
        self._n, self._size = n, 0
        self._parts: list[bytes | Bytes] = [_HEAD]  # the same for all, or a row for each

    @staticmethod
    def of(message: bytes) -> "Cdr":
        """A message that is complete."""
        cdr = Cdr()
        cdr._constant(message.removeprefix(_HEAD))
        return cdr

    def _constant(self, data: bytes) -> None:
        if not data:
            return
        before = self._parts[-1]
        if isinstance(before, bytes):
            self._parts[-1] = before + data
        else:
            self._parts.append(data)
        self._size += len(data)

    def _align(self, size: int) -> None:
        self._constant(bytes(-self._size % size))

    def add(self, code: str, *columns: Column) -> "Cdr":
        """Numbers of the `struct` code."""
        if any(isinstance(column, np.ndarray) for column in columns):
            numbers = np.empty((self._n, len(columns)), f"<{code}")
            for i, column in enumerate(columns):
                numbers[:, i] = column
            return self._rows(numbers)
        self._align(struct.calcsize(code))
        self._constant(struct.pack(f"<{len(columns)}{code}", *columns))
        return self

    def doubles(self, *tables: Floats) -> "Cdr":
        """Doubles, the columns of tables (n x any)."""
        for table in tables:
            self._rows(np.ascontiguousarray(table, "<f8"))
        return self

    def _rows(self, numbers: NDArray[np.generic]) -> "Cdr":
        self._align(numbers.itemsize)
        part = numbers.view(np.uint8)
        self._parts.append(part)
        self._size += part.shape[1]
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

    @property
    def size(self) -> int:
        """Bytes of a message."""
        return self._size + len(_HEAD)

    def fill(self, rows: Bytes) -> None:
        """Write all of them, one to a row (n x size)."""
        at = 0
        for part in self._parts:
            columns = np.frombuffer(part, np.uint8) if isinstance(part, bytes) else part
            rows[:, at : at + columns.shape[-1]] = columns
            at += columns.shape[-1]

    def rows(self) -> Bytes:
        """All of them, one to a row."""
        rows = np.empty((self._n, self.size), np.uint8)
        self.fill(rows)
        return rows

    def only(self) -> bytes:
        """The only one."""
        return self.rows().tobytes()
