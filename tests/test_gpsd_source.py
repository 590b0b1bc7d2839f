"""A gpsd as the receiver, `--port gpsd://HOST:PORT`: its reports, the connection, Debian's gpsd where there is one.

REAL are lines of Debian's gpsd 3.22, which read our emulated ZED-F9P; fields that are not used are left out.
"""

import contextlib
import json
import math
import os
import pty
import socket
import threading
import time
import tty

import pytest
from nmea_lines import gga, rmc
from scripted import Mute, Speaker, run
from test_gpsd_real import real_gpsd

from imud.configuration.settings import Gnss
from imud.daemon.ports import Port
from imud.drivers.detect import detect_server, search
from imud.drivers.driver import GnssConfigured, Identity, Options, Unsupported
from imud.drivers.errors import PortAbsentError, PortLostError, SpecError
from imud.drivers.findings import NoGreeting
from imud.drivers.gpsd.decoder import GpsdDecoder
from imud.drivers.registry import by_name
from imud.drivers.transport.dialogue_runner import run_dialogue
from imud.drivers.transport.line import open_line
from imud.drivers.transport.portspec import PortSpec
from imud.errors import UsageError
from imud.sensors.gnss import record
from imud.sensors.receiver import Receiver
from imud.setup import choices
from imud.setup.config import load

DRIVER = by_name("gpsd")
VERSION = b'{"class":"VERSION","release":"3.22","rev":"3.22","proto_major":3,"proto_minor":14}\r\n'
REAL = [
    b'{"class":"TOFF","device":"/tmp/gd.ubx","real_sec":1795396207, "real_nsec":0,"clock_sec":1795396207,'
    b'"clock_nsec":141775695}',
    b'{"class":"TPV","device":"/tmp/gd.ubx","mode":3,"time":"2026-11-23T01:10:07.000Z","ept":0.005,"lat":35.658628000,'
    b'"lon":139.745819800,"altHAE":59.3290,"altMSL":22.6290,"alt":22.6290,"epx":8.594,"epy":10.889,"epv":2.593,'
    b'"track":89.4682,"magvar":-7.6,"speed":13.476,"climb":0.182,"geoidSep":36.700,"eph":2.192,"sep":34.390}',
    b'{"class":"SKY","device":"/tmp/gd.ubx","time":"2019-04-08T01:10:07.000Z","xdop":0.57,"vdop":1.54,"hdop":1.02,'
    b'"pdop":1.84,"nSat":9,"uSat":8,"satellites":[{"PRN":21,"el":62.0,"az":41.0,"ss":45.0,"used":true,"gnssid":0,'
    b'"svid":21},{"PRN":28,"el":55.0,"az":200.0,"ss":47.0,"used":true,"gnssid":0,"svid":28}]}',
]
SECOND = 10**9


def line(kind, **values):
    return json.dumps({"class": kind, "device": "/dev/a", **values}).encode() + b"\r\n"


def tpv(second=0, **values):
    known = {"mode": 3, "time": f"2026-11-23T01:10:{second:02d}.000Z", "lat": 48.0, "lon": 11.0, "altMSL": 500.0}
    return line("TPV", **{**known, "geoidSep": 47.0, "speed": 5.0, "track": 90.0, **values})


def test_debians_reports():
    decoder = GpsdDecoder()
    assert decoder.feed(b"".join(text + b"\r\n" for text in (REAL[2], REAL[0])), 5) == []
    assert decoder.feed(REAL[1] + b"\r\n", 7) == []
    (fix,) = decoder.flush(SECOND)
    assert (fix.lat_deg, fix.lon_deg, fix.height_m, fix.alt_msl_m) == (
        35.658628,
        139.7458198,
        pytest.approx(59.329),
        22.629,
    )
    assert (fix.speed_mps, fix.course_deg, fix.hdop, fix.satellites) == (13.476, 89.4682, 1.02, 8)
    assert (fix.utc_s, fix.date.isoformat(), fix.quality, fix.dimensions) == (4207.0, "2026-11-23", 1, 3)
    assert fix.arrival_ns == 5, "the TOFF came as the epoch began"
    assert (fix.sigma_n_m, fix.velocity_mps) == (None, None), "guesses of gpsd"
    assert [(one.number, one.used, one.signal_dbhz) for one in decoder.sky.satellites] == [
        (21, True, 45),
        (28, True, 47),
    ]


