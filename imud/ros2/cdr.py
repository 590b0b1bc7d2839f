"""CDR, the serialisation of ROS 2 (OMG DDS-XTypes, plain CDR version 1, little-endian), written front to back."""

import struct
from collections.abc import Sequence

Quaternion = tuple[float, float, float, float]
NS = 1_000_000_000


class Cdr:
    """A message as it grows: each number aligned to its size, from behind the 4-byte header."""

    def __init__(self) -> None:
        self._data = bytearray(b"\x00\x01\x00\x00")

    def add(self, code: str, *numbers: float) -> "Cdr":
        """Numbers of the `struct` code."""
        self._data += bytes(-(len(self._data) - 4) % struct.calcsize(code))
        self._data += struct.pack(f"<{len(numbers)}{code}", *numbers)
        return self

    def text(self, text: str) -> "Cdr":
        """A string."""
        data = text.encode() + b"\0"
        self.add("I", len(data))
        self._data += data
        return self

    def time(self, unix_ns: int) -> "Cdr":
        """builtin_interfaces/Time."""
        return self.add("i", unix_ns // NS).add("I", unix_ns % NS)

    def header(self, unix_ns: int, frame: str) -> "Cdr":
        """std_msgs/Header."""
        return self.time(unix_ns).text(frame)

    def quaternion(self, q: Sequence[float]) -> "Cdr":
        """geometry_msgs/Quaternion, of one with the scalar first."""
        return self.add("d", *q[1:], q[0])

    def bytes(self) -> bytes:
        """All of it."""
        return bytes(self._data)
