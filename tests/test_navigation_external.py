"""Poses and velocities of another system in the navigation filter: with a receiver and without, and their faults."""

import numpy as np
import pytest
from accuracy_combined import run_aided
from fault_matrix import SOURCES, scene, settings_of
from navigation_simulation import curvature, drive, errors, received, sensed
from test_navigation_aiding import estimated

from imud.configuration.settings import Navigation, Settings
from imud.errors import BadDataError
from imud.estimators import registry
from imud.estimators.ins.aiding.external_pose import SOURCE
from imud.estimators.records import (
    BODY_VELOCITY_SOURCE,
    COASTING,
    HEADING_VALID,
    MEASUREMENT,
    POSE_N,
    POSE_SOURCE,
    POSITION_VALID,
    VELOCITY_SOURCE,
)
from imud.sensors.aiding import DatagramDecoder
from imud.tables.inputs import read_aiding

SIGMA, YAW_SIGMA = 0.1, np.radians(1.0)


def rows_at(d, kind, every_s=0.1, late_s=0.05):
    """(indices of the samples, MEASUREMENT rows) of a source without values."""
    step = round(every_s / (d.t[1] - d.t[0]))
    k = np.arange(step, len(d.t), step)
    rows = np.zeros(len(k), MEASUREMENT)
    rows["t_ns"] = np.round(1e9 * (100.0 + d.t[k]))
    rows["arrival_ns"] = rows["t_ns"] + round(1e9 * late_s)
    rows["kind"], rows["value"], rows["sigma"] = kind, np.nan, np.nan
    return k, rows


def lasting(rng, n, width, dt=0.1, tau=0.5):
    """Gauss-Markov noise of unit variance."""
    decay = np.exp(-dt / tau)
    out = np.empty((n, width))
    out[0] = rng.standard_normal(width)
    for i in range(1, n):
        out[i] = decay * out[i - 1] + np.sqrt(1.0 - decay**2) * rng.standard_normal(width)
    return out


def poses(d, rng, sigma=SIGMA, yaw=True):
    k, rows = rows_at(d, POSE_SOURCE)
    m, n = curvature(d.lat[k])
    error = lasting(rng, len(k), 4)
    rows["value"][:, 0] = d.lat[k] + sigma * error[:, 0] / m
    rows["value"][:, 1] = d.lon[k] + sigma * error[:, 1] / (n * np.cos(d.lat[k]))
    rows["value"][:, 2] = d.height[k] - sigma * error[:, 2]
    rows["sigma"][:, :3] = sigma
    if yaw:
        rows["value"][:, 3] = d.attitude.as_euler("ZYX")[k, 0] + YAW_SIGMA * error[:, 3]
        rows["sigma"][:, 3] = YAW_SIGMA
    return rows


def velocities(d, rng, body, sigma=0.1, scale=1.01):
    k, rows = rows_at(d, BODY_VELOCITY_SOURCE if body else VELOCITY_SOURCE)
    v = d.attitude[k].inv().apply(d.v[k]) if body else d.v[k]
    rows["value"][:, :3] = scale * v + sigma * lasting(rng, len(k), 3)
    rows["sigma"][:, :3] = sigma
    return rows


def recorded(seed, seconds=120.0):
    rng = np.random.default_rng(seed)
    d = drive(seconds)
    return d, sensed(d, rng), received(d, rng), rng


def honest(d, out, after_s, before_s=np.inf):
    """Largest position error over its sigma, per second of the time between, horizontally."""
    k = np.flatnonzero((d.t > after_s) & (d.t < before_s))[::100]
    return (np.abs(errors(d, out)[0][k]) / out["sigma_p"][k])[:, :2].max()


def test_poses_alone_start_navigation_and_hold_it():
    normalised, worst = [], 0.0
    for seed in range(4):
        d, samples, fixes, rng = recorded(seed)
        out, innovations = estimated(samples, fixes[:0], poses(d, rng))
        valid = POSITION_VALID | HEADING_VALID
        assert ((out["status"][d.t > 5.0] & valid) == valid).all() and not (out["status"][d.t > 5.0] & COASTING).any()
        assert innovations["used"].mean() > 0.99
        k = slice(2000, None, 100)
        p, _, phi = errors(d, out)
        worst = max(worst, np.abs(p[2000:]).max())
        normalised.append((p[k] / out["sigma_p"][k]) ** 2)
        assert np.abs(phi[2000:, 2]).max() < 3.0 * YAW_SIGMA
    assert worst < 4.0 * SIGMA
    assert 0.15 < np.mean(normalised) < 2.0


def test_poses_bring_a_receivers_metres_to_their_decimetres():
    d, samples, fixes, rng = recorded(5)
    rows = poses(d, rng, yaw=False)
    out, _ = estimated(samples, fixes, rows)
    late = d.t > 60.0
    assert np.sqrt(np.mean(errors(d, out)[0][late] ** 2)) < 2.0 * SIGMA
    assert honest(d, out, 60.0) < 4.0


def drifts(d, out):
    """By how much the position moved away in the outage from 80 s on, horizontally, m."""
    p = errors(d, out)[0]
    return np.hypot(*(p[-1] - p[8000])[:2])


