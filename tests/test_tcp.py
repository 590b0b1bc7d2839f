"""Connections to servers by name: a name server that does not answer must not stop the daemon."""

import contextlib
import socket
import struct
import threading
import time
from collections import Counter

import pytest
from test_rtcm import STATION

from imud.daemon.corrections import Corrections
from imud.drivers.errors import PortAbsentError, PortLostError
from imud.drivers.transport import tcp
from imud.drivers.transport.line import check_port, open_line
from imud.drivers.transport.portspec import PortSpec

NONE = socket.gaierror(socket.EAI_NONAME, "Name or service not known")
SECOND = 10**9


@pytest.fixture
def name_server(monkeypatch):
    """Answers once its event is set, with what `found` holds; nobody waits longer than a minute for it."""

    class NameServer:
        answers, asked, found = threading.Event(), 0, NONE

        def look_up(self, host, port, flags=0, **_):
            if flags & socket.AI_NUMERICHOST:
                raise NONE
            self.asked += 1
            self.answers.wait(60.0)
            if isinstance(self.found, OSError):
                raise self.found
            return [(socket.AF_INET, socket.SOCK_STREAM, 0, "", (found, port)) for found in self.found.split()]

    server = NameServer()
    monkeypatch.setattr(socket, "getaddrinfo", server.look_up)
    monkeypatch.setattr(tcp, "_found", {})
    monkeypatch.setattr(tcp, "_skipped", Counter())
    yield server
    server.answers.set()


def until_answered(host, port):
    deadline = time.monotonic() + 30.0
    while (host, port) in tcp._asked:
        assert time.monotonic() < deadline
        time.sleep(0.001)


def test_a_name_server_that_does_not_answer_stops_neither_corrections_nor_ports(name_server):
    corrections = Corrections("base.example:2101")
    assert corrections.read(0) == []
    assert "its address is being looked up" in corrections.properties(0)["state"]
    assert ("base.example", 2101) in tcp._asked, "it has waited for the name server"
    spec = PortSpec.parse("gpsd://boat.example")
    for _ in range(3):
        with pytest.raises(PortAbsentError, match=r"boat\.example: its address is being looked up"):
            open_line(spec)
    assert ("boat.example", 2947) in tcp._asked
    name_server.answers.set()
    until_answered("base.example", 2101)
    until_answered("boat.example", 2947)
    assert name_server.asked == 2
    with pytest.raises(PortAbsentError, match="Name or service not known: name a host that there is"):
        open_line(spec)
    corrections.read(60 * SECOND)
    assert "Name or service not known" in corrections.properties(0)["state"]


def test_a_name_is_asked_for_again_after_a_failure_and_not_after_an_answer(name_server):
    name_server.answers.set()
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        spec = PortSpec.parse(f"gpsd://boat.example:{port}")
        check_port(spec)
        with pytest.raises(PortAbsentError, match="Name or service not known"):
            open_line(spec)
        name_server.found = "127.0.0.1"
        name_server.answers.clear()
        with pytest.raises(PortAbsentError, match="being looked up"):
            open_line(spec)
        name_server.answers.set()
        until_answered("boat.example", port)
        for _ in range(2):
            open_line(spec).close()
        assert name_server.asked == 2


def test_a_server_that_has_moved_is_found_at_its_new_address(name_server, monkeypatch):
    """As a base with a dynamic address does; while no name server answers, the old address stays."""
    name_server.answers.set()
    with socket.create_server(("127.0.0.1", 0)) as old:
        port = old.getsockname()[1]
        spec = PortSpec.parse(f"gpsd://boat.example:{port}")
        name_server.found = "127.0.0.1"
        check_port(spec)
        monkeypatch.setattr(tcp, "_FRESH_S", 0.0)
        for answer in (NONE, "127.0.0.2"):
            name_server.found = answer
            with contextlib.closing(open_line(spec)) as line:
                assert line._socket.getpeername()[0] == "127.0.0.1"
            until_answered("boat.example", port)
    with socket.create_server(("127.0.0.2", port)), contextlib.closing(open_line(spec)) as line:
        assert line._socket.getpeername()[0] == "127.0.0.2"


@pytest.fixture
def two_addresses(name_server):
    """The port of a host with two addresses, of which the first one refuses later than at once, as over a network."""
    name_server.answers.set()
    name_server.found = "127.0.0.1 127.0.0.2"
    with socket.create_server(("127.0.0.1", 0)) as first:
        port = first.getsockname()[1]
        tcp.look_up("boat.example", port)

        def refuse():
            client, _ = first.accept()
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # a reset
            client.close()

        with socket.create_server(("127.0.0.2", port)) as second:
            second.settimeout(30.0)
            yield port, refuse, second


def test_a_port_whose_server_listens_at_the_second_address_only_is_connected_there_from_then_on(two_addresses):
    port, refuse, server = two_addresses
    spec = PortSpec.parse(f"gpsd://boat.example:{port}")
    with contextlib.closing(open_line(spec)) as line:
        refuse()
        with pytest.raises(PortLostError, match=r"no gpsd at boat\.example"):
            read_one(line)
    for _ in range(2):
        with contextlib.closing(open_line(spec)) as line:
            client, _ = server.accept()
            with client:
                client.sendall(b"{}")
                assert read_one(line) == b"{}"


def read_one(line):
    end_s = time.monotonic() + 30.0
    while not (data := line.read()):
        assert time.monotonic() < end_s
        time.sleep(0.001)
    return data


def read_until(corrections, state, now_ns):
    end_s = time.monotonic() + 30.0
    while not corrections.properties(now_ns)["state"].startswith(state):
        assert time.monotonic() < end_s
        corrections.read(now_ns)
        time.sleep(0.001)


def test_so_are_corrections(two_addresses):
    port, refuse, server = two_addresses
    corrections = Corrections(f"boat.example:{port}")
    assert corrections.read(0) == []
    refuse()
    for k in (1, 2):
        read_until(corrections, "no data of the base", 60 * k * SECOND)
        corrections.read(60 * k * SECOND + 30 * SECOND)
        client, _ = server.accept()
        with client:
            client.sendall(STATION)
            read_until(corrections, "data of the base come", 60 * k * SECOND + 30 * SECOND)
    corrections.close()


@pytest.mark.parametrize("host", ["a..b", "x" * 70 + ".example"])
def test_what_can_be_no_name_is_a_message(host, monkeypatch):
    monkeypatch.setattr(tcp, "_found", {})
    spec = PortSpec.parse(f"gpsd://{host}")
    check_port(spec)
    with pytest.raises(PortAbsentError, match="no host can have that name"):
        open_line(spec)
