"""What gpsd's messages say of a solution: golden lines, units, bounds, and what is left out when it is not known."""

import json
import math
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from gpsd_synthetic import IMU, RECEIVER, solution
from hypothesis import given
from hypothesis import strategies as st

from imud.drivers.fix import Fix, Satellite, Sky
from imud.estimators.records import (
    ATTITUDE_VALID,
    COASTING,
    FIX,
    HEADING_VALID,
    HEIGHT_VALID,
    POSITION_VALID,
    SOLUTION,
)
from imud.outputs.gpsd_json import CLASSES, DEFAULT_CLASSES, Report, status_text
from imud.outputs.gpsd_objects import line, quoted
from imud.outputs.view import NO_SOLUTION, Device, View
from imud.sensors.readings import ReceiverReport

FULL = ATTITUDE_VALID | HEADING_VALID | POSITION_VALID | HEIGHT_VALID


def golden_fix() -> bytes:
    row = np.zeros(1, FIX)
    row["height"] = row["v"] = row["sigma_v"] = math.nan
    row["t_ns"], row["arrival_ns"] = 9007199004740993, 9007199104740993
    row["lat"], row["lon"], row["course"] = map(math.radians, (48.5, -11.25, 90.0))
    row["sigma"], row["hdop"], row["speed"] = (1.5, 2.5, math.nan), 0.9, 5.0
    row["quality"], row["satellites"] = 2, 9
    return row.tobytes()


REPORTED = Fix(0, 43220.0, None, 48.5, -11.25, None, None, 2, 9, 0.9, 5.0, 90.0)
GNSS = ReceiverReport(
    satellites=9, hdop=0.9, quality=1, alt_msl=454.0, geoid_sep=46.125, age_s=0.1, fix=golden_fix(), reported=REPORTED
)


def golden_solution(status: int = FULL) -> np.ndarray:
    """Numbers that a reader can convert in his head."""
    row = np.zeros(1, SOLUTION)
    row["status"] = status
    row["lat"], row["lon"], row["height"] = math.radians(48.5), math.radians(-11.25), 500.125
    row["v"] = (3.0, -4.0, 0.5)
    row["q_nb"] = (math.sqrt(0.5), 0.0, 0.0, -math.sqrt(0.5))  # heading west
    row["w"] = np.radians((1.0, -2.0, 3.0))
    row["f"] = (3.0, 4.0, -12.0)
    row["bg"], row["ba"] = np.radians((0.1, 0.2, 0.3)), (0.01, 0.02, 0.03)
    row["sigma_p"], row["sigma_v"] = (1.0, 1.0, 2.0), (0.1, 0.1, 0.2)
    row["sigma_rpy"] = np.radians((0.5, 0.25, 1.5))
    row["sigma_bg"], row["sigma_ba"] = np.radians((0.01, 0.02, 0.03)), (0.001, 0.002, 0.003)
    return row


def golden_view(**changes) -> View:
    full = View(
        solution=golden_solution().tobytes(), utc_s=1774267220.25, utc_error_s=0.005, t_mono_ns=9007199254740993,
        seq=42, estimator="navigation", devices=(IMU, RECEIVER), gnss=GNSS, temperature=31.5,
        sensed=(math.pi / 2.0, -math.pi, 0.0, 2.0, 3.0, -6.0),
        states=lambda: {"cov_pn_pn": math.nan, "odometer_scale": 0.03125, "sodometer_scale": 0.001},
    )  # fmt: skip
    return full._replace(**changes)


def fields(kind: str, view: View) -> dict:
    return json.loads(Report(view).object(kind))


