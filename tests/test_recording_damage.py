"""A recording in which a byte has changed: either it is read as it was written, or refused with a clear message."""

import contextlib
import re
import struct

import lz4.frame
import msgspec
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded import message

from imud.commands import main
from imud.configuration.settings import Gnss, Initial, Settings
from imud.drivers import capture
from imud.drivers.capture_messages import CONNECTIONS, READS, Connection, Entry
from imud.drivers.errors import NotSerialError
from imud.drivers.transport.portspec import PortSpec
from imud.drivers.transport.replay import ReplayPort
from imud.errors import BadDataError, ConfigError
from imud.recording.file import RecordingFile
from imud.recording.player import Handlers, Player
from imud.recording.ports import expanded
from imud.recording.source import Recording, adapter, group

MADE_WITH = Settings(ports=("/dev/ttyACM0",), gnss=Gnss(latency_s=0.25))
FACTS = {"version": "0.1.0", "session": "abc", "part": "0", "unix_less_monotonic_ns": "1700000000000000000"}
SENTENCE = b"$GPGGA,120000.00,4800.0000,N,01100.0000,E,1,08,1.0,500.0,M,47.0,M,,*5F\r\n"


def write(path, messages=(), made_with=None, facts=FACTS):
    file = RecordingFile(path, facts, msgspec.json.encode(MADE_WITH if made_with is None else made_with), 0)
    for topic, t_ns, data in messages:
        file.write(topic, t_ns, data)
    file.finish()
    return path


def connection(**changes) -> bytes:
    said = Connection(10**9, 0, "/dev/ttyACM0", True, "gnss", "nmea", {"identity": {"driver": "nmea", "model": ""}})
    return msgspec.json.encode(msgspec.structs.replace(said, **changes))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    readings = [(READS, 10**9 * (i + 1), message(10**9 * (i + 1), SENTENCE)) for i in range(5)]
    messages = [("/connections", 10**9, connection()), *readings]
    return write(tmp_path_factory.mktemp("damage") / "whole.mcap", messages)


def read(path):
    """All that reading a recording is: what it was made with, and its messages played."""
    ((recording,), failed) = group([path])
    assert not failed
    adapt = adapter(None, (), None)
    made_with = recording.settings(adapt)
    player = Player(made_with, adapt, Initial(), Handlers(warn=recording.notes.append))
    for entry in recording:
        player.take(entry)
    return made_with, recording.unix_less_monotonic_ns, recording.notes


def test_the_whole_one_is_read_without_a_note(whole):
    assert read(whole) == (MADE_WITH, 1700000000000000000, [])


@pytest.mark.thorough
def test_one_changed_byte_in_the_header_is_refused_or_changes_nothing(whole, tmp_path):
    data, damaged = whole.read_bytes(), tmp_path / "damaged.mcap"
    first_chunk = data.find(b"\4\0\0\0zstd") - 37
    assert first_chunk > 1000
    refused = 0
    for place in range(first_chunk):
        for change in (0x01, 0x80, 0xFF):
            damaged.write_bytes(data[:place] + bytes([data[place] ^ change]) + data[place + 1 :])
            try:
                made_with, offset_ns, notes = read(damaged)
            except BadDataError as error:
                assert str(damaged) in str(error)
                refused += 1
            else:
                assert (made_with, offset_ns) == (MADE_WITH, 1700000000000000000) or notes, place
    assert refused > 2 * first_chunk


@given(st.data())
@settings(max_examples=200)
def test_changed_and_missing_bytes_anywhere_are_no_traceback(whole, tmp_path_factory, data):
    changed = bytearray(whole.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, max(0, len(changed) - 1)))
        kind = data.draw(st.sampled_from(["set", "cut", "insert", "remove"]))
        if kind == "set" and changed:
            changed[place] = data.draw(st.integers(0, 255))
        elif kind == "cut" and place:
            del changed[place:]
        elif kind == "insert":
            changed[place:place] = data.draw(st.binary(max_size=9))
        else:
            del changed[place : place + data.draw(st.integers(0, 9))]
    path = tmp_path_factory.mktemp("damage") / "changed.mcap"
    path.write_bytes(changed)
    try:
        read(path)
    except BadDataError as error:
        assert error.exit_code == 65


@pytest.mark.parametrize("command", ["replay", "export", "allan", "calibrate"])
def test_every_command_ends_with_65_and_names_the_file(command, whole, tmp_path, capsys):
    data = whole.read_bytes()
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data.replace(b'"latency_s":0.25', b'"latency_s":0.85'))
    assert damaged.read_bytes() != data
    arguments = {
        "replay": ["replay", str(damaged), "-o", str(tmp_path / "est.csv")],
        "export": ["export", str(damaged), "--csv", str(tmp_path / "csv")],
        "allan": ["allan", str(damaged)],
        "calibrate": ["calibrate", "still", str(damaged)],
    }[command]
    assert main(arguments) == 65
    captured = capsys.readouterr()
    assert "damaged.mcap is damaged: the checksum of 'settings.json'" in captured.err
    assert "Traceback" not in captured.err


