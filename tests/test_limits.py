"""What is shown is judged by one table of limits: in faults, messages, `imud status`, page and report."""

import asyncio
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from browser import DESKTOP, browser, program
from crossbow_packets import packet
from nmea_lines import gga
from test_web import page_server, scripted_daemon

from imud.commands.report.findings import findings
from imud.commands.report.session import Clock, Innovations, Session
from imud.commands.report.settled import CROWDED, settled_range
from imud.configuration.settings import Initial, Settings
from imud.daemon.status_tables import InnovationStatistics
from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.registry import by_name
from imud.estimators import registry
from imud.estimators.records import INNOVATION, POSITION_N, REST_Y
from imud.figures import Trace
from imud.outputs.gpsd_json import Report
from imud.outputs.view import Health, View
from imud.pipeline import Filter, InertialPipeline
from imud.recording.clock_fit import CLOCK_FIT
from imud.sensors.inertial import Inertial
from imud.sensors.limits import LIMITS, is_beyond
from imud.sensors.receiver import Receiver

SECOND = 1_000_000_000
STILL = (0, 0, 0, 0, 0, 10923)


def test_an_uncertain_value_is_beyond_its_limit_only_if_that_is_sure():
    most = LIMITS["clock_drift_ppm"].most
    assert is_beyond("clock_drift_ppm", -1.3 * most) and is_beyond("clock_drift_ppm", 1.3 * most)
    assert not is_beyond("clock_drift_ppm", -1.3 * most, 0.2 * most)
    assert not any(is_beyond(name, value) for name in LIMITS for value in (None, math.nan))


@pytest.mark.parametrize(
    ("ppm", "has_quartz", "reported"), [(-655.0, True, True), (100.0, True, False), (-655.0, False, False)]
)
def test_a_quartz_that_drifts_is_not_called_well(ppm, has_quartz, reported):
    driver = by_name("crossbow")
    configured = ImuConfigured(Identity(driver.name, ""), 100.0, 790, 0, 24, has_quartz=has_quartz)
    filter_ = Filter(registry.by_name("tilt"), Settings(), Initial(), 100.0)
    sensor = Inertial(InertialPipeline(driver, driver.new_state(configured), filter_))
    sensor.connect(SimpleNamespace(counters={}), driver, configured, 0)
    for k in range(3000):
        data, arrival_ns = packet(STILL, clock=-12_658 * k), round(12_658 * 790 * k * (1.0 + 1e-6 * ppm))
        sensor.pipeline.rx[: len(data)] = np.frombuffer(data, np.uint8)
        sensor.pipeline.ingest(len(data), arrival_ns)
    assert sensor.properties(arrival_ns)["clock"]["drift_ppm"] == pytest.approx(ppm, abs=5.0)
    assert [text for text in sensor.faults(arrival_ns) if "more than 500 ppm" in text] == sensor_faults(reported)
    assert sensor.properties(arrival_ns)["out_of_limits"] == ("clock_drift_ppm" if reported else None)
    assert not any("clock" in text for text in sensor.reading_faults())


@pytest.mark.parametrize(("hz", "kept", "share"), [(100.0, 1, 1.0), (60.0, 1, 0.6), (200.0, 1, 2.0), (100.0, 2, 1.0)])
def test_another_rate_is_noticed_although_the_timer_runs_on(hz, kept, share):
    """And is not taken for one: every second packet damaged on the line. kept: of so many packets one is whole."""
    driver = by_name("crossbow")
    configured = ImuConfigured(Identity(driver.name, ""), 100.0, 790, 0, 24)
    filter_ = Filter(registry.by_name("tilt"), Settings(), Initial(), 100.0)
    sensor = Inertial(InertialPipeline(driver, driver.new_state(configured), filter_))
    sensor.connect(SimpleNamespace(counters={}), driver, configured, 0)
    for k in range(int(8.0 * hz)):
        fill, arrival_ns = sensor.pipeline.fill, round(1e9 * k / hz)
        data = bytearray(packet(STILL, clock=-round(arrival_ns / 790)))
        data[8] ^= 1 if k % kept else 0
        sensor.pipeline.rx[fill : fill + len(data)] = np.frombuffer(data, np.uint8)
        sensor.pipeline.ingest(len(data), arrival_ns)
        ratio = sensor.rate_ratio()
    assert ratio == pytest.approx(share, rel=0.03)


def sensor_faults(reported):
    return ["inertial sensor: its clock differs from this machine's by more than 500 ppm"] * reported


