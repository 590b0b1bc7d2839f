"""The gpsd server over real sockets and a clock of our own: requests, rates, and clients that are slow or hostile."""

import contextlib
import itertools
import json
import os
import random
import re
import resource
import select
import socket
import stat
import struct

import pytest
from gpsd_synthetic import IMU, RECEIVER, running, solution, view
from hypothesis import given, settings
from hypothesis import strategies as st

from imud.errors import CannotCreateError, ConfigError, PermissionDeniedError
from imud.outputs.connection import Pace
from imud.outputs.gpsd import GpsdServer
from imud.outputs.gpsd_dialogue import REQUEST_MAX, Inbox, Policy, answer, devices_object
from imud.outputs.gpsd_json import CLASSES, Report
from imud.outputs.listen import AddressInUseError, holder_of, is_local, parse_address
from imud.outputs.view import Device, View
from imud.settings import Gpsd

MS, SECOND = 1_000_000, 1_000_000_000
WATCH = b'?WATCH={"enable":true,"json":true};\n'


class Loop:
    """The daemon's loop around a server, turned by hand."""

    def __init__(self, **changes) -> None:
        self.poller = select.poll()
        self.server = GpsdServer(Gpsd(**{"listen": "127.0.0.1:0"} | changes), self.poller)
        self.now, self.seq = 10 * SECOND, 0
        self.sockets = []

    def turn(self, until_quiet: bool = True, step: int = MS) -> int:
        """Wake up for what poll reports, time going on by `step`; returns the number of wake-ups."""
        for count in range(100_000):
            events = self.poller.poll(0)
            if not events:
                return count
            self.now += step
            for fd, mask in events:
                self.server.on_event(fd, mask, self.now)
            if not until_quiet:
                return 1
        raise AssertionError("never quiet")

    def publish(self, advance: int = 0, **changes) -> None:
        self.now += advance
        self.seq += 1
        self.server.publish(view(self.now / SECOND, self.now / SECOND, self.seq)._replace(**changes), self.now)

    def connect(self, *requests: bytes, buffer: int | None = None) -> "Client":
        """A client that has sent requests; `buffer` bounds what the kernel holds for it in bytes."""
        host, _, port = self.server.addresses[0].rpartition(":")
        sock = socket.socket()
        if buffer is not None:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        sock.connect((host, int(port)))
        client = Client(sock)
        self.sockets.append(sock)
        self.turn()
        for request in requests:
            client.send(request)
            self.turn()
        return client

    def close(self) -> None:
        for sock in self.sockets:
            sock.close()
        self.server.close()


class Client:
    """The other end: what it receives, as objects; every line has to be whole."""

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self.rest = b""

    def send(self, data: bytes) -> None:
        self.sock.sendall(data)

    def receive(self) -> list[dict]:
        """Everything that has come so far, without waiting."""
        with contextlib.suppress(BlockingIOError, ConnectionResetError):
            while data := self.sock.recv(1 << 20, socket.MSG_DONTWAIT):
                self.rest += data
        *lines, self.rest = self.rest.split(b"\r\n")
        return [json.loads(text) for text in lines]

    def classes(self) -> list[str]:
        return [message["class"] for message in self.receive()]

    def closed(self) -> bool:
        try:
            return self.sock.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) == b""
        except BlockingIOError:
            return False
        except ConnectionResetError:
            return True


@pytest.fixture
def make_loop():
    with contextlib.ExitStack() as stack:

        def make(**changes) -> Loop:
            loop = Loop(**changes)
            stack.callback(loop.close)
            return loop

        yield make


@pytest.fixture
def loop(make_loop):
    return make_loop()


# --- the language


def requests_of(*chunks: bytes) -> list:
    inbox, found = Inbox(), []
    for chunk in chunks:
        inbox.feed(chunk)
        while request := inbox.take():
            found.append(request)
    return found


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"?VERSION;", [("VERSION", None)]),
        (b"?VERSION\n", [("VERSION", None)]),
        (b"?DEVICES;\r\n", [("DEVICES", None)]),
        (b"?POLL;?VERSION;\n", [("POLL", None), ("VERSION", None)]),
        (b'?WATCH={"enable":true,"json":true};', [("WATCH", b'{"enable":true,"json":true}')]),
        (b'?WATCH={"raw":2,"pps":true}\r\n', [("WATCH", b'{"raw":2,"pps":true}')]),
        (b"hello\n?POLL\n", [("POLL", None)]),
        (b" \n ;; ?POLL ;", [("POLL", None)]),
        (b"?POLL", []),
        (b"?\n", [("", None)]),
        (b"?DEVICE=;", [("DEVICE", b"")]),
        (b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", []),
    ],
)
def test_requests(data, expected):
    assert [(request.command, request.argument) for request in requests_of(data)] == expected


