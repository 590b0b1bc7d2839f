"""The gpsd server and clients that are slow, stalled or hostile: they lose their own, and delay nobody."""

import contextlib
import json
import os
import random
import resource
import select
import socket
import struct

import pytest
from gpsd_loop import MS, SECOND, WATCH, Client, Loop, noise
from gpsd_synthetic import running
from hypothesis import given, settings
from hypothesis import strategies as st

from imud.outputs.gpsd_dialogue import REQUEST_MAX


def test_a_stalled_client_loses_messages_whole_and_the_others_none(loop):
    fast = b'?WATCH={"json":true,"rate":1000,"class":"EST"};'
    loop.publish()
    live, stalled = loop.connect(fast), loop.connect(fast, buffer=4096)
    live.receive()
    seen = []
    for _ in range(4000):
        loop.publish(MS)
        loop.turn(step=1)
        seen += [message["seq"] for message in live.receive()]
    assert seen == list(range(2, 4002))
    assert loop.server.counters.dropped > 1000
    assert loop.server.clients == 2
    late = catch_up(loop, stalled)  # every line is whole, or json would raise
    assert late == list(range(2, len(late) + 2)) and len(late) < 3000
    loop.publish(MS)
    assert catch_up(loop, stalled) == [4002]


def catch_up(loop: Loop, client: Client) -> list[int]:
    """Read until nothing is left anywhere; the kernel takes a moment to open a closed window."""
    seen = []
    while select.select([client.sock], [], [], 1.0)[0]:
        seen += [message["seq"] for message in client.receive() if message["class"] == "EST"]
        loop.turn(step=1)
    assert client.rest == b""
    return seen


def test_a_client_that_never_reads_is_cut_off(loop):
    loop.connect(b'?WATCH={"json":true,"rate":1000};', buffer=4096)
    (connection,) = loop.server._clients.values()
    while loop.server.clients and loop.now < 300 * SECOND:
        loop.publish(MS if connection.stalled_ns is None else 100 * MS)
        loop.turn(step=1)
    assert loop.server.counters.expelled == 1
    assert 60 * SECOND < loop.now - connection.stalled_ns < 62 * SECOND


def test_a_slow_reader_gets_whole_lines_and_stays(loop):
    client = loop.connect(b'?WATCH={"json":true,"rate":1000};', buffer=65536)
    data = b""
    for _ in range(3000):
        loop.publish(10 * MS)
        loop.turn(step=1)
        with contextlib.suppress(BlockingIOError):
            data += client.sock.recv(997, socket.MSG_DONTWAIT)
    client.rest = data
    kinds = [message["class"] for message in client.receive()]
    assert len(kinds) > 300
    assert loop.server.clients == 1
    assert loop.server.counters.dropped > 0


def test_the_unsent_bytes_of_a_client_are_bounded(loop):
    loop.connect(b'?WATCH={"json":true,"rate":1000};', buffer=4096)
    (client,) = loop.server._clients.values()
    for _ in range(2000):
        loop.publish(MS)
        loop.turn(step=1)
    assert client.sock.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF) <= 131072
    assert 0 < len(client._unsent) < 10240


def test_a_client_that_reads_no_answers_is_read_no_further(loop):
    loop.publish()
    client = loop.connect(b'?WATCH={"enable":true};', buffer=4096)
    client.sock.setblocking(False)
    for _ in range(50):
        with contextlib.suppress(BlockingIOError):
            while True:
                client.sock.send(b"?POLL;" * 100)
        loop.now += SECOND
        loop.turn(step=1)
        loop.server.tick(loop.now)
    (connection,) = loop.server._clients.values()
    assert 30 < loop.server.counters.requests < 50 * 100
    assert len(connection.receive_buffer._bytes) <= REQUEST_MAX + 128
    assert 0 < len(connection._unsent) < 1000  # one answer


def test_a_flood_of_requests_is_served_in_slices(loop):
    client = loop.connect()
    client.receive()
    client.send(b"?VERSION;" * 1000)
    answered = []
    for second in range(30):
        before = loop.server.counters.requests
        loop.turn(step=1)
        assert loop.server.counters.requests - before <= 100 + 14, second  # 14 fit into the last read
        answered += client.classes()
        loop.now += SECOND
        loop.server.tick(loop.now)
    assert answered == ["VERSION"] * 1000


