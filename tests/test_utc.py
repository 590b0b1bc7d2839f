"""The time that clients get: the machine's, or the receiver's where the two contradict each other."""

import calendar
import time
from types import SimpleNamespace

import pytest
from nmea_lines import line

from imud.configuration.settings import Settings
from imud.daemon.change_logger import ChangeLogger
from imud.daemon.in_use import SensorsInUse
from imud.daemon.publisher import Publisher
from imud.daemon.status_reporter import StatusReporter
from imud.daemon.utc import Utc
from imud.drivers.registry import by_name
from imud.outputs.view import Health
from imud.process.contained import ContainedErrors
from imud.sensors.receiver import Receiver

SECOND, YEAR_S = 1_000_000_000, 365 * 86_400
LATENCY_S = Settings().gnss.latency_s
AT_100_S = calendar.timegm((2026, 3, 23, 23, 59, 50))  # by the receiver, of the fix that comes at 100 s


class Clocks:
    """All clocks of the machine, in s; `time_ns` and so on stand in for those of `time`."""

    def __init__(self, monkeypatch):
        self.monotonic_s, self.suspended_s, self.ahead_s = 100.0, 0.0, 0.0
        monkeypatch.setattr(time, "monotonic_ns", lambda: round(self.monotonic_s * SECOND))
        monkeypatch.setattr(time, "clock_gettime_ns", lambda _: round((self.monotonic_s + self.suspended_s) * SECOND))
        monkeypatch.setattr(time, "time_ns", lambda: round((self.true_s + self.ahead_s) * SECOND))

    @property
    def true_s(self):
        """What the receiver's time is, LATENCY_S ago."""
        return AT_100_S + LATENCY_S + self.monotonic_s + self.suspended_s - 100.0


@pytest.fixture
def clocks(monkeypatch):
    return Clocks(monkeypatch)


class Source:
    """A receiver that sends RMC once a second, and what is known of UTC by it."""

    def __init__(self, clocks):
        self.clocks, self.utc = clocks, Utc()
        self.receiver = Receiver(by_name("nmea"), Settings().gnss, 0)

    def send(self, seconds, date=None):
        """One more fix a second. date: another one than the right one."""
        for _ in range(seconds):
            now, clocks = time.gmtime(self.clocks.true_s - LATENCY_S), self.clocks
            clock, day = time.strftime("%H%M%S.00", now), date or time.strftime("%d%m%y", now)
            sentence = f"GPRMC,{clock},A,4800.{now.tm_sec:02d},N,01131.0,E,5.0,84.4,{day},,,A"
            fixes = self.receiver.feed(line(sentence), round(clocks.monotonic_s * SECOND))
            clocks.monotonic_s += 0.5
            if fixes or self.receiver.flush(round(clocks.monotonic_s * SECOND)):
                self.utc.add(self.receiver)
            clocks.monotonic_s += 0.5

    def error_s(self):
        """Of the time that a client gets now."""
        return self.utc.at(time.monotonic_ns()) - self.clocks.true_s


@pytest.fixture
def source(clocks):
    source = Source(clocks)
    source.send(5)  # over midnight
    return source


@pytest.mark.parametrize("ahead_s", [0.0, 0.9, -0.9])
def test_within_a_second_the_machines_clock_counts(source, ahead_s):
    source.clocks.ahead_s = ahead_s
    assert source.error_s() == pytest.approx(ahead_s, abs=1e-6)
    assert not source.utc.machine_differs()


@pytest.mark.parametrize("ahead_s", [1.1, -3600.0, 10 * YEAR_S, -56 * YEAR_S])
def test_else_the_receivers_until_the_clock_has_been_set(source, ahead_s):
    source.clocks.ahead_s = ahead_s
    assert source.error_s() == pytest.approx(0.0, abs=1e-6)
    assert source.utc.machine_differs()
    source.clocks.ahead_s = 0.9  # not yet: the time must not jump to and fro
    assert source.error_s() == pytest.approx(0.0, abs=1e-6)
    source.clocks.ahead_s = 0.1
    assert source.error_s() == pytest.approx(0.1, abs=1e-6)
    assert not source.utc.machine_differs()


def test_the_receivers_time_continues_without_it_and_through_a_suspension(source):
    source.clocks.ahead_s = -10 * YEAR_S
    source.clocks.monotonic_s += 1000.0
    source.clocks.suspended_s += 3600.0
    assert source.error_s() == pytest.approx(0.0, abs=1e-6)


def test_a_single_wrong_date_does_not_count(source):
    source.send(1, date="010130")
    assert source.error_s() == pytest.approx(0.0, abs=1e-6)
    source.send(2, date="010130")
    assert source.error_s() > YEAR_S


def test_a_receiver_whose_weeks_have_rolled_over_does_not_contradict_a_right_clock(clocks):
    source = Source(clocks)
    source.send(5, date=time.strftime("%d%m%y", time.gmtime(AT_100_S - 1024 * 7 * 86_400)))
    clocks.monotonic_s += 10.0  # the last date was that before midnight
    assert source.utc.at(time.monotonic_ns()) == pytest.approx(clocks.true_s, abs=1e-6)


def test_a_contradiction_is_logged_once_it_lasts(source):
    nothing = SimpleNamespace(in_use=SensorsInUse(), spares=SimpleNamespace(sensors={}))
    devices, warnings, ended = SimpleNamespace(**vars(nothing), selection=SimpleNamespace(inertial=None)), [], []
    reporter = StatusReporter(devices, ContainedErrors(), source.utc)
    reporter._change_logger = ChangeLogger(SimpleNamespace(warning=warnings.append, info=ended.append))
    for second, ahead_s in enumerate((0.0, 0.0, 5.0, 5.0, 0.0, 0.0)):
        source.clocks.ahead_s = ahead_s
        reporter.health((200 + second) * SECOND)
    assert ["this machine's clock differ" in text for text in warnings] == [True]
    assert ended == [f"has ended: {warnings[0]}"]


def test_before_the_first_fix_only_the_machines_clock_is_known(clocks):
    clocks.ahead_s = -3600.0
    assert Source(clocks).error_s() == pytest.approx(-3600.0, abs=1e-6)


@pytest.mark.parametrize("ahead_s", [0.0, 0.7, -10 * YEAR_S])
def test_a_receiver_alone_has_the_very_time_of_its_fix(source, ahead_s):
    source.clocks.ahead_s = ahead_s
    used = SimpleNamespace(gnss=SimpleNamespace(sensor=source.receiver), imu=None)
    devices = SimpleNamespace(in_use=used, described=())
    publisher = Publisher(devices, None, None, None, source.utc)
    now = publisher._receivers_view(time.monotonic_ns(), Health())
    assert now.utc_s == pytest.approx(AT_100_S + 4, abs=1e-6)
