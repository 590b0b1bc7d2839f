"""Logs: for people on a terminal or in a file; with fields and priorities in the journal, by its own reader's rules."""

import contextlib
import json
import os
import re
import select
import socket
import subprocess
import sys
import uuid
from datetime import UTC, datetime

import pytest
import structlog
from hypothesis import given
from hypothesis import strategies as st

from imud.process import log

SAYS = """
import sys
from imud.process import log
log.JOURNAL = sys.argv[1]
log.configure()
import structlog
structlog.get_logger().bind(port="/dev/ttyUSB0").warning("two\\nlines", baud=9600)
structlog.get_logger().debug("not entry")
"""


def parsed(data: bytes) -> dict[str, str]:
    """The fields of a datagram, as JOURNAL_NATIVE_PROTOCOL describes them."""
    fields = {}
    while data:
        head, _, rest = data.partition(b"\n")
        name, equals, value = head.partition(b"=")
        if not equals:
            size = int.from_bytes(rest[:8], "little")
            value, data = rest[8 : 8 + size], rest[8 + size :]
            assert data[:1] == b"\n"
            data = data[1:]
        else:
            data = rest
        assert name.decode() not in fields
        fields[name.decode()] = value.decode()
    return fields


def said(stderr, journal: str, stream: str) -> None:
    environment = {**os.environ, "JOURNAL_STREAM": stream}
    subprocess.run([sys.executable, "-c", SAYS, journal], stderr=stderr, env=environment, check=True)


@pytest.fixture
def err(tmp_path):
    with (tmp_path / "err").open("w+") as file:
        yield file


def stream_of(file) -> str:
    status = os.fstat(file.fileno())
    return f"{status.st_dev}:{status.st_ino}"


def test_fields_and_priority_go_to_the_journal_and_nothing_to_stderr(tmp_path, err):
    path = f"/tmp/imud-{uuid.uuid4().hex}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as journal:
        journal.bind(path)
        try:
            journal.settimeout(10.0)
            said(err, path, stream_of(err))
            entry = parsed(journal.recv(65536))
        finally:
            os.unlink(path)  # noqa: PTH108
    assert (entry["PRIORITY"], entry["PORT"], entry["BAUD"], entry["EVENT"]) == (
        "4",
        "/dev/ttyUSB0",
        "9600",
        "two\nlines",
    )
    assert entry["MESSAGE"] == "two\nlines port=/dev/ttyUSB0 baud=9600" and entry["SYSLOG_IDENTIFIER"] == "imud"
    err.seek(0)
    assert err.read() == ""


def test_without_a_journal_that_listens_stderr_gets_the_priority(tmp_path, err):
    said(err, str(tmp_path / "nobody"), stream_of(err))
    err.seek(0)
    assert err.read() == "<4>two\nlines port=/dev/ttyUSB0 baud=9600\n"


def test_each_line_is_an_object_on_request(err):
    code = SAYS.replace("log.configure()", "log.configure(form='json')")
    subprocess.run([sys.executable, "-c", code, ""], stderr=err, check=True)
    err.seek(0)
    (line,) = err.read().splitlines()
    entry = json.loads(line)
    stamp = datetime.fromisoformat(entry.pop("timestamp"))
    assert abs((datetime.now(UTC) - stamp).total_seconds()) < 600.0
    assert entry == {"event": "two\nlines", "level": "warning", "port": "/dev/ttyUSB0", "baud": 9600}


def test_a_file_is_not_the_journal_of_who_started_us(err):
    said(err, "", "1:1")
    err.seek(0)
    text = err.read()
    assert "warning" in text and not text.startswith("<")


@pytest.mark.parametrize("form", ["text", "json"])
def test_the_sink_gets_each_line_that_is_written_with_all_its_facts(form, monkeypatch, err):
    monkeypatch.setattr(sys, "stderr", err)
    lines = []
    log.configure("warning", lambda *line: lines.append(line), form)
    try:
        logger = log.get_logger().bind(port="a")
        logger.info("left out")
        logger.bind(port="b").error("lost", after_s=1.5)
        logger.warning("late")
    finally:
        structlog.reset_defaults()
    assert lines == [("error", "lost", {"port": "b", "after_s": 1.5}), ("warning", "late", {"port": "a"})]
    err.seek(0)
    assert len(err.read().splitlines()) == 2


def test_what_a_device_says_cannot_steer_the_terminal(err):
    code = SAYS.replace("two\\nlines", "x").replace("/dev/ttyUSB0", "\\33[2J")
    subprocess.run([sys.executable, "-c", code, ""], stderr=err, check=True)
    err.seek(0)
    text = err.read()
    assert "\33" not in text and "port=\\x1b[2J" in text


def test_a_terminal_gets_colours_unless_they_are_not_wanted():
    shown = {}
    for wanted in ("", "1"):
        ours, theirs = os.openpty()
        environment = {**os.environ, "NO_COLOR": wanted, "JOURNAL_STREAM": ""}
        subprocess.run([sys.executable, "-c", SAYS, ""], stderr=theirs, env=environment, check=True)
        os.close(theirs)
        shown[wanted] = os.read(ours, 4096)
        os.close(ours)
    assert b"\33[" in shown[""] and b"\33" not in shown["1"]
    assert re.sub(rb"\x1b\[\d+m", b"", shown[""])[8:].split() == shown["1"][8:].split()


@given(st.dictionaries(st.from_regex(r"[a-z_][a-z0-9_]{0,9}", fullmatch=True), st.text() | st.integers()), st.text())
def test_any_event_is_readable(event, text):
    entry = parsed(log.datagram(6, {"event": text, **{f"x{key}": value for key, value in event.items()}}))
    assert entry["EVENT"] == text.encode(errors="replace").decode()
    assert all(name and name[0] not in "_0123456789" for name in entry)


def test_the_log_does_not_cost_asyncio():
    code = "import sys, imud.process.log; from structlog import stdlib; print('asyncio.base_events' in sys.modules)"
    code += "; print(stdlib.asyncio.sleep.__module__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "asyncio.tasks"]


UNREAD = """
import sys
from imud.process import log
log.configure()
for number in range(3000):
    log.get_logger().warning("x" * 100)
print("not stopped", flush=True)
sys.stdin.readline()
for number in range(2):
    log.get_logger().warning("read again")
"""


def two_sockets():
    """As the journal's: systemd connects a service's stderr so."""
    return (end.detach() for end in socket.socketpair())


@pytest.mark.parametrize("opened", [os.pipe, os.openpty, two_sockets])
def test_a_log_that_nobody_reads_loses_lines_and_stops_nothing(opened):
    reader, writer = opened()
    command = [sys.executable, "-c", UNREAD]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=writer, text=True) as process:
        os.close(writer)
        if not select.select([process.stdout], [], [], 60.0)[0]:
            process.kill()  # it waits for the reader of its log
        assert process.stdout.readline() == "not stopped\n"
        got = b""
        while select.select([reader], [], [], 0.5)[0]:
            got += os.read(reader, 1 << 16)
        process.stdin.write("go on\n")
        process.stdin.flush()
        with contextlib.suppress(OSError):  # how the end of a terminal is read
            while more := os.read(reader, 1 << 16):
                got += more
    os.close(reader)
    assert process.returncode == 0
    assert got.count(b"x" * 100) > 5
    assert b"read again" in got.splitlines()[-1]
