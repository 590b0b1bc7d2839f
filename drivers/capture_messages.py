"""The messages of a recording: the bytes of ports exactly as they were read, and the connections of devices.

Topics: `/raw` the bytes of all ports, `/connections` which device streams on which port. `capture` reads the files.
"""

import itertools
import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from .driver import GnssConfigured, ImuConfigured
from .protobuf import Field, delimited, fields

READS, CONNECTIONS = "/raw", "/connections"
JSON_READS = "imud.Raw"  # the schema of reads in a recording before version 2
FORMAT = 3  # version of the messages; that of JSON was 1, of reads in their order 2
SESSION = "imud"  # name of the metadata record
_FRAME_MAX, _ALIKE = 64, 0.25  # bytes; share of bytes
CHECKSUM = "crc32"  # in the metadata: of the other entries


class Raw(msgspec.Struct, frozen=True, omit_defaults=True):
    """One read of a port. No data: the line had become silent, and the receiver's open epoch was completed."""

    t_ns: int  # arrival, CLOCK_MONOTONIC
    data: bytes
    pulse_ns: int | None = None  # the receiver's last pulse per second before that, CLOCK_MONOTONIC; None: unknown


@dataclass(frozen=True)
class Reads:
    """Reads of ports in their order. The arrays have one element for each; data has their bytes in sequence."""

    port: NDArray[np.uint8]
    t_ns: NDArray[np.int64]
    size: NDArray[np.uint32]
    pulse_ns: NDArray[np.int64]  # as in `Raw`; 0: unknown
    data: bytes

    @classmethod
    def of(cls, reads: Sequence[tuple[int, Raw]]) -> "Reads":
        """From ports and what was read from them."""
        return cls(
            np.array([port for port, _ in reads], np.uint8),
            np.array([raw.t_ns for _, raw in reads], np.int64),
            np.array([len(raw.data) for _, raw in reads], np.uint32),
            np.array([raw.pulse_ns or 0 for _, raw in reads], np.int64),
            b"".join(raw.data for _, raw in reads),
        )

    def encode(self) -> bytes:
        """As a message of `READS_FIELDS`."""
        elapsed_ns = np.diff(self.t_ns, prepend=np.int64(0)).astype("<i8")
        data = np.frombuffer(self.data, np.uint8)
        streams = [data[own] for own in self._owned()]
        widths = np.array([_frame_size(stream) for stream in streams], "<u4")
        by_columns = b"".join(map(_columns, streams, widths.tolist()))
        packed = [(1, self.port.tobytes()), (3, self.size.tobytes())]
        packed += [(5, self.pulse_ns.tobytes())] if self.pulse_ns.any() else []
        packed += [(6, _columns(elapsed_ns.view(np.uint8), 8)), (7, widths.tobytes()), (8, by_columns)]
        return b"".join(delimited(number, value) for number, value in packed)

    def _owned(self) -> list[NDArray[np.bool_]]:
        """Of each port, by number: which of the bytes are its own."""
        owners = np.repeat(self.port, self.size)
        return [owners == port for port in np.flatnonzero(np.bincount(self.port)).tolist()]

    @classmethod
    def decode(cls, message: bytes) -> "Reads":
        """The other way round. Raises ValueError if it is something else."""
        parts = {number: value for number, value in fields(message) if isinstance(value, bytes)}
        port, size = (np.frombuffer(parts.get(number, b""), code) for number, code in ((1, "u1"), (3, "<u4")))
        if 6 in parts:
            t_ns = np.cumsum(_rows(np.frombuffer(parts[6], np.uint8), 8).view("<i8"))
        else:  # before version 3
            t_ns = np.frombuffer(parts.get(2, b""), "<i8")
        pulse_ns = np.frombuffer(parts[5], "<i8") if 5 in parts else np.zeros(len(port), np.int64)
        data = parts.get(8, b"") if 6 in parts else parts.get(4, b"")
        if not len(port) == len(t_ns) == len(size) == len(pulse_ns) or int(size.sum()) != len(data):
            raise ValueError("its arrays do not fit each other")
        reads = cls(port, t_ns, size, pulse_ns, data)
        return reads._in_sequence(np.frombuffer(parts.get(7, b""), "<u4").tolist()) if 6 in parts else reads

    def _in_sequence(self, widths: list[int]) -> "Reads":
        """With the data of all ports in the order of the reads, instead of port by port in columns."""
        data, at = np.empty(len(self.data), np.uint8), 0
        owned = self._owned()
        if len(widths) != len(owned) or 0 in widths:
            raise ValueError("its widths do not fit its ports")
        for own, width in zip(owned, widths, strict=True):
            n = int(np.count_nonzero(own))
            data[own] = _rows(np.frombuffer(self.data, np.uint8, n, at), width)
            at += n
        return replace(self, data=data.tobytes())

    def runs(self) -> Iterator[tuple[int, int, int, int]]:
        """The parts in which one port was read several times in sequence: that port, the first read, the one behind the
        last, and the first byte.
        """
        edges = [0, *(np.flatnonzero(np.diff(self.port)) + 1).tolist(), len(self.port)] if len(self.port) else []
        before = np.cumsum(self.size, dtype=np.int64) - self.size
        for first, last in itertools.pairwise(edges):
            yield int(self.port[first]), first, last, int(before[first])

    def part(self, first: int, last: int, first_byte: int) -> Iterator[Raw]:
        """The reads of a run."""
        columns = (column[first:last].tolist() for column in (self.t_ns, self.size, self.pulse_ns))
        for t_ns, size, pulse_ns in zip(*columns, strict=True):
            yield Raw(t_ns, self.data[first_byte : first_byte + size], pulse_ns or None)
            first_byte += size

    def __iter__(self) -> Iterator[tuple[int, Raw]]:
        return zip(self.port.tolist(), self.part(0, len(self.port), 0), strict=True)


