"""What the daemon tells of changes, and what the sensors say of themselves in words: no device, no clock but ours."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from crossbow_packets import packet
from hypothesis import given
from hypothesis import strategies as st
from nmea_lines import gga, line, rmc, vtg

from imud.configuration.settings import Initial, Settings
from imud.daemon.change_logger import STATUS_LASTS_NS, ChangeLogger, Debouncer
from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.fix import Fix
from imud.drivers.registry import by_name
from imud.estimators import registry
from imud.estimators.ins.solution import TUNABLES
from imud.estimators.records import ATTITUDE_VALID, COASTING, HEADING_VALID
from imud.firmware_sim import ublox
from imud.firmware_sim.fixes import Fix as TrueFix
from imud.firmware_sim.ublox_frames import Report
from imud.outputs.gpsd_json import Report as GpsdReport
from imud.outputs.view import View
from imud.pipeline import Filter, InertialPipeline
from imud.sensors.inertial import Inertial
from imud.sensors.receiver import Receiver, jumps

SECOND = 1_000_000_000
COASTING_S = next(t.default for t in TUNABLES if t.name == "coasting_s")


class Log(list):
    def info(self, text):
        self.append(text)

    warning = info


def test_a_status_that_flaps_is_told_once():
    announcer = ChangeLogger(log := Log())
    announcer.status(ATTITUDE_VALID, 0)
    assert announcer.status(ATTITUDE_VALID, STATUS_LASTS_NS) == ATTITUDE_VALID
    for k in range(1, 200):  # for 20 s
        announcer.status(ATTITUDE_VALID * (k % 2), STATUS_LASTS_NS + k * SECOND // 10)
    assert log == ["roll and pitch are valid"]
    for k in range(200, 212):
        announcer.status(HEADING_VALID, STATUS_LASTS_NS + k * SECOND // 10)
    assert log == ["roll and pitch are valid", "roll and pitch are lost", "heading is valid"]


@pytest.mark.parametrize(("period_s", "says"), [(1, []), (10, ["no fixes: coasting"]), (30, ["no fixes: coasting"])])
def test_a_receiver_that_sends_rarely_is_said_once_to_have_no_fixes(period_s, says):
    logger = ChangeLogger(log := Log())
    for k in range(3000):  # for 300 s
        since_fix_s = k / 10 % period_s
        logger.status(COASTING * (since_fix_s > COASTING_S), k * SECOND // 10)
    assert log == says
    for k in range(3000, 3065):
        logger.status(0, k * SECOND // 10)
    assert log == says + (["fixes are back"] if says else [])


@given(st.lists(st.tuples(st.integers(1, 400), st.frozensets(st.integers(0, 3))), max_size=60))
def test_changes_alternate_and_lasted(steps):
    changes, now, there, since = Debouncer(1000), 0, set(), {}
    for wait, properties in steps:
        now += wait
        came, went = changes.update(properties, now)
        since = {fact: since.get(fact, now) for fact in there ^ properties}
        assert not there & set(came)
        assert set(went) <= there
        assert set(came) | set(went) == {fact for fact, begin in since.items() if now - begin >= 1000}
        there = there - set(went) | set(came)


def inertial(driver, **known):
    configured = ImuConfigured(Identity(driver.name, ""), 100.0, 790, 0, 24, **known)
    filter_ = Filter(registry.by_name("tilt"), Settings(), Initial(), 100.0)
    sensor = Inertial(InertialPipeline(driver, driver.new_state(configured), filter_))
    sensor.connect(SimpleNamespace(counters={}), driver, configured, 0)
    return sensor


def receive_from(sensor, data, now_ns):
    sensor.pipeline.rx[sensor.pipeline.fill : sensor.pipeline.fill + len(data)] = np.frombuffer(data, np.uint8)
    sensor.pipeline.ingest(len(data), now_ns)


def test_fault_bits_of_a_dmu_are_reported_as_text():
    sensor = inertial(by_name("crossbow"))
    level = (0, 0, 0, 0, 0, 10923)
    reported = []
    for k, bit in enumerate([0, 0, 4, 4, 0x44, 0x40, 0]):
        receive_from(sensor, packet(level, clock=-12_658 * k, bit=bit), k * SECOND // 100)
        reported.append(sensor.faults(k * SECOND // 100))
        assert sensor.reading_faults() == reported[-1]
    failed, unknown = "the sensor reports a failed accelerometer (BIT bit 2)", "bit 6 of its status word"
    assert reported[:2] == [(), ()]
    assert reported[2] == reported[3] == (failed,)
    assert reported[4][0] == failed
    assert unknown in reported[4][1]
    assert unknown in reported[5][0]
    assert reported[6] == ()
    assert "stale" in sensor.faults(SECOND)[0]
    assert sensor.reading_faults() == ()


@pytest.mark.parametrize("gap", [0, 60, 500])
def test_samples_that_no_counter_misses_are_lost_by_the_clock(gap):
    """A timer that wraps within 52 ms knows nothing of the seconds for which the daemon was stopped."""
    sensor = inertial(by_name("crossbow"))
    for k in [*range(1000), *range(1000 + gap, 1300 + gap)]:
        receive_from(sensor, packet((0, 0, 0, 0, 0, 10923), clock=-12_658 * k), k * SECOND // 100)
    assert abs(sensor.lost - gap) <= 2
    assert sensor.counters()["lost"] == sensor.lost


@pytest.mark.parametrize(("share", "is_fault"), [(1.0, False), (0.5, True)])
def test_samples_at_another_rate_than_agreed_are_a_fault(share, is_fault):
    sensor = inertial(by_name("crossbow"))
    for k in range(500):
        receive_from(sensor, packet((0, 0, 0, 0, 0, 10923), clock=-round(12_658 * share * k)), k * SECOND // 100)
        sensor.rate_ratio()
    assert any("at another rate than was agreed" in fault for fault in sensor.faults(5 * SECOND)) == is_fault


def test_a_fault_that_is_reported_from_the_start_is_one_and_a_bit_of_unknown_meaning_is_none():
    """As of an M-G350 whose frames all have EA: `imud status` called it well."""
    sensor = inertial(by_name("crossbow"))
    level = (0, 0, 0, 0, 0, 10923)
    reported = []
    for k, bit in enumerate([0x44, 0x44, 0x40, 0, 0x40, 4]):
        receive_from(sensor, packet(level, clock=-12_658 * k, bit=bit), k * SECOND // 100)
        reported.append(sensor.faults(k * SECOND // 100))
    failed = "the sensor reports a failed accelerometer (BIT bit 2)"
    assert reported[:4] == [(failed,), (failed,), (), ()]
    assert "bit 6 of its status word" in reported[4][0]
    assert reported[5] == (failed,)


def test_the_sensors_own_ranges_hold():
    sensor = inertial(by_name("crossbow"), gyro_range=math.radians(100.0), accel_range=2.0 * 9.80665)
    for k in range(3):
        receive_from(sensor, packet((0, 0, 21_845, 0, 0, 10923), clock=-12_658 * k), k * SECOND // 100)
    assert sensor.faults(0) == ("gyro z at the end of its range",)


@pytest.mark.parametrize("name", ["crossbow", "epson", "seraccel"])
def test_every_state_has_a_status_word_and_every_complaint_one_bit(name):
    driver = by_name(name)
    configured = ImuConfigured(Identity(name, ""), 100.0, 10_000_000, 0, 20)
    assert driver.new_state(configured)["status"][0] == 0
    assert all(mask.bit_count() == 1 for mask in driver.fault_texts)


def fix(lat_deg, seconds, speed_mps=0.0, lon_deg=10.0):
    unsaid = dict.fromkeys(("date", "alt_msl_m", "geoid_sep_m", "satellites", "hdop", "course_deg"))
    return Fix(
        arrival_ns=round(seconds * 1e9), utc_s=seconds, lat_deg=lat_deg, lon_deg=lon_deg, quality=1,
        speed_mps=speed_mps, **unsaid,
    )  # fmt: skip


@pytest.mark.parametrize(("talks", "said"), [(False, "stale"), (True, "sends no position")])
def test_a_receiver_without_a_position_is_not_reported_silent(talks, said):
    receiver = Receiver(by_name("nmea"), Settings().gnss, 0)
    for second in range(6) if talks else ():
        receiver.feed(line("GPGSV,1,1,00"), second * SECOND)
    assert said in receiver.faults(5 * SECOND)[0]


def test_a_receiver_whose_positions_cannot_be_read_is_not_said_to_tell_none():
    receiver = Receiver(by_name("nmea"), Settings().gnss, 0)
    for second in range(6):
        receiver.feed(gga(f"12000{second}", lat="7.038,N"), second * SECOND)
    assert receiver.faults(5 * SECOND) == ("receiver: its positions cannot be read: GGA latitude",)


@pytest.mark.parametrize(
    ("other", "unread"),
    [
        (lambda time: rmc(time, motion="022.4,400.0"), "RMC course"),
        (lambda time: vtg(kmh="010,2"), "VTG unit"),  # a comma for the point shifts the fields
        (lambda time: rmc(time, motion="000.0,084.4"), ""),
    ],
)
def test_what_is_missing_in_the_fixes_as_it_cannot_be_read_is_named(other, unread):
    receiver = Receiver(by_name("nmea"), Settings().gnss, 0)
    for second in range(12):
        time = f"1200{second:02d}.000"
        receiver.feed(gga(time) + other(time), second * SECOND)
        receiver.flush(second * SECOND + SECOND // 2)
        receiver.update(second * SECOND)
    assert receiver.used > 9
    assert receiver.faults(11 * SECOND) == (f"receiver: some of its sentences cannot be read: {unread}",) * bool(unread)


@pytest.mark.parametrize(("sentence", "is_used"), [("APHDM,218.6,M", False), ("HEHDT,218.6,T", True)])
def test_a_sensor_of_which_nothing_is_used_is_not_called_well(sentence, is_used):
    sensor = Receiver(by_name("nmea"), Settings().gnss, 0, positions=False)
    for second in range(6):
        sensor.feed(line(sentence) + line("APXDR,A,0.1,D,PTCH"), second * SECOND)
    assert any("sends nothing that is used" in fault for fault in sensor.faults(5 * SECOND)) != is_used


def test_a_receiver_that_repeats_its_fix_is_not_called_well():
    receiver = Receiver(by_name("nmea"), Settings().gnss, 0)
    for second in range(10):
        receiver.feed(gga(f"12000{min(second, 5)}.000"), second * SECOND)
        receiver.flush(second * SECOND + SECOND // 2)
        stuck = second > 8
        assert receiver.faults(second * SECOND) == ("receiver: reports a fix, but sends no new one",) * stuck


def test_a_fix_that_came_a_moment_ago_is_not_beyond_the_limit_of_its_age():
    receiver = Receiver(by_name("nmea"), Settings().gnss, 0)
    receiver.feed(gga("120000.000"), SECOND)
    receiver.flush(2 * SECOND)
    for now_ns, age_s in ((SECOND - 1_000_000, 0.0), (SECOND, 0.0), (2 * SECOND, 1.0)):
        assert receiver.out_of_limits(now_ns) == ()
        assert receiver.view(now_ns).age_s == age_s
    assert receiver.out_of_limits(5 * SECOND) == ("gnss_age_s",)


GSV = line("GPGSV,1,1,02,05,45,120,38,12,10,300,")
NO_FIX = {
    "GGA": ("nmea", gga(rest="0,00,99.9,,M,,M,,")),
    "RMC": ("nmea", rmc(status="V")),
    "NAV-PVT": ("ubx", ublox.ubx.pvt(Report(1.8e9, None))),
    "TPV": ("gpsd", b'{"class":"TPV","device":"/dev/a","mode":1}\r\n'),
}


def tpv_of(receiver, now_ns):
    return json.loads(GpsdReport(View(gnss=receiver.view(now_ns))).object("TPV"))


@pytest.mark.parametrize(("driver", "message"), NO_FIX.values(), ids=NO_FIX)
def test_a_receiver_that_says_that_it_has_no_fix_has_mode_1_and_shows_its_satellites(driver, message):
    receiver = Receiver(by_name(driver), Settings().gnss, 0)
    assert tpv_of(receiver, 0)["mode"] == 0, "nothing has come yet"
    receiver.feed(message + GSV * (driver == "nmea"), SECOND)
    receiver.flush(2 * SECOND)
    assert tpv_of(receiver, 2 * SECOND) == {"class": "TPV", "mode": 1}
    sky = json.loads(GpsdReport(View(gnss=receiver.view(2 * SECOND))).object("SKY"))
    assert driver != "nmea" or [one["PRN"] for one in sky["satellites"]] == [5, 12]


def test_a_client_gets_the_receivers_fix_from_the_first_one_on():
    receiver = Receiver(by_name("nmea"), Settings().gnss, 0)
    sent = []
    for second in range(1, 6):
        rest = "0,03,,,M,,M,," if second < 3 else "1,08,0.9,545.4,M,46.9,M,,"
        receiver.feed(gga(f"1200{second:02d}.000", rest=rest), second * SECOND)
        receiver.flush(second * SECOND + SECOND // 2)
        sent.append(GpsdReport(View(gnss=receiver.view(second * SECOND + SECOND // 2))).lines(("FIX",)))
    assert sent[:2] == [b"", b""]
    assert json.loads(sent[-1])["lat_deg"] == pytest.approx(48.0, abs=1.0)


def test_satellites_are_shown_while_a_fix_is_lost_and_what_was_of_the_fix_is_not():
    receiver = Receiver(by_name("nmea"), Settings().gnss, 0)
    for second in range(30):
        lost = second >= 10
        rest = "0,03,,,M,,M,," if lost else "1,08,0.9,545.4,M,46.9,M,,"
        receiver.feed(gga(f"1200{second:02d}.000", rest=rest) + GSV, second * SECOND)
        receiver.flush(second * SECOND + SECOND // 2)
    report = receiver.view(29 * SECOND)
    assert (report.satellites, report.quality, len(report.sky.satellites)) == (3, 0, 2)
    sky = json.loads(GpsdReport(View(gnss=report)).object("SKY"))
    assert sky["uSat"] == 3 and "hdop" not in sky and len(sky["satellites"]) == 2


def _gga_of(second, lost):
    rest = "0,00,,,M,,M,," if lost else "1,08,0.9,545.4,M,46.9,M,,"
    return gga(f"1200{second:02d}.000", rest=rest)


def _pvt_of(second, lost):
    return ublox.ubx.pvt(Report(1.8e9 + second, None if lost else UBLOX_FIX))


def _tpv_of(second, lost):
    fix = {"mode": 1} if lost else {"mode": 3, "lat": 48.1, "lon": 11.5, "altHAE": 520.0}
    tpv = {"class": "TPV", "device": "/dev/a", "time": f"2026-11-23T01:10:{second:02d}.000Z", **fix}
    return json.dumps(tpv).encode() + b"\n"


UBLOX_FIX = TrueFix(
    1.0, 1.1, 48.1, 11.5, 520.0, 5.0, 90.0, 0.9, 7, True, (1.0, 1.0, 2.0), (0.0, 5.0, 0.0), (0.1, 0.1, 0.2)
)
GPSD_SKY = {"class": "SKY", "device": "/dev/a", "satellites": [{"PRN": 5, "gnssid": 0, "svid": 5, "used": True}]}
SKIES = {
    "nmea": (_gga_of, GSV + line("GPGSA,A,3,05,12,,,,,,,,,,,1.5,0.9,1.2")),
    "ubx": (_pvt_of, ublox.ubx.satellites(Report(1.8e9, UBLOX_FIX))),
    "gpsd": (_tpv_of, json.dumps({**GPSD_SKY, "pdop": 1.5, "vdop": 1.2}).encode() + b"\n"),
}


@pytest.mark.parametrize("lost", [False, True])
@pytest.mark.parametrize("driver", SKIES)
def test_satellites_of_which_no_list_comes_any_more_are_left_out(driver, lost):
    """Messages without a fix, or with one, go on; the last list came at 5 s."""
    of_second, satellites = SKIES[driver]
    receiver = Receiver(by_name(driver), Settings().gnss, 0)
    shown = []
    for second in range(1, 25):
        data = of_second(second, lost and second >= 5) + satellites * (second <= 5)
        receiver.feed(data, second * SECOND)
        receiver.flush(second * SECOND + SECOND // 2)
        report = GpsdReport(View(gnss=receiver.view(second * SECOND + SECOND // 2)))
        shown.append(json.loads(report.object("SKY")))
    assert [second for second, sky in enumerate(shown, 1) if "satellites" in sky] == list(range(1, 15))
    assert all("pdop" in sky for sky in shown[:4])
    assert not lost or not any("pdop" in sky for sky in shown[4:])


@pytest.mark.parametrize("driver", ["nmea", "gpsd"])
def test_dilutions_that_come_no_more_are_left_out(driver):
    """The fixes go on, and GSV, if there are any; the last GSA, or SKY, came at 5 s."""
    of_second, satellites = SKIES[driver]
    receiver = Receiver(by_name(driver), Settings().gnss, 0)
    shown = []
    for second in range(1, 25):
        list_alone = GSV if driver == "nmea" else b""
        receiver.feed(of_second(second, False) + (satellites if second <= 5 else list_alone), second * SECOND)
        receiver.flush(second * SECOND + SECOND // 2)
        report = GpsdReport(View(gnss=receiver.view(second * SECOND + SECOND // 2)))
        shown.append(json.loads(report.object("SKY")))
    for name in ("pdop", "vdop"):
        assert [second for second, sky in enumerate(shown, 1) if name in sky] == list(range(1, 15))
    assert all("satellites" in sky for sky in shown) == (driver == "nmea")


def test_a_receiver_whose_gpsd_has_no_date_is_told_what_it_lacks():
    """GGA and VTG alone have a time of day only, of which gpsd makes no time."""
    tpv = {"class": "TPV", "device": "/dev/a", "mode": 3, "lat": 48.1, "lon": 11.5, "altHAE": 520.0}
    receiver = Receiver(by_name("gpsd"), Settings().gnss, 0)
    for second in range(10):
        receiver.feed(json.dumps(tpv).encode() + b"\n", second * SECOND)
    assert receiver.faults(9 * SECOND) == (
        "receiver: its fixes have no time, and are not used; a gpsd knows it from RMC or ZDA",
    )
    assert receiver.fix_count == 0


def test_a_receiver_on_a_disturbed_line_is_not_called_well():
    receiver = Receiver(by_name("nmea"), Settings().gnss, 0)
    reported = []
    for second in range(60):
        good = gga(f"12{second // 60:02}{second % 60:02}.000")
        torn = good.replace(b"545", b"546") * (10 <= second < 30 and second % 2)
        receiver.feed(torn + good, second * SECOND)
        receiver.flush(second * SECOND + SECOND // 2)
        receiver.update(second * SECOND)
        reported.append(receiver.faults(second * SECOND))
    disturbed = ("receiver: more than 1% of its messages do not arrive whole",)
    assert set(reported[:18]) == set(reported[41:]) == {()}
    assert set(reported[20:30]) == {disturbed}


def test_an_inertial_sensor_on_a_disturbed_line_is_not_called_well():
    sensor = inertial(by_name("crossbow"))
    reported = []
    for k in range(6000):
        data = packet((0, 0, 0, 0, 0, 10923 + k % 2), clock=-12_658 * k)
        receive_from(sensor, bytes(24) if 1000 <= k < 3000 and k % 40 == 0 else data, k * SECOND // 100)
        sensor.update(k * SECOND // 100)
        reported.append(sensor.faults(k * SECOND // 100))
    disturbed = ("inertial sensor: more than 1% of its samples do not arrive whole",)
    assert set(reported[:1000]) == set(reported[4100:]) == {()}
    assert set(reported[2000:3000]) == {disturbed}


@pytest.mark.parametrize(("late_ms", "reported"), [(0.0, False), (1.0, False), (18.0, True)])
def test_samples_that_come_irregularly_have_uncertain_times(late_ms, reported):
    """Each two seconds all of them are late by another time, as when the machine has no time for them."""
    sensor, late = inertial(by_name("crossbow")), np.random.default_rng(1).random(60)
    for k in range(12000):
        late_ns = round(late_ms * 1e6 * late[k // 200])
        receive_from(sensor, packet((0, 0, 0, 0, 0, 10923), clock=-12_658 * k), k * SECOND // 100 + late_ns)
    reports = [text for text in sensor.faults(120 * SECOND) if "uncertain by more than 5 ms" in text]
    assert len(reports) == reported


def test_what_was_counted_in_all_connections_is_added_up():
    driver = by_name("crossbow")
    sensor = inertial(driver)
    for connection in range(3):
        configured = ImuConfigured(Identity(driver.name, ""), 100.0, 790, 0, 24)
        sensor.connect(SimpleNamespace(counters={"overruns": connection}), driver, configured, 0)
        receive_from(sensor, b"?" + packet((0, 0, 0, 0, 0, 10923)) * 10, SECOND)
    assert sensor.counters()["frames"] == 10
    totals = sensor.totals()
    assert [totals[name] for name in ("frames", "junk", "overruns")] == [30, 3, 3]


def test_positions_that_jump():
    assert not jumps(fix(50.0, 0.0), fix(50.0005, 1.0))  # 56 m
    assert jumps(fix(50.0, 0.0), fix(50.0027, 1.0))  # 300 m
    assert not jumps(fix(50.0, 0.0), fix(50.0027, 1.0, speed_mps=250.0))  # an aircraft
    assert not jumps(fix(50.0, 0.0), fix(50.0027, 30.0))
    assert not jumps(fix(0.0, 0.0, lon_deg=179.9999), fix(0.0, 1.0, lon_deg=-179.9999))
