"""The open descriptors of the ports: Python reads them, through the poll object; one of them the fast loop may read."""

import select

from ..pipeline import InertialPipeline
from .fast_loop import FastLoop
from .ports import Port


class Descriptors:
    """Which port has which descriptor. The fast loop reads one of them at most. Not thread-safe."""

    def __init__(self, fast_loop: FastLoop) -> None:
        self._fast_loop = fast_loop
        self._ports: dict[int, Port] = {}

    @property
    def fast(self) -> bool:
        """Whether the fast loop reads one of them."""
        return self._fast_loop.fd >= 0

    def __contains__(self, fd: int) -> bool:
        return fd in self._ports

    def __getitem__(self, fd: int) -> Port:
        return self._ports[fd]

    def add(self, port: Port, fd: int) -> None:
        """A port opened its device; Python reads it."""
        self._ports[fd] = port
        self._fast_loop.others.register(fd, select.POLLIN)

    def remove(self, fd: int) -> None:
        """A port closes its device."""
        del self._ports[fd]
        if fd == self._fast_loop.fd:
            self._fast_loop.detach()
        else:
            self._fast_loop.others.unregister(fd)

    def attach(self, fd: int, pipeline: InertialPipeline, stale_ns: int) -> None:
        """Have the fast loop read a descriptor into this stream, if it reads none yet; see `FastLoop.attach`."""
        if self._fast_loop.fd < 0:
            self._fast_loop.others.unregister(fd)
            self._fast_loop.attach(fd, pipeline, stale_ns)

    def detach(self, fd: int) -> None:
        """Have Python read a descriptor again, if the fast loop reads it."""
        if fd == self._fast_loop.fd:
            self._fast_loop.detach()
            self._fast_loop.others.register(fd, select.POLLIN)
