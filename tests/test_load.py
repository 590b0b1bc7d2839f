"""Overload: said once per change; messages wait, estimation and stream do not; hiccups and sleep are no overload."""

import re
import signal
import socket
import struct
import time

from processes import TIMEOUT_S, daemon, emulator

from imud.client import RECORD
from imud.daemon.load import Load

MS = 1_000_000


def feed(load, batches, start_ms=1000, period_s=1e-3):
    """Batches of (milliseconds since the last, samples): which were published, and the lines messages."""
    now, published, messages = start_ms * MS, [], []
    for after_ms, n in batches:
        now += after_ms * MS
        published.append(load.leaves_time_for_messages(n, period_s, now))
        messages += load.messages(0, after_ms * MS, now)
    return published, messages


def test_keeping_up_publishes_everything():
    published, messages = feed(Load(), [(1, 1)] * 3000)
    assert all(published)
    assert not messages


def test_losses_of_a_new_connection_are_reported_though_its_counter_restarts():
    load, messages = Load(), []
    for k, n in enumerate([1] * 100 + [186] * 50 + [1] * 2000):
        now = (1000 + 186 * k) * MS
        load.leaves_time_for_messages(n, 1e-3, now)
        messages += load.messages(70 if k < 120 else 3, 186 * MS, now)
    assert [line for line in messages if "; 3 samples lost" in line]


def test_a_short_stall_is_processed_completely():
    published, messages = feed(Load(), [(1, 1)] * 100 + [(700, 186), (1, 186), (1, 186), (1, 142)] + [(1, 1)] * 2000)
    assert all(published)
    assert not messages


def test_only_an_overload_makes_each_batch_a_matter_of_python():
    load = Load()
    feed(load, [(1, 1)] * 100 + [(186, 186)] * 2)
    assert load.max_batch(1e-3) == 100
    feed(load, [(186, 186)] * 10)
    assert load.max_batch(1e-3) == -1
    feed(load, [(1, 1)] * 600, start_ms=4000)
    assert load.max_batch(1e-3) == 100


def test_late_batches_now_and_then_are_no_overload():
    load = Load()
    for now_ms in range(1000, 20_000, 100):  # what is not late in between does not come here
        load.messages(0, 100 * MS, now_ms * MS)
        if now_ms % 700 == 0:
            assert load.leaves_time_for_messages(150, 1e-3, now_ms * MS)
        assert not load.overloaded


def test_in_lasting_lateness_messages_wait_and_it_is_reported_once():
    load = Load()
    published, messages = feed(load, [(1, 1)] * 100 + [(186, 186)] * 50)
    assert len(messages) == 1
    assert "cannot keep up" in messages[0]
    late = published[100:]
    assert all(late[:6])
    assert 0 < sum(late[10:]) <= 40 * 186 / 500 + 1
    published, messages = feed(load, [(1, 1)] * 2000, start_ms=20000)
    assert all(published)
    assert sum("keeps up again" in line for line in messages) == 1


def test_in_lateness_that_messages_do_not_cause_none_waits():
    load = Load()
    load.published(186, 1e-3, 10 * MS)
    published, messages = feed(load, [(1, 1)] * 100 + [(186, 186)] * 50)
    assert all(published)
    assert sum("cannot keep up" in line for line in messages) == 1
    load.published(186, 1e-3, 100 * MS)
    published, _ = feed(load, [(186, 186)] * 50, start_ms=30000)
    assert not all(published)


def test_batches_that_take_seconds_each_are_lateness_and_standstills():
    _, messages = feed(Load(), [(1900, 186)] * 5)
    assert sum("cannot keep up" in line for line in messages) == 1
    assert sum("stood still for 1.9 s" in line for line in messages) == 5


def test_two_samples_of_a_slow_sensor_are_not_late():
    _, messages = feed(Load(), [(128, 2)] * 40, period_s=0.064)
    assert not messages


def test_a_stall_is_reported():
    _, messages = feed(Load(), [(1, 1)] * 10 + [(6000, 186)] + [(1, 1)] * 10)
    assert len(messages) == 1
    assert "stood still for 6.0 s" in messages[0]


def test_an_overloaded_daemon_reports_it_and_catches_up_and_its_stream_misses_nothing(tmp_path):
    with (
        emulator("g350", "--scenario", "rest", "--patient", links=[tmp_path / "imu"]),
        daemon(tmp_path, "--port", str(tmp_path / "imu"), "--set", f"stream.listen='{tmp_path / 'stream'}'") as imud,
        socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as stream,
    ):
        imud.until(lambda m: m["class"] == "EST" and "aligning" not in m["state"])
        stream.connect(str(tmp_path / "stream"))
        stream.setblocking(False)
        numbers, behind = [], 0
        for _ in range(40):  # some of the time, but never for long: the line's buffer holds 0.7 s
            imud.process.send_signal(signal.SIGSTOP)
            time.sleep(0.2)
            imud.process.send_signal(signal.SIGCONT)
            time.sleep(0.01)
            numbers += numbers_in(stream)
            behind += "cannot keep up" in imud.log
            if behind > 5:
                break
        for message in imud.messages(TIMEOUT_S):
            numbers += numbers_in(stream)
            if message["class"] == "EST" and "keeps up again" in imud.log:
                break
        seq = message["seq"]
        imud.until(lambda m: m["class"] == "EST" and m["seq"] > seq + 200)
        numbers += numbers_in(stream)
        assert numbers[-1] > seq
        assert numbers == list(range(numbers[0], numbers[-1] + 1))
        messages = re.findall(r"cannot keep up|keeps up again; \d+ samples lost, (\d+) batches", imud.log)
        # how many batches are shed depends on the machine: messages that cost little never wait
        assert len(messages) >= 2
        # each in its turn; a busy machine adds others
        assert all(bool(shed) == i % 2 for i, shed in enumerate(messages))
        assert imud.log.count("again; 0 samples lost") == len(messages) // 2


def numbers_in(stream):
    """The numbers of the states that have come."""
    numbers = []
    while True:
        try:
            numbers.append(struct.unpack_from("<8xQ", stream.recv(2 * RECORD.size))[0])
        except BlockingIOError:
            return numbers
