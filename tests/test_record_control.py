"""Recordings that a client begins and ends: who may, what is answered, and what is left on the disk."""

import json
import socket
import time

import msgspec
import pytest
from processes import TIMEOUT_S
from recorded import reads_of

from imud.commands import main
from imud.configuration.settings import Record, Settings
from imud.drivers.capture import Capture
from imud.drivers.driver import GnssConfigured, Identity
from imud.outputs.addresses import AddressInUseError, is_from_this_machine
from imud.recording import control, recorder
from imud.recording.control import Recordings
from imud.recording.recorder import Recorder


def settings(folder="", path=""):
    return Settings(record=Record(folder=str(folder), path=str(path)))


def until(accept, recordings):
    """The state that `accept` takes, looked after as the daemon does."""
    deadline = time.monotonic() + TIMEOUT_S
    while not accept(state := json.loads(recordings.status())):
        assert time.monotonic() < deadline, state
        recordings.tick()
        time.sleep(0.02)
    return state


def test_a_client_begins_and_ends_recordings_in_the_folder(tmp_path):
    ended = []
    with Recordings(settings(tmp_path)) as recordings:
        recordings.on_begin = lambda: recordings.current.byte_sink(0)(b"abc", 7)
        recordings.on_end = lambda: ended.append(recordings.current)
        recordings.event("info", "before any", {})
        assert until(lambda s: True, recordings) == {
            **{"class": "RECORD", "allowed": True, "recording": False, "path": "", "bytes": 0, "trouble": ""}
        }
        assert json.loads(recordings.handle_command(b'{"enable":true}'))["recording"]
        assert json.loads(recordings.handle_command(b'{"enable":true}'))["recording"]  # the same one
        recordings.event("warning", "something", {})
        state = until(lambda s: s["bytes"] > 0, recordings)
        assert not json.loads(recordings.handle_command(b'{"enable":false}'))["recording"]
        assert ended == [None]
        recordings.tick()
    (path,) = tmp_path.iterdir()
    assert str(path) == state["path"]
    capture = Capture(path)
    messages = list(capture)
    assert capture.broken == ""
    assert [raw.data for raw in reads_of(path, 0)] == [b"abc"]
    assert [msgspec.json.decode(m.data)["text"] for m in messages if m.topic == "/events"] == ["something"]


def test_a_recording_whose_writer_died_is_none(tmp_path):
    with Recordings(settings(tmp_path)) as recordings:
        recordings.handle_command(b'{"enable":true}')
        until(lambda state: state["path"], recordings)
        recordings.current._process.kill()
        recordings.current._process.wait()

        def seen(state):
            if recordings.current:
                recordings.event("info", "something to write", {})
            return not state["recording"]

        state = until(seen, recordings)
        assert "its writer is gone" in state["trouble"]
        assert recordings.current is None


def test_a_client_that_begins_and_ends_them_again_and_again_makes_no_processes(tmp_path, monkeypatch):
    begun = []

    class Counted(Recorder):
        def __init__(self, settings):
            begun.append(time.monotonic())
            super().__init__(settings)

    monkeypatch.setattr(recorder, "Recorder", Counted)
    began_s = time.monotonic()
    with Recordings(settings(tmp_path)) as recordings:
        for _ in range(100):
            answers = [json.loads(recordings.handle_command(b'{"enable":%s}' % on)) for on in (b"true", b"false")]
            recordings.tick()
        if time.monotonic() - began_s < control._PAUSE_S:
            assert "try again in" in answers[0]["trouble"]
    assert len(begun) <= 1 + (time.monotonic() - began_s) / control._PAUSE_S


