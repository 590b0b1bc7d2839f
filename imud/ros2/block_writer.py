"""An MCAP writer that takes many messages of one size at once; the library's takes longer for each than making it."""

from typing import Any

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import MessageIndex
from mcap.writer import Writer

from ..math.arrays import Indices
from .cdr import Bytes

_HEADER = [
    ("opcode", "u1"),
    ("length", "<u8"),
    ("channel", "<u2"),
    ("sequence", "<u4"),
    ("log", "<u8"),
    ("made", "<u8"),
]
_BEFORE_LENGTH_COUNTS = 9  # bytes
_INDEX = np.dtype([("log", "<u8"), ("offset", "<u8")])


class _Index(MessageIndex):
    """Its records in arrays."""

    def __init__(self, channel_id: int) -> None:
        super().__init__(channel_id, [])
        self.blocks: list[Any] = []

    def write(self, stream: RecordBuilder) -> None:
        """See `MessageIndex`."""
        single = np.array(self.records, np.uint64).reshape(-1, 2)
        data = b"".join([single.tobytes(), *(block.tobytes() for block in self.blocks)])
        stream.start_record(Opcode.MESSAGE_INDEX)
        stream.write2(self.channel_id)
        stream.write4(len(data))
        stream.write(data)
        stream.finish_record()  # type: ignore[no-untyped-call]


class BlockWriter(Writer):
    """The library's, and `add_rows`."""

    def add_rows(self, channel: int, unix_ns: Indices, data: Bytes) -> None:
        """n > 0 messages: their times, and a row of bytes each. All of a channel's must come this way."""
        own: Any = self  # whose parts have private names
        builder, counted = own._Writer__chunk_builder, own._Writer__statistics
        n, size = data.shape
        rows = np.zeros(n, [*_HEADER, ("data", "u1", (size,))])
        rows["opcode"], rows["length"] = Opcode.MESSAGE, rows.itemsize - _BEFORE_LENGTH_COUNTS
        rows["channel"], rows["log"], rows["made"], rows["data"] = channel, unix_ns, unix_ns, data
        index = np.zeros(n, _INDEX)
        index["log"], index["offset"] = unix_ns, builder.count + rows.itemsize * np.arange(n)
        builder.message_indices.setdefault(channel, _Index(channel)).blocks.append(index)
        first_ns, last_ns = int(unix_ns.min()), int(unix_ns.max())
        for counts, number, start, end in (
            (builder, "num_messages", "message_start_time", "message_end_time"),
            (counted, "message_count", "message_start_time", "message_end_time"),
        ):
            before = getattr(counts, number)
            setattr(counts, start, min(first_ns, getattr(counts, start)) if before else first_ns)
            setattr(counts, end, max(last_ns, getattr(counts, end)))
            setattr(counts, number, before + n)
        counted.channel_message_counts[channel] += n
        builder.record_writer.write(rows.tobytes())
        own._Writer__maybe_finalize_chunk()
