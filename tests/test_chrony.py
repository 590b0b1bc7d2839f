"""The time for chrony: read by a C program with ntpd's own declaration of the segment, and by a real chronyd."""

import calendar
import ctypes
import math
import os
import random
import shutil
import subprocess
import time
from datetime import date

import pytest

from imud.drivers.fix import Fix
from imud.errors import CannotCreateError
from imud.outputs.chrony import KEY, ChronyOutput

# struct shmTime as ntpd's refclock_shm.c declares it
READER = r"""
#include <stdio.h>
#include <sys/shm.h>
#include <time.h>
struct shmTime {
    int mode; volatile int count;
    time_t clockTimeStampSec; int clockTimeStampUSec;
    time_t receiveTimeStampSec; int receiveTimeStampUSec;
    int leap; int precision; int nsamples; volatile int valid;
    unsigned clockTimeStampNSec; unsigned receiveTimeStampNSec;
    int dummy[8];
};
int main(int argc, char **argv) {
    int id = shmget(0x4e545030 + UNIT, sizeof(struct shmTime), 0);
    struct shmTime *t = id < 0 ? (void *)-1 : shmat(id, 0, 0);
    if (t == (void *)-1) { perror("shm"); return 1; }
    printf("%zu %d %d %d %lld %u %d %lld %u %d %d %d\n", sizeof *t, t->mode, t->count, t->valid,
        (long long)t->clockTimeStampSec, t->clockTimeStampNSec, t->clockTimeStampUSec,
        (long long)t->receiveTimeStampSec, t->receiveTimeStampNSec, t->receiveTimeStampUSec, t->leap, t->precision);
    return 0;
}
"""
FIX = Fix(
    0, 43_200.25, date(2026, 5, 4), 48.1, 11.5, 500.0, 46.0, 1, 9, 0.9, 1.0, 10.0,
)  # fmt: skip
NOON_S = calendar.timegm((2026, 5, 4, 12, 0, 0))
PERIOD_S, LATENCY_S = 0.2, 0.1


@pytest.fixture
def unit():
    """A unit of ours alone, whose segment is gone afterwards."""
    number = random.randrange(100, 250)
    yield number
    libc = ctypes.CDLL(None)
    segment = libc.shmget(KEY + number, 0, 0)
    if segment >= 0:
        libc.shmctl(segment, 0, None)


@pytest.fixture
def reader(tmp_path, unit):
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    source = tmp_path / "reader.c"
    source.write_text(READER.replace("UNIT", str(unit)))
    subprocess.run(["cc", "-o", str(tmp_path / "reader"), str(source)], check=True)
    return lambda: [int(word) for word in subprocess.check_output([str(tmp_path / "reader")], text=True).split()]


def test_a_c_program_reads_when_the_fix_was_by_both_clocks(unit, reader):
    output = ChronyOutput(unit)
    size, mode, count, valid, *_ = reader()
    assert (size, mode, count, valid) == (96, 1, 0, 0)  # nothing is epoch_ns before the first fix

    before_ns = time.time_ns()
    output.publish(FIX._replace(arrival_ns=time.monotonic_ns()), LATENCY_S)
    after_ns = time.time_ns()
    _, _, count, valid, clock_s, clock_ns, clock_us, receive_s, receive_ns, receive_us, leap, _ = reader()
    assert (count, valid, leap) == (2, 1, 0)
    assert (clock_s, clock_ns, clock_us) == (NOON_S, 250_000_000, 250_000)
    assert receive_us == receive_ns // 1000
    system_ns = receive_s * 1_000_000_000 + receive_ns + round(LATENCY_S * 1e9)
    assert before_ns - 1_000_000 <= system_ns <= after_ns + 1_000_000

    output.close()
    assert reader()[3] == 0


