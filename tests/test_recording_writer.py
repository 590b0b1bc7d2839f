"""The writing of recordings: nothing is lost but what must be, nobody waits, and other people's readers agree."""

import errno
import json
import os
import re
import shutil
import signal
import socket
import time
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import pytest
from google.protobuf import unknown_fields
from mcap.reader import make_reader
from recorded import decoded, reads_of

from imud.configuration.settings import Record, Settings
from imud.drivers.capture import MAGIC, Capture
from imud.drivers.capture_messages import Connection
from imud.drivers.errors import CaptureError
from imud.errors import CannotCreateError
from imud.estimators.records import INNOVATION, SOLUTION
from imud.recording import parts
from imud.recording.file import RecordingFile
from imud.recording.messages import TABLES
from imud.recording.protocol import HEADER, MessageKind
from imud.recording.recorder import Recorder
from imud.recording.writer import RecordingWriter, main


def settings(path, **record):
    return Settings(record=Record(path=str(path), **record), ports=("/dev/a", "/dev/b"))


def start_of(path, **record):
    return {
        "record": msgspec.to_builtins(settings(path, **record).record),
        "facts": {"session": "s", "version": "1"},
        "ports": ["/dev/a"],
        "settings": msgspec.to_builtins(settings(path)),
    }


def writer(path, messages=None, **record):
    start = start_of(path, **record)
    return RecordingWriter(start, (lambda *line: messages.append(line)) if messages is not None else lambda *line: None)


@pytest.mark.parametrize("refused", ["sched_setscheduler", "nice"])
def test_a_system_that_refuses_a_lower_priority_keeps_no_recording_from_its_file(tmp_path, monkeypatch, refused):
    """As the filter of system calls does in the unit file."""
    called = []

    def lower(name, *_):
        called.append(name)
        if name == refused:
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr("signal.signal", lambda *_: None)
    for name in ("sched_setscheduler", "nice"):
        monkeypatch.setattr(os, name, partial(lower, name))
    start = msgspec.json.encode(start_of(tmp_path / "drive.mcap"))
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours:
        ours.send(HEADER.pack(MessageKind.START, 0, 0, len(start), 0) + start)
        ours.shutdown(socket.SHUT_WR)
        main(theirs.detach())
    assert called == ["sched_setscheduler", "nice"]
    assert (tmp_path / "drive.mcap").stat().st_size > 0


def test_what_is_read_from_ports_reaches_the_file_in_order_and_other_readers_see_it(tmp_path):
    path = tmp_path / "drive.mcap"
    recorder = Recorder(settings(path))
    wanted = [(i % 2, 1000 + i, bytes([i % 256]) * (i % 50)) for i in range(3000)]
    for port, t_ns, data in wanted:
        recorder.byte_sink(port)(memoryview(data), t_ns)
    solutions = np.zeros(4, SOLUTION)
    solutions["t_ns"] = np.arange(4) * 10**9
    solutions["status"] = 7
    solutions["q_nb"] = 1.0, 0.0, 0.0, 0.0
    recorder.record_solutions(_samples(4), solutions)
    innovations = np.zeros(1, INNOVATION)
    innovations["value"], innovations["variance"] = 3.0, 4.0
    recorder.record_fix(_fix(), innovations)
    recorder.record_event("warning", "text", {"port": "/dev/a"})
    recorder.close()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        messages = [
            (channel, schema, message) for schema, channel, message in reader.iter_messages(log_time_order=False)
        ]
        assert {name for _, schema, _ in messages for name in [schema.name]} >= {
            *(f"imud.v2.{name}" for name in ("Sample", "Estimate", "Fix", "Innovation")),
            *("imud.v3.Reads", "imud.Event"),
            *("foxglove.LocationFix", "foxglove.FrameTransform"),
        }
        for channel, schema, message in messages:
            if channel.message_encoding == "json":
                assert schema.encoding == "jsonschema"
                assert set(json.loads(message.data)) >= set(json.loads(schema.data)["properties"]), channel.topic
            else:
                assert channel.message_encoding == schema.encoding == "protobuf"
                said = decoded(schema.name, schema.data, message.data)
                assert {field.name for field, _ in said.ListFields()} - {"pulse_ns"}, channel.topic
                assert not unknown_fields.UnknownFieldSet(said)
        assert next(iter(reader.iter_metadata())).metadata["version"]
        attached = next(iter(reader.iter_attachments()))
        assert json.loads(attached.data)["ports"] == ["/dev/a", "/dev/b"]
    found = [(port, raw.t_ns, raw.data) for entry in Capture(path) for port, raw in entry.reads() or ()]
    assert found == wanted
    by_topic = {
        channel.topic: decoded(schema.name, schema.data, message.data)
        for channel, schema, message in messages
        if schema.encoding == "protobuf"
    }
    verdict = by_topic["/innovations"]
    assert (verdict.S, verdict.sigma, verdict.normalised, verdict.verdict) == (4.0, 2.0, 1.5, "rejected")
    assert by_topic["/location"].timestamp.seconds > 1_600_000_000
    q = by_topic["/tf"].rotation  # level and northward: FLU in ENU is turned by 90 deg about up
    assert (q.w * q.z, q.x, q.y) == pytest.approx((0.5, 0.0, 0.0))


