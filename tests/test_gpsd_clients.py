"""Unmodified gpsd clients against our server, and our answers against those of a real gpsd.

Each test needs a program or module of the machine and is skipped with the reason when it is not there. The vehicle of
`gpsd_synthetic` moves on a circle; a client is right when it shows a point of that circle.
"""

import contextlib
import fcntl
import functools
import itertools
import json
import math
import operator
import os
import pty
import re
import select
import shutil
import socket
import struct
import subprocess
import sys
import termios
import time
import tty
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from pathlib import Path

import pynmeagps
import pyte
import pytest
from gpsd_synthetic import GEOID_M, HEIGHT_M, LAT_DEG, LON_DEG, RADIUS_M, ROLL_DEG, SPEED_MPS, running
from processes import PATIENCE_S

SYSTEM_PYTHON = "/usr/bin/python3"  # where Debian's python3-gps is


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    with running() as address:
        yield address


@pytest.fixture(scope="module")
def attitude_server() -> Iterator[str]:
    with running("--attitude-only") as address:
        yield address


def program(name: str) -> str:
    path = shutil.which(name, path=f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/bin")
    if path is None:
        pytest.skip(f"{name} is not installed (Debian: gpsd, gpsd-clients)")
    return path


def run(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=True).stdout


def on_the_circle(lat: float, lon: float) -> bool:
    """Within a decimetre of the synthetic vehicle's path; a second of arc of latitude is 30.9 m."""
    north = (lat - LAT_DEG) * 3600.0 * 30.887
    east = (lon - LON_DEG) * 3600.0 * 30.922 * math.cos(math.radians(LAT_DEG)) * 1.0018
    return math.hypot(north, east) == pytest.approx(RADIUS_M, abs=0.2)


def until(condition: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, f"in vain: {what}"
        time.sleep(0.05)


# --- programs of gpsd-clients


def test_gpspipe_prints_what_we_send(server):
    lines = run(program("gpspipe"), "-w", "-n", "12", server).splitlines()
    messages = [json.loads(text) for text in lines]
    kinds = [message["class"] for message in messages]
    assert kinds[:8] == ["VERSION", "DEVICES", "WATCH", "TPV", "SKY", "ATT", "IMU", "EST"]
    tpv = messages[3]
    assert tpv["mode"] == 3 and on_the_circle(tpv["lat"], tpv["lon"])


def test_gpspipe_prints_nmea_when_asked(server):
    lines = run(program("gpspipe"), "-r", "-n", "9", server).splitlines()
    assert [json.loads(text)["class"] for text in lines[:3]] == ["VERSION", "DEVICES", "WATCH"]
    assert [text[:6] for text in lines[3:6]] == ["$GPGGA", "$GPVTG", "$GPHDT"]
    assert on_the_circle(*(getattr(pynmeagps.NMEAReader.parse(lines[3]), name) for name in ("lat", "lon")))


@contextlib.contextmanager
def terminal(*command: str) -> Iterator[Callable[[], str]]:
    """A program in a pseudo-terminal; yields a function that reads its screen as a person would."""
    pid, fd = pty.fork()
    if pid == 0:
        os.environ.update(TERM="xterm", LINES="40", COLUMNS="130")
        os.execv(command[0], command)
    fcntl.ioctl(fd, termios.TIOCSWINSZ, struct.pack("4H", 40, 130, 0, 0))
    display = pyte.Screen(130, 40)
    stream = pyte.ByteStream(display)

    def screen() -> str:
        while select.select([fd], [], [], 0)[0]:
            try:
                stream.feed(os.read(fd, 65536))
            except OSError:  # the program has ended
                break
        return "\n".join(display.display)

    try:
        yield screen
    finally:
        os.kill(pid, 15)
        os.waitpid(pid, 0)
        os.close(fd)


def test_cgps_shows_a_3d_fix_and_the_position(server):
    with terminal(program("cgps"), "-s", "-u", "m", server) as screen:
        epx = "+/-  2.9 m"  # 1.96 times 1.5 m; drawn after the rest of the first fix
        until(lambda: "3D" in screen() and epx in screen() and " 45.0 " in screen(), "fix and satellites on the screen")
        shown = screen()
    lat = re.search(r"(\d+\.\d+) N", shown)
    lon = re.search(r"(\d+\.\d+) E", shown)
    assert on_the_circle(float(lat[1]), float(lon[1]))
    assert re.search(r"3D (GNSSDR )?FIX", shown)
    assert f"{HEIGHT_M:.3f}," in shown and f"{HEIGHT_M - GEOID_M:.3f} m" in shown
    assert "36.00 km/h" in shown
    assert re.search(r"GP +5 +5 +45.0 +61.0 +31.0 +Y", shown), shown


def test_cgps_shows_no_fix_for_attitude_alone(attitude_server):
    with terminal(program("cgps"), "-s", "-u", "m", attitude_server) as screen:
        until(lambda: re.search(r"20\d\d-\d\d-\d\dT", screen()), "the time on cgps' screen")
        shown = screen()
    assert "NO FIX" in shown
    assert not re.search(r"\d\.\d+ N ", shown)


def test_gpxlogger_writes_a_track(server, tmp_path):
    file = tmp_path / "track.gpx"
    with subprocess.Popen([program("gpxlogger"), "-i", "1", "-f", str(file), server]) as process:
        until(lambda: file.exists() and file.read_text().count("</trkpt>") >= 5, "five points in the track")
        process.terminate()
    space = "{http://www.topografix.com/GPX/1/1}"
    points = ET.fromstring(file.read_text()).findall(f".//{space}trkpt")
    assert all(on_the_circle(float(point.get("lat")), float(point.get("lon"))) for point in points)
    assert {point.find(f"{space}ele").text for point in points} == {f"{HEIGHT_M:.4f}"}
    assert {point.find(f"{space}fix").text for point in points} == {"3d"}


def test_gps2udp_forwards_the_messages(server):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(PATIENCE_S)
        target = f"127.0.0.1:{receiver.getsockname()[1]}"
        with subprocess.Popen([program("gps2udp"), "-j", "-u", target, server], stdout=subprocess.DEVNULL) as process:
            seen = set()
            while not {"TPV", "ATT"} <= seen:
                seen.add(json.loads(receiver.recv(65536))["class"])
            process.terminate()


def test_gpscsv_logs_attitudes(server):
    header, *rows = run(program("gpscsv"), "-n", "5", "-c", "ATT", server).split()
    assert len(rows) == 5
    for row in rows:
        attitude = dict(zip(header.split(","), row.split(","), strict=True))
        assert float(attitude["roll"]) == pytest.approx(ROLL_DEG)
        assert 0.0 <= float(attitude["heading"]) < 360.0


# --- Python modules

PY_GPS = """
import gps, json
session = gps.gps(host="127.0.0.1", port="{port}", mode=gps.WATCH_ENABLE | gps.WATCH_NEWSTYLE)
kinds = []
while len(kinds) < 9:
    if session.read() == -1:
        break
    if session.data:
        kinds.append(session.data["class"])
fix = session.fix
print(json.dumps([kinds, fix.mode, fix.latitude, fix.longitude, fix.altHAE, fix.speed]))
"""


def py_gps(address: str) -> list:
    probe = [SYSTEM_PYTHON, "-c", "import gps"]
    if not Path(SYSTEM_PYTHON).exists() or subprocess.run(probe, capture_output=True, check=False).returncode:
        pytest.skip("no Python module gps (Debian: python3-gps)")
    return json.loads(run(SYSTEM_PYTHON, "-c", PY_GPS.format(port=address.rpartition(":")[2])))


def test_python_gps_module(server):
    kinds, mode, lat, lon, height, speed = py_gps(server)
    assert kinds == ["VERSION", "DEVICES", "WATCH", "TPV", "SKY", "ATT", "IMU", "EST", "TPV"]
    assert mode == 3 and on_the_circle(lat, lon)
    assert height == HEIGHT_M
    assert speed == pytest.approx(SPEED_MPS)


def test_gpsdclient(server):
    gpsdclient = pytest.importorskip("gpsdclient")
    host, _, port = server.rpartition(":")
    with gpsdclient.GPSDClient(host, port, timeout=PATIENCE_S) as client:
        stream = client.dict_stream(convert_datetime=True)
        messages = [next(stream) for _ in range(8)]
    kinds = [message["class"] for message in messages]
    assert kinds == ["VERSION", "DEVICES", "WATCH", "TPV", "SKY", "ATT", "IMU", "EST"]
    assert abs(messages[3]["time"].timestamp() - time.time()) < 3600.0  # parsed to a datetime
    assert messages[7]["roll_deg"] == pytest.approx(ROLL_DEG)


def test_gpsd_py3(server):
    gpsd = pytest.importorskip("gpsd")
    host, _, port = server.rpartition(":")
    gpsd.connect(host, int(port))
    packet = gpsd.get_current()
    assert packet.mode == 3 and on_the_circle(*packet.position())
    assert packet.altitude() == HEIGHT_M - GEOID_M
    assert packet.movement()["speed"] == pytest.approx(SPEED_MPS)
    assert packet.position_precision() == (2.94, 4.9)
    assert gpsd.device() == {"path": "/dev/ttyUSB0", "speed": 460800, "driver": "Epson M-G350"}
    gpsd.gpsd_stream.close()
    gpsd.gpsd_socket.close()


def test_gpsd_py3_without_a_fix(attitude_server):
    gpsd = pytest.importorskip("gpsd")
    host, _, port = attitude_server.rpartition(":")
    gpsd.connect(host, int(port))
    packet = gpsd.get_current()
    assert packet.mode == 1
    with pytest.raises(gpsd.NoFixError):
        packet.position()
    gpsd.gpsd_stream.close()
    gpsd.gpsd_socket.close()


# --- a real gpsd: behind us as a relay, and beside us as the model


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
    with socket.create_connection((host, int(port)), timeout=PATIENCE_S) as sock:
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
    with socket.create_connection((host, int(port)), timeout=PATIENCE_S) as sock:
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
