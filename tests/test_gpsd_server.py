"""The gpsd server over real sockets and a clock of our own: conversations and rates."""

import itertools
import random

import pytest
from gpsd_loop import MS, SECOND, WATCH, Client, Loop
from gpsd_synthetic import IMU, RECEIVER, solution
from hypothesis import given
from hypothesis import strategies as st

from imud.outputs.connection import RateLimiter


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


def test_nmea_instead_of_json_or_beside_it(loop):
    plain, both = loop.connect(b'?WATCH={"enable":true,"nmea":true};'), loop.connect(WATCH, b'?WATCH={"nmea":true};')
    loop.publish(MS)
    said = plain.sock.recv(65536).split(b"\r\n")
    assert b'"json":false,"nmea":true' in said[2]
    assert [text[:6] for text in said[3:]] == [b"$GPGGA", b"$GPVTG", b"$GPHDT", b"$GPROT", b"$PASHR", b"$GPRMC", b""]
    mixed = both.sock.recv(65536)
    assert b'{"class":"ATT"' in mixed and b"\r\n".join(said[3:]) in mixed


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
def test_each_request_has_its_classes_of_answers(loop, request_, classes):
    loop.publish()
    client = loop.connect()
    client.receive()
    client.send(request_)
    loop.turn()
    assert client.classes() == classes


def test_an_own_request_is_answered_anew_ten_times_a_second_at_most(make_loop):
    made = []
    status = lambda: made.append(loop.now) or f'{{"class":"STATUS","made":{len(made)}}}'  # noqa: E731
    loop = make_loop(queries={"STATUS": status})
    client = loop.connect()
    client.receive()
    for _ in range(30):
        client.send(b"?STATUS;?STATUS=1;\n")
        loop.turn(step=10 * MS)
    received = client.receive()
    answers, refusals = received[::2], received[1::2]
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


def test_added_and_removed_devices_are_sent_to_watching_clients(loop):
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


def test_no_view_is_wanted_without_a_client(loop):
    assert loop.server.due_ns > loop.now + 10**6 * SECOND
    client = loop.connect(b'?WATCH={"json":true};')
    assert loop.now >= loop.server.due_ns
    client.sock.close()
    loop.turn()
    assert loop.server.due_ns > loop.now + 10**6 * SECOND


def test_a_view_is_wanted_when_a_message_is_due_and_for_a_request_if_the_last_is_outdated(loop):
    loop.connect()
    loop.publish()
    loop.server.want_newest(loop.now + 99 * MS)
    assert loop.server.due_ns > loop.now + 10**6 * SECOND
    loop.server.want_newest(loop.now + 100 * MS)
    assert loop.now + 100 * MS >= loop.server.due_ns
    loop.publish(100 * MS)
    assert loop.server.due_ns > loop.now + 10**6 * SECOND
    client = loop.connect(b'?WATCH={"json":true,"rate":1000};')
    assert loop.now >= loop.server.due_ns
    loop.publish(MS)
    client.send(b'?WATCH={"rate":50};')
    loop.turn()
    loop.publish(MS)
    assert [loop.now + step * MS >= loop.server.due_ns for step in (1, 10, 20)] == [False, False, True]


def test_a_view_is_wanted_as_soon_as_clients_do_not_know_the_devices(loop):
    loop.server.announce((IMU,), loop.now)
    assert loop.server.due_ns > loop.now  # there is no client
    loop.connect(b'?WATCH={"json":true,"class":"SKY"};')
    loop.publish(devices=(IMU,))
    loop.server.announce((IMU,), loop.now)
    assert loop.server.due_ns > loop.now
    loop.server.announce((IMU, RECEIVER), loop.now)
    assert loop.now >= loop.server.due_ns
    loop.publish(devices=(IMU, RECEIVER))
    loop.server.announce((IMU, RECEIVER), loop.now)
    assert loop.server.due_ns > loop.now


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
def test_the_mean_rate_is_the_one_that_the_client_asked_for(loop, rate_hz, publish_hz, jitter, expected):
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
    limiter, now, sent = RateLimiter(rate_hz), 0, 0
    for step in steps:
        now += step
        sent += limiter.try_acquire(now)
    assert 1 <= sent <= now / limiter.period_ns + 1.25 + 1e-9


def test_a_solution_may_be_overwritten_after_it_was_published(loop):
    row = solution(0.0)
    client = loop.connect(b'?WATCH={"enable":true};')
    loop.publish(solution=row.tobytes())
    row["lat"] = 0.0
    client.send(b"?POLL;")
    loop.turn()
    assert client.receive()[-1]["tpv"][0]["lat"] > 48