def _samples(n):
    samples = np.zeros(n, TABLES[0].dtype)
    samples["t_ns"] = np.arange(n) * 10**9
    return samples


def _fix():
    return np.zeros(1, TABLES[2].dtype)


def test_a_stalled_writer_does_not_delay_the_loop_and_its_gap_is_reported_once(tmp_path):
    recorder = Recorder(settings(tmp_path / "drive.mcap"))
    while not (tmp_path / "drive.mcap").exists():
        time.sleep(0.02)
    recorder.tick()
    os.kill(recorder._process.pid, signal.SIGSTOP)
    data = bytes(64 << 10)
    for i in range(400):  # 25 MB
        recorder.byte_sink(0)(data, i)
    assert recorder.dropped > 0
    assert [level for level, _ in recorder.tick()].count("warning") == 1
    assert recorder.tick() == []
    os.kill(recorder._process.pid, signal.SIGCONT)
    messages = []
    while not messages:
        time.sleep(0.02)
        messages = [text for level, text in recorder.tick() if "whole again" in text]
    recorder.close()
    assert len(reads_of(tmp_path / "drive.mcap")) == 400 - recorder.dropped


def test_a_message_of_the_writer_may_be_long_and_have_any_bytes(tmp_path):
    recorder = Recorder(settings(tmp_path / "drive.mcap"))
    state = {"path": "/" + 5000 * "p", "bytes": 7, "trouble": ""}
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setblocking(False)
    before, recorder._socket = recorder._socket, ours
    with ours, theirs:
        theirs.send(b"state:" + msgspec.json.encode(state))
        theirs.send(b"info:\xff")
        assert recorder.tick() == [("info", "\N{REPLACEMENT CHARACTER}")]
    assert recorder.state == state
    recorder._socket = before
    recorder.close()


