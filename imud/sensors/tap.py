"""How a sensor's bytes are read: so many at a time, and with whom they are shared."""

from typing import Protocol

READ = 4096  # bytes at a time: fewer frames than the pipeline takes in one batch


class Tap(Protocol):
    """Is handed all bytes as they are read, when they were there, and the last pulse per second before."""

    def __call__(self, data: bytes | memoryview, t_ns: int, pulse_ns: int | None = None) -> None: ...
