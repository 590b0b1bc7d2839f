"""NMEA out: an independent parser reads back what was meant; nothing invalid is said; no reader is waited for."""

import errno
import fcntl
import math
import os
import select
import socket
import subprocess
import sys
import termios
import time

import numpy as np
import pynmeagps
import pytest
from hypothesis import given
from hypothesis import strategies as st
from processes import TIMEOUT_S
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Nmea
from imud.errors import CannotCreateError, ConfigError
from imud.estimators.records import (
    ATTITUDE_VALID,
    COASTING,
    HEADING_VALID,
    HEIGHT_VALID,
    POSITION_VALID,
    SOLUTION,
)
from imud.outputs.nmea import _PTY_BACKLOG, NmeaOutput
from imud.outputs.nmea_sentences import sentences
from imud.outputs.view import View
from imud.sensors.readings import ReceiverReport

ALL = ATTITUDE_VALID | HEADING_VALID | POSITION_VALID | HEIGHT_VALID
GNSS = ReceiverReport(satellites=7, hdop=1.25, quality=1, alt_msl=80.0, geoid_sep=20.0, age_s=0.1)
SECOND_NS = 1_000_000_000


def view(
    status=ALL, lat=0.0, lon=0.0, v=(1.0, -2.0, 0.0), rpy=(0.0, 0.0, 0.0), w=(0.0, 0.0, 0.0), gnss=GNSS, utc_s=1.7e9
):
    row = np.zeros(1, SOLUTION)
    x, y, z, scalar = Rotation.from_euler("ZYX", rpy[::-1], degrees=True).as_quat()
    row["q_nb"], row["status"], row["height"], row["w"], row["v"] = (scalar, x, y, z), status, 100.0, w, v
    row["lat"], row["lon"] = math.radians(lat), math.radians(lon)
    row["sigma_rpy"], row["sigma_v"] = np.radians([0.1, 0.2, 0.3]), 0.1
    return View(solution=row[0].tobytes(), utc_s=utc_s, gnss=gnss)


def parsed(a_view):
    """Sentences by kind; PASHR, which the library takes for proprietary, as its fields."""
    found = {}
    for sentence in sentences(a_view).splitlines(keepends=True):
        message = pynmeagps.NMEAReader.parse(sentence, validate=pynmeagps.VALCKSUM)
        kind = sentence[1:6].decode()
        found[kind] = sentence.split(b"*")[0].decode().split(",") if kind == "PASHR" else message
    assert set(found) == {"GPGGA", "GPRMC", "GPVTG", "GPHDT", "GPROT", "PASHR"}
    assert list(found)[-1] == "GPRMC"  # gpsd 3.22 tells no position of bursts that end with PASHR
    return found


ANGLE = st.floats(-89.0, 89.0)


@given(st.floats(-90, 90), st.floats(-180, 180), ANGLE, ANGLE, st.floats(-180, 180))
def test_sentences_contain_the_solution(lat, lon, roll, pitch, yaw):
    said = parsed(view(lat=lat, lon=lon, rpy=(roll, pitch, yaw)))
    for kind in ("GPGGA", "GPRMC"):
        assert said[kind].lat == pytest.approx(lat, abs=1e-8)
        assert said[kind].lon == pytest.approx(lon, abs=1e-8)
    assert said["GPGGA"].alt + said["GPGGA"].sep == pytest.approx(100.0)
    assert (said["GPGGA"].numSV, said["GPGGA"].HDOP, said["GPGGA"].quality) == (7, pytest.approx(1.25, abs=0.06), 1)
    assert said["GPRMC"].spd * 1852 / 3600 == pytest.approx(math.sqrt(5), abs=1e-3)
    assert said["GPVTG"].sogk / 3.6 == pytest.approx(math.sqrt(5), abs=1e-3)
    assert said["GPVTG"].cogt == pytest.approx(math.degrees(math.atan2(-2, 1)) % 360, abs=0.01)
    assert 0.0 <= said["GPHDT"].headingT < 360.0
    assert math.remainder(said["GPHDT"].headingT - yaw, 360.0) == pytest.approx(0.0, abs=0.006)
    _, clock, heading, _, r, p, _, sr, sp, sh, quality, aligned = said["PASHR"]
    assert (float(r), float(p), clock) == (pytest.approx(roll, abs=0.006), pytest.approx(pitch, abs=0.006), "221320.00")
    assert r[0] in "+-" and p[0] in "+-" and float(heading) == said["GPHDT"].headingT
    assert [float(sr), float(sp), float(sh)] == [0.1, 0.2, 0.3]
    assert (quality, aligned) == ("1", "1")


