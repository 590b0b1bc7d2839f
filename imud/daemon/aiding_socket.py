"""The socket on which other programs send measurements: a Unix datagram socket, or UDP on this machine only."""

import contextlib
import select
import socket
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from ..errors import ConfigError
from ..outputs.addresses import Address, address_text, is_local, listen, parse_address

PORT = 2950
LONGEST = 4096  # bytes of a datagram
_AT_ONCE = 32  # lines read in one call, or little more, so that a flood does not keep the loop from the sensors


class Poller(Protocol):
    """What the socket needs of the loop's poll object."""

    def register(self, fd: int, eventmask: int, /) -> None: ...
    def unregister(self, fd: int, /) -> None: ...


def address_of(text: str) -> Address:
    """`/path`, `unix:PATH` or `HOST[:PORT]`. Raises ConfigError, also where other machines could send."""
    address = parse_address(text, PORT)
    if not is_local(address):
        raise ConfigError(
            f"refusing to receive measurements on {address.text}: other machines could send false ones; set "
            f"aiding.listen to 127.0.0.1:{PORT} or to the path of a Unix socket"
        )
    return address


class AidingSocket:
    """Never blocks; not thread-safe. Raises ConfigError, CannotCreateError and others as `listen`."""

    def __init__(self, text: str, poller: Poller) -> None:
        self._poller, self.messages = poller, deque[str]()  # always empty; as `IioReader.messages`
        self._socket = listen(address_of(text), socket.SOCK_DGRAM)
        self.fd = self._socket.fileno()
        self.address = address_text(self._socket)
        poller.register(self.fd, select.POLLIN)

    def datagrams(self) -> Iterator[bytes | None]:
        """The datagrams that have come, until they have `_AT_ONCE` lines; None for one that is too long."""
        lines = 0
        while lines < _AT_ONCE:
            try:
                data, _, flags, _ = self._socket.recvmsg(LONGEST)
            except OSError:  # none is left, or the socket reports an error of an earlier datagram
                return
            lines += 1 + data.count(b"\n")
            yield None if flags & socket.MSG_TRUNC else data

    def close(self) -> None:
        self._poller.unregister(self.fd)
        name = self._socket.getsockname()
        if isinstance(name, str):
            with contextlib.suppress(OSError):
                Path(name).unlink()
        self._socket.close()
