"""`imud status`: what a running daemon tells of itself, on the screen, as JSON and to Prometheus."""

import argparse
import contextlib
import json
import math
import re
import socket
import subprocess
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from processes import TIMEOUT_S, daemon, emulator

from imud.commands import status
from imud.commands.status import screen
from imud.commands.status.metrics import METRICS, prometheus
from imud.daemon.sigma_shares import SigmaShares
from imud.daemon.status_tables import InnovationStatistics, add_estimates, flat, status_object
from imud.errors import DeviceAbsentError, ImudError
from imud.estimators.innovation_kinds import KINDS
from imud.estimators.ins.aiding.barometer import SOURCE
from imud.estimators.records import ASSUMED, BAROMETER_SOURCE, INNOVATION
from imud.filter_state_names import STATES
from imud.outputs.addresses import parse_address
from imud.outputs.gpsd_objects import line
from imud.sensors.rate import SECOND_NS, RateMeter, SampleRateMonitor


def ask(*arguments: str) -> str:
    command = [sys.executable, "-m", "imud", "status", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def families(text: str) -> dict:
    """Prometheus' own parser's view: samples by family and labels."""
    parser = pytest.importorskip("prometheus_client.parser")
    return {family.name: family for family in parser.text_string_to_metric_families(text)}


def value(found: dict, name: str, **labels: str) -> float:
    [sample] = [s for s in found[name].samples if s.labels == labels]
    return sample.value


def comes_as_agreed(told: dict) -> bool:
    """Whether sensor and receiver, the first two ports, come at their rates."""
    imu_hz, gnss_hz = (port.get("rate_hz", 0.0) for port in told["ports"][:2])
    return 900.0 < imu_hz < 1100.0 and 0.5 < gnss_hz < 1.5


def tells_all(told: dict) -> bool:
    """Whether fixes are fused, and the sensor's clock is known."""
    return "north" in told.get("innovations", {}) and "drift_ppm" in told["ports"][0].get("clock", {})


def test_a_running_daemon_gives_the_same_status_in_three_forms(tmp_path):
    imu, gnss = str(tmp_path / "imu"), str(tmp_path / "gnss")
    absent = str(tmp_path / "absent")
    with (
        emulator("g350", "nmea", "--scenario", "car", links=[tmp_path / "imu", tmp_path / "gnss"]),
        daemon(tmp_path, "--port", imu, "--port", gnss, "--port", absent, "--estimator", "navigation") as imud,
    ):
        imud.until(lambda m: m["class"] == "EST" and {"attitude", "position"} <= set(m["state"].split(",")))
        address = str(tmp_path / "gpsd.sock")
        asked = 0
        while not tells_all(first := json.loads(ask("--json", address))):
            asked += 1
            assert asked < TIMEOUT_S, first
            list(imud.messages(1.0))
        list(imud.messages(0.5))  # an answer may be 0.1 s old
        found = families(ask("--prometheus", address))
        list(imud.messages(0.5))
        screen = ask(address)
        list(imud.messages(0.5))
        while not comes_as_agreed(last := json.loads(ask("--json", address))):
            asked += 1
            assert asked < TIMEOUT_S, last
            list(imud.messages(1.0))
        kinds = {message["class"] for message in imud.messages(1.5)}
        imud.process.terminate()
        imud.process.wait()
        ended = re.search(r"ended +samples=(\d+)", imud.log)

    assert "STATUS" not in kinds  # only who asks is told
    ports = {port["path"]: port for port in last["ports"]}
    assert list(ports) == [imu, gnss, absent]
    assert (ports[imu]["model"], ports[imu]["baud"], ports[imu]["rate_asked_hz"]) == ("M-G350", 460800, 1000.0)
    assert 0.0 <= ports[imu]["sample_age_s"] < 60.0 and 0.0 <= last["filter"]["age_s"] < 60.0
    assert ports[gnss]["quality"] == 1 and ports[gnss]["sentences"]["fixes"] >= ports[gnss]["used"] > 0
    assert ports[gnss]["lat_deg"] == pytest.approx(last["filter"]["lat_deg"], abs=1e-3)
    assert re.search(r"fix: lat 35\.6\d{5}°, lon 139\.7\d{5}°, quality 1, ", screen)
    assert not ports[absent]["streaming"] and "trying again" in ports[absent]["description"]
    assert first["ports"][0]["frames"] < ports[imu]["frames"] < int(ended[1])
    assert last["filter"]["flags"]["position"] and "position" in last["filter"]["state"]
    assert {"sroll_deg", "sn_m", "bgx_dps", "sbgx_dps", "baz_mps2"} <= last["filter"].keys()
    assert set(last["innovations"]) <= {kind.key for kind in KINDS.values()}
    assert last["innovations"]["north"]["used"] > 0
    assert last["outputs"]["gpsd"]["clients"] == 2 and last["outputs"]["gpsd"]["connections"] == 5 + asked
    assert first["uptime_s"] < last["uptime_s"] and first["cpu_s"] < last["cpu_s"]
    assert last["memory_peak_bytes"] >= last["memory_bytes"] > 2e7

    assert first["ports"][0]["frames"] < value(found, "imud_port_frames", port=imu) < ports[imu]["frames"]
    assert value(found, "imud_port_streaming", port=absent) == 0
    assert value(found, "imud_filter_state", state="position") == 1
    assert value(found, "imud_innovations", kind="north", outcome="used") > 0
    assert value(found, "imud_clients", output="gpsd") == 2
    assert value(found, "imud_gnss_bias_sigma_meters", part="d") > 0.0 and "imud_odometer_scale_ratio" not in found
    height_bias = value(found, "imud_gnss_bias_meters", part="d")
    assert height_bias == pytest.approx(last["states"]["gnss_bias_d_m"], abs=4.0 * last["states"]["sgnss_bias_d_m"])
    stated = math.sqrt(last["states"]["cov_pn_pn"])
    assert stated == pytest.approx(last["filter"]["sn_m"], rel=0.3)
    assert not [name for name in last["states"] if "odometer" in name or "baro" in name]
    model = next(s.labels for s in found["imud_port_info"].samples if s.labels["port"] == imu)
    assert (model["model"], model["serial"]) == ("M-G350", ports[imu]["serial"])
    assert all(family.documentation and family.type in ("gauge", "counter") for family in found.values())

    assert len(screen.splitlines()) <= 24
    assert all(len(line.replace(str(tmp_path), "")) <= 120 for line in screen.splitlines())
    for text in (
        "navigation: attitude",
        f"{imu}: M-G350, serial",
        "of 1000 Hz",
        absent,
        "trying again",
        "drift",
        "gyro bias",
    ):
        assert text in screen


def test_metric_names_are_as_prometheus_wants_them():
    for metric in METRICS:
        assert re.fullmatch(r"(imud|process)_[a-z_]+", metric.name)
        assert metric.name.endswith("_total") == (metric.kind == "counter"), metric.name
    assert len({metric.name for metric in METRICS}) == len(METRICS)


@pytest.mark.parametrize(
    ("heading", "syaw_deg", "yaw"),
    [
        (True, 1.25, "yaw -30.00 ±1.25°"),
        (False, 0.04, "yaw -30.00 ±0.04° from the start, not from north"),
        (False, math.degrees(math.pi / math.sqrt(3.0)), "yaw unknown"),
    ],
)
def test_the_screen_says_what_the_yaw_counts_from_and_how_old_the_estimate_is(heading, syaw_deg, yaw):
    table = {"estimator": "navigation", "state": "attitude,height", "flags": {"heading": heading}, "age_s": 0.1}
    table |= {"roll_deg": 1.0, "pitch_deg": 2.0, "yaw_deg": -30.0, "sroll_deg": 0.5, "spitch_deg": 0.25}
    rows = dict(screen._filter(table | {"syaw_deg": syaw_deg}))
    assert rows["filter"] == "navigation: attitude, height"
    assert rows["attitude"] == f"roll +1.00 ±0.50°, pitch +2.00 ±0.25°, {yaw}"
    rows = dict(screen._filter(table | {"age_s": 75.2}))
    assert rows["filter"] == "navigation: no sample for 1 min 15 s; before: attitude, height"


_TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\r", exclude_categories=["Cs"]), max_size=20)


@given(_TEXTS, _TEXTS, st.integers(0, 10**12))
def test_any_text_survives_as_a_label(path, model, frames):
    table = {"version": "1", "filter": {"estimator": "a"}}
    table["ports"] = {"0": {"path": path, "model": model, "frames": frames}}
    found = families(prometheus(flat(table)))
    assert found["imud_port_info"].samples[0].labels["model"] == model
    [sample] = found["imud_port_frames"].samples
    assert sample.labels["port"] == path and sample.value == pytest.approx(frames, rel=1e-11)


_NAMES = st.text("abc_", min_size=1, max_size=3)
_LEAVES = st.integers() | st.booleans() | st.text(max_size=3)


@given(st.recursive(_LEAVES, lambda t: st.dictionaries(_NAMES, t, min_size=1), max_leaves=8))
def test_flat_and_nested_are_inverse(tree):
    table = {"all": tree}
    assert status.nested(flat(table)) == {**table, "ports": []}


def test_unknown_values_are_left_out():
    assert flat({"a": math.nan, "b": None, "c": {"d": math.inf, "e": 0.0}}) == {"c.e": 0.0}


@given(st.text(st.characters(), max_size=5))
def test_a_status_with_any_text_is_sent(text):
    sent = json.loads(line(status_object({"ports": {"0": {"state": "…" + text}}})))
    assert sent == {"class": "STATUS", "ports.0.state": "…" + text}


@pytest.mark.parametrize("hz", [1.0, 125.0, 1000.0])
def test_the_rate_is_that_of_the_last_ten_seconds(hz):
    rate, count = RateMeter(), 0
    assert math.isnan(rate.hz)
    for k in range(40 * 50):
        count += 3.0 * hz / 50 if k < 20 * 50 else hz / 50
        rate.update(count, k * SECOND_NS // 50)
    assert rate.hz == pytest.approx(hz)


@pytest.mark.parametrize(
    ("shares", "found"),
    [((1.0,), 1.0), ((1.02, 0.97), 1.0), ((0.25,), 0.25), ((4.0,), 4.0), ((0.2, 1.8), None), ((0.5, 0.7), None)],
)
def test_another_rate_is_distinguished_from_an_uneven_one(shares, found):
    rate_monitor, ticks = SampleRateMonitor(1000.0), 0.0
    for k in range(4 * 20 + 1):
        rate_monitor.update(int(ticks), k * SECOND_NS // 4)
        ticks += 250.0 * shares[k // 4 % len(shares)]
    assert rate_monitor.share == (None if found is None else pytest.approx(found, rel=1e-2))


def test_a_silence_is_no_other_pace():
    rate_monitor = SampleRateMonitor(1000.0)
    for k in range(40):
        rate_monitor.update(250 * k, 10 * SECOND_NS * k)
    assert rate_monitor.share is None


def test_innovation_ratios_of_a_consistent_filter_are_one():
    statistics, rng = InnovationStatistics(), np.random.default_rng(3)
    rows = np.zeros(2, INNOVATION)
    rows["value"] = rows["variance"] = np.nan  # refused unseen
    statistics.add(rows[:1])
    assert math.isnan(statistics.table()["north"]["ratio"])
    ratios = []
    for _ in range(4000):
        rows["kind"], rows["variance"], rows["used"] = (0, 6), (4.0, 0.01), (1, 0)
        rows["value"] = rng.normal(0.0, (2.0, 0.3))  # the second says 0.1 and is 0.3
        statistics.add(rows)
        ratios.append([statistics.table()[kind]["ratio"] for kind in ("north", "heading")])
    assert statistics.table()["north"] == {"used": 4000, "rejected": 1, "ratio": ratios[-1][0]}
    assert statistics.table()["heading"]["rejected"] == 4000
    assert np.mean(ratios, axis=0) == pytest.approx([1.0, 9.0], rel=0.1)


def test_a_pose_with_four_innovations_is_counted_once():
    statistics, rows = InnovationStatistics(), np.zeros(4, INNOVATION)
    rows["kind"], rows["value"], rows["variance"], rows["used"] = (5, 6, 7, 8), 2.0, 4.0, 1
    for _ in range(10):
        statistics.add(rows)
    assert statistics.sum((5, 6, 7, 8, 9)) == {"used": 10, "rejected": 0, "ratio": 1.0}
    assert statistics.sum((9,)) == {"used": 0, "rejected": 0}


def test_of_a_silent_source_it_is_not_said_that_it_repeats_itself():
    found = {BAROMETER_SOURCE: {"offset_m": 3.0, "finding": "it repeats its last reading"}}
    estimator = SimpleNamespace(source_estimates=lambda _: found, source_ages_s=None, sources=(SOURCE,))
    for age_s, says in ((0.1, True), (20.0, False)):
        tables = {"barometer": {"received": 5, "age_s": age_s}}
        add_estimates(tables, SimpleNamespace(estimator=estimator, state=None))
        assert tables["barometer"]["offset_m"] == 3.0 and ("finding" in tables["barometer"]) == says


def test_a_sources_share_is_of_the_reductions_of_a_minute():
    shares = SigmaShares()
    assert shares.table("odometer") == {}
    shares.add("gnss", (4.0, 1.0, 1.0, 1.0), (1.0, 1.0, 1.0, 1.0), 0)
    shares.add(
        "odometer", (4.0, 1.0, 1.0, 1.0), (1.0, 1.0, 0.5, 1.0), round(60e9 * np.log(3.0))
    )  # a third of it is left
    assert shares.table("gnss") == {"share": {"position": 0.25, "velocity": 0.0}}
    assert shares.table("odometer") == {"share": {"position": 0.75, "velocity": 1.0}}


def test_each_code_of_an_innovation_up_to_the_last_has_names():
    assert set(KINDS) == set(range(len(KINDS))) and set(ASSUMED) < set(KINDS)


def test_innovations_without_a_value_have_no_ratio_to_show():
    refused, judged = {"used": 0, "rejected": 109}, {"used": 7, "rejected": 1, "ratio": 0.96}
    assert screen.innovations({"north": refused}) == ["0 used, 109 rejected"]
    assert screen.innovations({"north": refused, "east": judged}) == [
        "east 0.96",
        "ratio 1 is right, less is cautious; 7 used, 110 rejected",
    ]


def test_what_the_filter_has_found_stands_in_one_row_with_its_sigma():
    found = {"time_offset_s": 0.153, "stime_offset_s": 0.0121, "baro_offset_m": 90.0, "sbaro_offset_m": 1.0}
    found |= {"mount_pitch_deg": -0.31, "smount_pitch_deg": 0.2, "mount_yaw_deg": 12.34, "smount_yaw_deg": 0.46}
    found |= {f"gnss_bias_{axis}_m": 1.0 for axis in "ned"} | {f"sgnss_bias_{axis}_m": 0.6 for axis in "ned"}
    text = "fixes late by +0.153 ±0.012 s, pitch, yaw of the vehicle -0.31 +12.34 ±0.46°"
    assert list(screen._states(found)) == [("found", text)]
    found["time_offset_s"] = -0.158
    assert list(screen._states(found)) == [("found", text.replace("late by +0.153", "early by +0.158"))]
    found = dict.fromkeys([state.column for state in STATES], 100.0)
    found |= {f"s{name}": 1.0 for name in found}
    lines = list(screen._states(found))
    assert len(lines) == 3 and all(len(line) <= 100 for _, line in lines)
    assert not list(screen._states({})) and not list(screen._states({"gnss_noise_vertical_m": 1.0}))


def test_a_source_is_early_or_late():
    assert list(screen._estimates({"late_s": -0.3})) == ["  found: early by 0.30 s"]
    assert list(screen._estimates({"late_s": 0.3})) == ["  found: late by 0.30 s"]


@contextlib.contextmanager
def stranger(*lines: bytes):
    """Somebody else's server, that says these lines to one client and hangs up; silent without."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with contextlib.suppress(OSError):
                client, _ = server.accept()
                with client:
                    client.sendall(b"".join(lines))
                    client.recv(100)

        thread = threading.Thread(target=serve if lines else lambda: None)
        thread.start()
        yield f"127.0.0.1:{server.getsockname()[1]}"
    thread.join()


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ((b'{"class":"VERSION"}\r\n', b'{"class":"ERROR","message":"Unrecognized"}\r\n'), "not imud.*Unrecognized"),
        ((b'{"class":"ERROR","message":"too many clients"}\r\n',), r"too many clients: .*gpsd\.max_clients"),
        ((b"SSH-2.0-OpenSSH\r\n",), "not imud"),
        ((b"[]\n",), "not imud"),
        ((b'{"class":"VERSION"}\r\n',), "not imud"),
        ((), "open, but does not answer"),
    ],
)
def test_another_program_is_recognised(monkeypatch, lines, says):
    monkeypatch.setattr(status, "TIMEOUT_S", 0.5)
    with stranger(*lines) as address, pytest.raises(ImudError, match=says):
        status.ask(parse_address(address, 1))


def test_without_a_daemon_the_command_says_how_to_start_one(tmp_path):
    with pytest.raises(DeviceAbsentError, match=r"no daemon answers at .*start one"):
        status.run(argparse.Namespace(address=str(tmp_path / "sock"), json=False, prometheus=False))


def test_one_is_counted_in_the_singular():
    counted = screen._counted({"frames": 1, "lost": 1, "errors": 2}, ("frames", "lost", "errors"))
    assert counted == "1 frame, 1 lost, 2 errors"


def test_reasons_of_refused_fixes_are_not_taken_for_settings():
    """`gnss.age` is none: a fix whose age is not known is refused by no setting."""
    counted = screen._counted({"used": 7, "refused": {"unknown age": 1, "max_hdop": 2}}, ("used",))
    assert counted == "7 used, 1 refused for unknown age, 2 refused for max_hdop"
