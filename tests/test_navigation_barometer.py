"""A barometer in the navigation filter: the height between fixes, weather, doors, wrong units."""

import numpy as np
import pytest
from fault_matrix import SOURCES, cell, scene, settings_of
from navigation_simulation import drive, errors, received, sensed
from replay_in_process import new_filter
from test_navigation_aiding import estimated

from imud.batch import play
from imud.estimators import registry
from imud.estimators.ins.aiding.barometer import SOURCE, standard_height
from imud.estimators.records import BAROMETER_SOURCE, HEIGHT_VALID, MEASUREMENT, REJECTING
from imud.sensors.aiding import DatagramDecoder
from imud.tables.inputs import read_aiding


def pressures(d, rng, every_s=0.1, offset=-37.0, weather=0.002, scale=0.03):
    """MEASUREMENT rows of a barometer: an offset that the weather changes (m/s), an atmosphere warmer by `scale`."""
    step = round(every_s / (d.t[1] - d.t[0]))
    t, height = d.t[step::step], d.height[step::step]
    rows = np.zeros(len(t), MEASUREMENT)
    rows["t_ns"] = np.round(1e9 * (100.0 + t))
    rows["arrival_ns"] = rows["t_ns"] + 20_000_000
    rows["kind"], rows["sigma"] = BAROMETER_SOURCE, np.nan
    reading = offset + weather * t + height + scale * (height - height[0]) + 0.15 * rng.standard_normal(len(t))
    rows["value"][:, 0] = reading
    return rows


def recorded(seed, seconds=150.0):
    rng = np.random.default_rng(seed)
    d = drive(seconds)
    return d, sensed(d, rng), received(d, rng, sigma=2.0, white=1.0), rng  # of the height: 1.8 times as much


def height_nees(d, out):
    k = slice(6000, None, 100)
    return errors(d, out)[0][k, 2] / out["sigma_p"][k, 2]


def changes(d, out, over_s=20):
    """RMS error of the change of the height over that time."""
    error = errors(d, out)[0][6000:, 2]
    return np.sqrt(np.mean((error[100 * over_s :] - error[: -100 * over_s]) ** 2))


def test_the_change_of_height_is_better_than_the_receivers_and_the_height_within_sigma():
    with_it, without, normalised = [], [], []
    for seed in range(6):
        d, samples, fixes, rng = recorded(seed)
        rows = pressures(d, rng)
        out, innovations = estimated(samples, fixes, rows)
        alone, _ = estimated(samples, fixes, rows[:0])
        with_it.append(changes(d, out))
        without.append(changes(d, alone))
        normalised.append(height_nees(d, out))
        assert innovations["used"].mean() > 0.99 and (out["status"][d.t > 5.0] & HEIGHT_VALID).all()
    assert np.mean(with_it) < 0.8 * np.mean(without) and np.mean(with_it) < 1.05
    assert np.mean(np.square(normalised)) < 2.0


def test_a_door_and_a_gust_are_rejected_and_a_change_that_stays_is_learned():
    d, samples, fixes, rng = recorded(7)
    rows = pressures(d, rng)
    t = rows["t_ns"] * 1e-9 - 100.0
    rows["value"][(t > 70.0) & (t < 72.0), 0] -= 8.0
    rows["value"][t > 100.0, 0] += 12.0
    out, innovations = estimated(samples, fixes, rows)
    at = innovations["t_ns"] * 1e-9 - 100.0
    assert not innovations["used"][(at > 70.05) & (at < 71.95)].any()
    assert innovations["used"][(at > 72.05) & (at < 99.9)].all() and innovations["used"][at > 107.0].all()
    assert np.mean(height_nees(d, out) ** 2) < 2.5
    assert not (out["status"][d.t > 20.0] & REJECTING).any()


def test_pressure_is_converted_by_the_standard_atmosphere():
    """The table of ISO 2533: 0 m, 1000 m, 5000 m."""
    for pressure, height in ((101325.0, 0.0), (89874.6, 1000.0), (54019.9, 5000.0)):
        assert standard_height(pressure) == pytest.approx(height, abs=1.5)


def test_pressure_or_height_in_a_datagram_and_in_a_table(tmp_path):
    sources = registry.by_name("navigation").sources
    receiver = DatagramDecoder()
    data = b'{"class":"BARO","pressure":89874.6}\n{"class":"BARO","height":1000}\n{"class":"BARO","pressure":1013.25}\n'
    found = list(receiver.decode(data + b'{"class":"BARO","sigma":1}', sources, 5, 5))
    assert [row["value"][0, 0] for _, row in found] == pytest.approx([1000.0, 1000.0], abs=1.5)
    assert receiver.properties(5)["refused"] == {"value": 2}
    assert any("pressure_pa is 1013.25, outside 19000 to 130000" in text for text in receiver.messages)
    table = tmp_path / "baro.csv"
    table.write_text("t_s,pressure_pa\n1.0,89874.6\n")
    assert read_aiding(SOURCE, table, 0)["value"][0, 0] == pytest.approx(1000.0, abs=1.5)


def test_a_barometer_that_repeats_its_last_reading_is_not_used():
    """As one that has stopped; the vehicle climbs meanwhile."""
    d, samples, fixes, rng = recorded(3)
    rows = pressures(d, rng)
    stopped = rows["t_ns"] > 160_000_000_000
    rows["value"][stopped] = rows["value"][~stopped][-1]
    out, innovations = estimated(samples, fixes, rows)
    assert innovations["t_ns"].max() <= 160_000_000_000
    without, _ = estimated(samples, fixes, rows[~stopped])
    assert np.nanmax(np.abs(out["height"] - without["height"])) < 0.01


@pytest.mark.parametrize("seed", [11, 12, 14])
def test_readings_in_feet_on_a_drone_are_not_believed(seed):
    found = cell(seed, "barometer", "wrong units", "drone")
    assert found.sure_s == 0.0, found.worst


def hectopascal(height):
    return 1013.25 * (1.0 - height / 44330.77) ** 5.25588


UNITS = {"hPa": hectopascal, "kPa": lambda height: hectopascal(height) / 10.0, "km": lambda height: height / 1e3}


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("seed", [31, 43])
def test_readings_that_hardly_change_while_a_drone_climbs_are_not_believed(seed, unit):
    """They would hold the height; what was learned with them is doubted as soon as fixes show it."""
    d, samples, fixes = scene(seed, "drone")
    rows = SOURCES["barometer"](d, np.random.default_rng(100 + seed)).copy()
    rows["value"][:, 0] = UNITS[unit](rows["value"][:, 0])
    out, _ = estimated(samples, fixes, rows, settings_of("barometer", "drone"))
    error, sigma = errors(d, out)[0][:, 2], out["sigma_p"][:, 2]
    valid = out["status"] & HEIGHT_VALID != 0
    assert not np.any((np.abs(error) > np.maximum(4.0 * sigma, 5.0))[valid])


@pytest.mark.parametrize("seed", [31, 43])
def test_a_right_barometer_on_a_drone_keeps_its_weight(seed):
    d, samples, fixes = scene(seed, "drone")
    filter_ = new_filter("navigation", samples, settings_of("barometer", "drone"))
    rows = SOURCES["barometer"](d, np.random.default_rng(100 + seed))
    play(filter_, samples.copy(), fixes, lambda block: None, aiding=rows)
    assert filter_.state["core"][0, 0]["barometer"]["scale_error2_by_fixes"] == 0.0
