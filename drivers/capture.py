"""Recordings: MCAP files with the messages of `capture_messages`, in the order of the events.

Recordings before version 2 of the format have JSON throughout, and `/raw/N` for each read of port N. A truncated
recording (a power cut) is read up to its last whole chunk; damaged chunks are left out.
"""

import io
import mmap
import struct
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, McapRecord, Metadata, Schema, Statistics
from mcap.stream_reader import StreamReader, get_chunk_data_stream

from .capture_messages import CHECKSUM, CONNECTIONS, JSON_READS, READS, SESSION, Connection, Entry, checksum_of
from .errors import CaptureError

MAGIC = b"\x89MCAP0\r\n"
_RAW = "/raw/"  # and the port, in a recording before version 2
_ORDERED = {CONNECTIONS, "/settings", "/aiding"}  # what was read before these must not come after them
_CHECKSUM_BYTES = 4
_RECORD_MAX = 1 << 30  # bytes
_CHUNK_MAX = 1 << 26  # bytes, uncompressed: a small file may hold terabytes of zeros; the recorder's chunks have 1 MiB
_RECORD, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<H4xQ")  # opcode, length; channel, sequence, time
_INDEX = struct.Struct("<2xI")  # channel; bytes that follow
_BEFORE_BODY = _MESSAGE.size + 8  # another time
_Message = tuple[int, int, bytes]  # channel, time, body
_COMPRESSION, _BEFORE_COMPRESSION = b"\4\0\0\0zstd", 37  # in a chunk; opcode, length, two times, size, checksum


def _together(single: list[Entry]) -> Iterator[Entry]:
    """The reads of a recording before version 2, a message each, in one, as it is today. Empties the list."""
    if single:
        texts = [b"[%s,%s]" % (entry.topic[len(_RAW) :].encode(), entry.data) for entry in single]
        yield Entry(READS, JSON_READS, single[0].log_ns, b"[%s]" % b",".join(texts))
        single.clear()


def _next_chunk(file: BinaryIO, after: int) -> int | None:
    """Offset of the next chunk after `after`, found by the name of its compression; None: there is none."""
    with mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ) as data:
        at = data.find(_COMPRESSION, after + _BEFORE_COMPRESSION)
        while at >= 0 and data[at - _BEFORE_COMPRESSION] != Opcode.CHUNK:
            at = data.find(_COMPRESSION, at + 1)
    return at - _BEFORE_COMPRESSION if at >= 0 else None


class _Reader(StreamReader):
    """Skips the index of messages behind each chunk, one a topic, which takes longer to read than the chunk.

    Zeros are no records: a power cut may leave a file with any number of them at its end.
    """

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        if opcode == 0:
            raise ValueError("zeros instead of a record")
        if opcode != Opcode.MESSAGE_INDEX:
            return super()._read_record(opcode, length)
        size = _INDEX.unpack(self._stream.read(_INDEX.size))[0]
        if _INDEX.size + size != length:
            raise ValueError(f"an index of {size} bytes in a record of {length}")
        self._stream.read(size)
        return None


def _split(chunk: Chunk) -> list[Schema | Channel | _Message]:
    """The records of a chunk; as the library's `breakup_chunk`, many times as fast for messages."""
    _check_size(chunk)
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    data = stream.read(size)
    found: list[Schema | Channel | _Message] = []
    at = 0
    while at < size:
        opcode, length = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        if opcode == Opcode.MESSAGE:
            channel, log_ns = _MESSAGE.unpack_from(data, at)
            found.append((channel, log_ns, data[at + _BEFORE_BODY : at + length]))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            record = Schema if opcode == Opcode.SCHEMA else Channel
            found.append(record.read(ReadDataStream(io.BytesIO(data[at : at + length]))))
        elif opcode == 0:
            raise ValueError("zeros instead of a record")
        at += length
    return found


def _check_size(chunk: Chunk) -> None:
    """Before it is uncompressed. Raises ValueError for one that is larger than any, by its own words or in truth."""
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        size = max(size, zstandard.frame_content_size(chunk.data))  # else the library takes at most `size` bytes
    elif chunk.compression == "lz4":
        with lz4.frame.LZ4FrameDecompressor() as decompressor:
            size = max(size, len(decompressor.decompress(chunk.data, _CHUNK_MAX + 1)))
    if size > _CHUNK_MAX:
        raise ValueError(f"a chunk of {size >> 20} MiB")


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
        return self.entries()

    def entries(self, topics: Collection[str] | None = None) -> Iterator[Entry]:
        """Messages in the order in which they were written. topics: those wanted; None: all."""
        schemas: dict[int, str] = {}
        channels: dict[int, tuple[str, str]] = {}  # topic and schema
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
                    channels[part.id] = part.topic, schemas.get(part.schema_id, "")
                elif part[0] in channels:
                    n += 1
                    topic, schema = channels[part[0]]
                    if topic.startswith(_RAW):
                        single.append(Entry(topic, schema, *part[1:]))
                        continue
                    if topic in _ORDERED:
                        yield from _together(single)
                    if topics is None or topic in topics:
                        yield Entry(topic, schema, *part[1:])
            yield from _together(single)

    def _parts(self, chunk: Chunk) -> list[Schema | Channel | _Message]:
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
                reader = _Reader(file, skip_magic=start > 0, emit_chunks=True, record_size_limit=_RECORD_MAX)
                try:
                    for record in reader.records:
                        self.read_bytes = file.tell()
                        ended = ended or isinstance(record, DataEnd)
                        yield record
                        if ended and isinstance(record, Statistics):
                            return  # what follows is an index
                    why = "it has no end"
                except (McapError, ValueError, struct.error, MemoryError, OverflowError) as error:
                    why = type(error).__name__
                if ended:
                    return
                at = f"at {self.read_bytes} bytes ({why})"
                start = _next_chunk(file, max(start, self.read_bytes) + 1)
                if start is None:
                    how = "broke off, as after a power cut, or is still being written,"
                    self.broken = f"{self.path} {how} {at}; read up to there"
                else:
                    self.broken = f"{self.path} is damaged {at}: what cannot be read is left out"