def test_the_work_of_one_wakeup_is_limited(loop):
    clients = [loop.connect() for _ in range(30)]
    for client in clients:
        client.receive()
        client.send(b"?VERSION;")
    before = loop.server.counters.requests
    loop.turn(until_quiet=False)
    assert loop.server.counters.requests - before == 4
    loop.turn()
    assert [client.classes() for client in clients] == [["VERSION"]] * 30


@pytest.mark.parametrize("data", [b"x" * 5000, b"?" * 5000, b"?WATCH={" + b" " * 5000, b"\xff" * 100_000])
def test_endless_requests_end_the_connection(loop, data):
    client = loop.connect()
    with contextlib.suppress(BlockingIOError, ConnectionError):
        client.sock.setblocking(False)
        client.send(data)
    loop.turn()
    assert loop.server.clients == 0
    assert client.classes()[:1] == ["VERSION"]
    assert loop.server.counters.expelled == 1


def test_too_many_clients_receive_an_error(make_loop):
    loop = make_loop(max_clients=3)
    clients = [loop.connect() for _ in range(5)]
    assert [client.classes() for client in clients] == [["VERSION"]] * 3 + [["ERROR"]] * 2
    assert [client.closed() for client in clients] == [False] * 3 + [True] * 2
    clients[0].sock.close()
    loop.turn()
    assert loop.connect().classes() == ["VERSION"]


def test_a_thousand_connections(loop):
    loop.publish()
    first = loop.connect(b'?WATCH={"json":true,"class":"EST"};')
    first.receive()
    since = loop.now
    for _ in range(1000):
        sock = socket.create_connection(("127.0.0.1", int(loop.server.addresses[0].rpartition(":")[2])))
        loop.sockets.append(sock)
        loop.turn()
        loop.publish(MS)
        if loop.server.counters.refused:
            loop.sockets.pop().close()  # a process may have no more than 1024 descriptors
    assert loop.server.clients == 64
    assert loop.server.counters.refused == 1000 - 63
    assert len(first.receive()) == pytest.approx((loop.now - since) / (100 * MS), abs=1)


@contextlib.contextmanager
def no_descriptors():
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    lowest = os.dup(0)
    os.close(lowest)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (lowest, hard))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_out_of_descriptors_clients_receive_an_error_and_are_rejected(loop):
    port = int(loop.server.addresses[0].rpartition(":")[2])
    waiting = [Client(socket.create_connection(("127.0.0.1", port))) for _ in range(3)]
    loop.server.tick(loop.now)
    with no_descriptors():
        loop.turn()
    for client in waiting:
        (message,) = client.receive()
        assert (message["class"], message["message"]) == ("ERROR", "no descriptor left for another client")
        assert client.closed()
    assert (loop.server.clients, loop.server.counters.refused) == (0, 3)
    assert loop.connect().classes() == ["VERSION"]


