"""Recordings: MCAP files with the bytes of ports exactly as they were read, and the connections of devices.

Topics: `/raw` the bytes of all ports, `/connections` which device streams on which port. The messages are in the order
of the events. Recordings before version 2 of the format have JSON throughout, and `/raw/N` for each read of port N. A
truncated recording (a power cut) is read up to its last whole chunk; damaged chunks are left out.
"""

import io
import itertools
import math
import mmap
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Message, Metadata, Schema, Statistics
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from numpy.typing import NDArray

from .driver import GnssConfigured, ImuConfigured
from .errors import CaptureError
from .protobuf import Field, delimited, fields

MAGIC = b"\x89MCAP0\r\n"
READS, CONNECTIONS = "/raw", "/connections"
_RAW, _JSON_READS = "/raw/", "imud.Raw"  # and the port, and the schema, in a recording before version 2
_ORDERED = {CONNECTIONS, "/settings", "/aiding"}  # what was read before these must not come after them
FORMAT = 2  # version of the messages; that of JSON was 1
SESSION = "imud"  # name of the metadata record
CHECKSUM = "crc32"  # in the metadata: of the other entries
_CHECKSUM_BYTES = 4
_RECORD_MAX = 1 << 30  # bytes
_RECORD, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")  # opcode, length; channel, sequence, two times
_COMPRESSION, _BEFORE_COMPRESSION = b"\4\0\0\0zstd", 37  # in a chunk; opcode, length, two times, size, checksum


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
        columns = (self.port, self.t_ns, self.size) + ((self.pulse_ns,) if self.pulse_ns.any() else ())
        numbers = (1, 2, 3, 5)[: len(columns)]
        packed = (delimited(number, column.tobytes()) for number, column in zip(numbers, columns, strict=True))
        return b"".join(packed) + delimited(4, self.data)

    @classmethod
    def decode(cls, message: bytes) -> "Reads":
        """The other way round. Raises ValueError if it is something else."""
        parts = {number: value for number, value in fields(message) if isinstance(value, bytes)}
        port, t_ns, size = (
            np.frombuffer(parts.get(i + 1, b""), f"<{kind}") for i, kind in enumerate(("u1", "i8", "u4"))
        )
        pulse_ns = np.frombuffer(parts[5], "<i8") if 5 in parts else np.zeros(len(port), np.int64)
        data = parts.get(4, b"")
        if not len(port) == len(t_ns) == len(size) == len(pulse_ns) or int(size.sum()) != len(data):
            raise ValueError("its arrays do not fit each other")
        return cls(port, t_ns, size, pulse_ns, data)

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


READS_FIELDS = (
    Field(1, "port", "bytes", about="number of the port of each read"),
    Field(2, "t_ns", "sfixed64", True, "its arrival, CLOCK_MONOTONIC of the host, ns"),
    Field(3, "size", "fixed32", True, "how many bytes of `data`; 0: the line had become silent"),
    Field(4, "data", "bytes", about="the bytes of all reads, one behind the other"),
    Field(5, "pulse_ns", "sfixed64", True, "the receiver's last pulse per second before that; 0: unknown"),
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
        if self.schema == _JSON_READS:
            return Reads.of(msgspec.json.decode(self.data, type=list[tuple[int, Raw]]))
        return Reads.decode(self.data)

    def connection(self) -> Connection:
        """The message of the topic `CONNECTIONS`, decoded. Raises ValueError if it is something else."""
        return msgspec.json.decode(self.data, type=Connection)


def _together(single: list[Entry]) -> Iterator[Entry]:
    """The reads of a recording before version 2, a message each, in one, as it is today. Empties the list."""
    if single:
        texts = [b"[%s,%s]" % (entry.topic[len(_RAW) :].encode(), entry.data) for entry in single]
        yield Entry(READS, _JSON_READS, single[0].log_ns, b"[%s]" % b",".join(texts))
        single.clear()


def _next_chunk(file: BinaryIO, after: int) -> int | None:
    """Offset of the next chunk after `after`, found by the name of its compression; None: there is none."""
    with mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ) as data:
        at = data.find(_COMPRESSION, after + _BEFORE_COMPRESSION)
        while at >= 0 and data[at - _BEFORE_COMPRESSION] != Opcode.CHUNK:
            at = data.find(_COMPRESSION, at + 1)
    return at - _BEFORE_COMPRESSION if at >= 0 else None


def _split(chunk: Chunk) -> list[Any]:
    """The records of a chunk; as the library's `breakup_chunk`, several times as fast for messages."""
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    data = stream.read(size)
    found: list[Any] = []
    at = 0
    while at < size:
        opcode, length = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(data, at)
            body = data[at + _MESSAGE.size : at + length]
            found.append(Message(channel, log_ns, body, publish_ns, sequence))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            record = Schema if opcode == Opcode.SCHEMA else Channel
            found.append(record.read(ReadDataStream(io.BytesIO(data[at : at + length]))))
        at += length
    return found