@pytest.mark.parametrize(
    "made_with",
    [[], 5, None, "text", {"gnss": 7}, {"gnss": {"latency_s": 1e300}}, {"unknown": 1}, {"ports": 5}],
    ids=str,
)
def test_invalid_settings_are_rejected_by_name(made_with, tmp_path):
    path = write(tmp_path / "odd.mcap", made_with=msgspec.Raw(msgspec.json.encode(made_with)))
    recording = Recording([path])
    with pytest.raises(BadDataError):
        recording.settings(adapter(None, (), None))


def test_a_wrong_option_is_the_users_mistake_and_not_the_recordings(whole):
    with pytest.raises(ConfigError):
        Recording([whole]).settings(adapter(None, ("gnss.latency_s=1e300",), None))


@pytest.mark.parametrize("name", ["part", "unix_less_monotonic_ns"])
@pytest.mark.parametrize("text", ["", "x", "1e5", "9" * 5000, "0x1", "１"])
def test_numbers_of_the_metadata_are_numbers(name, text, tmp_path):
    path = write(tmp_path / "odd.mcap", facts=FACTS | {name: text})
    with pytest.raises(BadDataError, match=name):
        _ = Recording([path]).unix_less_monotonic_ns


@pytest.mark.parametrize(
    "said",
    [
        b"[]",
        b"{}",
        b'"x"',
        b"[" * 900,
        connection(driver="none"),
        connection(kind="imu", driver="epson", configured={}),
        connection(kind="imu", driver="epson", configured={"identity": {"driver": "epson", "model": ""}, "rate_hz": 0}),
        connection(calibration={"gyro_bias": {"b": "x"}}, kind="imu", driver="epson"),
    ],
)
def test_a_message_that_is_not_what_its_topic_promises_is_refused(said, tmp_path):
    path = write(tmp_path / "odd.mcap", [("/connections", 10**9, said)])
    with pytest.raises(BadDataError):
        read(path)
    with contextlib.suppress(BadDataError):  # or it is one of several devices, and is named
        expanded([f"replay:{path}"])
    with pytest.raises(NotSerialError):
        ReplayPort(PortSpec(f"replay:{path}", "imu"))


def test_a_repeated_connection_changes_nothing_unless_it_is_of_a_connection_that_was_lost():
    player = Player(MADE_WITH, adapter(None, (), None), Initial(), Handlers())
    sensors = []
    for changes in ({}, {"repeated": True}, {"t_ns": 3 * 10**9, "repeated": True}):
        player.take(Entry(CONNECTIONS, "", 10**9, connection(**changes)))
        ((_, sensor),) = player.sensors()
        sensors.append(sensor)
    assert sensors[1] is sensors[0]
    assert sensors[2] is not sensors[0]


def test_zeros_behind_a_recording_are_not_read_one_by_one(whole, tmp_path, monkeypatch):
    end_of_data = b"\x0f\4" + bytes(7)  # opcode, length
    broken_off = tmp_path / "zeros.mcap"
    broken_off.write_bytes(whole.read_bytes().partition(end_of_data)[0] + bytes(1 << 20))
    records = []
    read_record = capture._Reader._read_record
    monkeypatch.setattr(capture._Reader, "_read_record", lambda *of: (records.append(of[1]), read_record(*of))[1])
    *_, notes = read(broken_off)
    assert len(records) < 1000
    assert "broke off" in "".join(notes)


def _chunk(data: bytes, compression: str, said: int) -> bytes:
    """A record with a chunk of MCAP that unpacks to `said` bytes by its own words (mcap.dev/spec)."""
    texts = struct.pack("<I", len(compression)) + compression.encode()
    body = struct.pack("<QQQI", 0, 1, said, 0) + texts + struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", 6, len(body)) + body


BOMB = 200 << 20  # bytes
BOMBS = {
    "zstd": lambda: (zstandard.compress(bytes(BOMB)), "zstd", BOMB),
    "zstd that says it is small": lambda: (zstandard.compress(bytes(BOMB)), "zstd", 100),
    "zstd that says nothing": lambda: (
        zstandard.ZstdCompressor(write_content_size=False).compress(bytes(BOMB)),
        "zstd",
        BOMB,
    ),
    "lz4": lambda: (lz4.frame.compress(bytes(BOMB)), "lz4", BOMB),
    "lz4 that says it is small": lambda: (lz4.frame.compress(bytes(BOMB)), "lz4", 100),
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_a_chunk_that_unpacks_to_much_is_left_out_without_being_unpacked(bomb, whole, tmp_path):
    path, content = tmp_path / "bomb.mcap", whole.read_bytes()
    at = content.index(b"\4\0\0\0zstd") - 37  # the first chunk
    path.write_bytes(content[:at] + _chunk(*BOMBS[bomb]()) + content[at:])
    recording = capture.Capture(path)
    assert len(list(recording)) == len(list(capture.Capture(whole)))
    assert re.search(r"is damaged: .*\(a chunk of \d+ MiB\)", recording.broken)


def test_zeros_in_a_chunk_are_no_records(whole, tmp_path):
    path, content = tmp_path / "zeros.mcap", whole.read_bytes()
    at = content.index(b"\4\0\0\0zstd") - 37
    path.write_bytes(content[:at] + _chunk(zstandard.compress(bytes(1 << 20)), "zstd", 1 << 20) + content[at:])
    recording = capture.Capture(path)
    assert len(list(recording)) == len(list(capture.Capture(whole)))
    assert "zeros instead of a record" in recording.broken
