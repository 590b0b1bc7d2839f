"""Fixes on their way to the filter: which are refused, and what their records say. Oracle: the definitions."""

import gzip
import json
import math
import os
from collections import Counter

import numpy as np
import pytest
from nmea_lines import decode, gga, line, rmc, vtg

from imud.api import navigate
from imud.configuration.settings import Gnss
from imud.daemon.receiver_solution import solution
from imud.drivers.fix import ReceiverStatus
from imud.drivers.registry import by_name
from imud.errors import BadDataError, ConfigError
from imud.estimators.records import NEW_RECEIVER
from imud.outputs.gpsd_json import Report
from imud.outputs.view import View
from imud.sensors.gnss import record, refusal, refusals
from imud.sensors.readings import ReceiverReport
from imud.sensors.receiver import Receiver
from imud.setup.config import load
from imud.tables.inputs import read_fixes
from imud.tables.lines import is_nmea
from imud.tables.nmea_log import fixes_of_log
from imud.tables.refused import without_refused

FIX = decode(gga() + rmc(motion="10.0,90.0") + vtg())[0][0]


@pytest.mark.parametrize(("quality", "fresh"), [(1, True), (0, False)])
def test_a_receiver_that_says_that_it_has_lost_its_fix_has_no_fresh_one(quality, fresh):
    receiver = Receiver(by_name("nmea"), Gnss(), 0)
    for second in range(4):
        receiver.feed(gga(f"12000{second}.000"), second * 10**9)
    assert receiver.fresh_fix(3 * 10**9) is not None
    receiver.feed(gga("120004.000", rest=f"{quality},08,0.9,545.4,M,46.9,M,,"), 4 * 10**9)
    receiver.flush(4_300_000_000)
    assert (receiver.fresh_fix(4_300_000_000) is not None) is fresh
    receiver.feed(gga("120005.000"), 5 * 10**9)
    receiver.flush(5_300_000_000)
    assert receiver.fresh_fix(5_300_000_000) is not None
    assert receiver.fresh_fix(9 * 10**9) is None


def test_the_papers_rules_are_the_defaults_and_can_be_changed():
    assert refusal(FIX, Gnss()) is None
    assert "4 satellites" in str(refusal(FIX._replace(satellites=4), Gnss()))
    assert refusal(FIX._replace(satellites=5), Gnss()) is None
    assert refusal(FIX._replace(satellites=None), Gnss()) is None, "RMC does not say"
    assert refusal(FIX._replace(satellites=3), Gnss(min_satellites=0)) is None


@pytest.mark.parametrize(("quality", "word"), [(6, "dead reckoning"), (7, "by hand"), (8, "simulated")])
def test_guesses_and_simulations_are_refused_unless_wanted(quality, word):
    assert word in str(refusal(FIX._replace(quality=quality), Gnss()))
    assert refusal(FIX._replace(quality=quality), Gnss(qualities=(quality,))) is None
    for measured in (1, 2, 3, 4, 5):
        assert refusal(FIX._replace(quality=measured), Gnss()) is None


def test_a_poor_or_timeless_fix_is_refused_but_an_unknown_hdop_is_not():
    assert "HDOP" in str(refusal(FIX._replace(hdop=20.1), Gnss()))
    assert refusal(decode(gga(rest="1,08,99.99,545.4,M,46.9,M,,"))[0][0], Gnss()) is None
    assert "no time" in str(refusal(FIX._replace(utc_s=None), Gnss()))


class Says:
    """A decoder of one fix a second."""

    whole, counters, decoded, pending, status = 0, Counter(), 0, False, ReceiverStatus()

    def __init__(self, **told):
        self.told = told

    def feed(self, data, arrival_ns):
        self.status = ReceiverStatus(quality=1, arrival_ns=arrival_ns)
        self.decoded += 1
        return [FIX._replace(**self.told, arrival_ns=arrival_ns, utc_s=float(self.decoded))]