def _frame_size(stream: NDArray[np.uint8]) -> int:
    """The distance at which bytes are alike most often, as those of frames are; 1 if there are no such frames."""
    lags = range(2, min(_FRAME_MAX, len(stream) // 2) + 1)
    alike = [np.count_nonzero(stream[lag:] == stream[:-lag]) for lag in lags]
    return lags[int(np.argmax(alike))] if alike and max(alike) > _ALIKE * len(stream) else 1


def _columns(data: NDArray[np.uint8], width: int) -> bytes:
    """Rows of `width` bytes column by column, and then what is left: what is alike comes together, and compresses."""
    whole = len(data) - len(data) % width
    return data[:whole].reshape(-1, width).T.tobytes() + data[whole:].tobytes()


def _rows(data: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    """The other way round."""
    n = len(data) // width
    return np.concatenate([data[: n * width].reshape(width, n).T.ravel(), data[n * width :]])


READS_FIELDS = (  # before version 3: 2 the arrivals, 4 the bytes of all reads in their order
    Field(1, "port", "bytes", about="number of the port of each read"),
    Field(3, "size", "fixed32", True, "how many bytes; 0: the line had become silent"),
    Field(5, "pulse_ns", "sfixed64", True, "the receiver's last pulse per second before that; 0: unknown"),
    Field(
        6,
        "elapsed_ns",
        "bytes",
        about="arrival less that of the read before, CLOCK_MONOTONIC of the host, ns (the first less 0): int64 in "
        "little-endian order, their first bytes, then their second, ...",
    ),
    Field(7, "width", "fixed32", True, "of each port that occurs, in order of its number: columns of its data"),
    Field(
        8,
        "data",
        "bytes",
        about="port by port all bytes that were read there, in rows of `width` bytes: the first of each row, then the "
        "second of each, ..., and last what is no whole row",
    ),
)


class Connection(msgspec.Struct, frozen=True):
    """A device began to stream, or stopped."""

    t_ns: int
    port: int
    path: str
    streaming: bool = True
    kind: str = ""  # imu, gnss
    driver: str = ""
    configured: dict[str, Any] = {}
    calibration: dict[str, Any] = {}
    biases: dict[str, Any] = {}  # of an inertial sensor, kept from an earlier run, with which the filter begins
    checkpoint: bytes = b""  # and the rest of its filter's state, kept likewise
    repeated: bool = False  # at the start of a later file of the same recording

    def imu(self) -> ImuConfigured:
        """How the inertial sensor was set up."""
        return msgspec.convert(_without_none(self.configured), ImuConfigured)

    def gnss(self) -> GnssConfigured:
        """How the receiver was set up."""
        return msgspec.convert(_without_none(self.configured), GnssConfigured)


def checksum_of(metadata: Mapping[str, str]) -> str:
    """Of the metadata's entries, as the entry CHECKSUM holds it."""
    others = sorted((name, text) for name, text in metadata.items() if name != CHECKSUM)
    return f"{zlib.crc32(msgspec.json.encode(others)):08x}"


def to_builtins(configured: ImuConfigured | GnssConfigured) -> dict[str, Any]:
    """For JSON. An infinite range is left out, since JSON has no infinity; reading it back restores it."""
    known = {name: value for name, value in asdict(configured).items() if value not in (math.inf, None)}
    return dict(msgspec.to_builtins(known))


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return value


@dataclass(frozen=True)
class Entry:
    """One message of the file. log_ns: Unix time; schema: name of the message's type."""

    topic: str
    schema: str
    log_ns: int
    data: bytes

    def reads(self) -> Reads | None:
        """The bytes of ports in it; None: it is on another topic. Raises ValueError if it is something else."""
        if self.topic != READS:
            return None
        if self.schema == JSON_READS:
            return Reads.of(msgspec.json.decode(self.data, type=list[tuple[int, Raw]]))
        return Reads.decode(self.data)

    def connection(self) -> Connection:
        """The message of the topic `CONNECTIONS`, decoded. Raises ValueError if it is something else."""
        return msgspec.json.decode(self.data, type=Connection)
