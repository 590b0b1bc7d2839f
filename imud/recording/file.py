"""One MCAP file of a recording; whatever happens, it is complete on the disk up to the last second."""

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path

from mcap.writer import CompressionType, Writer

from imud.drivers.capture_messages import CHECKSUM, FORMAT, SESSION, checksum_of

from .messages import SCHEMAS

_CHUNK_BYTES = 1 << 20


class RecordingFile:
    """Opened for writing. To open it may raise OSError, which leaves no file behind.

    So may any other method but `abandon` and `discard`: then `abandon` it; what was committed stays readable.
    """

    def __init__(self, path: Path, facts: Mapping[str, str], settings: bytes, unix_ns: int) -> None:
        self.path = path
        self._file = path.open("xb")
        self._committed = 0
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._channels: dict[str, int] = {}
        self._count: dict[int, int] = {}
        try:
            self._writer.start(profile="imud", library=f"imud {facts['version']}")
            facts = {"format": str(FORMAT), **facts}
            self._writer.add_metadata(SESSION, {**facts, CHECKSUM: checksum_of(facts)})
            self._writer.add_attachment(unix_ns, unix_ns, "settings.json", "application/json", settings)
            self.commit()
            _sync_folder(path.parent)
        except OSError:
            self.abandon()
            raise

    @property
    def size(self) -> int:
        """Bytes committed."""
        return self._committed

    @property
    def is_in_place(self) -> bool:
        """Whether a file of its name is there, and it was not removed: what is written to it then is lost."""
        return os.path.lexists(self.path) and os.fstat(self._file.fileno()).st_nlink > 0

    def write(self, topic: str, unix_ns: int, data: bytes) -> None:
        """A message, at the time by which viewers show it."""
        channel = self._channels.get(topic)
        if channel is None:
            schema = SCHEMAS[topic]
            number = self._writer.register_schema(schema.name, schema.schema_encoding, schema.data)
            channel = self._channels[topic] = self._writer.register_channel(topic, schema.encoding, number)
        sequence = self._count[channel] = self._count.get(channel, -1) + 1
        self._writer.add_message(channel, unix_ns, data, unix_ns, sequence & 0xFFFFFFFF)

    def declare_again(self) -> None:
        """Write the schemas and channels once more: where the chunk with the first ones is damaged, others are read."""
        chunk = self._writer._Writer__chunk_builder  # type: ignore[attr-defined]  # the library has no public way
        for schema in self._writer._Writer__schemas.values():  # type: ignore[attr-defined]
            chunk.add_schema(schema)
        for channel in self._writer._Writer__channels.values():  # type: ignore[attr-defined]
            chunk.add_channel(channel)

    def commit(self) -> None:
        """End the chunk, and have it on the disk."""
        self._writer._Writer__finalize_chunk()  # type: ignore[attr-defined]  # the library has no public way
        self._file.flush()
        os.fdatasync(self._file.fileno())
        self._committed = self._file.tell()

    def finish(self) -> None:
        """Close with summary and index."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.flush()
        os.fsync(self._file.fileno())
        self._committed = self._file.tell()
        self._file.close()

    def abandon(self) -> None:
        """Close after a failure, cut off behind what was committed; an empty file is removed."""
        with contextlib.suppress(OSError):
            os.ftruncate(self._file.fileno(), self._committed)
        with contextlib.suppress(OSError):
            self._file.raw.close()  # without what is buffered
        with contextlib.suppress(OSError, ValueError):
            self._file.close()
        if not self._committed:
            with contextlib.suppress(OSError):
                self.path.unlink()

    def discard(self) -> None:
        """Close and remove."""
        self._committed = 0
        self.abandon()


def _sync_folder(folder: Path) -> None:
    """Have the file's name on the disk, too."""
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
