"""An MCAP file that is written chunk by chunk, many messages of one size at once.

The writer of the library `mcap` takes a message at a time, longer for each than making it. Here are its records.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import BinaryIO, NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Footer, Header, McapRecord, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from ..math.arrays import Indices
from .cdr import Bytes, Cdr

_LEVEL = -1  # of zstd: two thirds less time than the default, and 6 % more bytes of these messages
_MESSAGE = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("made", "<u8")]
)
_BEFORE_LENGTH_COUNTS = 9  # bytes
_INDEX = np.dtype([("log", "<u8"), ("offset", "<u8")])


class Rows(NamedTuple):
    """n > 0 messages, their channel and times."""

    channel: int
    unix_ns: Indices
    messages: Cdr


class BlockWriter:
    """Writes to an open file, from its beginning."""

    def __init__(self, file: BinaryIO, profile: str) -> None:
        self._file = file
        self._at = 0
        self._memory = np.empty(0, np.uint8)
        self._compressor = zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True)
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._unwritten: list[McapRecord] = []  # of both: for the next chunk
        self._chunks: list[ChunkIndex] = []
        self._counts: defaultdict[int, int] = defaultdict(int)  # of messages, by channel
        self._write(MCAP0_MAGIC)
        self._write_records([Header(profile, "imud")])

    def add_channel(self, topic: str, encoding: str, schema: tuple[str, str, bytes], facts: Mapping[str, str]) -> int:
        """schema: name, encoding and text. Returns the channel's number."""
        number = 1 + len(self._channels)
        name, kind, text = schema
        self._schemas.append(Schema(id=number, name=name, encoding=kind, data=text))
        self._channels.append(
            Channel(id=number, topic=topic, message_encoding=encoding, metadata=dict(facts), schema_id=number)
        )
        self._unwritten += [self._schemas[-1], self._channels[-1]]
        return number

    def write_chunk(self, blocks: Iterable[Rows]) -> None:
        """Messages, at least one."""
        blocks = list(blocks)
        start = np.frombuffer(_bytes_of(self._unwritten), np.uint8)
        self._unwritten.clear()
        sizes = [len(start), *(len(rows.unix_ns) * (_MESSAGE.itemsize + rows.messages.size) for rows in blocks)]
        data = self._room(sum(sizes))
        data[: len(start)] = start
        indices: defaultdict[int, list[bytes]] = defaultdict(list)
        at = len(start)
        for rows, size in zip(blocks, sizes[1:], strict=True):
            indices[rows.channel].append(_write_messages(rows, data[at : at + size], at))
            at += size
            self._counts[rows.channel] += len(rows.unix_ns)
        times = np.concatenate([rows.unix_ns for rows in blocks])
        chunk = Chunk(
            compression="zstd",
            data=self._compressor.compress(data.data),
            message_start_time=int(times.min()),
            message_end_time=int(times.max()),
            uncompressed_crc=0,  # none: zstd has its own checksum, several times as fast, which every reader compares
            uncompressed_size=len(data),
        )
        self._write_indexed(chunk, indices)

    def _room(self, size: int) -> Bytes:
        """Memory for a chunk, the same again and again."""
        if len(self._memory) < size:
            self._memory = np.empty(2 * size, np.uint8)
        return self._memory[:size]

    def _write_indexed(self, chunk: Chunk, indices: Mapping[int, list[bytes]]) -> None:
        """indices: of each channel the parts of its message index."""
        chunk_at = self._at
        self._write_records([chunk])
        indices_at = self._at
        offsets = {}
        for channel, index in indices.items():
            offsets[channel] = self._at
            self._write(_index_record(channel, b"".join(index)))
        self._chunks.append(
            ChunkIndex(
                chunk_start_offset=chunk_at,
                chunk_length=indices_at - chunk_at,
                message_index_offsets=offsets,
                message_index_length=self._at - indices_at,
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                uncompressed_size=chunk.uncompressed_size,
            )
        )

    def finish(self) -> None:
        """Write what readers begin with."""
        self._write_records([DataEnd(data_section_crc=0)])
        summary_at = self._at
        self._write_records([*self._schemas, *self._channels, self._statistics(), *self._chunks])
        self._write_records([Footer(summary_start=summary_at, summary_offset_start=0, summary_crc=0)])
        self._write(MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            channel_message_counts=dict(self._counts),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            attachment_count=0,
            metadata_count=0,
        )

    def _write_records(self, records: Iterable[McapRecord]) -> None:
        self._write(_bytes_of(records))

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self._at += len(data)


def _bytes_of(records: Iterable[McapRecord]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _write_messages(rows: Rows, data: Bytes, at: int) -> bytes:
    """Message records into `data`, which is at `at` in the chunk; returns for the index the time and place of each."""
    n, before = len(rows.unix_ns), _MESSAGE.itemsize
    records = data.reshape(n, before + rows.messages.size)
    head = np.zeros(n, _MESSAGE)
    head["opcode"], head["length"] = Opcode.MESSAGE, records.shape[1] - _BEFORE_LENGTH_COUNTS
    head["channel"], head["log"], head["made"] = rows.channel, rows.unix_ns, rows.unix_ns
    records[:, :before] = head.view(np.uint8).reshape(n, before)
    rows.messages.fill(records[:, before:])
    index = np.empty(n, _INDEX)
    index["log"], index["offset"] = rows.unix_ns, at + records.shape[1] * np.arange(n)
    return index.tobytes()


def _index_record(channel: int, entries: bytes) -> bytes:
    """A MessageIndex."""
    head = np.array(
        (Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries)),
        [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("bytes", "<u4")],
    )
    return head.tobytes() + entries