@pytest.mark.parametrize(
    "told",
    [
        {"velocity_mps": (2e6, 0.0, 0.0)},
        {"velocity_mps": (0.0, -2e6, None)},
        {"velocity_mps": (0.0, 0.0, 2e6)},
        {"speed_mps": 2e6},
        {"alt_msl_m": -2e6},
        {"alt_msl_m": 9e5, "geoid_sep_m": 9e5},
        {"lat_deg": 0.0, "lon_deg": 0.0},
    ],
)
def test_a_fix_that_cannot_be_is_refused_and_a_fault(told):
    assert refusal(FIX._replace(velocity_mps=(9000.0, -9000.0, math.nan), alt_msl_m=9e5), Gnss()) is None
    assert "cannot" not in str(refusal(FIX, Gnss()))
    assert refusal(FIX._replace(**told), Gnss()).rule == "range"

    receiver = Receiver(by_name("nmea"), Gnss(), 0)
    receiver.decoder = Says(**told)
    assert not any(receiver.feed(b"", second * 10**9) for second in range(1, 9))
    assert any("beyond what can be" in fault for fault in receiver.faults(9 * 10**9))


def test_the_first_fix_of_a_connection_says_so():
    """It may be of another receiver than those before."""
    receiver, decoder = Receiver(by_name("nmea"), Gnss(min_satellites=5), 0), Says(satellites=3)
    receiver.decoder, flags = decoder, []
    for second in range(1, 20):
        decoder.told["satellites"] = 3 if second in (1, 2, 12) else 8
        flags += [int(row["flags"][0]) for row in receiver.feed(b"", second * 10**9)]
    assert receiver.refused["gnss.min_satellites"] == 3 and len(flags) > 3
    assert flags == [NEW_RECEIVER] + [0] * (len(flags) - 1)


def test_the_record_is_in_si_units():
    row = record(FIX, 5, 7)[0]
    assert (row["t_ns"], row["arrival_ns"], row["quality"], row["satellites"]) == (5, 7, 1, 8)
    assert row["lat"] == math.radians(48 + 7.038 / 60)
    assert row["height"] == pytest.approx(545.4 + 46.9)
    assert row["speed"] == pytest.approx(18520 / 3600)
    assert row["course"] == math.radians(90.0)
    assert all(math.isnan(v) for v in row["v"])
    assert record(FIX._replace(satellites=None), 0, 0)["satellites"][0] == -1
    assert np.isnan(record(FIX._replace(sigma_n_m=0.0, sigma_e_m=0.0), 0, 0)["sigma"]).all()  # as GST of some


def test_a_position_that_may_be_anywhere_is_none():
    """A u-blox states 4295 km where it has none; of such variances the filter's covariance kept no digit."""
    assert refusal(FIX._replace(sigma_n_m=4294967.295, sigma_e_m=4294967.295), Gnss()).rule == "unknown accuracy"
    assert refusal(FIX._replace(sigma_n_m=5e3, sigma_e_m=5e3, sigma_d_m=4294967.295), Gnss()) is None
    row = record(FIX._replace(sigma_n_m=5.0, sigma_e_m=5.0, sigma_d_m=4294967.295), 0, 0)
    assert np.isnan(row["height"]) and np.isnan(row["sigma"][0, 2]) and row["sigma"][0, 0] == 5.0
    rows = np.concatenate([row, row])
    rows["sigma"][1, 0] = 2e4
    assert [why and why.rule for why in refusals(rows, Gnss())] == [None, "unknown accuracy"]


def test_an_accuracy_that_no_receiver_has_is_not_known():
    """A stated sigma of a nanometre made the position wrong and sure, and then lost."""
    row = record(FIX._replace(sigma_n_m=1e-9, sigma_e_m=2e-4, sigma_d_m=2e-3, hdop=1e-4), 0, 0)[0]
    assert np.isnan(row["sigma"][:2]).all() and row["sigma"][2] == 2e-3
    assert np.isnan(row["hdop"])
    assert record(FIX._replace(hdop=0.4), 0, 0)["hdop"] == 0.4


