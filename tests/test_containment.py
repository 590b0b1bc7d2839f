"""A defect that one client, request, view or device meets ends that one: it is counted, and logged once."""

import errno
import json
import select
import socket

import pytest
from gpsd_loop import MS, SECOND, WATCH
from structlog.testing import capture_logs

from imud.client import connect
from imud.configuration.settings import Gpsd, Nmea, Settings, Stream
from imud.errors import UsageError
from imud.outputs.all import Outputs
from imud.outputs.gpsd_dialogue import Policy
from imud.outputs.view import View
from imud.process.contained import ContainedErrors


def broken(*_):
    raise OverflowError("int too large")


def test_errors_are_counted_and_each_kind_is_logged_once():
    with capture_logs() as lines:
        errors = ContainedErrors()
        for _ in range(3):
            with errors.contain("a test"):
                broken()
        with errors.contain("a test"):
            raise ValueError
    assert errors.count == 4
    assert "a test: ValueError in tests/test_containment.py" in errors.last
    assert [line["log_level"] for line in lines] == ["error", "error"]
    assert "OverflowError" in lines[0]["event"] and "int too large" in lines[0]["traceback"]


def test_an_error_is_contained_also_where_its_traceback_cannot_be_made(monkeypatch):
    def no_descriptors(*_, **__):
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr("traceback.extract_tb", no_descriptors)
    monkeypatch.setattr("traceback.format_exception", no_descriptors)
    with capture_logs() as lines:
        errors = ContainedErrors()
        with errors.contain("a test"):
            broken()
    assert errors.count == 1
    assert "OverflowError in tests/test_containment.py" in lines[0]["event"] and lines[0]["traceback"] == ""


def test_an_error_with_a_message_of_its_own_is_not_contained():
    errors = ContainedErrors()
    with pytest.raises(UsageError), errors.contain("a test"):
        raise UsageError("no such port")
    assert errors.count == 0


@pytest.mark.parametrize("rate", ["1e-300", "5e-324", "1e300", "1e999", "-1", "0", "1e-9", "null", '"x"', "[]", "NaN"])
def test_no_rate_that_a_client_asks_for_ends_the_server(loop, rate):
    client = loop.connect(WATCH, f'?WATCH={{"rate":{rate}}};\n'.encode())
    loop.publish(SECOND)
    loop.turn()
    kinds = client.classes()
    assert kinds[:3] == ["VERSION", "DEVICES", "WATCH"] and "TPV" in kinds
    assert ("ERROR" in kinds) == (rate != "null")
    assert (loop.server._errors.count, loop.server.clients) == (0, 1)


@pytest.mark.parametrize(
    "verb", ["GET", "HEAD", "POST", "PUT", "DELETE", "CONNECT", "OPTIONS", "TRACE", "PATCH", "put", "PROPFIND"]
)
def test_a_request_of_http_is_refused_and_nothing_after_it_is_read(loop, verb):
    body = b'?WATCH={"enable":true,"json":true}\n'
    page = loop.connect(f"{verb} / HTTP/1.1\r\nHost: 127.0.0.1:2947\r\n\r\n".encode() + body)
    loop.publish(SECOND)
    version, refusal = page.receive()
    assert (version["class"], refusal["class"]) == ("VERSION", "ERROR") and "HTTP" in refusal["message"]
    assert page.closed()
    counters = loop.server.counters
    assert (loop.server.clients, counters.requests, counters.expelled) == (0, 0, 1)


@pytest.mark.parametrize("cut", range(1, 30, 4))
def test_a_request_of_http_is_refused_however_it_is_cut(loop, cut):
    data = b'POST /;?WATCH={"enable":true} HTTP/1.1\r\n\r\n?POLL;'
    page = loop.connect()
    page.send(data[:cut])
    loop.turn()
    if not page.closed():
        page.sock.send(data[cut:])
        loop.turn()
    assert (loop.server.clients, loop.server.counters.requests) == (0, 0)


def test_an_exception_in_a_request_is_an_answer(make_loop):
    loop = make_loop(queries={"STATUS": broken})
    client = loop.connect(b"?STATUS;?VERSION;")
    _, refusal, after = client.receive()
    assert refusal == {"class": "ERROR", "message": "internal error"} and after["class"] == "VERSION"
    assert loop.server._errors.count == 1