def test_several_reports_of_one_epoch_are_one_fix_when_as_many_came_as_before():
    decoder = GpsdDecoder()
    parts = [{"speed": None, "track": None}, {"altMSL": None}]
    assert decoder.feed(tpv(0, **parts[0]) + tpv(0, **parts[1]), 0) == []
    (first,) = decoder.feed(tpv(1, **parts[0]), SECOND)
    (second,) = decoder.feed(tpv(1, altMSL=501.0), SECOND + 5)
    assert (first.speed_mps, second.alt_msl_m, second.arrival_ns) == (5.0, 501.0, SECOND)
    assert decoder.feed(tpv(1), SECOND + 9) == [] and decoder.counters["late"] == 1
    assert decoder.feed(tpv(2) * 2, 2 * SECOND) == [], "three are expected now"
    assert len(decoder.feed(tpv(2), 2 * SECOND)) == 1


@pytest.mark.parametrize(
    ("status", "quality"), [(None, 1), (0, 1), (1, 1), (2, 2), (3, 4), (4, 5), (5, 6), (6, 1), (7, 7), (8, 8), (9, 3)]
)
def test_qualities_are_those_of_nmea(status, quality):
    decoder = GpsdDecoder()
    decoder.feed(tpv(status=status), 0)
    assert decoder.flush(SECOND)[0].quality == decoder.status.quality == quality


def test_no_fix_ends_the_epoch_and_is_reported():
    decoder = GpsdDecoder()
    decoder.feed(tpv(), 0)
    assert len(decoder.feed(line("TPV", mode=1), 5)) == 1
    assert (decoder.status.quality, decoder.status.arrival_ns, decoder.counters["no fix"]) == (0, 5, 1)
    receiver = Receiver(DRIVER, Gnss(), 0)
    receiver.feed(line("TPV", mode=0), SECOND)
    assert receiver.faults(SECOND) == ("receiver: no fix",)
    assert any("stale" in text for text in receiver.faults(9 * SECOND))


def test_a_two_dimensional_fix_has_no_height():
    decoder = GpsdDecoder()
    decoder.feed(tpv(mode=2), 0)
    assert math.isnan(record(decoder.flush(SECOND)[0], 0, 0)["height"][0])


