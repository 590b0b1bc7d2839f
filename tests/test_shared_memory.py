"""Shared memory: no reader sees half a state, and what a crash or another program left is noticed."""

import ctypes
import errno
import fcntl
import multiprocessing
import os
import shutil
import struct
import subprocess
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from binary_outputs import opened, serve, solutions
from structlog.testing import capture_logs

from imud import client
from imud.commands import reference
from imud.errors import CannotCreateError
from imud.outputs.shared_memory import SharedMemory


@pytest.fixture
def outputs(tmp_path):
    with opened(tmp_path) as made:
        yield made


def test_shared_memory_follows_and_ends(outputs):
    assert client.latest(outputs.at / "m") is None
    shared = client.Shared(outputs.at / "m")
    for seq in range(3):
        outputs.publish(solutions(4, 4 * seq), 4, 4 * seq + 3, 0)
        state = shared.read()
        assert (state.seq, state.lat) == (4 * seq + 3, 4 * seq + 3)
    outputs.close()
    assert shared.read() is None
    shared.close()


def _write_without_end(path: str, stop: multiprocessing.Event) -> None:
    record = np.zeros(client.RECORD.size // 8, np.uint64)
    elsewhere = SharedMemory(f"{path}-elsewhere")
    elsewhere.publish(record)  # compiles, which takes longer than a heartbeat may be old
    elsewhere.close()
    memory = SharedMemory(path)
    header = np.frombuffer(b"IMUD" + struct.pack("<HH", 1, 336), np.uint64)
    seq = 0
    while not stop.is_set():
        seq += 1
        record[:] = seq
        record[0] = header[0]
        memory.publish(record)
        time.sleep(1e-3)  # as a daemon at 1 kHz: without a pause a slow reader never meets the time between two states


@pytest.fixture
def memory_folder():
    """In memory, as /run is: where a disk is busy, a writer may wait for it in the middle of a state."""
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:
        yield Path(folder)


def test_no_reader_sees_half_a_state(memory_folder):
    path = memory_folder / "m"
    SharedMemory(str(path)).close()
    shared = client.Shared(path)
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    writer = context.Process(target=_write_without_end, args=(str(path), stop))
    writer.start()
    try:
        seen = set()
        while len(seen) < 200:
            assert writer.is_alive()
            if (state := shared.read()) is not None:
                words = struct.unpack("<41Q", struct.pack("<Qqqq37d", *state[:4], *_flat(state[4:])))
                assert len(set(words)) == 1
                seen.add(state.seq)
    finally:
        stop.set()
        writer.join()


def _flat(values):
    for value in values:
        yield from value if isinstance(value, tuple) else (value,)


def test_a_writer_that_died_in_the_middle_is_noticed(outputs):
    outputs.publish(solutions(1), 1, 0, 0)
    outputs._shared._memory[0] += np.uint64(1)
    outputs._shared._write_all()
    with pytest.raises(client.ProtocolError, match="middle of a write"):
        client.latest(outputs.at / "m")


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_c_header_reads_what_python_reads(outputs, tmp_path):
    (tmp_path / "imud.h").write_text(reference.c_header())
    (tmp_path / "reader.c").write_text(
        '#include "imud.h"\nint get(void *m, struct imud_state *s) { return imud_read(m, s); }'
    )
    library = tmp_path / "reader.so"
    flags = ["-Wall", "-Wextra", "-Werror", "-std=c11", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, str(tmp_path / "reader.c"), "-o", str(library)], check=True)
    read = ctypes.CDLL(str(library)).get
    out = ctypes.create_string_buffer(client.RECORD.size)
    memory = np.memmap(tmp_path / "m", np.uint8, "r+")
    assert read(ctypes.c_void_p(memory.ctypes.data), out) == 0
    outputs.publish(solutions(1, 9), 1, 9, 0)
    assert read(ctypes.c_void_p(memory.ctypes.data), out) == 1
    assert client.decode(out.raw) == client.latest(tmp_path / "m")
    for place in (0, -4, -2, -1):  # the writer at work, no heartbeat, another boot
        outputs._shared._memory[place] += np.uint64(1 + 10**10)
        outputs._shared._write_all()
        assert read(ctypes.c_void_p(memory.ctypes.data), out) == 0
        outputs._shared._memory[place] -= np.uint64(1 + 10**10)
        outputs._shared._write_all()
        assert read(ctypes.c_void_p(memory.ctypes.data), out) == 1