def test_a_writer_that_cannot_be_started_is_a_message_and_leaves_nothing_open(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    monkeypatch.setattr("subprocess.Popen", fail)
    before = sum(1 for _ in Path("/proc/self/fd").iterdir())
    with pytest.raises(CannotCreateError, match=r"cannot record to .*drive\.mcap: its writer does not start"):
        Recorder(settings(tmp_path / "drive.mcap"))
    assert sum(1 for _ in Path("/proc/self/fd").iterdir()) == before


def test_the_death_of_a_writer_is_reported_and_does_no_harm(tmp_path):
    recorder = Recorder(settings(tmp_path / "drive.mcap"))
    recorder._process.kill()
    recorder._process.wait()
    recorder.byte_sink(0)(b"abc", 1)
    assert ("error", "the recording ended: its writer is gone; everything else goes on") in recorder.tick()
    recorder.byte_sink(0)(bytes(1 << 16), 1)
    assert recorder.tick() == []
    recorder.close()


def test_a_power_cut_and_damage_cost_no_more_than_what_they_hit(tmp_path):
    path = tmp_path / "drive.mcap"
    recording = writer(path)
    for second in range(5):
        for i in range(100):
            recording.take(MessageKind.RAW, 0, second * 100 + i, b"0123456789" * 3)
        recording.commit()
    sizes = path.stat().st_size
    recording.take(MessageKind.RAW, 0, 999, b"never on the disk")
    whole = path.read_bytes()[:sizes]
    assert [raw.t_ns for raw in reads_of(path)] == list(range(500))
    cut = tmp_path / "cut.mcap"
    before = 0
    for end in range(len(MAGIC), sizes + 1, 97):
        for tail in (b"", bytes(300)):  # a file system may leave zeros
            cut.write_bytes(whole[:end] + tail)
            capture = Capture(cut)
            n = count(capture)
            assert n % 100 == 0
            assert "broke off" in capture.broken
        assert n >= before
        before = n
    recording.finish()
    capture = Capture(path)
    assert count(capture) == 501
    assert not capture.broken
    sound = path.read_bytes()
    second = sound.find(b"zstd", sound.find(b"zstd") + 1)  # the first chunk knows the channel
    for start in range(second, sizes, 41):
        cut.write_bytes(sound[:start] + bytes(5) + sound[start + 5 :])
        capture = Capture(cut)
        n = count(capture)
        assert n == 501 or capture.broken, start
        assert n >= 400, (start, capture.broken)
    chunks = [place.start() for place in re.finditer(b"(?s)\\x06.{36}\\x04\\0\\0\\0zstd", sound)]
    lengths = bytearray(sound)
    for start in chunks[1:3]:
        lengths[start + 1 : start + 9] = b"\xff" * 8
    cut.write_bytes(lengths)
    assert count(Capture(cut)) == 301


def test_a_damaged_beginning_costs_no_more_than_itself(tmp_path, monkeypatch):
    monkeypatch.setattr("imud.recording.writer._DESCRIBE_S", 0.0)
    path, damaged = tmp_path / "drive.mcap", tmp_path / "damaged.mcap"
    recording = writer(path)
    opened = Connection(7, 0, "/dev/a", True, "gnss", "nmea")
    recording.take(MessageKind.CONNECTION, 0, 7, msgspec.json.encode(opened))
    for second in range(5):
        for i in range(100):
            recording.take(MessageKind.RAW, 0, second * 100 + i, b"0123456789" * 3)
        recording.commit()
    recording.finish()
    sound = path.read_bytes()
    first = sound.find(b"zstd") + 20
    damaged.write_bytes(sound[:first] + bytes(5) + sound[first + 5 :])
    for file, repeated, n in ((path, False, 500), (damaged, True, 400)):
        capture = Capture(file)
        entries = list(capture)
        assert bool(capture.broken) == repeated
        assert sum(len(entry.reads().size) for entry in entries if entry.topic == "/raw") == n
        assert entries[0].connection() == msgspec.structs.replace(opened, repeated=repeated)
    with path.open("rb") as file:  # as another reader sees it
        assert len(list(make_reader(file, validate_crcs=True).iter_messages("/raw"))) == 5


def count(capture):
    return sum(len(entry.reads().size) for entry in capture if entry.topic == "/raw")


def test_a_file_that_is_no_recording_is_reported(tmp_path):
    (tmp_path / "x").write_text("t_s,gx_radps\n")
    with pytest.raises(CaptureError, match="is no recording"):
        Capture(tmp_path / "x")


def test_files_change_at_their_size_and_the_oldest_go_for_the_budget(tmp_path, monkeypatch):
    monkeypatch.setattr("imud.recording.writer._MB", 2000)
    path, messages = tmp_path / "drive.mcap", []
    path.write_bytes(b"somebody's earlier recording")
    recording = writer(path, messages, file_mb=2, budget_mb=9, spare_mb=0)
    for t_ns in range(40):
        recording.take(MessageKind.RAW, 0, t_ns, np.random.default_rng(t_ns).bytes(1500))
        recording.commit()
    recording.finish()
    left = parts.existing(path)
    assert not path.exists()
    assert path.with_name("drive.0001.mcap") not in left
    assert sum(file.stat().st_size for file in left) <= 9 * 2000 + 2 * 3000
    times = [raw.t_ns for file in left for raw in reads_of(file)]
    assert times == list(range(times[0], 40))
    assert any("removed" in text for _, text in messages)
    numbers = [Capture(file).session()[0]["part"] for file in left]
    assert [int(number) for number in numbers] == list(range(int(numbers[0]), int(numbers[0]) + len(left)))


def test_a_full_disk_pauses_the_recording_until_there_is_space(tmp_path, monkeypatch):
    path, messages, full = tmp_path / "drive.mcap", [], []
    recording = writer(path, messages)
    sync = os.fdatasync
    monkeypatch.setattr(os, "fdatasync", lambda fd: _no_room() if full else sync(fd))
    recording.take(MessageKind.RAW, 0, 1, b"before")
    recording.commit()
    full.append(True)
    recording.take(MessageKind.RAW, 0, 2, b"lost")
    recording.commit()
    recording.take(MessageKind.RAW, 0, 3, b"lost, too")
    recording.commit()
    full.clear()
    recording._retry_s = 0.0
    recording.commit()
    recording.take(MessageKind.RAW, 0, 4, b"after")
    recording.finish()
    assert [raw.data for raw in reads_of(path)] == [b"before"]
    assert [raw.data for raw in reads_of(path.with_name("drive.0001.mcap"))] == [b"after"]
    assert [level for level, _ in messages] == ["info", "error", "info"]
    assert "No space left" in messages[1][1]


def test_a_pause_is_logged_once_where_the_full_disk_takes_not_even_the_end_of_the_file(tmp_path, monkeypatch):
    messages = []
    recording = writer(tmp_path / "drive.mcap", messages, spare_mb=5)

    def fail(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(RecordingFile, "finish", fail)
    monkeypatch.setattr(parts, "free_bytes", lambda _: 0)
    recording.commit()
    [text] = [text for level, text in messages if level == "error"]
    assert text.startswith("recording pauses: the disk refuses it: No space left")


@pytest.mark.parametrize("spare_mb", [0, 3])
def test_no_file_begins_while_there_is_room_for_little_more_than_its_beginning(spare_mb, tmp_path, monkeypatch):
    path, messages, free = tmp_path / "drive.mcap", [], [20_000]
    monkeypatch.setattr(parts, "free_bytes", lambda _: free[0])
    recording = writer(path, messages, spare_mb=spare_mb)
    for _ in range(2):
        recording._retry_s = 0.0
        recording.commit()
    assert list(tmp_path.iterdir()) == []
    free[0] = 4 << 20
    recording._retry_s = 0.0
    recording.commit()
    free[0] = 20_000
    recording.take(MessageKind.RAW, 0, 4, b"after")
    recording.commit()
    recording.finish()
    assert [raw.data for raw in reads_of(path)] == [b"after"]
    assert [level for level, _ in messages] == ["error", "info"] + ["error"] * (spare_mb > 0)
    assert messages[0][1].startswith(f"recording pauses: less than {spare_mb or 1} MB are free")


def test_a_folder_that_is_gone_pauses_the_recording_until_it_is_back(tmp_path):
    path, messages = tmp_path / "stick/drive.mcap", []
    path.parent.mkdir()
    recording = writer(path, messages, spare_mb=1)
    recording.commit()
    shutil.rmtree(path.parent)
    for _ in range(2):  # found, and tried again
        recording._retry_s = 0.0
        recording.commit()
    path.parent.mkdir()
    recording._retry_s = 0.0
    recording.commit()
    recording.take(MessageKind.RAW, 0, 4, b"after")
    recording.finish()
    assert [raw.data for raw in reads_of(path)] == [b"after"]
    assert [level for level, _ in messages] == ["info", "error", "error", "info"]


@pytest.mark.parametrize("elsewhere", ["", "moved.mcap"])
def test_a_file_that_is_removed_or_renamed_is_followed_by_another(elsewhere, tmp_path):
    path, messages = tmp_path / "drive.mcap", []
    recording = writer(path, messages, spare_mb=1)
    recording.take(MessageKind.RAW, 0, 3, b"before")
    recording.commit()
    if elsewhere:
        path.rename(tmp_path / elsewhere)
    else:
        path.unlink()
    recording.commit()
    recording.take(MessageKind.RAW, 0, 4, b"after")
    recording.finish()
    assert [raw.data for raw in reads_of(path)] == [b"after"]
    if elsewhere:
        moved = Capture(tmp_path / elsewhere)
        assert list(moved) and moved.broken == ""
    assert [level for level, _ in messages] == ["info", "warning", "info"]
    assert "was removed or renamed" in messages[1][1]


def test_what_is_no_file_of_ours_does_not_stop_the_budget(tmp_path):
    base = tmp_path / "drive.mcap"
    base.write_bytes(bytes(1000))
    (tmp_path / "drive.0001.mcap").symlink_to(tmp_path / "absent")
    (tmp_path / "drive.0002.mcap").symlink_to(base)
    (tmp_path / "drive.0003.mcap").mkdir()
    (tmp_path / "drive.0004.mcap").write_bytes(bytes(1000))
    assert parts.make_room(base, 1500, tmp_path / "drive.0004.mcap") == [base]
    assert len(list(tmp_path.iterdir())) == 4


def _no_room():
    raise OSError(28, "No space left on device")


def test_paths_that_cannot_become_recordings_are_refused_at_once(tmp_path):
    with pytest.raises(CannotCreateError, match="is a folder"):
        Recorder(settings(tmp_path))
    with pytest.raises(CannotCreateError, match="no folder"):
        Recorder(settings(tmp_path / "no" / "drive.mcap"))
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/null")):
        with pytest.raises(CannotCreateError, match=f"{path}: it is a device, a pipe or a socket"):
            Recorder(settings(path))


def test_a_daemon_that_leaves_without_hearing_the_writer_out_still_gets_a_whole_file(tmp_path):
    path = tmp_path / "drive.mcap"
    recorder = Recorder(settings(path))
    while not path.exists():
        time.sleep(0.01)
    recorder.byte_sink(0)(b"abc", 5)
    time.sleep(0.2)  # "recording to …" waits to be read by then
    recorder.close()
    capture = Capture(path)
    assert [raw.data for raw in reads_of(path, 0)] == [b"abc"]
    assert capture.broken == ""