GOLDEN = {
    "TPV": '{"class":"TPV","device":"/dev/ttyUSB0","status":6,"mode":3,"time":"2026-03-23T12:00:20.250000Z",'
    '"ept":0.005,"lat":48.5,"lon":-11.25,"altHAE":500.125,"altMSL":454,"alt":454,"geoidSep":46.125,'
    '"epx":1.96,"epy":1.96,"epv":3.92,"eph":2.437,"sep":4.22,'
    '"track":306.8699,"speed":5,"climb":-0.5,"epd":2.246,"eps":0.196,"epc":0.392,"velN":3,"velE":-4,"velD":0.5}\r\n',
    "SKY": '{"class":"SKY","device":"/dev/ttyUSB0","time":"2026-03-23T12:00:20.250000Z",'
    '"hdop":0.9,"nSat":9,"uSat":9}\r\n',
    "ATT": '{"class":"ATT","device":"/dev/ttyUSB0","time":"2026-03-23T12:00:20.250000Z",'
    '"heading":270,"yaw":-90,"pitch":0,"roll":0,"rot":180,"acc_len":13,"acc_x":3,"acc_y":4,"acc_z":-12,'
    '"gyro_x":1,"gyro_y":-2,"gyro_z":3,"temp":31.5}\r\n',
    "IMU": '{"class":"IMU","device":"/dev/ttyUSB0","time":"2026-03-23T12:00:20.250000Z","msg":"imud",'
    '"gyro_x":90,"gyro_y":-180,"gyro_z":0,"acc_x":2,"acc_y":3,"acc_z":-6,"acc_len":7,"temp":31.5}\r\n',
    "EST": '{"class":"EST","device":"/dev/ttyUSB0","time":"2026-03-23T12:00:20.250000Z","t_mono_ns":9007199254740993,'
    '"seq":42,"estimator":"navigation","status":135,"state":"attitude,heading,position,height",'
    '"lat_deg":48.5,"lon_deg":-11.25,"height_m":500.125,"vn_mps":3,"ve_mps":-4,"vd_mps":0.5,'
    '"roll_deg":0,"pitch_deg":0,"yaw_deg":-90,"sn_m":1,"se_m":1,"sd_m":2,"svn_mps":0.1,"sve_mps":0.1,"svd_mps":0.2,'
    '"sroll_deg":0.5,"spitch_deg":0.25,"syaw_deg":1.5,"q0":0.707106781,"q1":0,"q2":0,"q3":-0.707106781,'
    '"bgx_dps":0.1,"bgy_dps":0.2,"bgz_dps":0.3,"bax_mps2":0.01,"bay_mps2":0.02,"baz_mps2":0.03,'
    '"sbgx_dps":0.01,"sbgy_dps":0.02,"sbgz_dps":0.03,"sbax_mps2":0.001,"sbay_mps2":0.002,"sbaz_mps2":0.003,'
    '"gnss_age_s":0.1,"gnss_quality":1}\r\n',
    "FIX": '{"class":"FIX","device":"/dev/ttyUSB0","time":"2026-03-23T12:00:20.000000Z","t_mono_ns":9007199004740993,'
    '"arrival_mono_ns":9007199104740993,"quality":2,"uSat":9,"lat_deg":48.5,"lon_deg":-11.25,"sn_m":1.5,'
    '"se_m":2.5,"hdop":0.9,"speed_mps":5,"course_deg":90}\r\n',
    "STATES": '{"class":"STATES","device":"/dev/ttyUSB0","time":"2026-03-23T12:00:20.250000Z",'
    '"t_mono_ns":9007199254740993,"odometer_scale":0.03125,"sodometer_scale":0.001}\r\n',
}


def test_a_climb_of_nothing_has_no_sign():
    row = golden_solution()
    row["v"] = (3.0, -4.0, 0.0)
    assert '"climb":0,' in Report(golden_view(solution=row.tobytes())).object("TPV")


@pytest.mark.parametrize("kind", CLASSES)
def test_each_class_is_written_as_its_golden_line(kind):
    assert Report(golden_view()).lines((kind,)).decode() == GOLDEN[kind]


def test_nobody_pays_for_states_who_does_not_ask_for_them():
    def unasked():
        raise AssertionError

    report = Report(golden_view(states=unasked))
    assert "STATES" not in DEFAULT_CLASSES and b"odometer_scale" not in report.lines(DEFAULT_CLASSES)