def test_clients_leave_descriptors_for_ports_files_and_recordings(loop):
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    lowest = os.dup(0)
    os.close(lowest)
    limit = lowest + 60
    clients = []
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))
        while loop.server.counters.refused == 0:  # client and server are one process: each connection costs two
            clients.append(loop.connect())
        free = [os.dup(0) for _ in range(min(32, limit // 4) - 1)]  # the refused client has the last one
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    for fd in free:
        os.close(fd)
    (message,) = clients[-1].receive()
    assert message["message"] == "no descriptor left for another client"
    assert loop.server.clients == len(clients) - 1 > 0


def test_out_of_descriptors_and_without_a_reserve_the_listener_waits_for_the_next_second(loop):
    waiting = socket.create_connection(("127.0.0.1", int(loop.server.addresses[0].rpartition(":")[2])))
    loop.sockets.append(waiting)
    loop.server.tick(loop.now)
    loop.server._listeners._spare.close()
    taken = [os.dup(0)]  # as another thread may, between the reserve's descriptor and the client's
    with no_descriptors():
        assert loop.turn(until_quiet=False) == 1
        assert loop.poller.poll(0) == []
    os.close(taken[0])
    assert loop.server.clients == 0
    loop.now += SECOND
    loop.server.tick(loop.now)
    loop.turn()
    assert Client(waiting).classes() == ["VERSION"]


@pytest.mark.parametrize(
    ("requests", "after_s"),
    [((), 60), ((b"?POLL;",), 900), ((WATCH, b'?WATCH={"enable":false};'), 900)],
)
def test_silent_clients_are_cut_off_as_by_gpsd(loop, requests, after_s):
    client = loop.connect(*requests)
    since = loop.now
    while loop.server.clients and loop.now < since + 2000 * SECOND:
        loop.now += SECOND
        loop.server.tick(loop.now)
    assert (loop.now - since) / SECOND == pytest.approx(after_s, abs=3)
    client.receive()
    assert client.closed()


def test_a_watching_client_may_be_silent_for_ever(loop):
    loop.connect(b'?WATCH={"enable":true}\n')
    for _ in range(5000):
        loop.now += SECOND
        loop.server.tick(loop.now)
    assert loop.server.clients == 1


def test_a_reset_connection_is_forgotten(loop):
    client = loop.connect(WATCH)
    client.sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    client.sock.close()
    loop.publish(MS)
    loop.turn()
    assert loop.server.clients == 0


def test_events_of_foreign_descriptors_are_passed_over(loop):
    loop.server.on_event(12345, select.POLLIN, loop.now)
    assert 12345 not in loop.server


actions = st.lists(
    st.one_of(
        st.tuples(st.just("connect")),
        st.tuples(st.just("send"), st.integers(0, 5), noise | st.sampled_from([WATCH, b"?POLL;" * 50, b"x" * 3000])),
        st.tuples(st.just("read"), st.integers(0, 5), st.integers(1, 5000)),
        st.tuples(st.just("close"), st.integers(0, 5)),
        st.tuples(st.just("reset"), st.integers(0, 5)),
        st.tuples(st.just("publish"), st.sampled_from([MS, 100 * MS, 3 * SECOND])),
    ),
    min_size=8,
    max_size=40,
)


@settings(max_examples=60, deadline=None)
@given(actions)
def test_whatever_clients_do_a_well_behaved_one_is_served(script):
    loop = Loop(max_clients=5)
    try:
        good = loop.connect(b'?WATCH={"json":true,"rate":1000,"class":"EST"};')
        others = [loop.connect(), loop.connect(WATCH), loop.connect()]
        assert good.classes() == ["VERSION", "DEVICES", "WATCH"]
        for action, *arguments in script:
            act(loop, others, action, *arguments)
            loop.turn()
            loop.publish(MS)
            assert [m["seq"] for m in good.receive() if m["class"] == "EST"][-1] == loop.seq
            assert all(fd in loop.server for fd, _ in loop.poller.poll(0))
        assert not good.closed()
    finally:
        loop.close()


def act(loop: Loop, others: list, action: str, *arguments) -> None:
    """One thing that a stranger does."""
    if action == "connect":
        others.append(loop.connect())
    elif action == "publish":
        loop.publish(arguments[0])
    elif arguments[0] < len(others):
        sock = others[arguments[0]].sock
        with contextlib.suppress(OSError):  # already closed, or the server had enough of it
            if action == "send":
                sock.send(arguments[1], socket.MSG_DONTWAIT)
            elif action == "read":
                sock.recv(arguments[1], socket.MSG_DONTWAIT)
            else:
                if action == "reset":
                    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                sock.close()


@pytest.mark.thorough
def test_a_server_under_attack_still_serves():
    """In a process of its own: garbage from many connections, none of which ever reads."""
    with running("--max-clients", "20") as address, contextlib.ExitStack() as stack:
        where = ("127.0.0.1", int(address.rpartition(":")[2]))
        live = stack.enter_context(socket.create_connection(where, timeout=20))
        live.sendall(b'?WATCH={"json":true,"class":"EST"};')
        chance = random.Random(5)
        for _ in range(300):
            attacker = stack.enter_context(socket.create_connection(where, timeout=20))
            attacker.setblocking(False)
            with contextlib.suppress(OSError):
                attacker.send(chance.choice([chance.randbytes(3000), b"?POLL;" * 200, b"?WATCH=", WATCH * 50]))
        lines = live.makefile("rb")
        kinds = [json.loads(next(lines))["class"] for _ in range(30)]
    assert kinds == ["VERSION", "DEVICES", "WATCH"] + ["EST"] * 27
