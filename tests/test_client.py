"""The binary outputs and their client: layout, losses, stalled readers, torn writes; in C as in Python."""

import contextlib
import math
import os
import resource
import select
import socket
import stat
import struct
import subprocess
import threading

import numpy as np
import pytest
from binary_outputs import opened, serve, solutions
from scipy.spatial.transform import Rotation

from imud import client
from imud.configuration.settings import Settings
from imud.configuration.settings import SharedMemory as SharedMemorySettings
from imud.configuration.settings import Stream as StreamSettings
from imud.errors import CannotCreateError
from imud.estimators import records
from imud.estimators.records import SOLUTION
from imud.outputs.binary import LAYOUT, BinaryOutputs
from imud.outputs.shared_memory import SharedMemory


@pytest.fixture
def outputs(tmp_path):
    with opened(tmp_path) as made:
        yield made


def test_the_layout_is_the_solutions_own():
    ours = [(name, kind, count) for name, kind, count, _ in client.FIELDS]
    kinds = {"f": "double", "i": "int64_t"}
    theirs = [(name, kinds[SOLUTION[name].base.kind], math.prod(SOLUTION[name].shape)) for name in SOLUTION.names]
    assert ours[5:] == theirs
    assert LAYOUT.itemsize == client.RECORD.size
    assert client.State._fields == tuple(name for name, *_ in ours[3:])
    assert {getattr(records, name): name for name in client.STATUS} == {
        bit: name for name, bit in client.STATUS.items()
    }


def test_a_record_byte_for_byte():
    """The header written by hand: a change of layout needs a new version."""
    row = solutions(1)
    record = (
        b"IMUD" + struct.pack("<HHQq", 1, 336, 7, -9) + struct.pack("<qq37d", 1000, 5, *(i / 64.0 for i in range(37)))
    )
    state = client.decode(record)
    assert (state.seq, state.utc_offset_ns, state.t_ns, state.status) == (7, -9, 1000, 5)
    for name in SOLUTION.names[2:]:
        np.testing.assert_array_equal(getattr(state, name), row[name][0])


@pytest.mark.parametrize("record", [b"", b"IMUD", b"x" * 336, b"IMUD\x02\x00" + bytes(330)])
def test_what_is_no_state_is_refused(record):
    with pytest.raises(client.ProtocolError):
        client.decode(record)


def test_angles_agree_with_scipy():
    rng = np.random.default_rng(1)
    for rotation in Rotation.random(50, rng):
        x, y, z, w = rotation.as_quat()
        state = client.State(*[0] * 7, (0,) * 3, (w, x, y, z), *[(0,) * 3] * 9)
        np.testing.assert_allclose((state.yaw, state.pitch, state.roll), rotation.as_euler("ZYX"), atol=1e-12)


def test_clients_get_every_state_they_asked_for(outputs):
    all_ = client.connect(outputs.at / "s", timeout_s=5.0)
    with all_, client.connect(outputs.at / "s", divisor=10, timeout_s=5.0) as tenth:
        for _ in range(3):  # two connections and a request
            serve(outputs)
        for first in range(0, 1000, 25):
            outputs.publish(solutions(25, first), 25, first + 24, 0)
            heard = [next(all_) for _ in range(25)]
            assert [state.seq for state in heard] == list(range(first, first + 25))
            assert [state.lat for state in heard] == list(range(first, first + 25))
        heard = [next(tenth).seq for _ in range(100)]
        assert heard == list(range(0, 1000, 10))


def test_a_stalled_client_loses_its_own_records_and_sees_the_gap_in_their_numbers(outputs):
    with client.connect(outputs.at / "s") as live, client.connect(outputs.at / "s", timeout_s=1.0) as stalled:
        serve(outputs)
        serve(outputs)
        for seq in range(5000):
            outputs.publish(solutions(1, seq), 1, seq, seq)
            assert next(live).seq == seq
        kept = outputs.stream.dropped
        assert 0 < kept < 5000
        got = [next(stalled).seq for _ in range(5000 - kept)]
        assert got == list(range(5000 - kept))
        outputs.publish(solutions(1), 1, 5000, 0)
        assert next(stalled).seq == 5000


def test_one_that_never_reads_is_cut_off(outputs):
    with client.connect(outputs.at / "s"):
        serve(outputs)
        for seq in range(3000):
            outputs.publish(solutions(1), 1, seq, 1)
        outputs.tick(59_000_000_000)
        assert outputs.stream.clients == 1
        outputs.tick(61_000_000_000)
        assert outputs.stream.clients == 0


def test_invalid_requests_and_too_many_clients(outputs):
    crowd = [client.connect(outputs.at / "s") for _ in range(8)]
    for _ in crowd:
        serve(outputs)
    assert outputs.stream.clients == 5
    crowd[0]._socket.send(b"GET / HTTP/1.0\r\n\r\n")
    crowd[1]._socket.send(bytes(4))
    serve(outputs)
    assert outputs.stream.clients == 3
    for stream in crowd:
        stream.close()
    serve(outputs)
    assert outputs.stream.clients == 0


