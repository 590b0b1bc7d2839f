"""What a wake-up costs, in counts: system calls, compilations, garbage collections, memory that stays. No times."""

import json
import os
import shutil
import signal
import subprocess
import time

import pytest
from processes import START_S, TIMEOUT_S, emulator, process

from imud.client import connect
from imud.commands.bench.live import traced_calls

FRAMES, SENT = 6000, 3000
TRACES = 5  # at most: one in which the machine starved daemon or emulator for more than a second says nothing
BY_TIME = 200  # system calls per second, as 20 looks at everything, 10 views, the threads of the state's files


def traced(states, pid, file):
    """System calls of the process while so many states come, how many came, and how long it took; else nothing."""
    with subprocess.Popen(["strace", "-c", "-o", file, "-p", str(pid)], stderr=subprocess.PIPE, text=True) as tracer:
        attached, begin_s = "attached" in tracer.stderr.readline(), time.monotonic()
        begin = next(states).seq
        seen = [next(states).seq for _ in range(SENT if attached else 0)]
        tracer.send_signal(signal.SIGINT)
        tracer.communicate()
    if not attached:
        return {}
    return traced_calls(file.read_text()) | {"frames": seen[-1] - begin, "seconds": time.monotonic() - begin_s}


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    """A daemon at 1 kHz with one subscriber: what its interpreter did, and its system calls beside so many frames."""
    folder = tmp_path_factory.mktemp("hot")
    port, stream = folder / "imu", folder / "stream"
    command = ("imud.commands.bench.observed", str(folder / "seen.json"), "run", "--port", str(port))
    outputs = ("--listen", str(folder / "gpsd"), "--set", f"stream.listen={stream}")
    calls = {}
    with (
        (folder / "log").open("w") as log,
        emulator("g350", "--scenario", "rest", "--patient", links=[port]),
        process(*command, *outputs, stderr=log, env={**os.environ, "NO_COLOR": "1"}) as running,
    ):
        deadline = time.monotonic() + START_S
        while " ready " not in (folder / "log").read_text():
            assert running.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        with connect(stream, timeout_s=START_S) as states:
            first = next(states).seq
            while next(states).seq < first + FRAMES:
                pass
            for _ in range(TRACES if shutil.which("strace") else 0):
                calls = traced(states, running.pid, folder / "calls")
                if "cannot keep up" not in (folder / "log").read_text():
                    break
                (folder / "log").write_text("")
        running.send_signal(signal.SIGTERM)
        assert running.wait(TIMEOUT_S) == 0
    return json.loads((folder / "seen.json").read_text()), calls


def test_nothing_is_compiled_after_ready(watched):
    assert watched[0]["compiled"] == 0


def test_frames_leave_nothing_for_the_garbage_collector(watched):
    """Connecting may; a leak of one object per frame would be nine collections of the youngest generation."""
    assert len(watched[0]["pauses_ns"]) < FRAMES / 700
    assert watched[0]["objects"] < 100  # that a collection would look through


def test_frames_leave_no_memory_allocated(watched):
    assert watched[0]["blocks"] < FRAMES / 2


def test_a_wake_up_is_a_wait_and_a_read_and_a_send_for_each_subscriber(watched):
    calls = watched[1]
    if not calls:
        pytest.skip("strace is not on this machine, or may not attach")
    by_time = BY_TIME * calls.pop("seconds")
    sends, reads = calls.pop("sendto"), calls["read"]
    assert SENT / 3 < sends <= calls.pop("frames") + SENT  # the others waited to be seen before the tracer came
    assert calls["epoll_wait"] <= reads + by_time / 2.0  # a busy machine reads several frames at once
    assert sum(calls.values()) <= 2 * reads + by_time, calls
