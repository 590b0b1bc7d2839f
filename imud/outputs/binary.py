"""Solutions as records for the stream and the shared memory; nothing is done while nobody wants them."""

import time

import numpy as np
from numpy.typing import NDArray

from imud.client import MAGIC, RECORD, VERSION
from imud.estimators.records import SOLUTION
from imud.settings import Settings

from .gpsd import Poller
from .shared_memory import SharedMemory
from .stream import StreamServer

_HEADER = [("magic", "S4"), ("version", "<u2"), ("size", "<u2"), ("seq", "<u8"), ("utc_offset_ns", "<i8")]
_OPAQUE = np.dtype(("V", SOLUTION.itemsize))  # numpy copies a state as one, not field by field: 0.5 us instead of 17
LAYOUT = np.dtype([*_HEADER, ("state", SOLUTION)])  # imud.client.FIELDS, as numpy sees it


class BinaryOutputs:
    """The stream's server and the shared memory, as far as they are configured."""

    def __init__(self, settings: Settings, poller: Poller, batch: int) -> None:
        """Open for at most `batch` solutions at a time. Raises ImudError."""
        self.stream = StreamServer(settings.stream, poller)
        try:
            self._shared = SharedMemory(settings.shared_memory.path) if settings.shared_memory.path else None
        except BaseException:
            self.stream.close()
            raise
        self._records = np.zeros(batch, LAYOUT)
        self._records["magic"], self._records["version"], self._records["size"] = MAGIC, VERSION, RECORD.size
        self._states = self._records["state"].view(_OPAQUE)
        self._bytes = self._records.view(np.uint8).data
        self._words = self._records.view(np.uint64).reshape(batch, -1)

    def publish(self, solutions: NDArray[np.void], n: int, seq: int, now_ns: int) -> None:
        """The first `n` of `solutions`, the last of them being the sample number `seq`."""
        if not self.stream.clients and self._shared is None:
            return
        records = self._records[:n]
        records["seq"] = np.arange(seq - n + 1, seq + 1)
        records["utc_offset_ns"] = time.time_ns() - time.monotonic_ns()
        self._states[:n] = solutions[:n].view(_OPAQUE)
        if self._shared is not None:
            self._shared.publish(self._words[n - 1])
        if self.stream.clients:
            self.stream.publish(self._bytes[: n * RECORD.size], seq - n + 1, now_ns)

    def close(self) -> None:
        self.stream.close()
        if self._shared is not None:
            self._shared.close()
            self._shared = None