@pytest.mark.parametrize(
    ("folder", "path", "command", "says"),
    [
        ("", "", b'{"enable":true}', "record.folder"),
        ("{tmp}/absent", "", b'{"enable":true}', "no folder"),
        ("{tmp}", "{tmp}/own.mcap", b'{"enable":false}', "by its configuration"),
        ("{tmp}", "", b'{"enable":true,"path":"/etc/x"}', "path"),
        ("{tmp}", "", b"[[[", "what is to be done?"),
    ],
)
def test_a_command_that_fails_is_reported(folder, path, command, says, tmp_path):
    with Recordings(settings(folder.format(tmp=tmp_path), path.format(tmp=tmp_path))) as recordings:
        answer = json.loads(recordings.handle_command(command))
        assert says in answer["trouble"] and answer["recording"] == bool(path)


@pytest.mark.parametrize("folder", ["{tmp}", "{tmp}/absent"])
def test_a_command_that_is_not_understood_changes_nothing_that_others_are_answered(folder, tmp_path):
    with Recordings(settings(folder.format(tmp=tmp_path))) as recordings:
        before = recordings.status()
        assert "what is to be done?" in recordings.handle_command(b'{"begin":true}')
        assert recordings.status() == before


@pytest.mark.parametrize("folder", ["{tmp}/absent", "/dev/null/x", "/" + "x" * 300])
def test_a_folder_that_cannot_be_written_to_is_reported_at_the_start(folder, tmp_path):
    chosen = settings(folder.format(tmp=tmp_path))
    with Recordings(chosen) as recordings:
        ((level, text),) = recordings.tick()
        assert level == "warning" and "(record.folder)" in text
        assert recordings.tick() == []
        assert json.loads(recordings.status())["trouble"] == text
    assert main(["run", "--check", "--set", f"record.folder={chosen.record.folder}"]) == 73


def test_only_clients_of_this_machine_that_speak_the_protocol_give_orders(make_loop):
    commands = []

    def handle_command(argument):
        commands.append(argument)
        return '{"class":"RECORD"}'

    loop = make_loop(commands={"RECORD": handle_command})
    command = b'?RECORD={"enable":true}\n'
    assert loop.connect(command).classes() == ["VERSION", "RECORD"]
    assert commands == [b'{"enable":true}']
    _, refusal, after = loop.connect(b"hello\n" + command + b"?VERSION\n").receive()
    assert "only by a client on this machine" in refusal["message"] and after["class"] == "VERSION"
    assert len(commands) == 1


def test_who_is_on_this_machine():
    class Far(socket.socket):
        def getpeername(self):
            return self.peer

    for family, peer, own in (
        (socket.AF_INET, ("127.0.0.1", 5), True),
        (socket.AF_INET, ("192.168.1.7", 5), False),
        (socket.AF_INET6, ("::1", 5, 0, 0), True),
        (socket.AF_INET6, ("::ffff:127.0.0.1", 5, 0, 0), True),
        (socket.AF_INET6, ("fe80::1%eth0", 5, 0, 0), False),
    ):
        with Far(family) as sock:
            sock.peer = peer
            assert is_from_this_machine(sock) is own
    with socket.socket() as sock:
        assert not is_from_this_machine(sock)
    a, b = socket.socketpair()
    with a, b:
        assert is_from_this_machine(a)


@pytest.mark.parametrize("streamed", [False, True])
def test_a_start_that_is_refused_leaves_no_empty_recording(streamed, tmp_path):
    identity = Identity("seraccel", "SerAccel", "", "", profile="consumer-mems")
    with pytest.raises(AddressInUseError), Recordings(settings(path=tmp_path / "own.mcap")) as recordings:
        until(lambda state: state["bytes"] > 0, recordings)
        recordings.event("error", "before the end", {})
        if streamed:
            recordings.current.connected(0, "/dev/null", GnssConfigured(identity), None, 1)
        raise AddressInUseError("cannot listen")
    assert [path.name for path in tmp_path.iterdir()] == ["own.mcap"] * streamed


def test_a_daemon_whose_socket_is_in_use_leaves_no_recording(tmp_path, capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        listen = f"127.0.0.1:{taken.getsockname()[1]}"
        assert main(["run", "--port", str(tmp_path / "x"), "--listen", listen, "--record", f"{tmp_path}/r.mcap"]) == 73
    assert "in use" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