def test_several_classes_go_out_in_one_piece():
    report = Report(golden_view())
    assert report.lines(("TPV", "ATT")).decode() == GOLDEN["TPV"] + GOLDEN["ATT"]


def test_without_a_receiver_there_is_no_fix_no_heading_and_a_relative_yaw_in_est_alone():
    view = golden_view(solution=golden_solution(ATTITUDE_VALID).tobytes(), gnss=None)
    tpv = {"class": "TPV", "device": "/dev/ttyUSB0", "mode": 1, "time": "2026-03-23T12:00:20.250000Z", "ept": 0.005}
    assert fields("TPV", view) == tpv
    att = fields("ATT", view)
    assert not {"heading", "yaw"} & att.keys()  # gpsd's clients take a yaw for one from north
    assert (att["pitch"], att["roll"]) == (0, 0)
    est = fields("EST", view)
    assert est["yaw_deg"] == -90
    assert not {"lat_deg", "vn_mps", "sn_m", "svn_mps", "gnss_age_s"} & est.keys()
    assert est["syaw_deg"] == 1.5


def test_where_the_estimator_takes_no_fixes_the_position_is_the_receivers_of_its_own_time():
    fix = golden_solution(POSITION_VALID)
    fix["lat"] = math.radians(47.5)
    receiver = View(solution=fix.tobytes(), utc_s=1774267219.0, devices=(RECEIVER,), gnss=GNSS)
    view = golden_view(solution=golden_solution(ATTITUDE_VALID).tobytes(), estimator="attitude", receiver=receiver)
    tpv = fields("TPV", view)
    assert (tpv["device"], tpv["mode"], tpv["lat"], tpv["time"]) == (
        RECEIVER.path,
        2,
        47.5,
        "2026-03-23T12:00:19.000000Z",
    )
    est = fields("EST", view)
    assert est["device"] == IMU.path and "lat_deg" not in est and est["time"] == "2026-03-23T12:00:20.250000Z"
    none = view._replace(receiver=View(devices=(RECEIVER,)))
    assert fields("TPV", none) == {"class": "TPV", "device": RECEIVER.path, "mode": 0}
    lost = view._replace(receiver=receiver._replace(solution=View().solution))
    assert fields("TPV", lost)["mode"] == 1 and "lat" not in fields("TPV", lost)


def test_no_angles_before_alignment():
    att = fields("ATT", golden_view(solution=golden_solution(0).tobytes()))
    assert not {"roll", "pitch", "yaw", "heading", "rot"} & att.keys()
    assert att["gyro_z"] == 3


def test_without_a_solution_there_is_only_a_fixless_position_report():
    report = Report(View(devices=(IMU,)))
    assert report.lines(CLASSES) == b'{"class":"TPV","device":"/dev/ttyUSB0","mode":0}\r\n'
    assert json.loads(report.poll(watched=True)) == {
        "class": "POLL",
        "active": 1,
        "tpv": [{"class": "TPV", "device": "/dev/ttyUSB0", "mode": 0}],
        "gst": [],
        "sky": [{"class": "SKY", "device": "/dev/ttyUSB0"}],
    }


def test_without_devices_there_is_no_device():
    assert Report(View()).lines(("TPV",)) == b'{"class":"TPV","mode":0}\r\n'


def test_poll_before_watch_is_empty():
    assert json.loads(Report(golden_view()).poll(watched=False)) == {
        "class": "POLL", "time": "2026-03-23T12:00:20.250000Z", "active": 0, "tpv": [], "gst": [], "sky": [],
    }  # fmt: skip


def test_unknown_time_is_left_out_everywhere():
    view = golden_view(utc_s=None)
    for kind in CLASSES:
        assert not {"time", "ept"} & fields(kind, view).keys()
    assert "time" not in json.loads(Report(view).poll(watched=True))


def test_a_height_that_is_not_valid_is_not_published():
    row = golden_solution(FULL & ~HEIGHT_VALID)
    tpv = fields("TPV", golden_view(solution=row.tobytes()))
    assert tpv["mode"] == 2
    assert not {"altHAE", "altMSL", "alt"} & tpv.keys()