class Capture:
    """A recording, read from its start by one reader at a time. Raises OSError, CaptureError if it is no recording."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.broken = ""  # after reading: what is damaged or missing, and where; empty: nothing
        self.read_bytes = 0
        with self.path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise CaptureError(f"{path} is no recording (MCAP)")

    def session(self) -> tuple[dict[str, str], dict[str, bytes]]:
        """imud's own metadata, and the attachments that precede the first message.

        Raises CaptureError where their checksums show that they are damaged.
        """
        metadata: dict[str, str] = {}
        attached: dict[str, bytes] = {}
        for record in self._records():
            if isinstance(record, Metadata) and record.name == SESSION:
                metadata = record.metadata
                unchecked = "" if "format" in metadata else checksum_of(metadata)  # the oldest had no checksum
                if metadata.get(CHECKSUM, unchecked) != checksum_of(metadata):
                    raise CaptureError(f"{self.path} is damaged: the checksum of its metadata is wrong")
            elif isinstance(record, Attachment):
                if not self._is_whole(record):
                    raise CaptureError(f"{self.path} is damaged: the checksum of {record.name!r} in it is wrong")
                attached[record.name] = record.data
            elif isinstance(record, Chunk):
                break
        return metadata, attached

    def _is_whole(self, attachment: Attachment) -> bool:
        """Whether the attachment that was just read has the checksum that ends its record, which the library skips."""
        texts = [text.encode() for text in (attachment.name, attachment.media_type)]
        prefixed = b"".join(struct.pack("<I", len(text)) + text for text in texts)
        times = struct.pack("<QQ", attachment.log_time, attachment.create_time)
        data = times + prefixed + struct.pack("<Q", len(attachment.data)) + attachment.data
        with self.path.open("rb") as file:
            file.seek(self.read_bytes - _CHECKSUM_BYTES)
            return file.read(_CHECKSUM_BYTES) == struct.pack("<I", zlib.crc32(data))

    def devices(self, within_s: float = 10.0) -> list[Connection]:
        """The devices that began to stream within `within_s` of the first one, each port once."""
        found: dict[int, Connection] = {}
        first_ns = None
        for entry in self:
            if first_ns is not None and entry.log_ns - first_ns > within_s * 1e9:
                break
            if entry.topic == CONNECTIONS:
                try:
                    connection = entry.connection()
                except ValueError as error:
                    raise CaptureError(f"{self.path}: a message on {CONNECTIONS} cannot be decoded") from error
                first_ns = entry.log_ns if first_ns is None else first_ns
                if connection.streaming:
                    found.setdefault(connection.port, connection)
        return list(found.values())

    def __iter__(self) -> Iterator[Entry]:
        """All messages in the order in which they were written."""
        schemas: dict[int, str] = {}
        channels: dict[int, Channel] = {}
        n = 0
        for record in self._records():
            if isinstance(record, Statistics) and n < record.message_count and not self.broken:
                self.broken = f"{self.path} is damaged: {record.message_count - n} messages cannot be read"
            if not isinstance(record, Chunk):
                continue
            single: list[Entry] = []
            for part in self._parts(record):
                if isinstance(part, Schema):
                    schemas[part.id] = part.name
                elif isinstance(part, Channel):
                    channels[part.id] = part
                elif isinstance(part, Message) and part.channel_id in channels:
                    channel = channels[part.channel_id]
                    n += 1
                    entry = Entry(channel.topic, schemas.get(channel.schema_id, ""), part.log_time, part.data)
                    if entry.topic.startswith(_RAW):
                        single.append(entry)
                        continue
                    if entry.topic in _ORDERED:
                        yield from _together(single)
                    yield entry
            yield from _together(single)

    def _parts(self, chunk: Chunk) -> list[Any]:
        try:
            return _split(chunk)
        except Exception as error:  # zstandard, lz4 and struct have errors of their own for a damaged chunk
            self.broken = f"{self.path} is damaged: what cannot be read is left out ({error})"
        return []

    def _records(self) -> Iterator[Any]:
        """All records in file order. A damaged summary behind the data ends the iteration without complaint."""
        with self.path.open("rb") as file:
            start: int | None = 0
            ended = False
            while start is not None:
                file.seek(start)
                reader = StreamReader(file, skip_magic=start > 0, emit_chunks=True, record_size_limit=_RECORD_MAX)
                try:
                    for record in reader.records:
                        self.read_bytes = file.tell()
                        ended = ended or isinstance(record, DataEnd)
                        yield record
                    why = "it has no end"
                except (McapError, ValueError, struct.error, MemoryError, OverflowError) as error:
                    why = type(error).__name__
                if ended:
                    return
                at = f"at {self.read_bytes} bytes ({why})"
                start = _next_chunk(file, max(start, self.read_bytes) + 1)
                if start is None:
                    self.broken = f"{self.path} broke off, as after a power cut, {at}; read up to there"
                else:
                    self.broken = f"{self.path} is damaged {at}: what cannot be read is left out"
