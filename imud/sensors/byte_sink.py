"""How many bytes of a sensor are read at a time, and who else gets them."""

from typing import Protocol

READ_BYTES = 4096  # bytes at a time: fewer frames than the pipeline takes in one batch


class ByteSink(Protocol):
    """Called with all bytes as they are read, their arrival, and the receiver's last pulse per second before that."""

    def __call__(self, data: bytes | memoryview, t_ns: int, pulse_ns: int | None = None) -> None: ...
