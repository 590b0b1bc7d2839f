"""A magnetometer in the navigation filter: a heading of last resort, with disturbances that last."""

import numpy as np
import pytest
from navigation_simulation import drive, errors, received, sensed
from scipy.spatial.transform import Rotation
from test_navigation_aiding import estimated, found_of_sources

from imud.configuration.settings import Aiding, Initial, Navigation, Noise, Settings
from imud.estimators import registry
from imud.estimators.records import HEADING_VALID, MAGNETOMETER, MAGNETOMETER_SOURCE, MEASUREMENT, SOLUTION
from imud.pipeline import Filter
from imud.sensors.aiding import DatagramDecoder
from imud.tables.inputs import read_aiding

EARTH = np.array([20.9e-6, 1.6e-6, 43.4e-6])  # T, NED, near Munich
ON = Settings(aiding=Aiding(magnetometer=True))


def readings(d, rng, every_s=0.1, iron=0.0, surroundings=0.0, tau=60.0, noise=0.5e-6):
    """MEASUREMENT rows: iron of the vehicle and fields of the surroundings, T, are Gaussian in each axis."""
    step = round(every_s / (d.t[1] - d.t[0]))
    k = np.arange(step, len(d.t), step)
    decay, outside = np.exp(-every_s / tau), np.empty((len(k), 3))
    outside[0] = surroundings * rng.standard_normal(3)
    for i in range(1, len(k)):
        outside[i] = decay * outside[i - 1] + surroundings * np.sqrt(1.0 - decay**2) * rng.standard_normal(3)
    rows = np.zeros(len(k), MEASUREMENT)
    rows["t_ns"] = np.round(1e9 * (100.0 + d.t[k]))
    rows["arrival_ns"] = rows["t_ns"] + 20_000_000
    rows["kind"], rows["sigma"] = MAGNETOMETER_SOURCE, np.nan
    body = d.attitude[k].inv().apply(EARTH + outside) + iron * rng.standard_normal(3)
    rows["value"][:, :3] = body + noise * rng.standard_normal(body.shape)
    rows["value"][:, 3:] = EARTH
    return rows


def recorded(seed, seconds=120.0, rest=60.0):
    rng = np.random.default_rng(seed)
    d = drive(seconds, rest=rest)
    return d, sensed(d, rng), received(d, rng), rng


def yaw(d, out):
    """Error, and sigma, rad."""
    return errors(d, out)[2][:, 2], out["sigma_rpy"][:, 2]


def during(d, first, last=np.inf):
    return (d.t >= first) & (d.t < last)


def motor(rows, since_s, strength=10e-6, angle=0.0):
    """The field of a current, T, horizontal in the vehicle."""
    on = rows["t_ns"] * 1e-9 - 100.0 > since_s
    rows["value"][on, :3] += strength * np.array([np.cos(angle), np.sin(angle), 0.0])


def test_it_gives_a_standing_vehicle_a_heading_with_an_honest_sigma():
    squares, found = [], 0
    for seed in range(12):
        d, samples, fixes, rng = recorded(seed, seconds=30.0, rest=30.0)
        out, _ = estimated(samples, fixes, readings(d, rng, iron=1e-6, surroundings=1e-6), ON)
        e, sigma = yaw(d, out)
        standing = during(d, 15.0) & (out["status"] & HEADING_VALID > 0)
        if not standing.any():
            continue
        found += 1
        assert np.radians(5.0) < sigma[standing].min() and sigma[standing].max() < np.radians(10.0)
        squares.append((e[-1] / sigma[-1]) ** 2)
    assert found >= 10
    assert 0.1 < np.mean(squares) < 2.0


def test_all_readings_together_know_no_more_than_one():
    d, samples, fixes, rng = recorded(1, seconds=60.0)
    sigmas = [yaw(d, estimated(samples, fixes, readings(d, rng, every_s=every_s), ON)[0])[1] for every_s in (1.0, 0.05)]
    assert sigmas[1][-1] == pytest.approx(sigmas[0][-1], rel=0.05)
    assert sigmas[1][-1] == pytest.approx(sigmas[1][1000], rel=0.05)


