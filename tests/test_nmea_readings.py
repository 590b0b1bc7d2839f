"""Speeds and pressures in NMEA: read as pynmeagps reads them, on a port of their own, recorded, from a log."""

import itertools
import json
import os
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import numpy as np
import pynmeagps
import pytest
from nmea_lines import gga, line, rmc
from processes import TIMEOUT_S, daemon, emulator, silent_tty
from recorded import stored

from imud.commands.status.screen import measurements
from imud.configuration.settings import Aiding, Gnss, Initial, Settings
from imud.drivers.dialogue import Exchange
from imud.drivers.driver import Options
from imud.drivers.fix import Reading
from imud.drivers.nmea.decoder import NmeaDecoder
from imud.drivers.nmea.driver import RECEIVER, SENSOR, Nmea
from imud.estimators import registry
from imud.estimators.aiding_source import AidingSource, ImpossibleValueError
from imud.recording.messages import ESTIMATE_TABLE, INNOVATION_TABLE
from imud.recording.player import Handlers, Player
from imud.recording.source import Recording, adapter
from imud.sensors.aiding import NamedMeasurement
from imud.sensors.nmea_aiding import measured_of
from imud.sensors.receiver import Receiver
from imud.tables.nmea_readings import readings_of_log

SECOND = 1_000_000_000
KNOT = 1852.0 / 3600.0
SOURCES = registry.by_name("navigation").sources


def readings(*bodies):
    decoder = NmeaDecoder()
    decoder.feed(b"".join(map(line, bodies)), SECOND)
    return decoder.take_readings(), decoder.counters


def parsed(body):
    return pynmeagps.NMEAReader.parse(line(body))


def test_a_ground_speed_is_what_another_library_reads():
    for ahead in ("-2.53", "0.0", "7", "+12.25"):
        body = f"VDVBW,3.1,-0.1,A,{ahead},0.2,A"
        [water, ground], _ = readings(body)
        assert (water.source, ground.source) == ("water speed", "speed")
        assert ground.value == pytest.approx(KNOT * float(parsed(body).longgroundspd), abs=1e-12)
        assert water.value == pytest.approx(KNOT * parsed(body).longwaterspd)


def test_only_the_valid_one_of_the_two_speeds_is_read():
    assert [r.source for r in readings("VDVBW,3.1,,A,2.5,,V,,V,,V")[0]] == ["water speed"]
    assert [r.source for r in readings("VDVBW,3.1,,V,2.5,,A")[0]] == ["speed"]
    found, counters = readings("VDVBW,3.1,,V,2.5,,V", "VDVBW,,,A,,,A", "VDVBW,x,,A,,,V", "VDVBW,400,,A,,,V")
    assert not found and counters == {"no reading": 2, "VBW speed": 2}


def test_vhw_is_a_speed_through_the_water_in_knots_or_else_in_km_per_hour():
    body = "IIVHW,101.2,T,98.7,M,4.25,N,7.87,K"
    [both], _ = readings(body)
    assert (both.source, both.value) == ("water speed", pytest.approx(KNOT * parsed(body).spdN))
    [only_km], _ = readings("IIVHW,,T,,M,,N,7.87,K")
    assert only_km.value == pytest.approx(parsed(body).spdK / 3.6)
    assert readings("IIVHW,,T,,M,7.8,K,,")[1] == {"VHW unit": 1}


@pytest.mark.parametrize(
    ("body", "unit"),
    [
        ("IIXDR,P,1.02481,B,Barometer", 1e5),  # Signal K
        ("WIXDR,C,24.59,C,TEMP,P,1.02412,B,BARO", 1e5),  # nanobaro
        ("IIXDR,C,28.7,C,ENV_OUTSIDE_T,P,101400,P,ENV_ATMOS_P,H,47.38,P,ENV_OUTSIDE_H", 1.0),
        ("YXXDR,C,,C,WCHR,C,,C,WCHT,C,,C,HINX,P,1.015,B,STNP", 1e5),  # Airmar LB150
        ("WIXDR,P,1013.2,H,0", 1e2),  # Vaisala WXT530
    ],
)
def test_the_pressure_of_the_air_is_what_another_library_reads(body, unit):
    sentence, found = parsed(body), readings(body)[0]
    k = next(k for k in range(1, 5) if getattr(sentence, f"tdrtype_{k:02d}") == "P")
    assert [r.source for r in found] == ["pressure"]
    assert found[0].value == pytest.approx(unit * float(getattr(sentence, f"data_{k:02d}")))


def test_another_pressure_is_not_that_of_the_air():
    others = ("IIXDR,P,1.013,B,OILP", "IIXDR,P,1.02,B,ENGOIL#0", "IIXDR,P,1.02,,Barometer", "IIXDR,G,1.02,B,Barometer")
    assert readings(*others) == ([], {"no reading": 4})
    assert readings("IIXDR,P,4.2,B,Barometer")[1] == {"XDR pressure": 1}


