"""Overload: said once per change, publishing shed before estimation, hiccups and sleep not mistaken for it."""

import re
import signal
import time

from processes import daemon, emulator

from imud.daemon.load import Load

MS = 1_000_000


def feed(load, batches, start_ms=1000, period_s=1e-3):
    """Batches of (milliseconds since the last, samples): which were published, and the lines told."""
    now, published, told = start_ms * MS, [], []
    for after_ms, n in batches:
        now += after_ms * MS
        published.append(load.leaves_time_to_publish(n, period_s, now))
        told += load.messages(0, now)
    return published, told


def test_keeping_up_publishes_everything():
    published, told = feed(Load(), [(1, 1)] * 3000)
    assert all(published)
    assert not told


def test_what_a_new_connection_lost_is_told_though_it_counts_anew():
    load, told = Load(), []
    for k, n in enumerate([1] * 100 + [186] * 50 + [1] * 2000):
        now = (1000 + 186 * k) * MS
        load.leaves_time_to_publish(n, 1e-3, now)
        told += load.messages(70 if k < 120 else 3, now)
    assert [line for line in told if "; 3 samples lost" in line]


def test_a_hiccup_is_worked_off_whole():
    published, told = feed(Load(), [(1, 1)] * 100 + [(700, 186), (1, 186), (1, 186), (1, 142)] + [(1, 1)] * 2000)
    assert all(published)
    assert not told


def test_lateness_that_lasts_sheds_publishing_and_is_told_once():
    load = Load()
    published, told = feed(load, [(1, 1)] * 100 + [(186, 186)] * 50)
    assert len(told) == 1
    assert "cannot keep up" in told[0]
    late = published[100:]
    assert all(late[:6])
    assert 0 < sum(late[10:]) <= 40 * 186 / 500 + 1
    published, told = feed(load, [(1, 1)] * 2000, start_ms=20000)
    assert all(published)
    assert sum("keeps up again" in line for line in told) == 1


def test_batches_that_take_seconds_each_are_lateness_and_standstills():
    _, told = feed(Load(), [(1900, 186)] * 5)
    assert sum("cannot keep up" in line for line in told) == 1
    assert sum("stood still for 1.9 s" in line for line in told) == 4


def test_two_samples_of_a_slow_sensor_are_not_late():
    _, told = feed(Load(), [(128, 2)] * 40, period_s=0.064)
    assert not told


def test_a_standstill_is_told():
    _, told = feed(Load(), [(1, 1)] * 10 + [(6000, 186)] + [(1, 1)] * 10)
    assert len(told) == 1
    assert "stood still for 6.0 s" in told[0]


def test_a_starved_daemon_says_so_and_catches_up(tmp_path):
    with (
        emulator("g350", "--scenario", "rest", "--patient", links=[tmp_path / "imu"]),
        daemon(tmp_path, "--port", str(tmp_path / "imu")) as imud,
    ):
        imud.until(lambda m: m["class"] == "EST" and "aligning" not in m["state"])
        for _ in range(40):  # some of the time, but never for long: the line's buffer holds 0.7 s
            imud.process.send_signal(signal.SIGSTOP)
            time.sleep(0.2)
            imud.process.send_signal(signal.SIGCONT)
            time.sleep(0.01)
            if "cannot keep up" in imud.log:
                break
        imud.says("keeps up again")
        seq = imud.until(lambda m: m["class"] == "EST")["seq"]
        imud.until(lambda m: m["class"] == "EST" and m["seq"] > seq + 500)
        told = re.findall(r"cannot keep up|keeps up again; \d+ samples lost, (\d+) batches", imud.log)
        assert told[0] == "" and int(told[1]) > 0
        assert all(bool(shed) == i % 2 for i, shed in enumerate(told))  # each in its turn; a busy machine adds others
        assert imud.log.count("again; 0 samples lost") == len(told) // 2