pieces = st.sampled_from(
    [b"?WATCH=", b'{"enable":', b"true", b"}", b";", b"\r\n", b"\n", b"?POLL", b"?", b"=", b"{", b"\xff"]
)
noise = st.lists(pieces | st.binary(max_size=8), max_size=40).map(b"".join)


@given(noise, st.data())
def test_any_chunking_gives_the_same_requests(data, draw):
    cuts = sorted(draw.draw(st.lists(st.integers(0, len(data)), max_size=10)))
    chunks = [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]
    assert requests_of(*chunks) == requests_of(data)


@given(noise | st.binary(max_size=2000))
def test_no_bytes_raise_and_every_answer_is_json(data):
    policy, report = Policy(10.0), Report(view(1.0, 1.0, 1))
    for request in requests_of(data):
        answered = answer(request, policy, report)
        policy = answered.policy
        for text in answered.objects:
            message = json.loads(text)
            assert message["class"] in {"VERSION", "DEVICES", "DEVICE", "WATCH", "POLL", "ERROR"}
            assert answered.refused == (message["class"] == "ERROR")
            assert len(message.get("message", "")) < 256


@pytest.mark.parametrize(
    "argument", [b"[" * 900, b'{"a":' * 180, b'{"enable":"\xff"}', b'{"rate":1e999}', b"\x00", b'"']
)
def test_hostile_arguments_are_refused(argument):
    (request,) = requests_of(b"?WATCH=" + argument + b"\n")
    assert answer(request, Policy(10.0), Report(View())).refused


def watched(*arguments: bytes) -> Policy:
    policy = Policy(10.0)
    for argument in arguments:
        policy = policy.told(argument)
    return policy


@pytest.mark.parametrize(
    ("arguments", "streaming"),
    [
        ([b"{}"], False),
        ([b'{"enable":true}'], False),
        ([b'{"json":true}'], True),
        ([b'{"enable":true,"json":true}'], True),
        ([b'{"raw":2,"pps":true}'], False),
        ([b'{"json":true}', b'{"enable":false}'], False),
        ([b'{"json":true}', b'{"enable":false}', b"{}"], True),  # json is remembered, enable means true
        ([b'{"json":true}', b'{"json":false}'], False),
        ([b'{"class":"WATCH","json":true,"scaled":true,"unknown":[1,{"a":2}]}'], True),
    ],
)
def test_watch_merges_like_gpsd(arguments, streaming):
    assert watched(*arguments).streaming == streaming


@pytest.mark.parametrize(
    ("argument", "classes", "rate_hz"),
    [
        (b"{}", CLASSES, 10.0),
        (b'{"class":"att, tpv"}', ("TPV", "ATT"), 10.0),
        (b'{"class":"WATCH","rate":50}', CLASSES, 50.0),
        (b'{"class":"EST","rate":0.5}', ("EST",), 0.5),
    ],
)
def test_watch_chooses_classes_and_rate(argument, classes, rate_hz):
    policy = watched(argument)
    assert (policy.classes, policy.rate_hz) == (classes, rate_hz)


def test_five_devices_are_told_as_four_because_libgps_would_hang():
    devices = [Device(f"/dev/ttyUSB{n}" + "x" * 200, "driver" * 20) for n in range(5)]
    told = json.loads(devices_object(devices))["devices"]
    assert [entry["path"][:12] for entry in told] == [f"/dev/ttyUSB{n}" for n in range(4)]
    assert all(len(entry["path"]) == 127 and len(entry["driver"]) == 63 for entry in told)


# --- a conversation


def test_greeting_then_silence_until_watch(loop):
    client = loop.connect()
    for _ in range(300):
        loop.publish(MS)
    (version,) = client.receive()
    assert version.keys() == {"class", "release", "rev", "proto_major", "proto_minor"}
    assert (version["class"], version["proto_major"], version["proto_minor"]) == ("VERSION", 3, 14)
    assert version["rev"] == f"imud-{version['release']}"