def test_a_coarse_last_digit_is_the_sigma():
    """0.001 bar are 8 m of height, a knot is 0.5 m/s: more than what such sensors are wrong by."""
    [coarse, fine, whole, tenth], _ = readings(
        "YXXDR,P,1.015,B,STNP", "YXXDR,P,1.01500,B,STNP", "VDVBW,,,V,5,,A", "VDVBW,,,V,5.0,,A"
    )
    assert (coarse.sigma, fine.sigma, tenth.sigma) == (pytest.approx(100.0), None, None)
    assert whole.sigma == pytest.approx(KNOT)
    receiver = Receiver(Nmea(), Gnss(), 0)
    receiver.feed(line("YXXDR,P,1.01325,B,STNP") + line("YXXDR,P,1.013,B,STNP"), SECOND)
    heights = [each.row(SOURCES) for each in receiver.measured]
    assert heights[0]["value"][0, 0] == pytest.approx(0.0, abs=1e-6)
    assert heights[1]["value"][0, 0] - heights[0]["value"][0, 0] == pytest.approx(25 * 0.0832, rel=2e-3)
    assert heights[1]["sigma"][0, 0] == pytest.approx(100 * 0.0832, rel=3e-3)


@pytest.mark.parametrize("body", ["YXXDR,P,1.2,B,STNP", "YXXDR,P,1.299,B,STNP", "YXXDR,P,19001,P,STNP"])
def test_a_pressure_that_no_barometer_of_use_reports_is_left_out(body):
    """Of one decimal of a bar, or of heights that the source does not take."""
    receiver = Receiver(Nmea(), Gnss(), 0)
    receiver.feed(line(body), SECOND)
    assert list(receiver.take_measured(SOURCES)) == [] == list(receiver.take_measured(SOURCES))
    counter = receiver.received["barometer"]
    assert (counter.count, counter.refused, counter.message.startswith("refused: barometer: ")) == (1, 1, True)
    table = counter.table(SECOND)
    assert table["refused"] == 1 and "outside" in table["last_refused"]
    screen = " ".join(measurements({"sources": {"barometer": table}}))
    assert "1 of them refused, the last one: barometer: " in screen


def test_a_heading_without_any_accuracy_is_left_out():
    heading = Reading("heading", SECOND, 1.0, 90.0, 400.0)
    source, values = measured_of(heading, Gnss(), Aiding())
    with pytest.raises(ImpossibleValueError, match="sigma_deg is 400, outside"):
        NamedMeasurement(source, values, SECOND, SECOND).row(SOURCES)


def test_a_defect_in_a_source_is_no_refused_value(monkeypatch):
    def broken(*_):
        raise ValueError("a defect")

    monkeypatch.setattr(AidingSource, "fill", broken)
    receiver = Receiver(Nmea(), Gnss(), 0)
    receiver.feed(line("YXXDR,P,1.01325,B,STNP"), SECOND)
    with pytest.raises(ValueError, match="a defect"):
        list(receiver.take_measured(SOURCES))
    assert receiver.received["barometer"].refused == 0 and not receiver.measured


def test_what_is_left_out_of_a_log_is_said(tmp_path):
    bar = line("YXXDR,P,1.2,B,STNP")
    (tmp_path / "log.nmea").write_bytes(gga() + bar + gga("120001.000") + bar + gga("120002.000"))
    warnings = []
    assert not len(readings_of_log(tmp_path / "log.nmea", 43_199, 0, Settings(), SOURCES, warnings.append))
    assert len(warnings) == 1 and warnings[0].startswith("2 readings for barometer are not used; the first: ")


def test_speeds_and_pressures_are_of_their_arrival_and_a_water_speed_needs_to_know_the_current():
    sentences = gga() + line("VDVBW,4.0,,A,5.0,,A") + line("IIVHW,,T,,M,6.0,N,,K") + line("IIXDR,P,1.02,B,Barometer")
    by_default, afloat = Receiver(Nmea(), Gnss(), 0), Receiver(Nmea(), Gnss(), 0, aiding=Aiding(current_mps=0.5))
    for receiver in (by_default, afloat):
        receiver.feed(sentences, 5 * SECOND)
    assert [each.source for each in by_default.measured] == ["odometer", "barometer"]
    rows = [each.row(SOURCES) for each in afloat.measured]
    assert [row["sigma"][0, 1] for row in rows[:3]] == pytest.approx([0.5, np.nan, 0.5], nan_ok=True)
    assert all(row["t_ns"] == 5 * SECOND for row in rows)


def configured(first, later):
    """Of a line on which detection heard `first`, and `later` comes while it is set up."""
    driver = Nmea()
    dialogue = driver.configure(driver.recognise(first), Options())
    answer = None
    try:
        while isinstance(dialogue.send(answer), Exchange):
            answer = later
    except StopIteration as result:
        return result.value


def test_a_line_without_positions_is_a_sensor():
    vbw, fix = line("VDVBW,,,V,5.0,,A"), gga()
    depth = line("SDDBT,12.0,f,3.7,M,2.0,F")
    for alone in (configured(vbw * 2, vbw * 12), configured(depth * 2, depth * 3)):
        assert (alone.positions, alone.identity.model) == (False, SENSOR)
    for first, later in ((vbw * 2, vbw + fix), (fix + vbw, vbw), (depth * 2, fix)):
        receiver = configured(first, later)
        assert (receiver.positions, receiver.identity.model) == (True, RECEIVER)


