"""Listening sockets: parsing of addresses, which of them are safe to open, and which process holds one in use."""

import errno
import os
import re
import socket
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ..errors import CannotCreateError, ConfigError, PermissionDeniedError

if TYPE_CHECKING:
    from ..configuration.settings import Gpsd

PORT = 2947  # gpsd's
_BACKLOG = 128
_IPV4_MAPPED, _IPV6_LOOPBACK = bytes(10) + b"\xff\xff", bytes(15) + b"\x01"  # RFC 4291, 2.5.5.2 and 2.5.3
_LISTENING, _UNCONNECTED = "0A", "07"  # TCP_LISTEN in /proc/net/tcp, TCP_CLOSE in /proc/net/udp


class AddressInUseError(CannotCreateError):
    """Another process listens there already."""


class Address(NamedTuple):
    """A TCP address or the path of a Unix socket."""

    text: str
    family: socket.AddressFamily
    where: str | tuple[str, int]


def parse_address(text: str, default_port: int) -> Address:
    """`HOST[:PORT]`, `[IPV6][:PORT]`, `/PATH`, `unix:PATH`, or `PORT` of 127.0.0.1. An empty host is all of IPv4.

    Raises ConfigError for anything else and for names that do not resolve.
    """
    text = text.strip()
    if text.startswith(("/", "unix:")):
        return parse_path(text)
    match = re.fullmatch(r"(?:\[(?P<v6>[^\]]+)\]|(?P<host>[^:\[\]]*))(?::(?P<port>\d{1,5}))?", text, re.ASCII)
    if not match or not text:
        raise ConfigError(
            f"{text!r} is no address: write it as HOST:PORT, [IPV6]:PORT or /path/of/socket, "
            f"for example 127.0.0.1:{default_port}"
        )
    host, digits = match["v6"] or match["host"] or "0.0.0.0", match["port"]
    if host.isdecimal() and not digits:
        host, digits = "127.0.0.1", host
    port = int(digits or default_port)
    if port > 65535:
        raise ConfigError(f"{text!r} is no address: the highest port is 65535")
    family, host = _resolve(host, text)
    return Address(_host_port(host, port), family, (host, port))


def addresses_of(settings: "Gpsd") -> list[Address]:
    """The listening addresses. Raises ConfigError for a wrong syntax, and without allow_remote for remote access."""
    addresses = [parse_address(text, PORT) for text in settings.listen.split(",")]
    for address in addresses:
        if not settings.allow_remote and not is_local(address):
            raise ConfigError(
                f"refusing to listen on {address.text}: other machines could connect, and the protocol has no "
                "password; listen on 127.0.0.1, or set gpsd.allow_remote = true"
            )
    return addresses


def parse_path(text: str) -> Address:
    """`/PATH` or `unix:PATH`. Raises ConfigError for a path that no Unix socket can have."""
    path = text.strip().removeprefix("unix:")
    if not 0 < len(os.fsencode(path)) < 108 or "\0" in path:  # sizeof(sockaddr_un.sun_path)
        raise ConfigError(f"{text!r} is no address: the path of a Unix socket has 1 to 107 bytes")
    return Address(f"unix:{path}", socket.AF_UNIX, path)