@pytest.mark.thorough
def test_in_an_outage_it_holds_the_heading_of_a_poor_gyro_and_says_how_well():
    """Mean NEES of yaw over runs with iron, surroundings and gyros of their own each, from 80 s on without fixes."""
    instability = np.radians(0.2)  # rad/s, within 100 s
    settings = Settings(
        aiding=Aiding(magnetometer=True),
        navigation=Navigation(vehicle="land"),
        noise=Noise(gyro_bias_instability_deg_per_h=np.degrees(instability) * 3600.0),
    )
    nees, spread, alone = [], [], []
    for seed in range(8):
        rng = np.random.default_rng(40 + seed)
        d = drive(320.0, rest=15.0)
        samples, fixes = sensed(d, rng), received(d, rng)
        steps = instability / np.sqrt(100.0 * 100.0) * rng.standard_normal((len(samples), 3))
        samples["w"] += np.cumsum(steps, axis=0)
        fixes = fixes[fixes["t_ns"] < 180e9]
        rows = readings(d, rng, every_s=0.2, iron=1e-6, surroundings=1e-6)
        out, innovations = estimated(samples, fixes, rows, settings)
        without, _ = estimated(samples, fixes, rows[:0], settings)
        e, sigma = yaw(d, out)
        late = during(d, 250.0)
        assert (out["status"][late] & HEADING_VALID).all()
        assert (innovations["kind"] == MAGNETOMETER).all() and innovations["used"].mean() > 0.5
        nees.append(np.mean((e[late] / sigma[late]) ** 2))
        spread.append(np.sqrt(np.mean(e[late] ** 2)))
        alone.append(np.sqrt(np.mean(yaw(d, without)[0][late] ** 2)))
    assert 0.3 < np.mean(nees) < 2.0
    assert np.sqrt(np.mean(np.square(spread))) < 0.8 * np.sqrt(np.mean(np.square(alone)))


def test_a_heading_that_gnss_knows_better_is_left_alone():
    d, samples, fixes, rng = recorded(2, rest=10.0)
    rows = readings(d, rng, iron=3e-6)
    rows = rows[rows["t_ns"] > 160e9]
    out, innovations = estimated(samples, fixes, rows, ON)
    without, _ = estimated(samples, fixes, rows[:0], ON)
    assert len(innovations) == len(rows)  # and the propagation is split at their epochs
    assert np.abs(yaw(d, out)[0] - yaw(d, without)[0]).max() < np.radians(0.02)
    assert yaw(d, out)[1] == pytest.approx(yaw(d, without)[1], rel=0.01)


def test_it_is_off_unless_asked_for():
    d, samples, fixes, rng = recorded(3, seconds=20.0, rest=20.0)
    out, innovations = estimated(samples, fixes, readings(d, rng), Settings())
    without, _ = estimated(samples, fixes, readings(d, rng)[:0], Settings())
    assert not len(innovations) and out.tobytes() == without.tobytes()


@pytest.mark.parametrize("seed", range(4))
def test_a_motor_that_is_switched_on_does_not_turn_the_heading(seed):
    d, samples, fixes, rng = recorded(seed, seconds=90.0, rest=90.0)
    rows = readings(d, rng, iron=0.5e-6)
    motor(rows, 20.0, angle=1.5 * seed)
    out, _ = estimated(samples, fixes, rows, ON)
    e, sigma = yaw(d, out)
    assert (out["status"][during(d, 10.0)] & HEADING_VALID).all()
    assert np.abs(e[during(d, 20.0)] - e[1900]).max() < np.radians(1.0)
    assert (np.abs(e) < 3.0 * sigma)[during(d, 10.0)].all()


