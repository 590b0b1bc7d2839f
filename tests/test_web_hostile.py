"""The page's server and clients that send rubbish, send nothing, or come by the hundred."""

import contextlib
import resource
import socket
import subprocess
import sys
import time
import urllib.request

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("aiohttp", reason="the live page needs the extra imud[web]")
pytest.importorskip("plotly", reason="the live page needs the extra imud[web]")

from aiohttp.http_exceptions import BadHttpMessage
from processes import TIMEOUT_S

from imud.commands.web import limits
from imud.commands.web.server import is_own_name, is_own_origin


@contextlib.contextmanager
def page_server(tmp_path, code="", descriptors=None):
    """`imud web`, after `code`: its address, and what it has printed on stderr."""
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    if descriptors:
        code = f"import resource; resource.setrlimit(resource.RLIMIT_NOFILE, ({descriptors}, {hard}))"
    program = f"import sys; from imud.__main__ import main; {code}\nsys.argv[0] = 'imud'; sys.exit(main())"
    command = [sys.executable, "-c", program, "web", "--listen=127.0.0.1:0", str(tmp_path / "absent.sock")]
    with (tmp_path / "stderr").open("w") as stderr:
        running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True)
        try:
            url = running.stdout.readline().strip()
            host, _, port = url.removeprefix("http://").rstrip("/").rpartition(":")
            yield (host, int(port)), (tmp_path / "stderr").read_text
        finally:
            running.terminate()
            assert running.wait(TIMEOUT_S) == 0


def answer(address, request: bytes, whole: bool = True) -> bytes:
    """What comes back; after a request that is not whole nothing more is sent."""
    with socket.create_connection(address, timeout=TIMEOUT_S) as sock:
        sock.sendall(request)
        if not whole:
            sock.shutdown(socket.SHUT_WR)
        data = b""
        with contextlib.suppress(ConnectionError):
            while more := sock.recv(65536):
                data += more
    return data


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    with page_server(tmp_path_factory.mktemp("web")) as found:
        yield found


HOSTS = ["[", "]", "[::1", "::1]", "[x]", "", " ", "a b", "x" * 4000, "localhost:99999999", "127.0.0.1/", "127.0.0.1@e"]
HOSTS += ["localhost#@evil.example", "[localhost]", "evil.example\\@127.0.0.1", "127.0.0.1:8080:1"]