@pytest.mark.parametrize(
    ("lat", "lon", "sigma_m"),  # a minute of latitude is 1853.25 m; evenly distributed over a step: step / sqrt(12)
    [
        ("4807.0,N", "01131.0,E", 53.5),
        ("4807,N", "01131,E", 535.0),
        ("4807.0381,N", "01131.0,E", 53.5),
        ("4807.03,N", "01131.00,E", 5.35),
        ("4807.038,N", "01131.000,E", None),
        ("4807.0381234,N", "01131.0001234,E", None),
    ],
)
def test_a_position_of_few_digits_is_no_better_than_its_rounding(lat, lon, sigma_m):
    (fix,), _ = decode(gga(lat=lat, lon=lon))
    row = record(fix, 0, 0)[0]
    expected = [math.nan if sigma_m is None else sigma_m] * 2
    assert row["sigma"][:2].tolist() == pytest.approx(expected, rel=2e-3, nan_ok=True)
    assert math.isnan(row["sigma"][2])
    worse = record(fix._replace(sigma_n_m=30.0, sigma_e_m=40.0), 0, 0)[0]
    assert worse["sigma"][:2] == pytest.approx(
        [math.hypot(stated, sigma_m or 0.0) for stated in (30.0, 40.0)], rel=2e-3
    )


def test_without_an_inertial_sensor_the_receivers_fix_is_published():
    kinds = ("TPV", "ATT", "IMU", "EST")
    row = solution(record(FIX._replace(hdop=0.8), 5, 7))
    view = View(solution=row.tobytes(), utc_s=1.7e9, gnss=ReceiverReport(quality=4, geoid_sep=46.9))
    (tpv,) = map(json.loads, Report(view).lines(kinds).splitlines())
    assert (tpv["mode"], tpv["status"], tpv["track"]) == (3, 3, pytest.approx(90.0))
    assert (tpv["lat"], tpv["altHAE"]) == pytest.approx((48 + 7.038 / 60, 545.4 + 46.9))
    assert tpv["eph"] == pytest.approx(2.448 * 2.0 * 0.8, rel=0.02)  # chi-square of two: 95 %
    assert tpv["speed"] == pytest.approx(18520 / 3600)
    assert "climb" not in tpv
    held = solution(record(FIX._replace(dimensions=2, speed_mps=None), 5, 7))
    (tpv,) = map(json.loads, Report(view._replace(solution=held.tobytes(), gnss=None)).lines(kinds).splitlines())
    assert tpv["mode"] == 2
    assert not tpv.keys() & {"status", "altHAE", "speed", "track", "velN"}


def test_a_height_that_the_receiver_holds_is_unknown():
    """Garmin 25 LP with three satellites: the height stays where it was (gpsd's garmin25lp.log)."""
    flat = decode(line("GPGSA,A,2,01,03,,14,,,,,,,,,3.1,3.1,") + gga(rest="1,03,3.1,746.1,M,44.2,M,,"))[0][0]
    assert (flat.dimensions, flat.height_m) == (2, pytest.approx(790.3))
    assert math.isnan(record(flat, 0, 0)["height"][0])
    assert record(flat._replace(dimensions=3), 0, 0)["height"][0] == pytest.approx(790.3)
    assert record(flat._replace(dimensions=None), 0, 0)["height"][0] == pytest.approx(790.3)


def test_settings_name_the_qualities_that_there_are():
    assert load(None, ["gnss.qualities=[4, 5]"]).gnss.qualities == (4, 5)
    with pytest.raises(ConfigError, match=r"gnss\.qualities"):
        load(None, ["gnss.qualities=[0]"])


def test_a_log_gets_the_date_of_the_samples_also_over_midnight(tmp_path):
    log = tmp_path / "track.nmea"
    log.write_bytes(b"".join(gga(time) for time in ("235958.000", "235959.000", "000000.000", "000001.000")))
    origin = 1_700_000_000 // 86_400 * 86_400
    rows = fixes_of_log(log, origin, 86_397 * 10**9, Gnss())
    assert [round(t * 1e-9) for t in rows["t_ns"]] == [86_398, 86_399, 86_400, 86_401]
    assert set(rows["arrival_ns"] - rows["t_ns"]) == {150_000_000}


