"""Recordings: MCAP files with the bytes of ports exactly as they were read, and the connections of devices.

Topics: `/raw/N` the bytes of port N, `/connections` which device streams on which port. The messages are in the order
of the events. A truncated recording (a power cut) is read up to its last whole chunk; damaged chunks are left out.
"""

import math
import mmap
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Message, Metadata, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk

from .driver import GnssConfigured, ImuConfigured
from .errors import CaptureError

MAGIC = b"\x89MCAP0\r\n"
RAW, CONNECTIONS = "/raw/", "/connections"
SESSION = "imud"  # name of the metadata record
CHECKSUM = "crc32"  # in the metadata: of the other entries
_CHECKSUM_BYTES = 4
_RECORD_MAX = 1 << 30  # bytes
_COMPRESSION, _BEFORE_COMPRESSION = b"\4\0\0\0zstd", 37  # in a chunk; opcode, length, two times, size, checksum


class Raw(msgspec.Struct, frozen=True, omit_defaults=True):
    """One read of a port. No data: the line had become silent, and the receiver's open epoch was completed."""

    t_ns: int  # arrival, CLOCK_MONOTONIC
    data: bytes
    pulse_ns: int | None = None  # the receiver's last pulse per second before that, CLOCK_MONOTONIC; None: unknown


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

    @property
    def port(self) -> int | None:
        """The port whose bytes these are; None: the topic is not `/raw/N`."""
        return int(self.topic[len(RAW) :]) if self.topic.startswith(RAW) else None

    def raw(self) -> Raw:
        """The message of a topic `/raw/N`, decoded. Raises ValueError if it is something else."""
        return msgspec.json.decode(self.data, type=Raw)

    def connection(self) -> Connection:
        """The message of the topic `CONNECTIONS`, decoded. Raises ValueError if it is something else."""
        return msgspec.json.decode(self.data, type=Connection)


def _next_chunk(file: BinaryIO, after: int) -> int | None:
    """Offset of the next chunk after `after`, found by the name of its compression; None: there is none."""
    with mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ) as data:
        at = data.find(_COMPRESSION, after + _BEFORE_COMPRESSION)
        while at >= 0 and data[at - _BEFORE_COMPRESSION] != Opcode.CHUNK:
            at = data.find(_COMPRESSION, at + 1)
    return at - _BEFORE_COMPRESSION if at >= 0 else None


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
                if metadata.get(CHECKSUM, checksum_of(metadata)) != checksum_of(metadata):
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
            for part in self._parts(record):
                if isinstance(part, Schema):
                    schemas[part.id] = part.name
                elif isinstance(part, Channel):
                    channels[part.id] = part
                elif isinstance(part, Message) and part.channel_id in channels:
                    channel = channels[part.channel_id]
                    n += 1
                    yield Entry(channel.topic, schemas.get(channel.schema_id, ""), part.log_time, part.data)

    def _parts(self, chunk: Chunk) -> list[Any]:
        try:
            return breakup_chunk(chunk, validate_crc=True)
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