@pytest.mark.parametrize("host", HOSTS)
def test_an_invalid_host_is_rejected(host, served):
    address, printed = served
    status = answer(address, f"GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode()).split(b"\r\n")[0]
    assert status in (b"HTTP/1.1 403 Forbidden", b"HTTP/1.0 400 Bad Request", b"HTTP/1.1 400 Bad Request")
    assert "Traceback" not in printed()


@pytest.mark.parametrize("origin", ["http://[", "http://", "[", "null", "http://{host}@evil", "ftp://{host}", "{host}"])
def test_an_invalid_origin_is_rejected(origin, served):
    address, printed = served
    host = f"{address[0]}:{address[1]}"
    for given_origin, status in ((f"http://{host}", b"200"), (origin.format(host=host), b"403")):
        head = f"GET / HTTP/1.1\r\nHost: {host}\r\nOrigin: {given_origin}\r\nConnection: close\r\n\r\n"
        assert answer(address, head.encode()).startswith(b"HTTP/1.1 " + status)
    assert "Traceback" not in printed()


@given(st.text(max_size=40) | st.from_regex(r"[\[\]:@/#0-9a-z.]{0,20}", fullmatch=True))
def test_any_host_and_origin_are_judged(text):
    assert is_own_name(text) in (True, False)
    assert is_own_origin(text, "127.0.0.1:8080") == (
        text.lower() in ("http://127.0.0.1:8080", "https://127.0.0.1:8080")
    )


@pytest.mark.parametrize(
    ("host", "own"),
    [
        ("127.0.0.1", True),
        ("127.0.0.1:8080", True),
        ("[::1]:8080", True),
        ("LOCALHOST", True),
        ("192.168.7.1:80", True),
        ("evil.example", False),
        ("127.0.0.1.evil.example", False),
    ],
)
def test_names_of_this_machine(host, own):
    assert is_own_name(host) == own


MALFORMED = [
    b"\x16\x03\x01\x02\x00",
    b"GET\r\n\r\n",
    b"GET / HTTP/9.9\r\n\r\n",
    b"\x00" * 100,
    b"GET / HTTP/1.1\r\n: x\r\n\r\n",
]
MALFORMED += [b"GET / HTTP/1.1\r\nContent-Length: -5\r\n\r\n", b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 9000 + b"\r\n"]
MALFORMED += [b"GET /" + b"x" * 20_000 + b" HTTP/1.1\r\n\r\n", b"POST / HTTP/1.1\r\nTransfer-Encoding: x\r\n\r\nzz\r\n"]


def test_malformed_requests_are_a_line_each_kind_and_no_traceback(tmp_path):
    with page_server(tmp_path) as (address, printed):
        for _ in range(20):
            for request in MALFORMED:
                assert not answer(address, request, whole=False).startswith(
                    (b"HTTP/1.1 5", b"HTTP/1.0 5", b"HTTP/1.1 200")
                )
        page = answer(address, b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        assert page.startswith(b"HTTP/1.1 200")
        assert "Traceback" not in printed()
        assert len(printed().splitlines()) < 2 * len(MALFORMED)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "body",
    [
        b"Content-Encoding: gzip\r\nContent-Length: 3\r\n\r\nabc",
        b"Content-Encoding: deflate\r\nContent-Length: 3\r\n\r\nabc",
        b"Transfer-Encoding: chunked\r\n\r\n3\r\nabcXX\r\n",
    ],
)
def test_a_body_that_cannot_be_decoded_is_no_traceback(body, tmp_path):
    with page_server(tmp_path) as (address, printed):
        head = b"POST / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n"
        assert answer(address, head + body).split()[1] in (b"400", b"405")
        answer(address, b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        assert "Traceback" not in printed()
        assert len(printed().splitlines()) <= 1


def test_a_connection_without_a_whole_request_is_ended(tmp_path):
    code = "from imud.commands.web import limits; limits.HEADER_S = 0.3"
    with page_server(tmp_path, code) as (address, printed):
        slow = [socket.create_connection(address, timeout=TIMEOUT_S) for _ in range(5)]
        for sock in slow[1:]:
            sock.sendall(b"GET / HTTP/1.1\r\nHost: loc")
        for sock in slow:
            with contextlib.suppress(ConnectionResetError), sock:
                assert sock.recv(100) == b""
        assert printed() == ""


def test_at_its_limit_of_descriptors_it_continues_to_serve_and_prints_little(tmp_path):
    with page_server(tmp_path, descriptors=96) as (address, printed), contextlib.ExitStack() as stack:
        for _ in range(200):
            stack.enter_context(socket.create_connection(address, timeout=TIMEOUT_S))
        deadline = time.monotonic() + TIMEOUT_S
        while "connections: the newest are closed" not in printed():
            assert time.monotonic() < deadline
            time.sleep(0.05)
        stack.close()
        url = f"http://{address[0]}:{address[1]}/page/style.css"
        while True:  # the connections that are closed are seen one by one
            with contextlib.suppress(OSError), urllib.request.urlopen(url, timeout=TIMEOUT_S) as page:
                assert page.status == 200
                break
            assert time.monotonic() < deadline
        assert len(printed().splitlines()) < 5 and "Traceback" not in printed()


def test_each_kind_of_error_is_printed_once(capsys):
    log = limits.ErrorLog()
    for i in range(1000):
        log.on_loop_exception(
            None, {"message": "socket.accept() out of system resource", "exception": OSError(24, "no")}
        )
        try:
            raise BadHttpMessage(f"number {i}")
        except BadHttpMessage:
            log.logger().exception("Error handling request from %s", f"10.0.0.{i}")
    assert len(capsys.readouterr().err.splitlines()) == 2
    try:
        raise RuntimeError("a defect")
    except RuntimeError:
        log.logger().exception("Error handling request from %s", "::1")
    assert "Traceback" in capsys.readouterr().err
    for i in range(1000):
        log.report(f"text {i}")
    assert len(capsys.readouterr().err.splitlines()) < 110