def test_a_log_without_a_usable_fix_reports_why(tmp_path):
    log = tmp_path / "track.nmea"
    log.write_bytes(gga(rest="1,04,0.9,545.4,M,46.9,M,,"))
    with pytest.raises(BadDataError, match=r"4 satellites, fewer than gnss\.min_satellites = 5 \(1 times\)"):
        fixes_of_log(log, 0, 0, Gnss())
    assert len(fixes_of_log(log, 0, 0, Gnss(min_satellites=4))) == 1
    notes = []
    log.write_bytes(gga() + gga("120001.000", rest="6,08,0.9,545.4,M,46.9,M,,"))
    assert len(fixes_of_log(log, 0, 0, Gnss(), notes.append)) == 1
    assert notes[0].startswith("1 of 2 fixes are not used: quality 6 (dead reckoning by the receiver)")
    log.write_bytes(gga().split(b"*")[0] + b"\r\n")
    with pytest.raises(BadDataError, match=r"no fix in it; 1 x no checksum: .* gnss\.require_checksum=false"):
        fixes_of_log(log, 0, 0, Gnss())
    assert len(fixes_of_log(log, 0, 0, Gnss(require_checksum=False))) == 1
    log.write_bytes(gga()[:-2])
    assert len(fixes_of_log(log, 0, 0, Gnss())) == 1
    log.write_bytes(gga() + gga("120001.000")[:30])
    assert len(fixes_of_log(log, 0, 0, Gnss(require_checksum=False))) == 1


_LOG = b"".join(gga(f"1200{second:02}.000") for second in range(4))


@pytest.mark.parametrize(
    "data",
    [
        _LOG[40:],  # begins within a sentence
        b"\xef\xbb\xbf" + _LOG,
        b"\xb5\x62\x01\x07\x00\x00" + _LOG,
        b"# a logger, its version\n" + _LOG,
        b"".join(b"2026-03-01 12:00:00 " + line for line in _LOG.splitlines(keepends=True)),
        gzip.compress(_LOG),
        gzip.compress(_LOG * 50)[:-20],  # cut off
        _LOG.decode().encode("utf-16"),
    ],
)
def test_a_log_of_any_make_is_known_and_read(data, tmp_path):
    log = tmp_path / "drive.log"
    log.write_bytes(data)
    assert is_nmea(log)
    assert len(fixes_of_log(log, 0, 0, Gnss())) >= 3


def test_a_table_is_no_log(tmp_path):
    table = tmp_path / "gnss.csv"
    table.write_text("t_s,lat_deg,lon_deg,height_m\n0,1,2,3\n")
    assert not is_nmea(table)


class FileLine:
    def __init__(self, fd):
        self._fd = fd

    def receive(self, room, now_ns):
        return os.readv(self._fd, [room]), now_ns


def test_rejection_of_fixes_is_reported_once_per_change_with_its_setting():
    driver = by_name("nmea")
    reader, writer = os.pipe2(os.O_NONBLOCK)
    line = FileLine(reader)
    receiver = Receiver(driver, Gnss(), 0)
    notes = []
    satellites = [3, 4, 3, 3, 4, 6, 4, 6, 6, 6, 6, 4, 6, 6]  # one of another kind now and then is no change
    for second, count in enumerate(satellites):
        os.write(writer, gga(f"1200{second:02}.000", rest=f"1,{count},2.9,545.4,M,46.9,M,,"))
        receiver.read(line, second * 1_000_000_000)
        receiver.flush(second * 1_000_000_000 + 500_000_000)
        if receiver.message:
            notes.append((second, receiver.message))
            receiver.message = ""
    os.close(reader)
    os.close(writer)
    assert notes == [
        (2, "the fixes are refused: 3 satellites, fewer than gnss.min_satellites = 5"),
        (9, "the fixes are used again"),
    ]
    counters = receiver.counters()
    assert counters["fixes_used"] == sum(count >= 5 for count in satellites)
    assert counters["refused"] == f"{sum(count < 5 for count in satellites)} gnss.min_satellites"
    assert "14 fixes" in counters["sentences"]


def test_noise_keeps_no_receiver_alive():
    receiver = Receiver(by_name("nmea"), Gnss(), 0)
    receiver.feed(gga("120000.000"), 1)
    receiver.feed(b"\xff\x80$GPGGA,\xfe*00\r\n" * 40, 2)
    assert receiver.last_data_ns == 1
    receiver.feed(b"$GPTXT,01*62\r\n", 3)  # whole, and of no use
    assert receiver.last_data_ns == 3


