"""Connections over TCP: to a gpsd (`gpsd://HOST[:PORT][/DEVICE]`), to a base of corrections. Nothing ever blocks."""

import _thread
import contextlib
import errno
import math
import os
import socket
import time
from collections import Counter
from collections.abc import Mapping
from typing import Any

from ..errors import PortAbsentError, PortLostError
from .descriptor import DescriptorPort
from .portspec import PortSpec

_FRESH_S = 60.0  # after which an address is looked up anew, while the old one is used: it may be another one now
Addresses = list[tuple[int, Any]]  # families and addresses of a host

_found: dict[tuple[str, int], tuple[float, Addresses | OSError]] = {}  # by host and port, and when
_asked: set[tuple[str, int]] = set()  # whose addresses a thread looks up
_skipped = Counter[tuple[str, int]]()  # connections that brought nothing, by host and port


def _resolve(host: str, port: int, flags: int = 0) -> Addresses:
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=flags)
    return [(family, address) for family, _, _, _, address in found]


def look_up(host: str, port: int) -> None:
    """Look up the addresses of a host, for `connect`; waits for a name server, which may not answer for a minute."""
    found: Addresses | OSError
    try:
        found = _resolve(host, port)
    except OSError as error:
        found = error
    except UnicodeError:  # such as an empty part of a name, as in `a..b`
        found = socket.gaierror(socket.EAI_NONAME, "no host can have that name")
    before = _found.get((host, port), (0.0, found))[1]
    _found[host, port] = time.monotonic(), before if isinstance(found, OSError) else found
    _asked.discard((host, port))


def _addresses(host: str, port: int) -> Addresses:
    """Families and addresses of a host. Raises OSError, BlockingIOError while a thread looks up the first ones."""
    with contextlib.suppress(socket.gaierror, UnicodeError):
        return _resolve(host, port, socket.AI_NUMERICHOST)  # numbers need no name server
    key = host, port
    since_s, found = _found.get(key, (-math.inf, None))
    if key not in _asked and time.monotonic() - since_s > _FRESH_S:
        _asked.add(key)
        try:
            _thread.start_new_thread(look_up, key)
        except RuntimeError as error:  # the limit of threads, or of memory
            _asked.discard(key)
            raise OSError(errno.EAGAIN, str(error)) from error
    if found is None:
        raise BlockingIOError(errno.EAGAIN, "its address is being looked up")
    if isinstance(found, OSError):
        del _found[key]  # the next attempt looks it up anew
        raise found
    return found


def _connect(family: int, address: Any) -> tuple[socket.socket, int]:
    """A socket that is being connected, and the error number; 0: none yet. This machine refuses at once."""
    connection = socket.socket(family, socket.SOCK_STREAM)
    connection.setblocking(False)
    number = connection.connect_ex(address)
    if number == errno.EINPROGRESS:
        number = connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    return connection, number


def connect(host: str, port: int) -> socket.socket:
    """A connection that is made or being made; never blocks.

    Raises OSError, BlockingIOError while the host's address is being looked up.
    """
    number = errno.EHOSTUNREACH
    addresses = _addresses(host, port)
    first = _skipped[host, port] % len(addresses)
    for family, address in addresses[first:] + addresses[:first]:
        connection, number = _connect(family, address)
        if number == 0:
            return connection
        connection.close()
    raise OSError(number, os.strerror(number))


def skip_address(host: str, port: int) -> None:
    """Begin with the host's next address from now on: a connection brought nothing, and servers may have but one."""
    _skipped[host, port] += 1


class TcpPort(DescriptorPort):
    """An open connection, or one that is being made. Not thread-safe.

    Raises PortAbsentError on opening and PortLostError in use. What is written before there is a connection is lost:
    the other side must greet first.
    """

    warning, plain, chunk = "", False, 65536

    def __init__(self, spec: PortSpec) -> None:
        assert spec.server is not None
        self.path = spec.path
        self._server = host, port = spec.server[:2]
        self._where = f"{host} port {port}"
        try:
            self._socket = connect(host, port)
        except BlockingIOError as error:
            raise PortAbsentError(self.path, f"{host}: {error.strerror}") from error
        except socket.gaierror as error:
            raise PortAbsentError(self.path, f"{host}: {error.strerror}: name a host that there is") from error
        except OSError as error:
            raise PortAbsentError(self.path, self._refusal(error.errno or errno.EIO)) from error
        self._connected = False
        self.fd: int = self._socket.fileno()

    @property
    def counters(self) -> Mapping[str, int]:
        """See `Line`: TCP repairs what goes wrong."""
        return {}

    def set_baud(self, baud: int) -> None:
        """See `DialoguePort`: a connection has no speed."""

    def discard(self) -> None:
        """See `DialoguePort`: the greeting must not be thrown away, and nothing is waiting else."""

    def write(self, data: bytes) -> int:
        """Send a short request."""
        try:
            return self._socket.send(data)
        except OSError as error:
            raise self._lost(error) from error

    def read(self) -> bytes:
        """What is waiting; empty if nothing is."""
        data = super().read()
        self._connected = self._connected or bool(data)
        return data

    def close(self) -> None:
        """Close the connection. May be called twice."""
        if not self._connected and self._socket.fileno() >= 0:
            skip_address(*self._server)
        self._socket.close()

    def _refusal(self, number: int) -> str:
        return f"no gpsd at {self._where} ({os.strerror(number)}): is it running, and does it listen there?"

    def _lost(self, error: OSError | None) -> PortLostError:
        if not self._connected and error is not None and error.errno:
            return PortLostError(self.path, self._refusal(error.errno))
        why = f": {error.strerror}" if error is not None else ""
        return PortLostError(self.path, f"gpsd at {self._where} ended the connection{why}")