def test_a_state_that_a_crash_left_behind_is_not_taken_for_new(outputs):
    outputs.publish(solutions(1), 1, 0, 0)
    assert client.latest(outputs.at / "m").seq == 0
    for place, says in (
        (-4, "does not run, or runs in another time namespace: its last heartbeat is"),
        (-1, "started anew"),
    ):
        outputs._shared._memory[place] -= np.uint64(5 * 10**9)
        outputs._shared._write_all()
        with pytest.raises(client.StaleError, match=rf"\(pid {os.getpid()}\).*{says}"):
            client.latest(outputs.at / "m")
        outputs._shared._memory[place] += np.uint64(5 * 10**9)
    outputs.tick(time.monotonic_ns())
    assert client.latest(outputs.at / "m").seq == 0
    outputs.tick(time.monotonic_ns() + 10**10)  # of another time namespace
    with pytest.raises(client.StaleError, match="time namespace"):
        client.latest(outputs.at / "m")


@pytest.mark.parametrize("size", [0, 8, 100, 4096])
def test_a_truncated_file_is_written_anew(outputs, size):
    outputs.publish(solutions(1, 3), 1, 3, 0)
    shared = client.Shared(outputs.at / "m")
    os.truncate(outputs.at / "m", size)
    if size < client.SHARED_SIZE:
        with pytest.raises(client.ProtocolError, match="bytes instead of"):
            shared.read()
    outputs.tick(time.monotonic_ns())
    assert shared.read().seq == 3
    os.truncate(outputs.at / "m", size)
    outputs.publish(solutions(1, 4), 1, 4, 0)
    assert shared.read().seq == 4
    shared.close()


def test_a_reader_follows_to_the_file_that_the_next_daemon_makes(tmp_path):
    """As where systemd removes a service's folder at its end. Threads may read meanwhile."""
    with opened(tmp_path) as before:
        before.publish(solutions(1, 3), 1, 3, 0)
        shared = client.Shared(tmp_path / "m")
        assert shared.read().seq == 3
    (tmp_path / "m").unlink()
    assert shared.read() is None
    with opened(tmp_path) as after:
        assert shared.read() is None
        after.publish(solutions(1, 4), 1, 4, 0)
        assert shared.read().seq == 4
    shared.close()


def test_a_file_that_was_removed_is_made_anew(outputs):
    outputs.publish(solutions(1, 3), 1, 3, 0)
    shared = client.Shared(outputs.at / "m")
    (outputs.at / "m").unlink()
    outputs.tick(time.monotonic_ns())
    assert client.latest(outputs.at / "m").seq == 3
    outputs.publish(solutions(1, 4), 1, 4, 0)
    assert client.latest(outputs.at / "m").seq == 4
    shared.close()


def _without_a_process():
    with subprocess.Popen(["true"]) as process:
        process.wait()
    return process.pid


@pytest.mark.parametrize("ended", ["as it should", "killed", "at another boot"])
def test_a_reader_that_locks_the_file_does_not_keep_the_next_daemon_from_it(tmp_path, ended):
    path = tmp_path / "m"
    SharedMemory(str(path)).close()
    if ended != "as it should":
        boot = bytes(16) if ended == "at another boot" else client.boot_id()
        left = client.LIVENESS.pack(time.monotonic_ns() - 3 * client.STALE_NS, _without_a_process(), boot)
        path.write_bytes(path.read_bytes()[: -len(left)] + left)
    with path.open("rb") as reader:
        fcntl.flock(reader, fcntl.LOCK_SH)
        memory = SharedMemory(str(path))
        with pytest.raises(CannotCreateError, match="another imud writes there"):
            SharedMemory(str(path))
        memory.close()


def test_a_full_disk_is_no_defect_of_the_daemon(outputs, monkeypatch):
    outputs.publish(solutions(1, 3), 1, 3, 0)
    os.truncate(outputs.at / "m", 0)

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as disk, capture_logs() as lines:
        disk.setattr(os, "pwrite", full)
        outputs.tick(time.monotonic_ns())
        outputs.tick(time.monotonic_ns())
    assert [line["event"].partition(" cannot be ")[2] for line in lines] == ["written: No space left on device"]
    outputs.tick(time.monotonic_ns())
    assert client.latest(outputs.at / "m").seq == 3


def test_a_thread_may_wait_while_the_daemon_starts(outputs):
    heard = []
    with client.connect(outputs.at / "s") as stream:
        thread = threading.Thread(target=lambda: heard.append(next(stream)))
        thread.start()
        serve(outputs)
        outputs.publish(solutions(1), 1, 3, 0)
        thread.join(10)
    assert heard[0].seq == 3
