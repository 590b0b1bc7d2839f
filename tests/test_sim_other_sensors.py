"""Emulated wheel, barometer and compass: their sentences as another library reads them, against the true motion."""

import numpy as np
import pynmeagps
import pytest
from simulated import Remembering

from imud.daemon import simulated
from imud.firmware_sim.faults import spec
from imud.firmware_sim.faults.readings import FaultyReadings
from imud.firmware_sim.motion import Trajectory
from imud.firmware_sim.other_sensors import KINDS, OtherSensor
from imud.firmware_sim.scenarios import SCENARIOS

CAR = Trajectory(SCENARIOS["car"](0.0, 0.0, 0.0), 35.6, 139.7, 60.0)
REMEMBERED = Remembering(CAR)
FIELDS = {"wheel": "longgroundspd", "baro": "data_01", "compass": "headingT"}
UNITS = {"wheel": 1852.0 / 3600.0, "baro": 1e5, "compass": 1.0}


def said(name, seconds, faults="", **options):
    """(times, readings in SI units or degrees) of an emulated sensor, every sentence read by pynmeagps."""
    [own] = spec.parse(faults, [name])
    sensor = OtherSensor(KINDS[name], REMEMBERED, np.random.default_rng(1), 38400, fault=FaultyReadings(own), **options)
    sensor.advance(seconds)
    data = sensor.uart.take(1e9, 38400)
    found = [pynmeagps.NMEAReader.parse(line + b"\r\n") for line in data.split(b"\r\n") if line]
    values = np.array([float(getattr(sentence, FIELDS[name])) for sentence in found])
    return np.arange(1, len(values) + 1) / KINDS[name].rate_hz, UNITS[name] * values


@pytest.mark.thorough
def test_ideal_ones_tell_the_true_motion():
    t, speed = said("wheel", 60.0, ideal=True)
    truth = CAR.at(t)
    np.testing.assert_allclose(np.abs(speed), np.linalg.norm(truth.v_n, axis=1), atol=0.01)
    assert speed.max() > 5.0 and len(t) == 600
    _, pressure = said("baro", 60.0, ideal=True)
    climbs = np.abs(np.diff(truth.height)) > 0.02
    slope = np.diff(pressure)[climbs] / np.diff(truth.height)[climbs]
    assert np.median(slope) == pytest.approx(-12.0, abs=0.5)  # Pa per m near the ground
    _, heading = said("compass", 60.0, ideal=True)
    np.testing.assert_allclose((heading - np.degrees(truth.rpy[:, 2]) + 180.0) % 360.0, 180.0, atol=0.01)


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "most"), [("wheel", 0.4), ("baro", 370.0), ("compass", 2.5)])
def test_real_ones_are_wrong_by_a_little(name, most):
    ideal, real = said(name, 60.0, ideal=True)[1], said(name, 60.0)[1]
    apart = (real - ideal + 180.0) % 360.0 - 180.0 if name == "compass" else real - ideal
    assert 0.0 < np.abs(apart).max() < most


@pytest.mark.thorough
def test_faults_hold_shift_and_scale_the_reading_in_their_time():
    t, right = said("wheel", 40.0, ideal=True)
    for faults, expected in (
        ("other:held@20-30", np.where((t >= 20.0) & (t < 30.0), right[198], right)),
        ("offset=2.5@20-30", np.where((t >= 20.0) & (t < 30.0), right + 2.5, right)),
        ("wheel:scale=3.6@20", np.where(t >= 20.0, 3.6 * right, right)),
    ):
        np.testing.assert_allclose(said("wheel", 40.0, faults, ideal=True)[1], expected, atol=2e-3)


def test_inertial_sensors_and_receivers_have_none_of_these_faults():
    with pytest.raises(spec.SpecError, match="not a fault of g350, nmea"):
        spec.parse("held@3", ["g350", "nmea"])
    assert [len(faults) for faults in spec.parse("cut=0.1", ["g350", "wheel"])] == [1, 1]


def test_they_are_ports_of_a_scenario_and_speak_nmea():
    with simulated.emulated(("sim:rest:nmea", "sim:rest:wheel", "sim:rest:baro@9600"), 1) as emulated:
        texts = emulated.ports
        assert [text.rpartition(":")[2] for text in texts] == ["nmea", "nmea", "nmea@9600"]
        assert all(name in text for name, text in zip(("nmea", "wheel", "baro"), texts, strict=True))