def test_the_errors_are_those_of_gst_for_the_same_epoch():
    decoder, sigmas = GpsdDecoder(), {"lat": 1.5, "lon": 2.5, "alt": 4.0}
    fixes = []
    for second in range(3):
        if second != 1:
            decoder.feed(line("GST", time=f"2026-11-23T01:10:{second:02d}.000Z", **sigmas), second * SECOND)
        fixes += decoder.feed(tpv(second), second * SECOND) + decoder.flush(second * SECOND + SECOND // 2)
    assert [fix.sigma_e_m for fix in fixes] == [2.5, None, 2.5]


def test_one_of_two_devices_counts_until_it_is_away():
    decoder, used = GpsdDecoder(), []
    for second in range(20):
        now_ns = second * SECOND
        data = tpv(second, lat=10.0) if second < 8 or second >= 15 else line("TPV", mode=1)
        fixes = decoder.feed(data + tpv(second, device="/dev/b", lat=20.0), now_ns) + decoder.flush(
            now_ns + SECOND // 2
        )
        used += [(second, fix.lat_deg) for fix in fixes]
    assert used == [(s, 10.0) for s in range(8)] + [(s, 20.0) for s in range(11, 20)]
    assert decoder.counters["other device"] > 10


def test_values_of_a_wrong_type_are_missing():
    decoder = GpsdDecoder()
    for i, wrong in enumerate((True, "48", None, [48.0], 1e400, 91.0, -1e300)):
        assert decoder.feed(tpv(i, lat=wrong), i * SECOND) + decoder.flush(i * SECOND + SECOND // 2) == []
    for bad in (b"[1]\n", b"{}\n", b"nonsense\n", b'{"class":7}\n', b"[" * 60000 + b"\n"):
        decoder.feed(bad, 99 * SECOND)
    decoder.feed(b"x" * 200_000 + b"\n", 99 * SECOND)
    assert (decoder.counters["no JSON"], decoder.counters["too long"]) == (5, 1)
    decoder.feed(tpv(time="yesterday") + tpv(time=5), 99 * SECOND)
    assert decoder.counters["no time"] == 2


def test_any_chunking_gives_the_same_fixes():
    data = b"".join(tpv(second) + line("SKY", hdop=1.0, uSat=9) for second in range(4))

    def fixes(size):
        decoder = GpsdDecoder()
        return [fix for i in range(0, len(data), size) for fix in decoder.feed(data[i : i + size], 1)]

    assert len(fixes(len(data))) == 4
    assert fixes(1) == fixes(7) == fixes(len(data))


# the connection


def test_ports_are_written_like_this():
    assert PortSpec.parse("gpsd://localhost").server == ("localhost", 2947, "")
    assert PortSpec.parse("gpsd://[::1]:4000/dev/ttyACM0").server == ("::1", 4000, "/dev/ttyACM0")
    assert str(PortSpec.parse("gpsd://pi.local:2947")) == "gpsd://pi.local:2947"
    for wrong in ("gpsd://", "gpsd:localhost", "gpsd://a:0", "gpsd://a:99999", "gpsd://a:b", "/dev/ttyUSB0:gpsd"):
        with pytest.raises(SpecError, match="gpsd://"):
            PortSpec.parse(wrong)
    ((_, options),) = choices.ports(load(None, ['ports=["gpsd://a/dev/b"]']))
    assert options.device == "/dev/b"
    with pytest.raises(UsageError, match="named twice"):
        choices.ports(load(None, ['ports=["gpsd://a", "gpsd://a"]']))


def test_reports_of_one_time_with_ever_new_names_take_no_more_memory():
    decoder = GpsdDecoder()
    for i in range(1000):
        decoder.feed(tpv(1, **{f"of no use {i}": i, "altHAE": 547.0}), i)
    assert len(decoder._epoch.values) < 20
    (fix,) = decoder.flush(SECOND)
    assert (fix.lat_deg, fix.height_m, fix.speed_mps, fix.course_deg, fix.quality) == (48.0, 547.0, 5.0, 90.0, 1)


def test_the_greeting_tells_what_it_is():
    found, _ = run(detect_server(), Speaker(0, VERSION))
    assert (found.driver, found.firmware) == ("gpsd", "3.22")
    found, _ = run(
        detect_server(), Speaker(0, VERSION.replace(b'"release":"3.22"', b'"release":"%s"' % (60_000 * b"3")))
    )
    assert found.firmware == 255 * "3"
    other, _ = run(detect_server(), Speaker(0, VERSION.replace(b'"rev":"3.22"', b'"rev":"imud 1.0"')))
    assert isinstance(other, Unsupported) and "estimates" in str(other)
    for device in (Mute(0), Speaker(0, b"HTTP/1.1 400 Bad Request\r\n")):
        assert isinstance(run(detect_server(), device)[0], NoGreeting)


class Server:
    """A gpsd of the tests: greets, and sends `data` when it is asked for reports."""

    def __init__(self, data):
        self._data, self.requests = data, []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._connections = []
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                self._connections.append(connection)
                connection.sendall(VERSION)
                self.requests.append(connection.recv(1000))
                connection.sendall(self._data)

    def drop(self):
        """End all connections, as a gpsd that is restarted."""
        while self._connections:
            connection = self._connections.pop()
            connection.shutdown(socket.SHUT_RDWR)
            connection.close()

    def close(self):
        self.drop()
        self._listener.close()


@pytest.fixture
def serve():
    with contextlib.ExitStack() as stack:

        def start(data):
            server = Server(data)
            stack.callback(server.close)
            return server

        yield start


def connected(server, **options):
    line = open_line(PortSpec.parse(f"gpsd://127.0.0.1:{server.port}"))
    found = run_dialogue(line, search(PortSpec.parse(f"gpsd://127.0.0.1:{server.port}")))
    assert isinstance(found, Identity), found
    return line, run_dialogue(line, DRIVER.configure(found, Options(**options)))


def test_a_gpsd_is_asked_for_its_reports_also_on_a_readonly_port(serve):
    server = serve(tpv())
    line, configured = connected(server, readonly=True, device="/dev/a")
    line.close()
    assert isinstance(configured, GnssConfigured)
    assert server.requests == [b'?WATCH={"enable": true, "json": true, "pps": true, "device": "/dev/a"};\n']


def test_what_gpsd_complains_of_is_shown(serve):
    line, refused = connected(serve(b'{"class":"ERROR","message":"Do nuffin: /dev/a"}\r\n'))
    line.close()
    assert isinstance(refused, Unsupported) and "Do nuffin" in str(refused)


def test_a_server_that_is_not_there():
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(PortAbsentError, match=r"no gpsd at 127\.0\.0\.1 port \d+ \(Connection refused\)"):
        open_line(PortSpec.parse(f"gpsd://127.0.0.1:{port}"))


def test_a_connection_that_ends_is_lost_and_made_again(serve):
    """A port of the daemon, driven as its loop does."""
    server, calls = serve(tpv()), []

    class Owner:
        def __getattr__(self, name):
            return lambda *_: calls.append(name)

    port = Port(PortSpec.parse(f"gpsd://127.0.0.1:{server.port}"), Options(), Owner(), wait=True)
    buffer = memoryview(bytearray(4096))

    def until(state):
        end = time.monotonic() + 30.0
        while port.state.name != state:
            assert time.monotonic() < end, port.description
            port.on_time(time.monotonic())
            if port.state.name == "STREAMING" != state:
                try:
                    port.line.receive(buffer, 0)
                except PortLostError as error:
                    port.lost(str(error))
            elif port.fd >= 0:
                port.on_event()
            time.sleep(0.005)

    until("STREAMING")
    server.drop()
    until("WAITING")
    assert "ended the connection" in port.description
    until("STREAMING")
    assert (port.connects, calls.count("connected"), len(server.requests)) == (2, 2, 2)
    port.close()


def test_debians_gpsd_serves_a_receiver():
    controller, device = pty.openpty()
    tty.setraw(device)
    ended = threading.Event()

    def speak():
        second = 0
        while not ended.wait(0.1):
            time_of_day = f"12{second // 60:02d}{second % 60:02d}.000"
            os.write(controller, gga(time_of_day) + rmc(time_of_day, motion="10.0,90.0"))
            second += 1

    speaker = threading.Thread(target=speak)
    speaker.start()
    try:
        with real_gpsd(os.ttyname(device)) as address:
            spec = PortSpec.parse(f"gpsd://{address}")
            line = open_line(spec)
            found = run_dialogue(line, search(spec))
            assert isinstance(run_dialogue(line, DRIVER.configure(found, Options())), GnssConfigured)
            decoder, fixes, end = GpsdDecoder(), [], time.monotonic() + 30.0
            while len(fixes) < 3 and time.monotonic() < end:
                fixes += decoder.feed(line.read(), time.monotonic_ns())
                time.sleep(0.01)
            line.close()
    finally:
        ended.set()
        speaker.join()
        os.close(controller)
        os.close(device)
    assert [fix.lat_deg for fix in fixes[:3]] == pytest.approx([48 + 7.038 / 60] * 3, abs=1e-8)
    assert fixes[2].alt_msl_m == pytest.approx(545.4, abs=0.01)
