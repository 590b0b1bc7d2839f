"""The time that clients get: the machine's, or the receiver's where the two contradict each other."""

import calendar
import contextlib
import json
import time
from datetime import date
from types import SimpleNamespace

import msgspec
import pytest
from nmea_lines import line

from imud.configuration.settings import Initial, Settings
from imud.daemon.change_logger import ChangeLogger
from imud.daemon.devices import Devices
from imud.daemon.fast_loop import FastLoop
from imud.daemon.in_use import SensorsInUse
from imud.daemon.publisher import Publisher
from imud.daemon.status_reporter import StatusReporter
from imud.daemon.utc import Utc
from imud.drivers.capture_messages import READS, Connection, Raw, Reads, to_builtins
from imud.drivers.driver import GnssConfigured, Identity
from imud.drivers.registry import by_name
from imud.outputs.gpsd_fix import fix_object
from imud.outputs.view import Health
from imud.process.contained import ContainedErrors
from imud.recording.control import Recordings
from imud.recording.file import RecordingFile
from imud.recording.player import Handlers, Player
from imud.recording.source import Recording, adapter
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
            self.send_fix(date=date)

    def send_fix(self, period_s=1.0, sentences=("RMC",), date=None):
        """Of these sentences; GGA has no date."""
        clocks = self.clocks
        second, hundredth = divmod(round((clocks.true_s - LATENCY_S) * 100.0), 100)
        now = time.gmtime(second)
        clock, day = f"{time.strftime('%H%M%S', now)}.{hundredth:02d}", date or time.strftime("%d%m%y", now)
        place = f"4800.{now.tm_sec:02d}{hundredth:02d},N,01131.0,E"
        texts = {
            "GGA": f"GPGGA,{clock},{place},1,10,0.9,500.0,M,47.0,M,,",
            "RMC": f"GPRMC,{clock},A,{place},5.0,84.4,{day},,,A",
        }
        data = b"".join(line(texts[sentence]) for sentence in sentences)
        fixes = self.receiver.feed(data, round(clocks.monotonic_s * SECOND))
        clocks.monotonic_s += 0.5 * period_s
        if fixes or self.receiver.flush(round(clocks.monotonic_s * SECOND)):
            self.utc.add(self.receiver)
        clocks.monotonic_s += 0.5 * period_s

    def view(self):
        """What clients get without an inertial sensor."""
        used = SimpleNamespace(gnss=SimpleNamespace(sensor=self.receiver), imu=None)
        publisher = Publisher(SimpleNamespace(in_use=used, described=()), None, None, None, self.utc)
        return publisher._receivers_view(time.monotonic_ns(), Health())

    def error_s(self):
        """Of the time that a client gets now."""
        return self.utc.at(time.monotonic_ns()) - self.clocks.true_s


def fix_time(view):
    """`time` of gpsd's FIX."""
    return json.loads(fix_object(view))["time"]


@pytest.fixture
def source(clocks):
    source = Source(clocks)
    source.send(5)  # over midnight
    return source


@pytest.mark.parametrize("ahead_s", [0.0, 0.9, -0.9])
def test_within_a_second_the_two_agree(source, ahead_s):
    source.clocks.ahead_s = ahead_s
    assert source.error_s() == pytest.approx(ahead_s, abs=1e-6)
    assert not source.utc.machine_differs()


@pytest.mark.parametrize("receiver_ahead_s", [-29.0, -1.4, 2.0, 18.0])  # it is late, or lacks the leap seconds
def test_within_half_a_minute_the_machines_clock_counts(clocks, receiver_ahead_s):
    clocks.ahead_s = -receiver_ahead_s  # `true_s` is the receiver's time
    source = Source(clocks)
    source.send(5)
    assert source.error_s() == pytest.approx(clocks.ahead_s, abs=1e-6)
    assert source.utc.machine_differs()


@pytest.mark.parametrize("ahead_s", [31.0, -3600.0, 10 * YEAR_S, -56 * YEAR_S])
def test_else_the_receivers_until_the_clock_has_been_set(source, ahead_s):
    source.clocks.ahead_s = ahead_s
    assert source.error_s() == pytest.approx(0.0, abs=1e-6)
    assert source.utc.machine_differs()
    source.clocks.ahead_s = 16.0  # not yet: the time must not jump to and fro
    assert source.error_s() == pytest.approx(0.0, abs=1e-6)
    source.clocks.ahead_s = 14.0
    assert source.error_s() == pytest.approx(14.0, abs=1e-6)
    assert source.utc.machine_differs()
    source.clocks.ahead_s = 0.1
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