def test_the_rate_of_turn_is_that_of_the_heading():
    """By difference quotient: turn the attitude by the body rates for a moment and look at the yaw."""
    w, rpy, dt = (0.3, -0.2, 0.1), (30.0, 20.0, 10.0), 1e-6
    before = Rotation.from_euler("ZYX", rpy[::-1], degrees=True)
    after = before * Rotation.from_rotvec(np.array(w) * dt)
    rate = (after.as_euler("ZYX", degrees=True)[0] - rpy[2]) / dt * 60.0
    assert parsed(view(rpy=rpy, w=w))["GPROT"].rot == pytest.approx(rate, abs=0.02)


def test_where_the_estimator_takes_no_fixes_the_position_is_the_receivers():
    receiver = view(status=POSITION_VALID, lat=47.5, utc_s=1.7e9 - 1.0)
    said = parsed(view(status=ATTITUDE_VALID, rpy=(1, 2, 3))._replace(receiver=receiver))
    for kind in ("GPGGA", "GPRMC"):
        assert said[kind].lat == pytest.approx(47.5) and said[kind].time.second == 19
    assert said["GPVTG"].sogk / 3.6 == pytest.approx(math.sqrt(5), abs=1e-3)
    assert said["PASHR"][1] == "221320.00" and said["PASHR"][4:6] == ["+1.00", "+2.00"]


def test_invalid_values_are_empty_fields():
    assert sentences(View()) == (
        b"$GPGGA,,,,,,0,,,,M,,M,,*66\r\n$GPVTG,,T,,M,,N,,K,N*2C\r\n"
        b"$GPHDT,,T*1B\r\n$GPROT,,V*08\r\n$PASHR,,,T,,,,,,,0,0*20\r\n$GPRMC,,V,,,,,,,,,,N*53\r\n"
    )
    attitude_only = parsed(view(status=ATTITUDE_VALID, rpy=(1, 2, 3)))
    assert attitude_only["GPGGA"].lat == "" and attitude_only["GPRMC"].status == "V"
    assert attitude_only["GPHDT"].headingT == "" and attitude_only["GPROT"].valid == "A"
    assert attitude_only["PASHR"][2] == "" and attitude_only["PASHR"][4:6] == ["+1.00", "+2.00"]
    assert parsed(view(status=POSITION_VALID))["PASHR"][4:6] == ["", ""]
    assert parsed(view(rpy=(0, 90, 0)))["GPROT"].valid == "V"


@pytest.mark.parametrize(
    ("status", "quality", "gga", "mode"),
    [
        (ALL, 1, 1, "A"),
        (ALL, 2, 2, "D"),
        (ALL, 4, 4, "R"),
        (ALL, 5, 5, "F"),
        (ALL | COASTING, 4, 6, "E"),
        (ALL, 0, 6, "E"),
    ],
)
def test_the_quality_of_the_fix_is_in_gga_rmc_and_vtg(status, quality, gga, mode):
    said = parsed(view(status=status, gnss=GNSS._replace(quality=quality)))
    assert (said["GPGGA"].quality, said["GPRMC"].posMode, said["GPVTG"].posMode) == (gga, mode, mode)


def test_without_a_geoid_the_altitude_is_that_of_a_receiver_without_one_and_slow_motion_has_no_course():
    assert parsed(view(gnss=None))["GPGGA"].alt == ""
    above_sea = parsed(view(gnss=GNSS._replace(geoid_sep=math.nan)))["GPGGA"]
    assert (above_sea.alt, above_sea.sep) == (pytest.approx(parsed(view(gnss=GNSS))["GPGGA"].alt + 20.0), "")
    assert parsed(view(v=(0.1, 0.1, 0.0)))["GPVTG"].cogt == ""


