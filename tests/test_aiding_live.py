"""Measurements of other programs in a running daemon: datagrams in, recorded, replayed to the same bits."""

import contextlib
import json
import select
import socket
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
from processes import TIMEOUT_S, daemon, emulator
from recorded import stored

from imud.client import AidingSender, filter_states
from imud.configuration.settings import Initial
from imud.daemon.aiding_socket import LONGEST, AidingSocket, address_of
from imud.daemon.status_reporter import StatusReporter
from imud.daemon.utc import Utc
from imud.errors import ConfigError
from imud.estimators import registry
from imud.estimators.records import HEADING, MAGNETOMETER
from imud.process.contained import ContainedErrors
from imud.recording.messages import ESTIMATE_TABLE, INNOVATION_TABLE
from imud.recording.player import Handlers, Player
from imud.recording.samples import fields_of
from imud.recording.source import Recording, adapter
from imud.sensors.aiding import LINES_MAX, RATE_HZ_MAX, DatagramDecoder, SourceCounter

SOURCES = registry.by_name("navigation").sources
NOW_NS, UNIX_NS = 50_000_000_000, 1_700_000_000_000_000_000


def decoded(receiver, *lines, now_ns=NOW_NS):
    return list(receiver.decode("\n".join(lines).encode(), SOURCES, now_ns, UNIX_NS + now_ns - NOW_NS))


def test_a_heading_with_and_without_a_time():
    timed, untimed = decoded(
        DatagramDecoder(),
        '{"class":"HDG","heading":90,"sigma":0.5,"t":1699999999.75}',
        '{"class":"HDG","heading":-45.5}',
    )
    source, row = timed
    assert source.name == "heading"
    assert row["t_ns"][0] == NOW_NS - 250_000_000 and row["arrival_ns"][0] == NOW_NS
    assert row["value"][0, 0] == pytest.approx(np.pi / 2) and row["sigma"][0, 0] == pytest.approx(np.radians(0.5))
    assert untimed[1]["t_ns"][0] == NOW_NS and np.isnan(untimed[1]["sigma"][0, 0])


@pytest.mark.parametrize(
    ("line", "rule", "why"),
    [
        ("{", "JSON", "no JSON"),
        ("[1]", "JSON", "no JSON object"),
        ('{"class":"HDG","heading":1,"heading":2}', "JSON", "a name is there twice"),
        ('{"class":"HDG","heading":NaN}', "JSON", "NaN is no number of JSON"),
        ('{"class":"HDG","heading":' + "9" * 4000 + "}", "value", "heading is too large"),
        ("[" * 3000, "JSON", "no JSON"),
        ('{"heading":1}', "class", "None is not one of the estimator's: HDG"),
        ('{"class":["HDG"],"heading":1}', "class", "is not one of"),
        ('{"class":"HDG"}', "value", "HDG without heading"),
        ('{"class":"HDG","heading":"1"}', "value", "heading is no number"),
        ('{"class":"HDG","heading":true}', "value", "heading is no number"),
        ('{"class":"HDG","heading":1e300}', "value", "heading is too large"),
        ('{"class":"HDG","heading":361}', "value", "heading_deg is 361, outside -360 to 360"),
        ('{"class":"HDG","heading":1,"sigma":0}', "value", "sigma_deg is 0, outside 0.01 to 180"),
        ('{"class":"HDG","heading":1,"yaw":2}', "value", "HDG has no 'yaw'; it has heading, sigma, t"),
        ('{"class":"HDG","heading":1,"t":12.5}', "time", "Unix time"),
        ('{"class":"HDG","heading":1,"t":1700000000000000000}', "time", "in s?"),  # in ns
        ('{"class":"HDG","heading":1,"t":1700000005}', "time", "t is +5.0 s from its arrival"),
    ],
)
def test_a_line_that_cannot_be_used_is_counted_and_told_once_and_the_others_are_used(line, rule, why):
    receiver = DatagramDecoder()
    assert len(decoded(receiver, line, '{"class":"HDG","heading":1}', line)) == 1
    properties = receiver.properties(NOW_NS)
    assert properties["refused"] == {rule: 2} and why in properties["last_refused"]
    [refused] = [text for text in receiver.messages if text.startswith("refused")]
    assert why in refused


@pytest.mark.parametrize(
    "line",
    ['{"class":"' + "X" * 4000 + '"}', '{"class":"HDG","heading":1' + "".join(f',"x{i}":1' for i in range(500)) + "}"],
)
def test_the_text_of_what_is_refused_is_short_whatever_is_sent(line):
    receiver = DatagramDecoder()
    assert decoded(receiver, line) == []
    assert len(receiver.properties(NOW_NS)["last_refused"]) < 300
    assert all(len(text) < 350 for text in receiver.messages)