@pytest.mark.parametrize("varying", [False, True])
def test_a_motor_that_runs_from_the_start_makes_no_heading_that_is_wrong_and_sure(varying):
    """But for a constant field straight across that of the earth, which nothing shows: not 1 in 8 here."""
    wrong = 0
    for seed in range(8):
        d, samples, fixes, rng = recorded(seed, seconds=30.0, rest=30.0)
        rows = readings(d, rng, iron=0.5e-6)
        motor(rows, 0.0, angle=0.8 * seed)
        if varying:
            rows["value"][:, :3] += np.repeat(rng.uniform(-8e-6, 8e-6, (len(rows) // 5 + 1, 3)), 5, axis=0)[: len(rows)]
        out, _ = estimated(samples, fixes, rows, ON)
        e, sigma = yaw(d, out)
        wrong += bool(((out["status"] & HEADING_VALID > 0) & (np.abs(e) > 3.0 * sigma)).any())
    assert wrong <= (0 if varying else 1)


def test_a_vehicle_that_starts_with_a_wrong_field_finds_its_heading_in_motion_and_keeps_it_in_an_outage():
    rng = np.random.default_rng(7)
    d = drive(160.0, rest=20.0)
    samples, fixes = sensed(d, rng), received(d, rng)
    rows = readings(d, rng)
    rows["value"][:, :3] = (
        (d.attitude * Rotation.from_euler("z", 40.0, degrees=True))
        .inv()
        .apply(EARTH)[np.round(rows["t_ns"] * 1e-7 - 10000).astype(int)]
    )  # of the right strength and dip, and 40 deg off
    out, _ = estimated(samples, fixes[fixes["t_ns"] < 220e9], rows, ON)
    e, sigma = yaw(d, out)
    assert np.abs(e[1900]) > np.radians(30.0)
    moving = during(d, 64.0)
    assert (out["status"][moving] & HEADING_VALID).all() and (np.abs(e[moving]) < 4.0 * sigma[moving]).all()


def test_why_a_field_is_not_used_is_said():
    d, samples, fixes, rng = recorded(4, seconds=40.0, rest=40.0)
    rows = readings(d, rng)
    assert "finding" not in found_of_sources(samples, fixes, rows, ON).get(MAGNETOMETER_SOURCE, {})
    motor(rows, 30.0)
    assert "not the earth's" in found_of_sources(samples, fixes, rows, ON)[MAGNETOMETER_SOURCE]["finding"]


def test_a_reading_without_field_or_place_changes_nothing():
    d, samples, fixes, rng = recorded(4, seconds=20.0, rest=20.0)
    rows = readings(d, rng)[20:100]
    rows["value"][::3, :3] = 0.0
    rows["value"][1::3, 1] = np.nan
    rows["value"][2::3, 3:5] = 0.0
    out, innovations = estimated(samples, fixes, rows, ON)
    without, _ = estimated(samples, fixes, rows[:0], ON)
    assert not len(innovations) and out.tobytes() == without.tobytes()


def test_a_magnetometer_in_a_datagram_and_in_a_table(tmp_path):
    sources = registry.by_name("navigation").sources
    receiver = DatagramDecoder()
    values = ('"x":20,"y":-1.5,"z":43', '"x":20,"y":1', '"x":48000,"y":0,"z":0')
    lines = "\n".join(f'{{"class":"MAG",{each}}}' for each in values).encode()
    [(source, row)] = receiver.decode(lines, sources, 5, 5)
    assert source.name == "magnetometer" and receiver.properties(5)["refused"] == {"value": 2}
    assert row["value"][0, :3] == pytest.approx([20e-6, -1.5e-6, 43e-6]) and np.isnan(row["value"][0, 3:]).all()
    table = tmp_path / "mag.csv"
    table.write_text("t_s,mx_ut,my_ut,mz_ut,north_ut,east_ut,down_ut,sigma_ut\n1.0,20,-1.5,43,21,1,43,2\n")
    [of_table] = read_aiding(source, table, 0)
    assert of_table["value"] == pytest.approx([20e-6, -1.5e-6, 43e-6, 21e-6, 1e-6, 43e-6])
    assert of_table["sigma"][0] == pytest.approx(2e-6)


def test_the_earths_field_is_written_once_the_place_is_known_and_recorded_readings_keep_theirs():
    d, samples, fixes, rng = recorded(5, seconds=20.0, rest=20.0)
    rows = readings(d, rng)
    filter_ = Filter(registry.by_name("navigation"), ON, Initial(), 100.0)
    bare = rows[:1].copy()
    bare["value"][:, 3:] = np.nan
    filter_.aid(bare)
    assert np.isnan(bare["value"][0, 3:]).all()
    out = np.zeros(len(samples), SOLUTION)
    filter_.run(samples[:101].copy(), out[:101])  # to the epoch of the fix
    filter_.update(fixes[:1])
    filter_.aid(bare)
    north, east, down = bare["value"][0, 3:]
    assert (north, east, down) == pytest.approx(EARTH, abs=1e-6)
    kept = rows[:1].copy()
    filter_.aid(kept)
    assert kept.tobytes() == rows[:1].tobytes()


def test_the_mounting_turns_the_readings_and_leaves_what_is_recorded():
    d, samples, fixes, rng = recorded(6, seconds=20.0, rest=20.0)
    rows = readings(d, rng)
    straight, _ = estimated(samples, fixes, rows.copy(), ON)
    turned = rows.copy()
    turned["value"][:, :3] = (
        Rotation.from_euler("ZYX", [90.0, 10.0, -20.0], degrees=True).inv().apply(rows["value"][:, :3])
    )
    settings = Settings(aiding=Aiding(magnetometer=True, magnetometer_mount_rpy_deg=(-20.0, 10.0, 90.0)))
    out, _ = estimated(samples, fixes, turned, settings)
    assert out["q_nb"] == pytest.approx(straight["q_nb"], abs=1e-9)