def test_watch_is_answered_with_devices_then_watch_then_the_stream(loop):
    loop.publish()
    client = loop.connect(WATCH)
    loop.publish(MS)
    _, devices, watch, *stream = client.receive()
    assert devices == {
        "class": "DEVICES",
        "devices": [
            {"class": "DEVICE", "path": "/dev/ttyUSB0", "driver": "Epson M-G350", "subtype": "M-G350-PD11",
             "sernum": "12345678", "activated": "2023-11-14T22:13:20.000000Z", "flags": 1, "native": 0,
             "bps": 460800, "parity": "N", "stopbits": 1},
            {"class": "DEVICE", "path": "/dev/ttyUSB1", "driver": "NMEA0183",
             "activated": "2023-11-14T22:13:20.000000Z", "flags": 1, "native": 0,
             "bps": 38400, "parity": "N", "stopbits": 1},
        ],
    }  # fmt: skip
    assert watch == {
        "class": "WATCH", "enable": True, "json": True, "nmea": False, "raw": 0, "scaled": False, "timing": False,
        "split24": False, "pps": False, "rate": 10, "classes": "TPV,SKY,ATT,IMU,EST",
    }  # fmt: skip
    assert [message["class"] for message in stream] == ["TPV", "SKY", "ATT", "IMU", "EST"]


@pytest.mark.parametrize(
    ("request_", "classes"),
    [
        (b"?VERSION;", ["VERSION"]),
        (b"?DEVICES\n", ["DEVICES"]),
        (b"?DEVICE;", ["DEVICE"]),
        (b'?DEVICE={"path":"/dev/ttyUSB1","bps":9600};', ["DEVICE"]),
        (b'?DEVICE={"path":"/dev/nope"};', ["ERROR"]),
        (b"?DEVICE={;", ["ERROR"]),
        (b"?WATCH;", ["DEVICES", "WATCH"]),
        (b'?WATCH={"enable":true}', []),
        (b'?WATCH={"enable":true}\n', ["DEVICES", "WATCH"]),
        (b'?WATCH={"device":"/dev/ttyUSB0"};', ["DEVICES", "WATCH"]),
        (b'?WATCH={"device":"/dev/nope"};', ["ERROR"]),
        (b'?WATCH={"class":"NONE"};', ["ERROR"]),
        (b'?WATCH={"rate":0};', ["ERROR"]),
        (b"?POLL;", ["POLL"]),
        (b"?FOO;", ["ERROR"]),
        (b"?VERSION=1;", ["ERROR"]),
        (b"?version;", ["ERROR"]),
        (b"text without a question mark\n", []),
        (b"?POLL;?VERSION;\n", ["POLL", "VERSION"]),
    ],
)
def test_answers(loop, request_, classes):
    loop.publish()
    client = loop.connect()
    client.receive()
    client.send(request_)
    loop.turn()
    assert client.classes() == classes


def test_an_own_request_is_answered_anew_ten_times_a_second_at_most(loop):
    made = []
    loop.server._own = {"STATUS": lambda: made.append(loop.now) or f'{{"class":"STATUS","made":{len(made)}}}'}
    client = loop.connect()
    client.receive()
    for _ in range(30):
        client.send(b"?STATUS;?STATUS=1;\n")
        loop.turn(step=10 * MS)
    told = client.receive()
    answers, refusals = told[::2], told[1::2]
    assert {m["class"] for m in answers} == {"STATUS"} and {m["class"] for m in refusals} == {"ERROR"}
    assert [m["made"] for m in answers] == sorted(m["made"] for m in answers)
    assert len(answers) == 30 and all(b - a >= 100 * MS for a, b in itertools.pairwise(made)) and len(made) >= 3


def test_unknown_request_is_named(loop):
    client = loop.connect(b'?FOO={"a":"\xff\x00"};')
    assert client.receive()[1] == {"class": "ERROR", "message": 'Unrecognized request \'?FOO={"a":"??"}\''}


def test_device_is_not_configured(loop):
    loop.publish()
    client = loop.connect(b'?DEVICE={"path":"/dev/ttyUSB1","bps":9600};')
    assert client.receive()[1]["bps"] == 38400


