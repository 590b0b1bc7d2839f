"""Unmodified gpsd clients against our server.

Each test needs a program or module of the machine and is skipped with the reason when it is not there. The vehicle of
`gpsd_synthetic` moves on a circle; a client is right when it shows a point of that circle.
"""

import json
import re
import socket
import subprocess
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator

import pynmeagps
import pytest
from gpsd_programs import on_the_circle, program, py_gps, run, terminal, until
from gpsd_synthetic import GEOID_M, HEIGHT_M, ROLL_DEG, SPEED_MPS, running
from processes import TIMEOUT_S


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    with running() as address:
        yield address


@pytest.fixture(scope="module")
def attitude_server() -> Iterator[str]:
    with running("--attitude-only") as address:
        yield address


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


def test_cgps_shows_no_fix_without_a_receiver(attitude_server):
    with terminal(program("cgps"), "-s", "-u", "m", attitude_server) as screen:
        until(lambda: re.search(r"20\d\d-\d\d-\d\dT", screen()), "the time on cgps' screen")
        shown = screen()
    assert "NO FIX" in shown
    assert not re.search(r"\d\.\d+ N ", shown)


def test_gpsmon_shows_the_position(server):
    """It watches the raw stream, and nothing else."""
    with terminal(program("gpsmon"), server) as screen:
        until(
            lambda: "NMEA0183>" in screen() and re.search(r"Latitude: +\d+\.\d+ N", screen()), "RMC on gpsmon's screen"
        )
        shown = screen()
    lat = re.search(r"Latitude: +(\d\d)(\d+\.\d+) N", shown)
    lon = re.search(r"Longitude: *(\d+)(\d\d\.\d+) E", shown)
    assert on_the_circle(*(int(degrees) + float(minutes) / 60 for degrees, minutes in (lat.groups(), lon.groups())))


def test_gpspipe_prints_nmea_as_raw(server):
    lines = run(program("gpspipe"), "-R", "-n", "9", server).splitlines()
    assert json.loads(lines[2])["raw"] == 2
    assert [text[:6] for text in lines[3:6]] == ["$GPGGA", "$GPVTG", "$GPHDT"]


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
        receiver.settimeout(TIMEOUT_S)
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


def test_python_gps_module(server):
    kinds, mode, lat, lon, height, speed = py_gps(server)
    assert kinds == ["VERSION", "DEVICES", "WATCH", "TPV", "SKY", "ATT", "IMU", "EST", "TPV"]
    assert mode == 3 and on_the_circle(lat, lon)
    assert height == HEIGHT_M
    assert speed == pytest.approx(SPEED_MPS)


def test_the_library_gpsdclient_reads_the_stream(server):
    gpsdclient = pytest.importorskip("gpsdclient")
    host, _, port = server.rpartition(":")
    with gpsdclient.GPSDClient(host, port, timeout=TIMEOUT_S) as client:
        stream = client.dict_stream(convert_datetime=True)
        messages = [next(stream) for _ in range(8)]
    kinds = [message["class"] for message in messages]
    assert kinds == ["VERSION", "DEVICES", "WATCH", "TPV", "SKY", "ATT", "IMU", "EST"]
    assert abs(messages[3]["time"].timestamp() - time.time()) < 3600.0  # parsed to a datetime
    assert messages[7]["roll_deg"] == pytest.approx(ROLL_DEG)


def test_the_library_gpsd_py3_reads_a_fix(server):
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


@pytest.mark.thorough
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