class FixedPulse:
    def __init__(self, pulse_ns):
        self.pulse_ns = pulse_ns

    def newest_ns(self):
        return self.pulse_ns


def test_a_tap_is_handed_all_that_the_fixes_depend_on():
    driver = by_name("nmea")
    heard, live, again = [], [], []
    receiver = Receiver(driver, Gnss(), 0, FixedPulse(None))
    receiver.byte_sink = lambda data, t_ns, pulse_ns=None: heard.append((bytes(data), t_ns, pulse_ns))
    for second in range(8):
        now_ns = second * 1_000_000_000 + 130_000_000
        receiver._pulse.pulse_ns = None if second % 3 == 0 else now_ns - 90_000_000
        live += receiver.feed(gga(f"1200{second:02}.000", rest="1,8,0.9,545.4,M,46.9,M,,"), now_ns)
        for later_ms in range(20, 400, 20):
            live += receiver.flush(now_ns + later_ms * 1_000_000)
    second = Receiver(driver, Gnss(), 0, pulse := FixedPulse(None))
    for data, t_ns, pulse.pulse_ns in heard:
        again += second.feed(data, t_ns) if data else second.flush(t_ns)
    assert len(live) == 7 and receiver.refused == {"unknown age": 1}, "all but the first, whose age is not known"
    assert len(heard) < 20
    assert np.concatenate(again).tobytes() == np.concatenate(live).tobytes()


def test_fixes_of_a_table_obey_the_same_settings(tmp_path):
    table = tmp_path / "gnss.csv"
    rows = ["1,48,11,500,0.9,8", "2,48,11,500,0.9,4", "3,48,11,500,25,8", "4,48,11,500,,"]
    table.write_text("\n".join(["t_s,lat_deg,lon_deg,height_m,hdop,satellites", *rows]) + "\n")
    fixes, notes = read_fixes(table, 0), []
    assert without_refused(table, fixes, Gnss(), notes.append)["t_ns"].tolist() == [1e9, 4e9]
    assert notes == [
        "2 of 4 fixes are not used: 4 satellites, fewer than gnss.min_satellites = 5 (1 times), "
        "HDOP 25, above gnss.max_hdop = 20 (1 times)"
    ]
    assert len(without_refused(table, fixes, Gnss(min_satellites=4, max_hdop=30.0), notes.append)) == 4
    with pytest.raises(BadDataError, match=r"none of its fixes is used: quality 1, .* gnss\.qualities = \[4\]"):
        without_refused(table, fixes[:3], Gnss(qualities=(4,)), notes.append)


def test_a_receivers_sigma_of_the_velocity_counts_where_it_is_larger_than_the_learned_one():
    known = FIX._replace(velocity_mps=(1.0, 2.0, None), velocity_sigma_mps=(0.1, 0.2, 0.3))
    row = record(known, 0, 0)[0]
    assert (list(row["v"][:2]), list(row["sigma_v"])) == ([1.0, 2.0], [0.1, 0.2, 0.3])
    assert all(math.isnan(value) for value in record(FIX, 0, 0)["sigma_v"][0])
    t, seconds = np.arange(0.0, 12.0, 0.01), np.arange(1.0, 11.0)
    imu = {"t": t, "gyro": np.zeros((len(t), 3)), "accel": np.tile([0.0, 0.0, -9.8], (len(t), 1))}
    fixes = {"t_s": seconds} | {name: np.zeros(10) for name in ("lat_deg", "lon_deg", "height_m", "vn_mps", "ve_mps")}

    def sigmas(**reported):
        found = navigate(imu, fixes | {name: np.full(10, value) for name, value in reported.items()}).innovations
        return found.sigma[np.isin(found.kind, ["vn_mps", "ve_mps"])]

    learned = sigmas()
    assert len(learned) >= 10 and learned.max() < 1.0
    assert sigmas(svn_mps=2.0, sve_mps=2.0).min() >= 2.0
    assert np.array_equal(sigmas(svn_mps=0.01, sve_mps=math.nan), learned)