def test_bytes_of_any_kind_raise_nothing():
    receiver, rng = DatagramDecoder(), np.random.default_rng(1)
    for _ in range(300):
        assert not list(receiver.decode(rng.bytes(rng.integers(1, 80)), SOURCES, NOW_NS, UNIX_NS))
    assert len(receiver.messages) <= 4


def test_too_many_are_refused_until_the_next_second():
    receiver = DatagramDecoder()
    line = '{"class":"HDG","heading":1}'
    assert sum(len(decoded(receiver, line)) for _ in range(150)) == RATE_HZ_MAX
    assert receiver.properties(NOW_NS)["refused"] == {"rate": 150 - RATE_HZ_MAX}
    assert len(decoded(receiver, line, now_ns=NOW_NS + 1_000_000_000)) == 1


def test_of_a_datagram_with_too_many_lines_the_first_are_read():
    receiver = DatagramDecoder()
    assert len(decoded(receiver, *['{"class":"HDG","heading":1}'] * 40, "", "[]")) == LINES_MAX
    assert receiver.properties(NOW_NS)["refused"] == {"lines": 1}


def test_a_source_that_fell_silent_is_a_fault():
    receiver = DatagramDecoder()
    decoded(receiver, '{"class":"HDG","heading":1}')
    assert receiver.faults(NOW_NS + 2_000_000_000) == ()
    assert receiver.faults(NOW_NS + 4_000_000_000) == ("heading: stale, nothing new comes",)


@pytest.mark.parametrize("text", ["0.0.0.0:2950", "192.0.2.1:2950", ":2950", "no/absolute/path"])
def test_only_this_machine_may_send(text):
    with pytest.raises(ConfigError):
        address_of(text)


@pytest.mark.parametrize("udp", [False, True])
def test_the_sender_reaches_the_socket_and_survives_without_it(udp, tmp_path):
    listening = AidingSocket("127.0.0.1:0" if udp else str(tmp_path / "aiding"), select.poll())
    with AidingSender(listening.address) as sender:
        assert sender.send("HDG", heading=12.5)
        [data] = listening.datagrams()
        assert json.loads(data) == {"class": "HDG", "heading": 12.5}
        sender.send("X" * 5000)
        assert list(listening.datagrams()) == [None]
        listening.close()
        if not udp:
            assert not sender.send("HDG", heading=12.5)


def test_a_sender_looks_a_name_up_once_whatever_kind_of_address_it_has(monkeypatch):
    asked = []

    def look_up(host, port, **_):
        asked.append(host)
        return [(socket.AF_INET6, socket.SOCK_STREAM, 0, "", ("::1", port, 0, 0))]

    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as listening:
        listening.bind(("::1", 0))
        listening.settimeout(30.0)
        monkeypatch.setattr(socket, "getaddrinfo", look_up)
        with AidingSender(f"navigation.example:{listening.getsockname()[1]}") as sender:
            for heading in (1.5, 2.5):
                assert sender.send("HDG", heading=heading)
                assert json.loads(listening.recv(1000)) == {"class": "HDG", "heading": heading}
    assert asked == ["navigation.example"]


