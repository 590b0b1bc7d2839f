"""Solutions as records for the stream and the shared memory. Without a reader no record is made.

`publish` is compiled, because the daemon's fast loop calls it without Python (`imud/daemon/fast_loop.py`).
"""

import numpy as np

from ..client import MAGIC, RECORD, VERSION
from ..compile.entry import entry
from ..compile.system import CLOCK_MONOTONIC, CLOCK_REALTIME, clock_ns, records
from ..configuration.settings import Settings
from ..estimators.records import SOLUTION
from ..math.arrays import Records
from .listeners import Poller
from .shared_memory import WORD, SharedMemory, write
from .stream import CLIENT, StreamServer, send_all

_HEADER = [("magic", "S4"), ("version", "<u2"), ("size", "<u2"), ("seq", "<u8"), ("utc_offset_ns", "<i8")]
LAYOUT = np.dtype([*_HEADER, ("state", SOLUTION)])  # imud.client.FIELDS, as numpy sees it
_WORDS, _STATE_WORDS = LAYOUT.itemsize // 8, SOLUTION.itemsize // 8
_SEQ, _UTC_OFFSET, _STATE = 1, 2, 3  # indices of LAYOUT's 64-bit words; magic, version and size are one

PUBLISHER = np.dtype(
    [
        ("messages", "<i8"),  # addresses: of rows of LAYOUT,
        ("shared", "<i8"),  # of the shared memory's contents; 0: there is none
        ("clients", "<i8"),  # of rows of CLIENT,
        ("shared_file", "<i8"),  # descriptor of the shared memory
        ("connected", "<i8"),  # and their number
        ("dropped", "<i8"),  # records that slow clients lost
        ("time", "<i8", (2,)),  # room for a timespec
        ("time_at", "<i8"),
    ],
    align=True,
)


@entry
def publish(publisher: Records, solutions: int, n: int, seq: int, now_ns: int) -> None:
    """The first n of the SOLUTION rows at the address `solutions`, the last of them being the sample number `seq`."""
    p = publisher[0]
    if p.connected == 0 and p.shared == 0:
        return
    messages, states = records(p.messages, n * _WORDS, WORD), records(solutions, n * _STATE_WORDS, WORD)
    monotonic_ns = clock_ns(CLOCK_MONOTONIC, p.time_at)
    utc_offset_ns = clock_ns(CLOCK_REALTIME, p.time_at) - monotonic_ns
    for k in range(n):
        messages[k * _WORDS + _SEQ] = seq - n + 1 + k
        messages[k * _WORDS + _UTC_OFFSET] = utc_offset_ns
        for i in range(_STATE_WORDS):
            messages[k * _WORDS + _STATE + i] = states[k * _STATE_WORDS + i]
    if p.shared:
        write(p.shared_file, p.shared, messages[(n - 1) * _WORDS :], monotonic_ns)
    if p.connected:
        p.dropped += send_all(records(p.clients, p.connected, CLIENT), p.messages, _WORDS * 8, n, seq, now_ns)


class BinaryOutputs:
    """The stream's server and the shared memory, as far as they are configured.

    `record` (array of one PUBLISHER) is the view that compiled code has of them.
    """

    def __init__(self, settings: Settings, poller: Poller, batch: int) -> None:
        """Open for at most `batch` solutions at a time. Raises ImudError."""
        self.record = np.zeros(1, PUBLISHER)
        self.stream = StreamServer(settings.stream, poller, self.record)
        try:
            self._shared = SharedMemory(settings.shared_memory.path) if settings.shared_memory.path else None
        except BaseException:
            self.stream.close()
            raise
        self._messages = np.zeros(batch if settings.stream.listen or self._shared else 0, LAYOUT)
        self._messages["magic"], self._messages["version"], self._messages["size"] = MAGIC, VERSION, RECORD.size
        self.record["messages"] = self._messages.ctypes.data
        self.record["time_at"] = self.record["time"].ctypes.data
        if self._shared:
            self.record["shared"], self.record["shared_file"] = self._shared.address, self._shared.file

    def publish(self, solutions: Records, n: int, seq: int, now_ns: int) -> None:
        """The first `n` of `solutions`, the last of them being the sample number `seq`."""
        publish(self.record, solutions.ctypes.data, n, seq, now_ns)

    def tick(self, now_ns: int) -> None:
        """Call several times per second: disconnects stalled clients and writes the shared memory's heartbeat."""
        self.stream.tick(now_ns)
        if self._shared is not None:
            self._shared.write_heartbeat(now_ns)

    def close(self) -> None:
        self.stream.close()
        if self._shared is not None:
            self.record["shared"] = 0
            self._shared.close()
            self._shared = None