def test_fixes_of_a_sensor_that_is_a_receiver_are_not_used():
    sensor = Receiver(Nmea(), Gnss(), 0, positions=False)
    assert not sensor.feed(gga() + rmc() + gga("120001.000"), SECOND) and not sensor.fix_count
    assert sensor.decoder.status.arrival_ns == SECOND  # the daemon sees it by that


def test_a_log_places_readings_between_the_fixes(tmp_path):
    """Ten per fix follow each other at a tenth of the interval; what is before the first fix has no time."""
    vbw = [line(f"VDVBW,,,V,{k}.0,,A") for k in range(30)]
    log = b"".join([vbw[29], *(b"".join([gga(f"12000{i}.000"), *vbw[10 * i : 10 * i + 10]]) for i in range(3))])
    (tmp_path / "log.nmea").write_bytes(log + gga("120003.000") + line("IIXDR,P,1.02,B,BARO"))
    warnings = []
    given = Settings(gnss=Gnss(latency_s=0.25))
    rows = readings_of_log(tmp_path / "log.nmea", 43_199, 0, given, SOURCES, warnings.append)
    assert not warnings
    speeds = rows[rows["kind"] == SOURCES[1].kind]
    assert speeds["value"][:, 0] == pytest.approx(KNOT * np.arange(30))
    assert speeds["t_ns"] == pytest.approx(SECOND * (1.0 + 0.1 * np.arange(30)), abs=2)
    assert (rows["arrival_ns"] - rows["t_ns"] == 250_000_000).all()
    assert len(rows) == 31 and rows["t_ns"][-1] == 4 * SECOND


@contextmanager
def speaking(*sentences, every_s=0.2):
    """A pseudo-terminal on which a sensor says all of them again and again, each time with another digit for #."""
    with silent_tty() as (master, path):
        ended = threading.Event()

        def speak():
            for digit in itertools.cycle("0123456789"):
                if ended.wait(every_s):
                    return
                os.write(master, b"".join(line(sentence.replace("#", digit)) for sentence in sentences))

        thread = threading.Thread(target=speak)
        thread.start()
        try:
            yield path
        finally:
            ended.set()
            thread.join()


@pytest.mark.thorough
def test_a_sensor_on_a_port_of_its_own_aids_is_recorded_and_replays_to_the_same_bits(tmp_path):
    imu, gnss = tmp_path / "imu", tmp_path / "gnss"
    sentences = ("HEHDT,123.0,T", "VDVBW,0.0,0.0,V,0.0,0.0,A", "IIXDR,P,1.01325#,B,Barometer")
    with (
        emulator("g350", "nmea", "--scenario", "rest", "--yaw-deg", "123", links=[imu, gnss]),
        speaking(*sentences) as sensor,
        daemon(
            tmp_path,
            *("--port", str(imu), "--port", str(gnss), "--port", sensor),
            *("--record", str(tmp_path / "rest.mcap"), "--set", "record.estimate_rate_hz=0"),
            *("--set", "aiding.heading_boresight_sigma_deg=0.01"),  # known: rest does not show it
        ) as imud,
    ):
        imud.says(SENSOR)
        est = imud.until(lambda m: m["class"] == "EST" and "heading" in m["state"] and m["syaw_deg"] < 1.5)
        assert est["yaw_deg"] == pytest.approx(123.0, abs=5.0)
        command = [sys.executable, "-m", "imud", "status", "--json", str(tmp_path / "gpsd.sock")]
        end = time.monotonic() + TIMEOUT_S
        while True:
            answer = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
            sources = answer["aiding"]["sources"]
            assert set(sources) == {"heading", "odometer", "barometer"}
            if all(each["received"] > 20 and each["used"] > 10 for each in sources.values()):
                break
            assert time.monotonic() < end, sources
            time.sleep(0.2)
        assert all(each["ratio"] < 2.0 and each["rejected"] == 0 for each in sources.values()), sources
        imud.process.terminate()
        assert imud.process.wait(TIMEOUT_S) == 0
        assert "a spare" not in imud.log

    rows = []
    recording, adapt = Recording([tmp_path / "rest.mcap"]), adapter(None, (), None)
    player = Player(recording.settings(adapt), adapt, Initial(), Handlers(lambda _, new: rows.append(new.copy())))
    for entry in recording:
        player.take(entry)
    kept = stored(tmp_path / "rest.mcap", ESTIMATE_TABLE)
    assert len(kept) > 1000 and np.concatenate(rows).tobytes() == kept.tobytes()
    found = stored(tmp_path / "rest.mcap", INNOVATION_TABLE)
    used = {source.name: found["used"][found["kind"] == next(iter(source.innovations))] for source in SOURCES[:3]}
    assert all(len(each) > 5 and each.mean() > 0.9 for each in used.values()), used