def test_poll_before_and_after_watch(loop):
    loop.publish()
    client = loop.connect(b"?POLL;", b'?WATCH={"enable":true}\n', b"?POLL;\n")
    before, after = (message for message in client.receive() if message["class"] == "POLL")
    assert (before["active"], before["tpv"], before["sky"], before["gst"]) == (0, [], [], [])
    assert after["active"] == 2
    assert after["tpv"][0]["mode"] == 3
    assert after["sky"][0]["hdop"] == 0.9


def test_poll_sees_the_newest_solution(loop):
    client = loop.connect(b'?WATCH={"enable":true};')
    for seconds in (100, 200):
        loop.publish(utc_s=float(seconds))
        client.send(b"?POLL;")
        loop.turn()
    assert [m["time"] for m in client.receive() if m["class"] == "POLL"] == [
        "1970-01-01T00:01:40.000000Z",
        "1970-01-01T00:03:20.000000Z",
    ]


def test_devices_that_come_and_go_are_told_to_those_who_watch(loop):
    loop.publish()
    watching, silent = loop.connect(b'?WATCH={"json":true,"class":"SKY"};'), loop.connect()
    loop.publish(MS)
    watching.receive()
    loop.publish(MS, devices=(IMU,))
    (gone,) = watching.receive()
    assert (gone["class"], gone["path"]) == ("DEVICE", RECEIVER.path)
    assert "activated" not in gone
    loop.publish(MS, devices=(IMU, RECEIVER))
    (back,) = watching.receive()
    assert (back["path"], back["activated"]) == (RECEIVER.path, "2023-11-14T22:13:20.000000Z")
    assert silent.classes() == ["VERSION"]


def test_a_view_is_wanted_when_a_message_is_due_and_ten_times_per_second_for_poll(loop):
    assert loop.server.wants(loop.now)
    loop.publish()
    assert not loop.server.wants(loop.now + 99 * MS)
    assert loop.server.wants(loop.now + 100 * MS)
    client = loop.connect(b'?WATCH={"json":true,"rate":1000};')
    assert loop.server.wants(loop.now)
    loop.publish(MS)
    client.send(b'?WATCH={"rate":50};')
    loop.turn()
    loop.publish(MS)
    assert [loop.server.wants(loop.now + step * MS) for step in (1, 10, 20)] == [False, False, True]


# --- rates


def stream(loop: Loop, client: Client, publish_hz: float, seconds: float, jitter: float = 0.0) -> list[dict]:
    """Publish for a time, with times that are off by up to `jitter` of the period; returns what the client got."""
    start, chance, got = loop.now, random.Random(3), []
    for n in range(int(seconds * publish_hz)):
        loop.now = start + round((n + chance.uniform(-jitter, jitter)) / publish_hz * SECOND)
        loop.publish()
        got += client.receive()
    return got


@pytest.mark.parametrize(
    ("rate_hz", "publish_hz", "jitter", "expected"),
    [
        (10, 1000, 0.4, 10),
        (300, 1000, 0.4, 300),
        (1000, 1000, 0.1, 1000),
        (100, 100, 0.1, 100),
        (1000, 100, 0.0, 100),
        (0.5, 100, 0.0, 0.5),
    ],
)
def test_mean_rate(loop, rate_hz, publish_hz, jitter, expected):
    client = loop.connect(b'?WATCH={"json":true,"class":"ATT","rate":%g};' % rate_hz)
    attitudes = [m for m in stream(loop, client, publish_hz, 4.0, jitter) if m["class"] == "ATT"]
    assert len(attitudes) == pytest.approx(4 * expected, abs=2)


def test_default_rate_is_that_of_the_settings(make_loop):
    loop = make_loop(rate_hz=25.0)
    client = loop.connect(b'?WATCH={"json":true,"class":"EST"};')
    assert sum(m["class"] == "EST" for m in stream(loop, client, 1000, 2.0)) == pytest.approx(50, abs=1)


def test_satellites_come_once_per_second(loop):
    client = loop.connect(WATCH)
    kinds = [m["class"] for m in stream(loop, client, 100, 5.0)]
    assert kinds.count("TPV") == kinds.count("ATT") == kinds.count("EST") == pytest.approx(50, abs=1)
    assert kinds.count("SKY") == pytest.approx(5, abs=1)


def test_disabling_ends_the_stream(loop):
    client = loop.connect(WATCH, b'?WATCH={"enable":false};')
    client.receive()
    assert stream(loop, client, 100, 1.0) == []


