"""Addresses to listen on: as users write them, which are safe, and who holds one that is taken."""

import contextlib
import os
import re
import select
import socket
import stat
import subprocess
import sys

import pytest
from gpsd_loop import WATCH, Client

from imud.configuration.settings import Gpsd
from imud.errors import CannotCreateError, ConfigError, PermissionDeniedError
from imud.outputs.addresses import AddressInUseError, holder_of, is_local, listen, parse_address
from imud.outputs.gpsd import GpsdServer


@pytest.mark.parametrize(
    ("text", "shown", "local"),
    [
        ("127.0.0.1:2947", "127.0.0.1:2947", True),
        ("127.0.0.1", "127.0.0.1:2947", True),
        ("localhost:0", "127.0.0.1:0", True),
        ("[::1]:2948", "[::1]:2948", True),
        ("127.8.8.8:1", "127.8.8.8:1", True),
        ("2948", "127.0.0.1:2948", True),
        (":2947", "0.0.0.0:2947", False),
        ("0.0.0.0:2947", "0.0.0.0:2947", False),
        ("[::]:2947", "[::]:2947", False),
        ("[::ffff:127.0.0.1]:1", "[::ffff:127.0.0.1]:1", True),
        ("192.0.2.7:2947", "192.0.2.7:2947", False),
        ("/run/imud/gpsd.sock", "unix:/run/imud/gpsd.sock", True),
        ("unix:gpsd.sock", "unix:gpsd.sock", True),
    ],
)
def test_an_address_is_parsed_and_known_as_local_or_not(text, shown, local):
    address = parse_address(text, 2947)
    assert (address.text, is_local(address)) == (shown, local)


@pytest.mark.parametrize(
    "text", ["", "::1", "127.0.0.1:x", "127.0.0.1:65536", "99999", "[::1", "/" + "x" * 108, "no.such.invalid:1"]
)
def test_bad_addresses_are_named(text):
    with pytest.raises(ConfigError, match=f"^{re.escape(repr(text))} is no address: "):
        parse_address(text, 2947)


@pytest.mark.parametrize("listen", ["0.0.0.0:0", ":0", "127.0.0.1:0,0.0.0.0:0"])
def test_other_machines_are_refused_unless_allowed(listen):
    with pytest.raises(ConfigError, match="allow_remote"):
        GpsdServer(Gpsd(listen=listen), select.poll())
    server = GpsdServer(Gpsd(listen=listen, allow_remote=True), select.poll())
    assert any(address.startswith("0.0.0.0:") for address in server.addresses)
    server.close()


def test_an_address_in_use_names_the_holder(loop):
    with pytest.raises(AddressInUseError, match=rf"127\.0\.0\.1:\d+: in use by .* \(pid {os.getpid()}\)"):
        GpsdServer(Gpsd(listen=loop.server.addresses[0]), select.poll())
    assert AddressInUseError.exit_code == 73


def test_an_address_of_datagrams_in_use_names_the_holder_and_not_that_of_the_same_tcp_port():
    """A TCP listener of another process has the same number."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
        ours.bind(("127.0.0.1", 0))
        address = parse_address(f"127.0.0.1:{ours.getsockname()[1]}", 0)
        with listener(address.where) as other:
            assert holder_of(address).endswith(f"(pid {other})")
            with pytest.raises(AddressInUseError, match=rf"in use by .* \(pid {os.getpid()}\)"):
                listen(address, socket.SOCK_DGRAM)


@contextlib.contextmanager
def listener(where):
    """A process that listens; its number."""
    script = f"import socket; listening = socket.create_server({where!r}); print(flush=True); input()"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", script], **pipes) as process:
        assert process.stdout.readline()
        try:
            yield process.pid
        finally:
            process.communicate(b"\n")


def test_nobody_holds_a_free_port(loop):
    address = parse_address(loop.server.addresses[0], 0)
    assert holder_of(address) is not None
    loop.server.close()
    assert holder_of(address) is None


def test_the_port_is_free_again_at_once(loop):
    loop.connect(WATCH)
    (address,) = loop.server.addresses
    loop.server.close()
    server = GpsdServer(Gpsd(listen=address), select.poll())
    assert server.addresses == (address,)
    server.close()


def test_a_server_listens_on_ipv6(make_loop):
    try:
        loop = make_loop(listen="[::1]:0")
    except CannotCreateError as error:
        pytest.skip(f"no IPv6 here: {error}")
    with socket.create_connection(("::1", int(loop.server.addresses[0].rpartition(":")[2]))) as sock:
        loop.turn()
        assert Client(sock).classes() == ["VERSION"]


def test_unix_socket_beside_tcp(make_loop, tmp_path):
    path = tmp_path / "gpsd.sock"
    loop = make_loop(listen=f"127.0.0.1:0, {path}")
    assert stat.S_IMODE(path.stat().st_mode) == 0o666
    with socket.socket(socket.AF_UNIX) as sock:
        sock.connect(str(path))
        loop.turn()
        assert Client(sock).classes() == ["VERSION"]
    assert loop.connect().classes() == ["VERSION"]
    with pytest.raises(AddressInUseError, match=rf"pid {os.getpid()}"):
        GpsdServer(Gpsd(listen=str(path)), select.poll())
    loop.server.close()
    assert not path.exists()


def test_a_dead_unix_socket_is_replaced_and_a_file_is_not(make_loop, tmp_path):
    path = tmp_path / "gpsd.sock"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    make_loop(listen=str(path))
    file = tmp_path / "notes.txt"
    file.write_text("keep me")
    with pytest.raises(AddressInUseError):
        GpsdServer(Gpsd(listen=str(file)), select.poll())
    assert file.read_text() == "keep me"
    with pytest.raises(CannotCreateError, match=f"there is no folder {tmp_path}/none$"):
        GpsdServer(Gpsd(listen=str(tmp_path / "none/gpsd.sock")), select.poll())


def test_a_forbidden_path_is_named(tmp_path):
    tmp_path.chmod(0o500)
    root = os.geteuid() == 0
    try:
        if root:
            os.seteuid(65534)
        with pytest.raises(PermissionDeniedError, match=r"gpsd\.sock: permission denied"):
            GpsdServer(Gpsd(listen=str(tmp_path / "gpsd.sock")), select.poll())
    finally:
        if root:
            os.seteuid(0)
    tmp_path.chmod(0o700)