def test_a_flood_of_datagrams_full_of_lines_is_read_in_small_pieces(tmp_path):
    with contextlib.closing(AidingSocket(str(tmp_path / "aiding"), select.poll())) as listening:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            for _ in range(4):
                sender.sendto(b"[]\n" * (LONGEST // 3), str(tmp_path / "aiding"))
        assert [len(list(listening.datagrams())) for _ in range(5)] == [1, 1, 1, 1, 0]
        with AidingSender(listening.address) as sender:
            sent = sum(sender.send("HDG", heading=1.0) for _ in range(5))
        assert len(list(listening.datagrams())) == sent  # those of a well-behaved program, at once


def last_states(path):
    """The first STATES that a client gets who watches nothing else."""
    with socket.socket(socket.AF_UNIX) as sock:
        sock.settimeout(TIMEOUT_S)
        sock.connect(str(path))
        sock.sendall(b'?WATCH={"enable":true,"json":true,"class":"STATES"};\n')
        return next(m for m in map(json.loads, sock.makefile("rb")) if m["class"] == "STATES")


@pytest.mark.thorough
def test_a_daemon_fuses_records_and_replays_the_headings_it_is_sent(tmp_path):
    imu, gnss, aiding = tmp_path / "imu", tmp_path / "gnss", tmp_path / "aiding"
    ports = ("--port", str(imu), "--port", str(gnss))
    record = ("--record", str(tmp_path / "rest.mcap"), "--set", "record.estimate_rate_hz=0")
    known = ("--set", "aiding.heading_boresight_sigma_deg=0.01")
    magnetometer = ("--set", "aiding.magnetometer=true", "--set", "aiding.magnetometer_mount_rpy_deg=[0,0,90]")
    with (
        emulator("g350", "nmea", "--scenario", "rest", "--yaw-deg", "123", links=[imu, gnss]),
        daemon(tmp_path, *ports, *record, *known, *magnetometer, "--set", f"aiding.listen={aiding}") as imud,
        AidingSender(aiding) as sender,
    ):

        def is_aligned(message):
            sender.send("HDG", heading=123.2, sigma=0.5, t=time.time() - 0.1)
            sender.send("HDG", heading=400.0)
            sender.send("MAG", x=15.0, y=-25.0, z=40.0)
            return message["class"] == "EST" and "heading" in message["state"] and message["syaw_deg"] < 0.4

        est = imud.until(is_aligned)
        assert est["yaw_deg"] == pytest.approx(123.2, abs=1.5)
        command = [sys.executable, "-m", "imud", "status", "--json", str(tmp_path / "gpsd.sock")]
        status = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        assert status["aiding"]["sources"]["heading"]["received"] > 5
        assert status["aiding"]["sources"]["heading"]["share"]["heading"] > 0.3
        assert status["aiding"]["refused"]["value"] > 5
        assert status["innovations"]["heading"]["used"] > 0
        states = filter_states(tmp_path / "gpsd.sock")
        assert states["sheading_boresight_deg"] < 0.1 and 0.0 < states["cov_pn_pn"] < 100.0
        watched = last_states(tmp_path / "gpsd.sock")
        assert watched.keys() >= states.keys() and watched["heading_boresight_deg"] == pytest.approx(0.0, abs=0.1)
        imud.process.terminate()
        assert imud.process.wait(TIMEOUT_S) == 0
        assert imud.log.count("heading_deg is 400") == 1

    rows, innovations = [], []
    recording, adapt = Recording([tmp_path / "rest.mcap"]), adapter(None, (), None)
    player = Player(
        recording.settings(adapt),
        adapt,
        Initial(),
        Handlers(lambda _, new: rows.append(new.copy()), aid=lambda _, new: innovations.append(new.copy())),
    )
    for entry in recording:
        player.take(entry)
    kept = stored(tmp_path / "rest.mcap", ESTIMATE_TABLE)
    assert len(kept) > 1000 and np.concatenate(rows).tobytes() == kept.tobytes()
    found = stored(tmp_path / "rest.mcap", INNOVATION_TABLE)
    aided = np.concatenate(innovations)
    assert set(aided["kind"]) == {HEADING, MAGNETOMETER}
    assert aided.tobytes() == found[np.isin(found["kind"], (HEADING, MAGNETOMETER))].tobytes()
    fields, serial = fields_of(tmp_path / "rest.mcap")
    assert serial and len(fields) > 5
    assert fields["value"][:, :3] == pytest.approx(np.tile([15e-6, -25e-6, 40e-6], (len(fields), 1)))  # as they came
    assert 22e-6 < np.linalg.norm(fields["value"][-1, 3:]) < 67e-6  # the earth's, at the place


def test_a_source_whose_port_is_away_is_silent_and_not_forgotten():
    """Without it nothing on the live page says that there had been wheels."""
    wheel = SourceCounter()
    wheel.add(10**9)
    connected = [SimpleNamespace(received={"odometer": wheel})]
    in_use = SimpleNamespace(by_kind=dict, imu=None, gnss=None, aiding_sensors={}, receivers=lambda: connected)
    selection = SimpleNamespace(inertial=None, estimator=SimpleNamespace(sources=()))
    devices = SimpleNamespace(selection=selection, in_use=in_use, spares=SimpleNamespace(sensors={}))
    reporter = StatusReporter(devices, ContainedErrors(), Utc())
    reporter._check_all(10**9)
    connected.clear()
    reporter._check_all(31 * 10**9)
    nothing = SimpleNamespace(sum=lambda kinds: {}, table=lambda name: {})
    publisher = SimpleNamespace(innovations=nothing, shares=nothing)
    assert reporter._aiding_table(publisher, None, 31 * 10**9)["sources"]["odometer"]["age_s"] == 30.0
    sent = {"odometer": {"age_s": 0.1, "received": 7}}  # by a program, since
    aiding = SimpleNamespace(properties=lambda now_ns: {"sources": sent})
    assert reporter._aiding_table(publisher, aiding, 31 * 10**9)["sources"]["odometer"]["received"] == 7