@given(st.lists(st.integers(0, 30 * MS), min_size=1, max_size=300), st.floats(1.0, 1000.0))
def test_no_more_messages_than_the_rate_allows(steps, rate_hz):
    pace, now, sent = Pace(rate_hz), 0, 0
    for step in steps:
        now += step
        sent += pace.take(now)
    assert 1 <= sent <= now / pace.period_ns + 1.25 + 1e-9


# --- clients that are slow, stalled or hostile


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
        loop.publish(MS if connection.stuck_ns is None else 100 * MS)
        loop.turn(step=1)
    assert loop.server.counters.expelled == 1
    assert 60 * SECOND < loop.now - connection.stuck_ns < 62 * SECOND


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


def test_what_a_client_is_owed_is_bounded(loop):
    loop.connect(b'?WATCH={"json":true,"rate":1000};', buffer=4096)
    (client,) = loop.server._clients.values()
    for _ in range(2000):
        loop.publish(MS)
        loop.turn(step=1)
    assert client.sock.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF) <= 131072
    assert 0 < len(client._owed) < 10240


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
    assert len(connection.inbox._bytes) <= REQUEST_MAX + 128
    assert 0 < len(connection._owed) < 1000  # one answer


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


def test_too_many_clients_are_told_so(make_loop):
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
    assert loop.server.clients == 64
    assert loop.server.counters.refused == 1000 - 63
    assert len(first.receive()) == pytest.approx((loop.now - since) / (100 * MS), abs=1)


def test_out_of_descriptors_the_listener_waits_for_the_next_second(loop):
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    waiting = socket.create_connection(("127.0.0.1", int(loop.server.addresses[0].rpartition(":")[2])))
    loop.sockets.append(waiting)
    lowest = os.dup(0)
    os.close(lowest)
    loop.server.tick(loop.now)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (lowest, hard))
        assert loop.turn(until_quiet=False) == 1
        assert loop.poller.poll(0) == []
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
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


def test_deadlines_exist_only_while_there_are_clients(loop):
    assert loop.server.next_deadline() is None
    client = loop.connect()
    assert loop.now < loop.server.next_deadline() <= loop.now + SECOND
    client.sock.close()
    loop.turn()
    assert loop.server.next_deadline() is None


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
            assert set(loop.server._clients) | set(loop.server._listeners) >= {fd for fd, _ in loop.poller.poll(0)}
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


# --- addresses


@pytest.mark.parametrize(
    ("text", "shown", "local"),
    [
        ("127.0.0.1:2947", "127.0.0.1:2947", True),
        ("127.0.0.1", "127.0.0.1:2947", True),
        ("localhost:0", "127.0.0.1:0", True),
        ("[::1]:2948", "[::1]:2948", True),
        ("127.8.8.8:1", "127.8.8.8:1", True),
        (":2947", "0.0.0.0:2947", False),
        ("0.0.0.0:2947", "0.0.0.0:2947", False),
        ("[::]:2947", "[::]:2947", False),
        ("[::ffff:127.0.0.1]:1", "[::ffff:127.0.0.1]:1", True),
        ("192.0.2.7:2947", "192.0.2.7:2947", False),
        ("/run/imud/gpsd.sock", "unix:/run/imud/gpsd.sock", True),
        ("unix:gpsd.sock", "unix:gpsd.sock", True),
    ],
)
def test_addresses(text, shown, local):
    address = parse_address(text, 2947)
    assert (address.text, is_local(address)) == (shown, local)


@pytest.mark.parametrize(
    "text", ["", "::1", "127.0.0.1:x", "127.0.0.1:65536", "[::1", "/" + "x" * 108, "no.such.invalid:1"]
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


def test_ipv6(make_loop):
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
    with pytest.raises(CannotCreateError, match="No such file"):
        GpsdServer(Gpsd(listen=str(tmp_path / "none/gpsd.sock")), select.poll())


def test_a_forbidden_place_is_named(tmp_path):
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


def test_a_solution_may_be_overwritten_after_it_was_published(loop):
    row = solution(0.0)
    client = loop.connect(b'?WATCH={"enable":true};')
    loop.publish(solution=row.tobytes())
    row["lat"] = 0.0
    client.send(b"?POLL;")
    loop.turn()
    assert client.receive()[-1]["tpv"][0]["lat"] > 48