@pytest.mark.parametrize("ahead_s", [0.0, -56 * YEAR_S])
def test_a_receiver_whose_weeks_have_rolled_over_means_todays_date(clocks, ahead_s):
    clocks.ahead_s = ahead_s
    clocks.monotonic_s += 3600.0  # all on one day
    source = Source(clocks)
    before = time.strftime("%d%m%y", time.gmtime(clocks.true_s - 1024 * 7 * 86_400))
    source.send(5, date=before)
    assert source.error_s() == pytest.approx(0.0, abs=1e-6)
    today = date(*time.gmtime(clocks.true_s)[:3])
    assert source.receiver.last_used_fix.date == today  # what chrony gets
    assert fix_time(source.view()).startswith(today.isoformat())


@pytest.mark.parametrize("date", ["060180", "220899", "010100"])
def test_a_date_that_is_no_rollover_either_is_none(clocks, date):
    """The receiver does not know it: only its time of day counts, and chrony gets the day of the machine's clock."""
    source = Source(clocks)
    source.send(5, date=date)
    assert source.receiver.last_used_fix.date is None
    assert source.error_s() == pytest.approx(0.0, abs=1e-6)
    assert fix_time(source.view()).startswith(time.strftime("%Y-%m-%d", time.gmtime(clocks.true_s)))
    assert not source.utc.machine_differs()


IN_2006 = [line(f"GPRMC,12000{k}.00,A,4800.{k:02d},N,01131.0,E,5.0,84.4,070806,,,A") for k in range(5)]
RECEIVER = GnssConfigured(Identity("nmea", ""))


@pytest.mark.parametrize(("port", "day"), [("replay:drive.mcap", (2006, 8, 7)), ("/dev/ttyUSB0", (2026, 3, 23))])
def test_the_daemon_leaves_a_recording_its_dates(port, day):
    settings = Settings(ports=(f"{port}:nmea",))
    with contextlib.closing(FastLoop()) as fast_loop, Recordings(settings) as recordings:
        devices = Devices(settings, True, fast_loop, recordings, ContainedErrors())
        devices.connected(devices.ports[0], by_name("nmea"), RECEIVER)
        receiver = devices.in_use.gnss.sensor
        for k, sentence in enumerate(IN_2006):
            receiver.feed(sentence, (100 + k) * SECOND)
        assert receiver.last_used_fix.date == date(*day)


def test_a_replay_leaves_a_recording_its_dates(tmp_path):
    path, days = tmp_path / "drive.mcap", []
    file = RecordingFile(path, {"version": "0", "session": "drive"}, b"{}", 0)
    connection = Connection(99 * SECOND, 0, "/dev/ttyUSB0", True, "gnss", "nmea", to_builtins(RECEIVER))
    file.write("/connections", 99 * SECOND, msgspec.json.encode(connection))
    for k, sentence in enumerate(IN_2006):
        raw = Raw((100 + k) * SECOND, sentence)
        file.write(READS, raw.t_ns, Reads.of([(0, raw)]).encode())
    file.finish()
    recording, adapt = Recording([path]), adapter(None, (), None)
    handlers = Handlers(fix=lambda _: days.append(player.reported and player.reported.date))
    player = Player(recording.settings(adapt), adapt, Initial(), handlers)
    for entry in recording:
        player.take(entry)
    assert set(filter(None, days)) == {date(2006, 8, 7)}


@pytest.mark.parametrize("ahead_s", [-5 * 3600.0, -400 * 86_400.0, -56 * YEAR_S])
@pytest.mark.parametrize("hz", [2, 3, 10])
def test_fixes_without_a_date_do_not_have_the_day_of_a_wrong_clock(clocks, hz, ahead_s):
    clocks.ahead_s = ahead_s
    source, is_known = Source(clocks), False
    for k in range(5 * hz):  # over midnight, GGA first
        source.send_fix(1.0 / hz, ("GGA", "RMC") if k % hz == hz - 1 else ("GGA",))
        is_known |= k >= hz and source.receiver.last_used_fix.date is not None
        if is_known:
            assert source.error_s() == pytest.approx(0.0, abs=0.02)
            view, epoch_s = source.view(), clocks.true_s - LATENCY_S - 1.0 / hz
            assert view.utc_s == pytest.approx(epoch_s, abs=1.1)
            assert calendar.timegm(time.strptime(fix_time(view)[:19], "%Y-%m-%dT%H:%M:%S")) == pytest.approx(
                epoch_s, abs=1.1
            )
    assert is_known


@pytest.mark.parametrize("ahead_s", [-5 * 3600.0, -56 * YEAR_S])
def test_a_receiver_without_dates_has_the_time_of_day_only(clocks, ahead_s):
    clocks.ahead_s = ahead_s
    source = Source(clocks)
    for _ in range(5):
        source.send_fix(sentences=("GGA",))
    for clocks.ahead_s in (ahead_s, ahead_s - YEAR_S, 10 * YEAR_S, 0.0):  # set by whole days since
        assert abs(source.utc.at(time.monotonic_ns()) - time.time_ns() * 1e-9) <= 43_200.0
        assert (source.error_s() + 0.01) % 86_400.0 < 0.02


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
    assert source.view().utc_s == pytest.approx(AT_100_S + 4, abs=1e-6)