def test_a_receiver_whose_fixes_are_refused_is_not_called_well():
    receiver = Receiver(by_name("nmea"), Settings().gnss, 0)
    for second in range(10):
        hdop = "0.9" if second < 5 else "55.0"
        receiver.feed(gga(f"12000{second}.000", rest=f"1,08,{hdop},545.4,M,46.9,M,,"), second * SECOND)
        receiver.flush(second * SECOND + SECOND // 2)
        if second == 4:
            assert receiver.faults(second * SECOND) == receiver.out_of_limits(second * SECOND) == ()
    assert receiver.faults(9 * SECOND) == ("receiver: its fixes are refused by gnss.max_hdop",)
    assert receiver.out_of_limits(9 * SECOND) == ("hdop",)
    assert receiver.out_of_limits(19 * SECOND) == ("gnss_age_s", "hdop")


def test_est_names_what_is_beyond_its_limit_and_nothing_else():
    def est(*names):
        return json.loads(Report(View(estimator="tilt", health=Health(out_of_limits=names))).object("EST"))

    assert est("clock_drift_ppm", "hdop")["out_of_limits"] == "clock_drift_ppm,hdop"
    assert "out_of_limits" not in est()


@pytest.mark.parametrize(
    ("drift_ppm", "residual_us", "has_quartz", "says"),
    [
        (-655.0, 20.0, True, "the drift of the sensor's clock is -655 ppm"),
        (-655.0, 20.0, False, ""),
        (2.0, 9000.0, True, "the distance of samples from the fitted clock is +9000 µs"),
        (2.0, 20.0, True, ""),
    ],
)
def test_a_report_judges_the_clock(drift_ppm, residual_us, has_quartz, says):
    rows = np.zeros(60, CLOCK_FIT)
    rows["t_ns"] = np.arange(60) * SECOND
    rows["drift"], rows["residual"] = 1e-6 * drift_ppm, 1e-6 * residual_us
    for name in ("drift", "sigma_drift", "residual"):
        rows[name][:3] = np.nan  # not fitted yet
    rows["sigma_drift"][3:] = 1e-6
    found = findings(Session(clocks=(Clock("run", rows, has_quartz),)))
    assert (len(found) == 1 and says in found[0]) if says else found == []


REST_S = np.concatenate([start + 0.5 * np.arange(20) for start in (0.0, 60.0, 120.0)])


@pytest.mark.parametrize(("rejected", "complains"), [((18, 19, 38, 39, 58, 59), False), (range(5, 11), True)])
def test_a_vehicle_that_sets_off_is_no_finding(rejected, complains):
    z = np.random.default_rng(2).normal(size=len(REST_S))
    used = np.ones(len(z), bool)
    used[list(rejected)] = False
    of = Innovations("run", "rest_wy_radps", REST_S, z, np.ones(len(z)), used)
    assert any("were rejected" in text for text in findings(Session(innovations=(of,)))) == complains


def test_the_ratio_of_status_leaves_out_the_window_in_which_a_vehicle_sets_off():
    statistics, rows = InnovationStatistics(), np.zeros(2, INNOVATION)
    rows["variance"], rows["used"] = 1.0, (1, 0)
    rows["value"] = (1.0, 15.0)
    for kind in (REST_Y, POSITION_N):
        rows["kind"] = kind
        statistics.add(rows)
    assert statistics.table()["rest_y"] == {"used": 1, "rejected": 1, "ratio": 1.0}
    assert statistics.table()["north"]["ratio"] > 100.0


def test_an_axis_shows_the_settled_signal():
    t = np.arange(1000.0)
    y, sigma = 0.1 * np.sin(0.05 * t), np.where(t < 20.0, 50.0, 0.02)
    low, high = settled_range([Trace("bias", t, y, sigma)])
    assert -0.14 < low < -0.119 and 0.119 < high < 0.14
    spike = np.where(t == 500.0, 3.0, y)
    assert settled_range([Trace("bias", t, spike, sigma)])[1] > 3.0  # of the signal nothing is cut off but the start
    alike = np.full(1000, 0.1 * CROWDED / 4.0)
    assert settled_range([Trace("bias", t, y, alike)]) is settled_range([Trace("raw", t, y)]) is None


@pytest.mark.thorough
@pytest.mark.skipif(program() is None, reason="no Chromium here")
def test_the_page_marks_what_is_beyond_its_limit_by_a_word_too(tmp_path):
    est = {"class": "EST", "seq": 1, "t_mono_ns": 5, "state": "attitude", "out_of_limits": "clock_drift_ppm"}
    est |= {"clock_drift_ppm": -655.2, "sclock_drift_ppm": 1.5, "clock_residual_us": 21.0}
    att = {"class": "ATT", "rot": 120.0}
    lines = [json.dumps(message).encode() for message in (est, att)]

    async def look(url):
        async with scripted_daemon(tmp_path / "gpsd.sock", *lines), browser(tmp_path / "profile") as page:
            await page.size(DESKTOP)
            await page.open(url)
            await page.until("document.querySelector('#health tr.bad') !== null")
            await page.do("Accessibility.enable")
            tree = (await page.do("Accessibility.getFullAXTree"))["nodes"]
            bad = await page.evaluate("[...document.querySelectorAll('tr.bad')].map((row) => row.innerText)")
            turn = await page.evaluate("document.getElementById('motion').innerText")
            return (
                bad,
                turn,
                [(n["role"]["value"], n.get("name", {}).get("value", "")) for n in tree if not n["ignored"]],
            )

    with page_server(tmp_path / "gpsd.sock") as url:
        bad, turn, named = asyncio.run(look(url))
    assert len(bad) == 1 and bad[0].split("\t")[:2] == ["clock drift: beyond its limit", "-655.2"]
    assert "2.0" in turn and "deg/s" in turn and "deg/min" not in turn
    assert ("rowheader", "clock drift: beyond its limit") in named
    for role in ("table", "image", "button", "heading"):
        assert all(name for found, name in named if found == role), role