@pytest.mark.parametrize(
    ("utc_s", "clock"), [(1.7e9 + 0.999, "221320.99"), (1.7e9 - 0.0001, "221319.99"), (86399.999, "235959.99")]
)
def test_the_time_is_never_in_the_future(utc_s, clock):
    assert parsed(view(utc_s=utc_s))["PASHR"][1] == clock


def test_nmea_has_the_hundredths_that_were_meant():
    for tenth in range(10):
        assert parsed(view(utc_s=1.7e9 + tenth / 10))["PASHR"][1] == f"221320.{tenth}0"


def test_udp_at_its_rate():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reader:
        reader.bind(("127.0.0.1", 0))
        reader.setblocking(False)
        output = NmeaOutput(Nmea(udp=f"127.0.0.1:{reader.getsockname()[1]}", rate_hz=5.0))
        for now_ns in range(0, 10 * SECOND_NS, SECOND_NS // 100):
            if now_ns >= output.due_ns:
                output.publish(view(), now_ns)
        heard = 0
        while True:
            try:
                assert reader.recv(2000) == sentences(view())
            except BlockingIOError:
                break
            heard += 1
        assert heard in (50, 51)
        reader.close()
        for now_ns in range(10 * SECOND_NS, 12 * SECOND_NS, SECOND_NS // 5):
            output.publish(view(), now_ns)  # nobody there: refused by ICMP, and no matter
        output.close()


@pytest.mark.parametrize("udp", ["192.0.2.1", "255.255.255.255:10110", "/tmp/x", "nonsense:port"])
def test_addresses_that_need_a_word(udp):
    with pytest.raises(ConfigError):
        NmeaOutput(Nmea(udp=udp))


def read_until(fd, end):
    """What the descriptor gives, up to `end`: a pseudo-terminal delivers in its own time."""
    heard = b""
    while not heard.endswith(end):
        assert select.select([fd], [], [], 10.0)[0], heard
        heard += os.read(fd, 65536)
    return heard


def settle(fd, wanted):
    """Wait until so many bytes can be read from the descriptor: a pseudo-terminal delivers in its own time."""
    give_up = time.monotonic() + TIMEOUT_S
    while (unread := int.from_bytes(fcntl.ioctl(fd, termios.FIONREAD, bytes(4)), sys.byteorder)) != wanted:
        assert time.monotonic() < give_up, (unread, wanted)
        time.sleep(0.001)


def test_a_pseudo_terminal_holds_the_newest_news_only(tmp_path):
    link = tmp_path / "nmea"
    link.symlink_to("/dev/pts/999999")  # left over
    output = NmeaOutput(Nmea(pty=str(link), rate_hz=10.0))
    reader = os.open(link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    unread = 0
    for second in range(100):
        output.publish(view(utc_s=1.7e9 + second), second * SECOND_NS)
        unread = (unread if unread <= _PTY_BACKLOG else 0) + len(sentences(view(utc_s=1.7e9 + second)))
        settle(reader, unread)
    os.write(reader, b"$PMTK314,whatever\r\n" * 200)
    heard = read_until(reader, sentences(view(utc_s=1.7e9 + 99)))
    assert len(heard) == unread
    for line in heard.splitlines(keepends=True):
        pynmeagps.NMEAReader.parse(line)
    rival = f"from imud.outputs.nmea import NmeaOutput, Nmea; NmeaOutput(Nmea(pty={str(link)!r}))"
    refused = subprocess.run([sys.executable, "-c", rival], capture_output=True, check=False)
    assert b"another instance uses it" in refused.stderr
    output.publish(view(), 200 * SECOND_NS)
    assert read_until(reader, sentences(view())) == sentences(view())
    os.close(reader)
    output.close()
    assert not link.is_symlink()
    output.close()


def test_a_link_that_cannot_be_made(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(CannotCreateError, match=os.strerror(errno.EEXIST)):
        NmeaOutput(Nmea(pty=str(tmp_path / "file")))
    assert (tmp_path / "file").exists()


def test_nothing_configured_wants_nothing():
    assert NmeaOutput(Nmea()).due_ns > 1 << 62