@pytest.mark.thorough
@pytest.mark.parametrize("body", [False, True])
def test_velocities_hold_the_position_of_a_free_craft_in_an_outage_of_two_minutes(body):
    with_it, without = [], []
    free = Settings(navigation=Navigation(vehicle="free"))
    for seed in range(4):
        rng = np.random.default_rng(10 + seed)
        d = drive(200.0)
        samples, fixes = sensed(d, rng, gyro_psd=5e-4, accel_psd=6e-3), received(d, rng)
        fixes = fixes[fixes["t_ns"] < 180e9]
        rows = velocities(d, rng, body)
        out, innovations = estimated(samples, fixes, rows, free)
        alone, _ = estimated(samples, fixes, rows[:0], free)
        assert innovations["used"].mean() > 0.95
        assert honest(d, out, 60.0) < 4.0
        with_it.append(drifts(d, out))
        without.append(drifts(d, alone))
    print(with_it, without)
    assert np.mean(with_it) < 0.5 * np.mean(without)


def frozen(rows, t):
    rows["value"][t > 70.0] = rows["value"][np.searchsorted(t, 70.0)]


def jumped(rows, t):
    rows["value"][(t > 70.0) & (t < 90.0), 0] += 30.0 / 6.37e6


def lost(rows, t):
    rows["value"][t > 70.0] = np.nan


def in_degrees(rows, t):
    rows["value"][:, :2] = np.degrees(rows["value"][:, :2]) % 1.0


@pytest.mark.parametrize("fault", [frozen, jumped, lost, in_degrees])
def test_a_fault_of_the_poses_leaves_the_rest_unharmed(fault):
    d, samples, fixes, rng = recorded(20)
    rows = poses(d, rng)
    fault(rows, rows["t_ns"] * 1e-9 - 100.0)
    out, innovations = estimated(samples, fixes, rows)
    assert honest(d, out, 30.0) < 4.0
    assert np.abs(errors(d, out)[2][6000:, 2]).max() < np.radians(6.0)
    at = innovations["t_ns"] * 1e-9 - 100.0
    wrong = innovations[(innovations["kind"] == POSE_N) & (at > 70.2) & (at < 89.9)]
    assert fault is lost or (len(wrong) and not wrong["used"].any())


def test_a_pose_in_a_datagram():
    receiver = DatagramDecoder()
    sources = registry.by_name("navigation").sources
    data = b'{"class":"POSE","lat":48,"lon":11,"height":500,"yaw":90,"sn":0.1,"syaw":1}\n{"class":"POSE","lat":48}\n'
    data += b'{"class":"VEL","vn":1,"ve":2}\n{"class":"BODYVEL","vx":3}\n{"class":"POSE","lat":91,"lon":11}\n'
    pose, ned, body = [row for _, row in receiver.decode(data, sources, 5, 5)]
    assert pose["value"][0, :4] == pytest.approx([np.radians(48), np.radians(11), 500.0, np.pi / 2])
    assert pose["sigma"][0, [0, 3]] == pytest.approx([0.1, np.radians(1)]) and np.isnan(pose["sigma"][0, 1:3]).all()
    assert ned["value"][0, :2] == pytest.approx([1.0, 2.0]) and np.isnan(ned["value"][0, 2])
    assert body["value"][0, 0] == 3.0
    assert receiver.properties(5)["refused"] == {"value": 2}


def test_poses_of_a_table_with_and_without_height_and_yaw(tmp_path):
    table = tmp_path / "pose.csv"
    table.write_text("t_s,lat_deg,lon_deg,height_m,yaw_deg,se_m\n1.0,48,11,500,90,0.2\n2.0,48,11,,,\n")
    whole, bare = read_aiding(SOURCE, table, 0)
    assert whole["value"][:4] == pytest.approx([np.radians(48), np.radians(11), 500.0, np.pi / 2])
    assert whole["sigma"][1] == 0.2 and np.isnan(whole["sigma"][[0, 2, 3]]).all()
    assert np.isfinite(bare["value"][:4]).tolist() == [True, True, False, False]
    table.write_text("t_s,lat_deg\n1.0,48\n")
    with pytest.raises(BadDataError, match="lon_deg"):
        read_aiding(SOURCE, table, 0)


@pytest.mark.parametrize("seed", [52, 539, 565])
def test_false_velocities_beside_a_receiver_make_nothing_wrong_and_sure(seed):
    """Random runs: a reversed north axis on a helicopter with RTK and a walker with positions alone, a turned sensor on
    a rally car. Before velocities had to agree for some seconds they were for 46, 1 and 24 s.
    """
    wrong, _, _, text = run_aided(seed, {})
    assert "velocity negative" in text or "velocity turned" in text
    assert wrong.sum() <= 1.0


def test_a_velocity_with_a_reversed_axis_is_never_used():
    d, samples, fixes = scene(72, "city")
    rows = SOURCES["velocity"](d, np.random.default_rng(72)).copy()
    rows["value"][:, 0] *= -1.0
    _, innovations = estimated(samples, fixes, rows, settings_of(None, "city"))
    assert not innovations["used"].any()