def _resolve(host: str, text: str) -> tuple[socket.AddressFamily, str]:
    try:
        name = host.encode() if host.isascii() else host  # a str would load the tables of international names
        found = socket.getaddrinfo(name, None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise ConfigError(f"{text!r} is no address: {why}") from None
    found.sort(key=lambda entry: entry[0] != socket.AF_INET)  # `localhost` is 127.0.0.1 to most clients
    return found[0][0], str(found[0][4][0])


def _host_port(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def is_from_this_machine(sock: socket.socket) -> bool:
    """Whether the peer of a connection is on this machine."""
    if sock.family == socket.AF_UNIX:
        return True
    try:
        return _is_loopback(sock.getpeername()[0])
    except OSError:  # gone
        return False


def is_local(address: Address) -> bool:
    """True when no other machine can connect."""
    return isinstance(address.where, str) or _is_loopback(address.where[0])


def _is_loopback(host: str) -> bool:
    """Of a numeric address; `ipaddress` would say the same, at the cost of 0.3 MB."""
    packed = socket.inet_pton(socket.AF_INET6 if ":" in host else socket.AF_INET, host.partition("%")[0])
    packed = packed.removeprefix(_IPV4_MAPPED)
    return packed[0] == 127 if len(packed) == 4 else packed == _IPV6_LOOPBACK


def listen(address: Address, kind: socket.SocketKind = socket.SOCK_STREAM) -> socket.socket:
    """A non-blocking listening socket, or one for datagrams. All users of this machine may connect to a Unix socket.

    Raises AddressInUseError naming the holder where it can be found, PermissionDeniedError, CannotCreateError.
    """
    sock = socket.socket(address.family, kind)
    try:
        sock.setblocking(False)
        if isinstance(address.where, str):
            _remove_stale_socket(address.where, kind)
        else:
            if kind != socket.SOCK_DGRAM:  # two may receive datagrams at one address then
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if address.family == socket.AF_INET6:
                sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        sock.bind(address.where)
        if isinstance(address.where, str):
            Path(address.where).chmod(0o666)  # a service's umask would exclude all other users
        if kind != socket.SOCK_DGRAM:
            sock.listen(_BACKLOG)
    except OSError as error:
        sock.close()
        raise _listen_error(address, kind, error) from error
    return sock


def address_text(sock: socket.socket) -> str:
    """Where a socket listens, with the port that the system chose for port 0."""
    name = sock.getsockname()
    return f"unix:{name}" if isinstance(name, str) else _host_port(name[0], name[1])


def _remove_stale_socket(path: str, kind: socket.SocketKind) -> None:
    """Remove the socket file of a process that ended; a socket in use and other kinds of file stay."""
    if not Path(path).is_socket():
        return
    with socket.socket(socket.AF_UNIX, kind) as probe:
        probe.setblocking(False)
        try:
            probe.connect(path)
        except ConnectionRefusedError:
            Path(path).unlink(missing_ok=True)
        except OSError:  # in use: busy, or of another kind
            pass


def _listen_error(address: Address, kind: socket.SocketKind, error: OSError) -> Exception:
    if error.errno == errno.EADDRINUSE and isinstance(address.where, str) and not Path(address.where).is_socket():
        return AddressInUseError(
            f"cannot listen on {address.text}: there is a file that is no socket; choose another name"
        )
    if error.errno == errno.EADDRINUSE:
        holder = holder_of(address, kind)
        by = f" by {holder}" if holder else ""
        return AddressInUseError(f"cannot listen on {address.text}: in use{by}; stop that or choose another")
    if error.errno in (errno.EACCES, errno.EPERM):
        return PermissionDeniedError(f"cannot listen on {address.text}: permission denied")
    if error.errno == errno.ENOENT and isinstance(address.where, str):
        return CannotCreateError(f"cannot listen on {address.text}: there is no folder {Path(address.where).parent}")
    return CannotCreateError(f"cannot listen on {address.text}: {error.strerror or error}")


def holder_of(address: Address, kind: socket.SocketKind = socket.SOCK_STREAM) -> str | None:
    """`gpsd (pid 123)` for the process that listens there, as far as /proc shows it to this user."""
    sockets = {f"socket:[{inode}]" for inode in _inodes(address, kind)}
    if not sockets:
        return None
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if any(str(entry.readlink()) in sockets for entry in (process / "fd").iterdir()):
                return f"{(process / 'comm').read_text().strip()} (pid {process.name})"
        except OSError:  # gone meanwhile, or another user's
            continue
    return None


def _inodes(address: Address, kind: socket.SocketKind) -> set[str]:
    if isinstance(address.where, str):
        rows = _rows("unix")
        return {row[6] for row in rows if len(row) > 7 and row[7] == address.where}
    port = f"{address.where[1]:04X}"
    name, state = ("udp", _UNCONNECTED) if kind == socket.SOCK_DGRAM else ("tcp", _LISTENING)
    rows = [row for table in (name, f"{name}6") for row in _rows(table)]
    return {row[9] for row in rows if row[1].rpartition(":")[2] == port and row[3] == state}


def _rows(table: str) -> Iterable[list[str]]:
    try:
        return [row.split() for row in Path("/proc/net", table).read_text().splitlines()[1:]]
    except OSError:
        return []