def test_an_exception_for_one_client_ends_its_connection_only(loop):
    good, bad = loop.connect(WATCH), loop.connect(WATCH)
    loop.publish()
    good.receive()
    loop.server._clients[[*loop.server._clients][1]].due_classes = broken
    loop.publish(SECOND)
    assert good.classes() == ["TPV", "SKY", "ATT", "IMU", "EST"]
    bad.receive()
    assert bad.closed() and not good.closed()
    assert loop.server._errors.count == 1


def test_an_exception_while_reading_one_client_ends_its_connection_only(loop):
    good, bad = loop.connect(WATCH), loop.connect()
    good.receive()
    loop.server._clients[[*loop.server._clients][1]].read = broken
    bad.send(b"?POLL;")
    loop.turn()
    bad.receive()
    assert bad.closed() and not good.closed()
    assert (loop.server.clients, loop.server._errors.count) == (1, 1)


def test_an_exception_while_accepting_does_not_keep_the_loop_busy(loop, monkeypatch):
    monkeypatch.setattr(loop.server._listeners, "accept", broken)
    with socket.create_connection(("127.0.0.1", int(loop.server.addresses[0].rpartition(":")[2]))):
        assert loop.turn() == 1
    assert loop.server._errors.count == 1
    monkeypatch.undo()
    loop.server.tick(loop.now + 2 * SECOND)
    assert loop.connect(b"?VERSION;").classes() == ["VERSION", "VERSION"]


@pytest.fixture
def outputs(tmp_path):
    chosen = Settings(
        gpsd=Gpsd(listen="127.0.0.1:0"), nmea=Nmea(udp="127.0.0.1:9"), stream=Stream(listen=str(tmp_path / "s"))
    )
    made = Outputs(chosen, select.poll(), 4, {}, {})
    yield made
    made.close()


def test_a_listener_that_paused_before_any_client_was_there_accepts_the_next_one(outputs, monkeypatch):
    """As after a lack of memory or of file descriptors."""
    gpsd = outputs.gpsd
    listener = next(iter(gpsd._listeners._sockets))
    host, _, port = gpsd.addresses[0].rpartition(":")
    with socket.create_connection((host, int(port))):
        monkeypatch.setattr(gpsd, "_accept", broken)
        outputs.on_event(listener, select.POLLIN, 10 * SECOND)
        monkeypatch.undo()
        assert (listener, select.POLLIN) not in gpsd._poller.poll(0)
        outputs.tick(12 * SECOND)
        assert (listener, select.POLLIN) in gpsd._poller.poll(10_000)


def test_an_output_that_fails_does_not_keep_the_view_from_the_others(outputs, monkeypatch):
    shown = []
    gpsd, nmea = outputs._view_outputs
    monkeypatch.setattr(type(gpsd), "due_ns", 0)  # as with a client
    monkeypatch.setattr(gpsd, "publish", broken)
    monkeypatch.setattr(nmea, "publish", lambda view, now_ns: shown.append(view))
    outputs.publish(View, 10 * SECOND)
    assert len(shown) == 1 and outputs._errors.count == 1


def test_an_exception_for_a_stream_client_ends_its_connection_only(outputs, monkeypatch, tmp_path):
    stream = outputs.binary.stream
    listener = next(iter(stream._listeners._sockets))
    with connect(tmp_path / "s") as one, connect(tmp_path / "s", divisor=2):
        for _ in range(2):
            outputs.on_event(listener, select.POLLIN, MS)
        one_fd, two_fd = [sock.fileno() for sock in stream._sockets]
        monkeypatch.setattr("imud.outputs.stream.DIVISOR", None)
        outputs.on_event(two_fd, select.POLLIN, MS)
        assert [sock.fileno() for sock in stream._sockets] == [one_fd]
        assert one._socket.fileno() >= 0
    assert outputs._errors.count == 1


def test_rates_within_the_range_are_taken(loop):
    for rate in (0.001, 1000.0):
        assert Policy(10.0).updated(json.dumps({"rate": rate}).encode()).rate_hz == rate
