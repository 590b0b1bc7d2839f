"""`imud soak`: its account of losses on numbers made by hand, its clock, and the whole of it once."""

import struct
import subprocess
import sys
import time

import numpy as np
import pytest
from processes import process

from imud.client import RECORD
from imud.commands.soak import table
from imud.commands.soak.received import Counts, States
from imud.commands.soak.troubles import Troubles, WallClock
from imud.commands.soak.waits import KERNEL, ProcessorWaits

MS = 1_000_000


def record(seq, t_ns):
    return struct.pack("<8xQqq", seq, 0, t_ns).ljust(RECORD.size, b"\0")


def test_missing_states_and_lateness():
    states = States()
    for seq in (5, 6, 9, 10, 20):
        states.add(record(seq, seq * MS), seq * MS + seq * 100_000)
    counts = states.counts()
    assert (counts.count, counts.missing, counts.gaps) == (5, 11, 2)
    assert counts.longest_gap_s == pytest.approx(0.010)
    late = np.array([5, 6, 9, 10, 20]) * 1e-4
    assert counts.recent_s == pytest.approx([np.median(late), np.percentile(late, 99.0), 2e-3])
    assert np.isnan(states.counts().recent_s).all()
    states.add(record(21, 21 * MS), 22 * MS)
    counts = states.counts()
    assert (counts.recent_s[2], counts.late_s[2]) == pytest.approx((1e-3, 2e-3))


@pytest.mark.parametrize(
    ("lost", "damaged", "missing", "expected"),
    [
        (0, 0, 0, (0, 0, 0)),
        (30, 0, 0, (0, 30, 30)),
        (30, 15, 0, (30, 0, 0)),  # each damaged message costs the one after it, too
        (30, 10, 4, (20, 10, 14)),
        (3, 10, 0, (3, 0, 0)),
    ],
)
def test_who_lost_what(lost, damaged, missing, expected):
    made = table.losses({"totals.frames": 1000, "totals.lost": lost}, Counts(missing=missing), damaged, 0.0)
    assert (made.damaged, made.unread, made.lost) == expected
    assert made.delivered == 1000 + lost


def test_the_wall_clock_of_one_process_steps_and_no_other(tmp_path):
    clock = WallClock(tmp_path)
    if clock.missing:
        pytest.skip(clock.missing)
    code = "import time; print(time.time() - time.clock_gettime(time.CLOCK_BOOTTIME))"
    apart_s = time.time() - time.clock_gettime(time.CLOCK_BOOTTIME)
    for seconds in (3600.0, -86400.0):
        clock.step(seconds)
        seen = subprocess.run([sys.executable, "-c", code], env=clock.environment, capture_output=True, check=True)
        assert float(seen.stdout) - apart_s == pytest.approx(clock.ahead_s, abs=1.0)


def test_troubles_happen_by_the_clock(tmp_path):
    class Clients:
        connected = 17

        def replace(self):
            pass

    waits = [sys.executable, "-c", "input()"]
    with subprocess.Popen(waits, stdin=subprocess.PIPE, text=True) as daemon:
        troubles = Troubles(daemon, Clients(), WallClock(tmp_path), tmp_path / "toml")
        troubles._daemon.send_signal = lambda number: None
        for elapsed_s in np.arange(0.0, 121.0, 0.5):
            troubles.on_time(elapsed_s)
        daemon.communicate("\n")
    assert troubles.counts["reloads"] == 7 and troubles.counts["full disks"] == 2
    assert troubles.due_s > 121.0 - 0.5


@pytest.mark.thorough
def test_a_short_soak(tmp_path):
    with process(
        *("imud", "soak", "--minutes", "0.1", "--faults", "gnss:loss@4-5"),
        *("--set", "imu.rate_hz=125"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as soak:
        out, errors = soak.communicate()
    words = [line.split() for line in out.splitlines()]
    delivered = next(int(line[-1]) for line in words if line[:2] == ["delivered", "by"])
    assert delivered > 200, out + errors
    assert soak.returncode == (0 if "nothing that was delivered is lost" in out else 1)
    assert any(line[:1] == ["roll"] for line in words)
    troubles = next(line for line in out.splitlines() if line.startswith("troubles"))
    assert " 0 " not in troubles.replace("0 clock steps", ""), (
        troubles
    )  # all of them happened; without a compiler no steps


def test_who_waited_for_a_processor(tmp_path):
    """A worker that ends and one that is new count with what is known of them; files of the kernel, made by hand."""

    def stat(number, comm, waited_ns, runs):
        folder = tmp_path / str(number)
        folder.mkdir(exist_ok=True)
        (folder / "comm").write_text(f"{comm}\n")
        (folder / "schedstat").write_text(f"1 {waited_ns} {runs}\n")

    stat(10, "imud", 5_000_000, 3)
    stat(11, "kworker/0:1", 0, 0)
    stat(12, "kworker/1:1", 7, 7)
    waits = ProcessorWaits({"daemon": 10}, tmp_path)
    stat(10, "imud", 9_000_000, 7)
    stat(11, "kworker/0:1", 30_000_000, 2)
    stat(13, "kworker/2:1", 500, 5)
    (tmp_path / "12" / "schedstat").unlink()
    waits.update()
    stat(13, "kworker/2:1", 10_000_500, 6)
    waits.update()
    assert (waits.waits["daemon"].waited_s, waits.waits["daemon"].runs) == (pytest.approx(0.004), 4)
    assert waits.waits["daemon"].mean_ms == pytest.approx(1.0)
    assert (waits.waits[KERNEL].waited_s, waits.waits[KERNEL].runs) == (pytest.approx(0.04), 3)


def test_what_the_daemon_said_of_one_port():
    log = "00:00 streaming port=/tmp/a/g350 baud=1\n00:01 streaming port=/tmp/a/nmea\n00:02 /tmp/a/g350 went away\n"
    assert [line[:5] for line in table.lines_of_port(log, "g350")] == ["00:00", "00:02"]