@pytest.mark.parametrize(
    ("status", "emulated", "expected"),
    [
        (FULL, False, (6, 3)),  # GNSS and dead reckoning
        (FULL | COASTING, False, (5, 3)),  # dead reckoning
        (FULL, True, (8, 3)),  # simulated
        (FULL | COASTING, True, (8, 3)),
        (FULL & ~HEIGHT_VALID, False, (6, 2)),
        (ATTITUDE_VALID, True, (None, 1)),
    ],
)
def test_status_and_mode(status, emulated, expected):
    row = golden_solution(status)
    tpv = fields("TPV", golden_view(solution=row.tobytes(), emulated=emulated))
    assert (tpv.get("status"), tpv["mode"]) == expected


@pytest.mark.parametrize(
    ("gnss", "hae", "msl"),
    [
        (ReceiverReport(geoid_sep=46.0, alt_msl=1.0), 500.125, 454.125),
        (ReceiverReport(alt_msl=500.0), None, 500.125),  # fixes, and so the filter, then have heights above the sea
        (ReceiverReport(), 500.125, None),
        (None, 500.125, None),
    ],
)
def test_altitudes_above_the_ellipsoid_and_above_the_sea(gnss, hae, msl):
    tpv = fields("TPV", golden_view(gnss=gnss))
    assert (tpv.get("altHAE"), tpv.get("altMSL"), tpv.get("alt")) == (hae, msl, msl)


@pytest.mark.parametrize(
    ("gnss", "expected"),
    [
        (ReceiverReport(satellites=9, hdop=0.9), {"hdop": 0.9, "nSat": 9, "uSat": 9}),
        (ReceiverReport(satellites=-1, hdop=1.5), {"hdop": 1.5}),
        (ReceiverReport(satellites=9, hdop=0.9, age_s=11.0), {}),
    ],
)
def test_satellites_and_hdop_are_those_of_a_fresh_fix(gnss, expected):
    sky = fields("SKY", golden_view(gnss=gnss, utc_s=None, devices=()))
    assert sky == {"class": "SKY"} | expected


def test_satellites_in_view_by_gpsd_s_numbers():
    """PRN as in gpsd.h: SBAS as broadcast, Galileo 301 and up, BeiDou 401, QZSS 193, GLONASS 65."""
    rows = [(0, 7, 7, 7), (1, 33, 120, 120), (2, 12, 312, 12), (2, 312, 312, 12), (3, 9, 409, 9), (5, 2, 194, 2),
            (5, 194, 194, 2), (6, 70, 70, 6)]  # fmt: skip
    sky = Sky(
        tuple(Satellite(system, name, 30, None, 41, used=False) for system, name, *_ in rows), pdop=2.5, vdop=1.75
    )
    sky_report = fields("SKY", golden_view(gnss=GNSS._replace(sky=sky)))
    assert [(s["gnssid"], s["PRN"], s["svid"]) for s in sky_report["satellites"]] == [(r[0], *r[2:]) for r in rows]
    assert sky_report["satellites"][0] == {"PRN": 7, "gnssid": 0, "svid": 7, "el": 30, "ss": 41, "used": False}
    assert (sky_report["nSat"], sky_report["uSat"], sky_report["pdop"], sky_report["vdop"]) == (8, 9, 2.5, 1.75)


def test_too_many_satellites_are_those_in_use_first_and_one_line():
    sky = Sky(tuple(Satellite(3, k, 89, 359, 99, used=k > 400) for k in range(1, 501)))
    view = golden_view(gnss=GNSS._replace(sky=sky))
    sky_report = fields("SKY", view)
    assert (
        sky_report["nSat"] == 500
        and sum(s["used"] for s in sky_report["satellites"]) == len(sky_report["satellites"]) == 100
    )
    assert len(Report(view).lines(("SKY",))) < 10240