def test_out_of_descriptors_clients_are_rejected(outputs):
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with client.connect(outputs.at / "s") as waiting:
        lowest = os.dup(0)
        os.close(lowest)
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (lowest, hard))
            serve(outputs)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        assert (outputs.stream.clients, list(waiting)) == (0, [])
    with client.connect(outputs.at / "s") as welcome:
        serve(outputs)
        outputs.publish(solutions(1), 1, 1, 0)
        assert next(welcome).seq == 1


def test_the_end_of_the_daemon_ends_the_stream(outputs):
    stream = client.connect(outputs.at / "s")
    serve(outputs)
    outputs.close()
    assert list(stream) == []
    assert not (outputs.at / "s").exists()
    with pytest.raises(FileNotFoundError, match=str(outputs.at / "s")):
        client.connect(outputs.at / "s")


def test_a_daemon_that_ends_before_it_has_read_the_divisor_ends_the_stream(tmp_path):
    """The kernel then says that the connection was reset."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as server:
        server.bind(str(tmp_path / "s"))
        server.listen()
        stream = client.connect(tmp_path / "s", divisor=10)
        server.accept()[0].close()
        with stream:
            assert list(stream) == []


@pytest.mark.parametrize("divisor", [0, -1, 1 << 32])
def test_a_divisor_that_is_none_is_an_error_of_the_program(outputs, divisor):
    with pytest.raises(ValueError, match="divisor"):
        client.connect(outputs.at / "s", divisor=divisor)


def test_two_daemons_never_share_an_output(outputs):
    with pytest.raises(CannotCreateError, match="in use"):
        BinaryOutputs(Settings(stream=StreamSettings(listen=str(outputs.at / "s"))), select.poll(), 1)
    with pytest.raises(CannotCreateError, match="another imud"):
        SharedMemory(str(outputs.at / "m"))


def test_a_file_of_something_else_is_not_written_over(tmp_path):
    notes = tmp_path / "notes"
    notes.write_text("worth keeping")
    with pytest.raises(CannotCreateError, match="another kind of file"):
        SharedMemory(str(notes))
    with pytest.raises(CannotCreateError, match="a file that is no socket"):
        BinaryOutputs(Settings(stream=StreamSettings(listen=str(notes))), select.poll(), 1)
    assert notes.read_text() == "worth keeping"


def test_a_device_is_not_written_to(tmp_path):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo, 0o600)
    with pytest.raises(CannotCreateError, match="no regular file"):
        SharedMemory(str(fifo))
    assert stat.S_IMODE(fifo.stat().st_mode) == 0o600  # as root it would make /dev/null unusable for all others


def test_the_socket_of_a_dead_daemon_is_replaced(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(str(tmp_path / "s"))
    (tmp_path / "m").write_bytes(b"\xff" * 8 + client.MAGIC + b"\xff" * 1000)
    settings = Settings(
        stream=StreamSettings(listen=str(tmp_path / "s")), shared_memory=SharedMemorySettings(path=str(tmp_path / "m"))
    )
    outputs = BinaryOutputs(settings, select.poll(), 1)
    assert client.latest(tmp_path / "m") is None
    outputs.publish(solutions(1), 1, 0, 0)
    assert client.latest(tmp_path / "m").t_ns == 1000
    outputs.close()


def test_without_clients_no_record_is_made(tmp_path):
    outputs = BinaryOutputs(Settings(), select.poll(), 4)
    outputs.publish(solutions(4), 4, 3, 0)
    assert not outputs._messages["seq"].any()
    outputs.close()


def test_the_client_needs_only_the_standard_library():
    code = "import sys, imud.client; print({'numpy', 'numba', 'msgspec', 'structlog'} & set(sys.modules))"
    done = subprocess.run([os.sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize("address", ["localhost", "localhost:", "localhost:99999", "localhost:²"])
def test_what_is_no_address_is_refused(address):
    with pytest.raises(ValueError, match="no address"):
        client.filter_states(address)


def test_the_states_are_numbers(tmp_path):
    with _answering(tmp_path, b'{"class":"STATUS","states.a":1.5,"states.b":"x","states.c":null,"d":1}\n'):
        assert client.filter_states(tmp_path / "other") == {"a": 1.5}


@pytest.mark.parametrize(
    "answer", [b'{"class":"ERROR"}\r\n[]\r\n', b"[" * 100_000 + b"\n", b'"' + b"x" * (2 << 20), b'{"class":"TP']
)
def test_what_the_filter_estimates_is_not_read_from_another_program(tmp_path, answer):
    with (
        _answering(tmp_path, answer),
        pytest.raises(client.ProtocolError, match=r"(answer as|message of) imud"),
    ):
        client.filter_states(tmp_path / "other")


@contextlib.contextmanager
def _answering(folder, answer):
    """A program that gives this answer to one client, and hangs up."""
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(folder / "other"))
        server.listen()

        def serve_one():
            with server.accept()[0] as asked, contextlib.suppress(OSError):
                asked.recv(64)
                asked.sendall(answer)

        thread = threading.Thread(target=serve_one)
        thread.start()
        yield
        thread.join()