@pytest.mark.parametrize("jitter_s", [0.0, 0.003, 0.05])
def test_the_precision_is_that_of_the_line(unit, reader, jitter_s):
    output = ChronyOutput(unit)
    noise = random.Random(1)
    steps = []
    start_ns, late = time.monotonic_ns(), 0.0
    output.publish(FIX._replace(arrival_ns=start_ns), LATENCY_S)
    assert reader()[-1] == 0  # one fix says nothing of the line
    for k in range(1, 200):
        before, late = late, noise.uniform(0.0, jitter_s)
        steps.append(abs(late - before))
        arrival_ns = start_ns + round((k * PERIOD_S + late) * 1e9)
        output.publish(FIX._replace(utc_s=FIX.utc_s + k * PERIOD_S, arrival_ns=arrival_ns), LATENCY_S)
    typical = sum(steps[-32:]) / 32
    assert reader()[-1] == pytest.approx(max(-10.0, math.log2(max(typical, 1e-9))), abs=1.01)
    output.close()


@pytest.mark.parametrize("step_s", [0.0, 3600.0, -86_400.0, -1.7e9])
def test_when_the_clock_has_been_set_the_precision_is_soon_that_of_the_line_again(unit, reader, monkeypatch, step_s):
    output, start_ns, real_ns = ChronyOutput(unit), time.monotonic_ns(), time.time_ns
    for k in range(64):
        if k == 32:
            monkeypatch.setattr(time, "time_ns", lambda: real_ns() + round(step_s * 1e9))
        arrival_ns = start_ns + round(k * PERIOD_S * 1e9)
        output.publish(FIX._replace(utc_s=FIX.utc_s + k * PERIOD_S, arrival_ns=arrival_ns), LATENCY_S)
    assert reader()[-1] <= -3
    assert reader()[7] == pytest.approx((real_ns() - time.monotonic_ns() + arrival_ns) * 1e-9 + step_s, abs=2.0)
    output.close()


def test_a_receiver_whose_date_jumps_from_fix_to_fix_gives_no_time(unit, reader):
    output, start_ns, counts = ChronyOutput(unit), time.monotonic_ns(), []
    for k, year in enumerate([2026, 2036, 2026, 2046, 2036, 2036, 2036]):
        fix = FIX._replace(utc_s=FIX.utc_s + k, date=date(year, 5, 4), arrival_ns=start_ns + k * 1_000_000_000)
        output.publish(fix, LATENCY_S)
        counts.append(reader()[2])
    assert counts == [2, 2, 2, 2, 2, 4, 6]  # the first has nothing to agree with
    output.close()


@pytest.mark.parametrize("ahead_s", [0.0, -5 * 3600.0, -400 * 86_400.0, -56 * 365 * 86_400.0])
@pytest.mark.parametrize("hz", [2, 3, 10])
def test_fixes_without_a_date_do_not_give_the_day_of_the_clock_that_is_to_be_set(
    unit, reader, monkeypatch, hz, ahead_s
):
    output, mono_ns = ChronyOutput(unit), time.monotonic_ns()
    monkeypatch.setattr(time, "monotonic_ns", lambda: mono_ns)
    monkeypatch.setattr(time, "time_ns", lambda: round((NOON_S + ahead_s) * 1e9))
    shown_s, counts = set(), set()
    for k in range(1, 4 * hz):
        dated = FIX.date if k % hz == 0 else None  # GGA first, then RMC once a second
        arrival_ns = mono_ns + round(k / hz * 1e9)
        output.publish(FIX._replace(utc_s=43_200.0 + k / hz, date=dated, arrival_ns=arrival_ns), LATENCY_S)
        _, _, count, valid, clock_s, *_ = reader()
        shown_s |= {clock_s} if valid else set()
        counts.add(count)
    assert shown_s == {NOON_S + 1, NOON_S + 2, NOON_S + 3}
    assert max(counts) == 6
    output.close()


def test_of_a_receiver_that_sends_no_date_the_day_is_the_nearest(unit, reader):
    output, start_ns = ChronyOutput(unit), time.monotonic_ns()
    of_day_s = (time.time_ns() % 86_400_000_000_000) * 1e-9
    for k in range(13):
        fix = FIX._replace(utc_s=(of_day_s + k) % 86_400.0, date=None, arrival_ns=start_ns + k * 1_000_000_000)
        output.publish(fix, LATENCY_S)
    _, _, count, valid, clock_s, _, _, receive_s, *_ = reader()
    assert (count, valid) == (6, 1)  # those of 10, 11 and 12 s
    assert abs(clock_s - receive_s) <= 1
    output.close()


