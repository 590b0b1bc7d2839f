"""A real gpsd: behind us as a relay, and beside us as the model of our answers. Skipped where there is none."""

import contextlib
import functools
import itertools
import json
import operator
import os
import pty
import re
import select
import socket
import subprocess
import sys
import tty
from collections.abc import Iterator

import pytest
from gpsd_programs import on_the_circle, program, py_gps, terminal, until
from gpsd_synthetic import running
from processes import TIMEOUT_S


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    with running() as address:
        yield address


def free_port() -> int:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return sock.getsockname()[1]


@contextlib.contextmanager
def real_gpsd(source: str) -> Iterator[str]:
    """A gpsd that reads `source`; yields its address."""
    port = free_port()
    command = [program("gpsd"), "-N", "-n", "-S", str(port), source]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:

        def listening() -> bool:
            with contextlib.suppress(ConnectionRefusedError), socket.create_connection(("127.0.0.1", port)):
                return True
            return False

        try:
            until(listening, "gpsd listening")
            yield f"127.0.0.1:{port}"
        finally:
            process.terminate()


def messages_of(address: str, *requests: bytes) -> Iterator[dict]:
    host, _, port = address.rpartition(":")
    with socket.create_connection((host, int(port)), timeout=TIMEOUT_S) as sock:
        for request in requests:
            sock.sendall(request)
        for text in sock.makefile("rb"):
            yield json.loads(text)


@pytest.fixture(scope="module")
def relay(server: str) -> Iterator[str]:
    with real_gpsd(f"gpsd://{server}") as address:
        yield address


def test_a_real_gpsd_relays_every_class_and_loses_nothing(relay):
    numbers, kinds, device = [], set(), set()
    for message in messages_of(relay, b'?WATCH={"enable":true,"json":true};\n'):
        if message["class"] in ("TPV", "SKY", "ATT", "IMU", "EST"):
            kinds.add(message["class"])
            device.add(message["device"])
        if message["class"] == "EST":
            numbers.append(message["t_mono_ns"])
            if len(numbers) == 30:
                break
    assert kinds == {"TPV", "SKY", "ATT", "IMU", "EST"}
    assert len(device) == 1 and device.pop().endswith("#/dev/ttyUSB0")
    periods = [round((b - a) / 1e8) for a, b in itertools.pairwise(numbers)]
    assert sum(periods) == pytest.approx(29, abs=1)


def test_cgps_behind_a_real_gpsd_shows_a_3d_fix(relay):
    with terminal(program("cgps"), "-s", "-u", "m", relay) as screen:
        until(lambda: "3D" in screen() and re.search(r"48\.13\d+ N", screen()), "a 3D fix through the relay")


def test_python_gps_behind_a_real_gpsd(relay):
    _, mode, lat, lon, *_ = py_gps(relay)
    assert mode == 3 and on_the_circle(lat, lon)


@contextlib.contextmanager
def receiver() -> Iterator[str]:
    """A pseudo-terminal on which an NMEA receiver speaks once per half second."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    sentence = b"GPGGA,120020.00,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,"
    checksum = functools.reduce(operator.xor, sentence)
    line = b"$%s*%02X\r\n" % (sentence, checksum)
    code = f"import os, time\nwhile True:\n    os.write({master}, {line!r})\n    time.sleep(0.5)"
    with subprocess.Popen([sys.executable, "-c", code], pass_fds=[master]) as process:
        try:
            yield os.ttyname(slave)
        finally:
            process.kill()
            os.close(slave)
            os.close(master)


def conversation(address: str, *requests: bytes) -> list[list[str]]:
    """The classes, and keys where they are fixed, that each request is answered with; ?VERSION ends each answer.

    It is sent when the answer begins or does not come: gpsd takes what it reads at once for one request.
    """
    host, _, port = address.rpartition(":")
    answers = []
    with socket.create_connection((host, int(port)), timeout=TIMEOUT_S) as sock:
        lines = sock.makefile("rb")
        next(lines)
        for request in requests:
            sock.sendall(request)
            select.select([sock], [], [], 0.3)
            sock.sendall(b"?VERSION;\n")
            found = []
            while (message := json.loads(next(lines)))["class"] != "VERSION":
                if message["class"] in ("DEVICES", "DEVICE", "WATCH", "POLL", "ERROR"):
                    found.append(message["class"])
                if message["class"] == "WATCH":
                    found += [f"enable={message['enable']}", f"json={message['json']}"]
                if message["class"] == "POLL":
                    found += [key for key in ("active", "tpv", "sky") if message[key]]
            answers.append(found)
    return answers


REQUESTS = (
    b"?DEVICES;\n", b"?DEVICE;\n", b"?WATCH;\n", b"?POLL;\n",
    b"?FOO;\n", b"hello\n", b"?\n", b"?WATCHED\n", b"?watch;\n", b"?VERSIONS;\n",
    b'?DEVICE={"path":"/dev/nope"}\n', b'?WATCH={"device":"/dev/nope"}\n',
    b'?WATCH={"enable":true}\n', b"?POLL;\n", b"?POLL;?DEVICES;\n", b'?WATCH={"json":true};\n', b"?WATCH;\n",
    b'?WATCH={"enable":false}\n', b"?WATCH={}\n", b'?WATCH={"json":false,"unknown":1}\n', b"?POLL;\n",
)  # fmt: skip


def test_we_answer_as_a_real_gpsd_does(server):
    with receiver() as device, real_gpsd(device) as address:

        def has_fix() -> bool:
            poll = (m for m in messages_of(address, b'?WATCH={"enable":true};\n', b"?POLL;\n") if m["class"] == "POLL")
            tpv = next(poll)["tpv"]
            return bool(tpv) and tpv[0]["mode"] == 3

        until(has_fix, "a fix of the real gpsd")
        model = conversation(address, *REQUESTS)
    ours = conversation(server, *REQUESTS)
    assert list(zip(REQUESTS, ours, strict=True)) == list(zip(REQUESTS, model, strict=True))
    assert model[REQUESTS.index(b"?WATCH={}\n")] == ["DEVICES", "WATCH", "enable=True", "json=True"]