def test_a_track_is_given_only_while_the_vehicle_moves():
    row = golden_solution()
    row["v"] = (0.05, 0.05, 0.0)  # 1 sigma of 0.1 m/s
    tpv = fields("TPV", golden_view(solution=row.tobytes()))
    assert not {"track", "epd"} & tpv.keys()
    assert tpv["speed"] == pytest.approx(math.hypot(0.05, 0.05), rel=1e-6)
    row["v"] = 0.0
    assert fields("TPV", golden_view(solution=row.tobytes()))["eps"] == pytest.approx(0.196, rel=1e-3)


@pytest.mark.parametrize(
    ("status", "words"),
    [(0, "aligning"), (7, "attitude,heading,position"), (1 | 8, "attitude,at-rest"), (7 | 16 | 32, None), (64, None)],
)
def test_status_bits_are_written_as_words(status, words):
    known = {7 | 16 | 32: "attitude,heading,position,coasting,rejecting", 64: "aligning,saturated"}
    assert status_text(status) == (words or known[status])


# --- what every client depends on, whatever the numbers are


def strict(text: str | bytes) -> dict:
    """The object of a line, read as strictly as RFC 8259 allows."""

    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    def unique(pairs):
        assert len(pairs) == len(dict(pairs)), "a key occurs twice"
        return dict(pairs)

    return json.loads(text, parse_constant=refuse, object_pairs_hook=unique)


any_double = st.floats(width=64) | st.sampled_from([0.0, -0.0, math.nan, math.inf, -math.inf, 1e308, 5e-324, 1e-300])


@pytest.mark.thorough
@given(
    st.integers(0, 127), st.lists(any_double, min_size=37, max_size=37), st.none() | any_double,
    st.none() | st.builds(ReceiverReport, st.none() | st.integers(-1, 99), *[any_double, st.none()], *[any_double] * 3,
                        fix=st.just(b"") | st.binary(min_size=FIX.itemsize, max_size=FIX.itemsize),
                        reported=st.none() | st.just(REPORTED)),
    any_double, any_double, st.booleans(), st.text(max_size=300),
)  # fmt: skip
def test_any_numbers_give_lines_that_all_clients_read(status, numbers, utc_s, gnss, error, temperature, emulated, path):
    data = struct.pack("<2q37d", 0, status, *numbers)
    view = View(data, utc_s, error, 2**62, 2**40, "navigation", (Device(path, "x"),), gnss, temperature, emulated)
    report = Report(view)
    for kind in CLASSES:
        text = line(report.object(kind))
        assert text.startswith(b'{"class":"%s"' % kind.encode())
        assert text.endswith(b"}\r\n") and text.count(b"\n") == 1
        assert len(text) < 10240 and text.isascii()
        for key, value in strict(text).items():
            assert len(key) <= 31
            rows = value if key == "satellites" else [{key: value}]  # the one list that libgps expects
            for flag in (row.pop("used") for row in rows if key == "satellites"):
                assert isinstance(flag, bool)
            for scalar in (scalar for row in rows for scalar in row.values()):
                assert isinstance(scalar, (int, float, str)) and not isinstance(scalar, bool)
    strict(report.poll(watched=True))
    assert len(strict(report.object("TPV"))["device"]) <= 127


@given(st.text(max_size=400))
def test_texts_are_quoted_and_limited(text):
    assert len(strict(quoted(text))) <= 127


def test_est_has_the_columns_of_replay():
    """Those that docs/interfaces.md lists for est.csv, up to the quaternion."""
    text = (Path(__file__).parents[1] / "docs/interfaces.md").read_text().partition("## `est.csv`")[2]
    columns = ",".join(re.findall(r"^\| `([\w,]+)` \|", text, flags=re.M)[1:6]).split(",")
    assert len(columns) == 22
    assert set(columns) <= fields("EST", golden_view()).keys()


def test_the_synthetic_solution_is_a_solution():
    assert solution(0.0).dtype == SOLUTION and solution(0.0).tobytes() != NO_SOLUTION