@pytest.mark.parametrize(
    ("utc_s", "day", "now", "expected"),
    [
        (1.5, date(2026, 5, 4), (2020, 1, 1, 0, 0, 0), (2026, 5, 4, 0, 0, 1.5)),  # the date is believed
        (86_399.0, None, (2026, 5, 4, 0, 0, 2), (2026, 5, 3, 23, 59, 59)),  # the day that is nearest
        (1.0, None, (2026, 5, 3, 23, 59, 58), (2026, 5, 4, 0, 0, 1)),
        (43_000.0, None, (2026, 5, 4, 12, 0, 0), (2026, 5, 4, 11, 56, 40)),
    ],
)
def test_the_day_of_a_fix(utc_s, day, now, expected):
    *whole, second = expected
    epoch_ns = FIX._replace(utc_s=utc_s, date=day).utc_ns(calendar.timegm(now) * 1_000_000_000)
    assert epoch_ns == calendar.timegm((*whole, 0)) * 1_000_000_000 + round(second * 1e9)


def test_a_fix_without_a_time_gives_no_time(unit, reader):
    output = ChronyOutput(unit)
    output.publish(FIX._replace(utc_s=None), LATENCY_S)
    assert reader()[2:4] == [0, 0]
    output.close()


def test_a_segment_of_another_size_is_named(unit):
    libc = ctypes.CDLL(None)
    assert libc.shmget(KEY + unit, 40, 0o1600) >= 0
    with pytest.raises(CannotCreateError, match=rf"chrony.shm_unit = {unit}.*ipcrm -M {KEY + unit:#x}"):
        ChronyOutput(unit)


def test_a_real_chronyd_takes_the_offset(unit, tmp_path):
    chronyd = shutil.which("chronyd", path="/usr/sbin:/usr/bin")
    if chronyd is None:
        pytest.skip("chronyd is not installed (Debian: chrony)")
    log = tmp_path / "log"
    log.mkdir(mode=0o777)
    log.chmod(0o777)
    tmp_path.chmod(0o777)
    config = tmp_path / "chrony.conf"
    config.write_text(
        f"refclock SHM {unit} poll 0 filter 4 refid IMUD delay 0.1\nlogdir {log}\nlog refclocks\ncmdport 0\n"
        f"pidfile {tmp_path}/pid\nbindcmdaddress /\nport 0\n"
    )
    output = ChronyOutput(unit)
    late_s = 0.123
    command = [chronyd, "-x", "-d", "-u", "root", "-f", str(config)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        try:
            samples: list[list[str]] = []
            deadline = time.monotonic() + 30.0
            while len(samples) < 3 and time.monotonic() < deadline and process.poll() is None:
                now_ns = time.time_ns()
                moment = time.gmtime(now_ns // 1_000_000_000)
                of_day_s = (now_ns % 86_400_000_000_000) * 1e-9 - late_s  # the true time, by which ours is ahead
                fix = FIX._replace(
                    utc_s=of_day_s, date=date(*moment[:3]), arrival_ns=time.monotonic_ns() + round(LATENCY_S * 1e9)
                )
                if of_day_s > 0.0:
                    output.publish(fix, LATENCY_S)
                time.sleep(PERIOD_S)
                file = log / "refclocks.log"
                rows = [row.split() for row in file.read_text().splitlines()] if file.exists() else []
                samples = [row for row in rows if len(row) > 6 and row[2] == "IMUD" and row[3].isdigit()]
            process.terminate()
            complaint = process.stderr.read().decode()
        finally:
            process.terminate()
    assert len(samples) >= 3, complaint
    # columns: date, time, refclock, number, leap, PPS, raw offset, cooked offset (true less system)
    assert all(float(row[6]) == pytest.approx(-late_s, abs=0.005) for row in samples), samples
    output.close()


def test_a_segment_that_is_there_already_and_open_to_all_is_reported(unit):
    libc = ctypes.CDLL(None)
    before = os.umask(0)
    try:
        assert libc.shmget(KEY + unit, 96, 0o1666) >= 0
    finally:
        os.umask(before)
    for mode, reported in ((0o600, True), (0o666, False)):
        output = ChronyOutput(unit, mode)
        assert output.is_open_to_all is reported
        output.close()


def test_a_segment_of_its_own_is_not_open_to_all(unit):
    output = ChronyOutput(unit)
    assert not output.is_open_to_all
    output.close()
