"""Reading a port through its file descriptor, without blocking: a serial line's and a connection's alike."""

import os
import time
from abc import ABC, abstractmethod

from ..errors import PortLostError


class DescriptorPort(ABC):
    """A port with an open descriptor. An end of file and every error but "nothing is waiting" is the port's loss."""

    fd: int
    chunk: int  # bytes of one `read` at most

    @abstractmethod
    def _lost(self, error: OSError | None) -> PortLostError:
        """The error to raise; None: end of file."""

    def read(self) -> bytes:
        """What is waiting, at most a chunk; empty if nothing is."""
        try:
            data = os.read(self.fd, self.chunk)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._lost(error) from error
        if not data:
            raise self._lost(None)
        return data

    def receive(self, buffer: memoryview, now_ns: int) -> tuple[int, int]:
        """Read into `buffer`; returns how many bytes, and the time after that: they may come late, but never early."""
        try:
            received = os.readv(self.fd, [buffer])
        except BlockingIOError:
            return 0, now_ns
        except OSError as error:
            raise self._lost(error) from error
        if received == 0:
            raise self._lost(None)
        return received, time.monotonic_ns()
