"""Prasanna's GPS and INS filters against dense matrices, their claims, and what their solution rows say."""

import math

import numpy as np
import pytest
from pymap3d import geodetic2enu

from imud.configuration.settings import GpsTrack, Imu, Initial, Ins9, Settings
from imud.estimators import registry
from imud.estimators.papers import ins9
from imud.estimators.records import (
    AT_REST,
    ATTITUDE_VALID,
    COASTING,
    FIX,
    HEADING_VALID,
    HEIGHT_VALID,
    POSITION_E,
    POSITION_N,
    POSITION_VALID,
    SOLUTION,
)
from imud.experiments import prasanna
from imud.experiments.simulate import level_at_rest, m_g350, samples_of
from imud.pipeline import Filter

pytestmark = pytest.mark.usefixtures("papers_as_c")

A, F = 6378137.0, 1.0 / 298.257223563
E2 = F * (2.0 - F)


def curvature(lat):
    d = 1.0 - E2 * math.sin(lat) ** 2
    return A * (1.0 - E2) / d**1.5, A / math.sqrt(d)


def fix_at(t_s, lat, lon, **more):
    fix = np.zeros(1, FIX)
    for name in ("height", "sigma", "v", "hdop", "speed", "course"):
        fix[name] = np.nan
    fix["t_ns"], fix["lat"], fix["lon"], fix["quality"] = round(t_s * 1e9), lat, lon, 1
    for name, value in more.items():
        fix[name] = value
    return fix


def one_row(filter_, t_s):
    out = np.zeros(1, SOLUTION)
    filter_.run(samples_of(np.array([t_s]), *level_at_rest(1)), out)
    return out[0]


def dense_track(t, fixes, Q, R):
    """X = [x, vx, y, vy] with textbook matrices; x, y counted from the moving estimate, which lat, lon remember."""
    H = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]])
    lat, lon, v = *fixes[0], np.zeros(2)
    P = np.diag([R, 900.0, R, 900.0])
    out = []
    for k in range(1, len(t)):
        dt = t[k] - t[k - 1]
        Phi = np.kron(np.eye(2), [[1, dt], [0, 1]])
        G = np.kron(np.eye(2), [[dt * dt / 2], [dt]])
        m, n = curvature(lat)
        lat, lon = lat + dt * v[0] / m, lon + dt * v[1] / (n * math.cos(lat))
        P = Phi @ P @ Phi.T + Q * G @ G.T
        m, n = curvature(lat)
        z = np.array([(fixes[k][0] - lat) * m, (fixes[k][1] - lon) * n * math.cos(lat)])
        W = P @ H.T @ np.linalg.inv(H @ P @ H.T + R * np.eye(2))
        dx = W @ z
        A_ = np.eye(4) - W @ H
        P = A_ @ P @ A_.T + R * W @ W.T
        lat, lon, v = lat + dx[0] / m, lon + dx[2] / (n * math.cos(lat)), v + dx[[1, 3]]
        out.append([lat, lon, *v, P[0, 0], P[2, 2], P[1, 1], P[3, 3]])
    return np.array(out)


def test_the_track_agrees_with_a_dense_filter():
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.2, 3.0, 200))
    fixes = np.column_stack([0.8 + 2e-6 * t, 0.3 + 1e-6 * t]) + 5e-7 * rng.standard_normal((200, 2))
    expected = dense_track(t, fixes, 0.3, 2.0)
    settings = Settings(gps_track=GpsTrack(acceleration_var=0.3, position_var=2.0))
    filter_ = Filter(registry.by_name("gps-track"), settings, Initial(), 100.0)
    rows = []
    for at, (lat, lon) in zip(t, fixes, strict=True):
        innovations = filter_.update(fix_at(at, lat, lon))
        rows.append(one_row(filter_, at))
    assert list(innovations["kind"]) == [POSITION_N, POSITION_E]
    got = np.array(
        [[r["lat"], r["lon"], *r["v"][:2], *r["sigma_p"][:2] ** 2, *r["sigma_v"][:2] ** 2] for r in rows[1:]]
    )
    # the fixes' times are whole ns
    np.testing.assert_allclose(got[:, :2], expected[:, :2], rtol=0, atol=1e-9 / A * 10)
    np.testing.assert_allclose(got[:, 2:], expected[:, 2:], rtol=1e-7, atol=1e-8)


def test_a_track_is_extrapolated_and_its_sigma_grows():
    filter_ = Filter(registry.by_name("gps-track"), Settings(), Initial(), 100.0)
    for k in range(30):
        filter_.update(fix_at(float(k), 0.8, 0.3 + 2e-6 * k))
    now, later = one_row(filter_, 29.0), one_row(filter_, 34.0)
    east, north, _ = geodetic2enu(later["lat"], later["lon"], 0.0, now["lat"], now["lon"], 0.0, deg=False)
    assert [north, east] == pytest.approx([5 * now["v"][0], 5 * now["v"][1]], abs=0.01)
    assert (later["sigma_p"][:2] > 3 * now["sigma_p"][:2]).all()
    assert now["status"] == POSITION_VALID
    assert later["status"] == POSITION_VALID | COASTING
    assert np.isnan([now["height"], now["v"][2], now["sigma_p"][2], *now["q_nb"], *now["sigma_rpy"]]).all()


def test_a_track_over_the_date_line():
    filter_ = Filter(registry.by_name("gps-track"), Settings(), Initial(), 100.0)
    for k in range(60):
        lon = math.pi - 1e-4 + 4e-6 * k
        filter_.update(fix_at(float(k), 0.1, lon if lon < math.pi else lon - 2 * math.pi))
    row = one_row(filter_, 59.0)
    assert -math.pi <= row["lon"] < -math.pi + 2e-4
    assert row["v"][1] == pytest.approx(4e-6 * curvature(0.1)[1] * math.cos(0.1), rel=1e-3)


def test_fixes_that_are_none_or_old_are_not_used_and_reported_sigmas_are():
    filter_ = Filter(registry.by_name("gps-track"), Settings(), Initial(), 100.0)
    assert one_row(filter_, 0.5)["status"] == 0
    filter_.update(fix_at(1.0, 0.8, 0.3, sigma=(0.02, 0.03, 0.05)))
    assert one_row(filter_, 1.0)["sigma_p"][:2] == pytest.approx([0.02, 0.03])
    for bad in (fix_at(2.0, np.nan, 0.3), fix_at(2.0, 0.8, 0.3, quality=0), fix_at(0.5, 0.8, 0.3)):
        assert len(filter_.update(bad)) == 0
    assert len(filter_.update(fix_at(2.0, 0.8, 0.3))) == 2


def quat_product(a, b):
    w, v, u, x = a[0], a[1:], b[0], b[1:]
    return np.concatenate([[w * u - v @ x], w * x + u * v + np.cross(v, x)])


def rotated(q, v):
    return quat_product(quat_product(q, np.concatenate([[0.0], v])), q * [1, -1, -1, -1])[1:]


def dense_ins(samples, T, Q, R):
    """Nine states per the paper with block matrices; dead reckoning with full rotations; p, v, a and P per sample."""
    w, f = samples["w"], samples["f"]
    rest = round(5.0 / T) + 1
    bg, mean = w[:rest].mean(axis=0), f[:rest].mean(axis=0)
    g = np.linalg.norm(mean)
    roll, pitch = math.atan2(-mean[1], -mean[2]), math.atan2(mean[0], math.hypot(mean[1], mean[2]))
    q = quat_product(
        np.array([math.cos(pitch / 2), 0, math.sin(pitch / 2), 0]),
        np.array([math.cos(roll / 2), math.sin(roll / 2), 0, 0]),
    )
    Phi = np.kron(np.eye(3), [[1, T, T * T / 2], [0, 1, T], [0, 0, 1]])
    G = np.kron(np.eye(3), [[T * T / 2], [T], [1]])
    H = np.kron(np.eye(3), [[1, 0, 0]])
    x, P, v, p = np.zeros(9), np.zeros((9, 9)), np.zeros(3), np.zeros(3)
    out = []
    for k in range(rest, len(w)):
        before = rotated(q, f[k - 1])
        angle = T * (0.5 * (w[k - 1] + w[k]) - bg)
        size = np.linalg.norm(angle)
        q = quat_product(q, np.concatenate([[math.cos(size / 2)], math.sin(size / 2) / size * angle]))
        a = 0.5 * (before + rotated(q, f[k])) + [0, 0, g]
        p, v = p + T * v + 0.5 * T * T * a, v + T * a
        x, P = Phi @ x, Phi @ P @ Phi.T + Q * T * G @ G.T
        W = P @ H.T @ np.linalg.inv(H @ P @ H.T + R * np.eye(3))
        x = x + W @ (p - H @ x)
        A_ = np.eye(9) - W @ H
        P = A_ @ P @ A_.T + R * W @ W.T
        out.append([*x.reshape(3, 3).T.ravel(), P[0, 0], P[1, 1], P[8, 8]])
    return np.array(out)


def carried(seconds=15.0, rate=100.0):
    """A body that rests tilted for 6 s, then turns and is pushed about."""
    t = np.arange(int(seconds * rate)) / rate
    go = np.maximum(t - 6.0, 0.0)
    w = np.column_stack([0.3 * np.sin(2 * go), -0.2 * np.sin(go), 0.5 * np.sin(0.7 * go)])
    f = np.tile([0.5, -1.0, -9.7], (len(t), 1)) + np.column_stack(
        [np.sin(3 * go), 0.5 * np.sin(go), 0.2 * np.sin(5 * go)]
    )
    return m_g350(np.random.default_rng(6), t, w, f), 1.0 / rate


def test_the_ins_filter_agrees_with_a_dense_one():
    samples, T = carried()
    expected = dense_ins(samples, T, 0.9, 0.4)
    settings = Settings(imu=Imu(profile="m-g350"), ins9=Ins9(acceleration_walk=0.9, distance_var=0.4))
    filter_ = Filter(registry.by_name("ins9"), settings, Initial(), 1 / T)
    got, out = [], np.zeros(1, SOLUTION)
    for k in range(len(samples)):
        filter_.run(samples[k : k + 1], out)
        s = filter_.state[0]
        got.append([*s["p"], *s["v"], *s["a"], s["P"][0], s["P"][3], s["P"][5]])
    got = np.array(got)[-len(expected) :]
    assert np.abs(got[-1, :3]).max() > 1.0
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9)


def test_the_row_of_the_ins():
    samples, _ = carried()
    known = Initial(lat_deg=45.0, lon_deg=8.0, height_m=100.0, yaw_deg=20.0)
    rows = {}
    for name, initial in (("known", known), ("unknown", Initial())):
        out = np.zeros(len(samples), SOLUTION)
        Filter(registry.by_name("ins9"), Settings(imu=Imu(profile="m-g350")), initial, 100.0).run(samples.copy(), out)
        rows[name] = out
    at_rest, end = rows["known"][300], rows["known"][-1]
    valid = ATTITUDE_VALID | HEADING_VALID | POSITION_VALID | HEIGHT_VALID
    assert (at_rest["status"], end["status"]) == (valid | AT_REST, valid | COASTING)
    assert (end["sigma_p"] > 10 * at_rest["sigma_p"]).all()
    assert rows["unknown"][-1]["status"] == ATTITUDE_VALID | COASTING
    assert np.isnan(rows["unknown"][-1]["lat"])
    east, north, up = geodetic2enu(np.degrees(end["lat"]), np.degrees(end["lon"]), end["height"], 45.0, 8.0, 100.0)
    filter_ = Filter(registry.by_name("ins9"), Settings(imu=Imu(profile="m-g350")), known, 100.0)
    filter_.run(samples.copy(), np.zeros(len(samples), SOLUTION))
    np.testing.assert_allclose([north, east, -up], filter_.state["p"][0], atol=5e-3)


def test_the_first_fix_is_the_origin():
    samples, _ = carried()
    filter_ = Filter(registry.by_name("ins9"), Settings(), Initial(), 100.0)
    out = np.zeros(len(samples), SOLUTION)
    filter_.update(fix_at(0.0, 0.7, 0.1, height=30.0, sigma=(0.1, 0.1, 0.2)))
    filter_.update(fix_at(1.0, 0.9, 0.2, height=30.0))  # says nothing new
    filter_.run(samples, out)
    assert out["lat"][100] == pytest.approx(0.7, abs=1e-12)
    assert out["sigma_p"][100] == pytest.approx([0.1, 0.1, 0.2], abs=1e-3)


def test_the_devices_own_tilt_is_used():
    t = np.arange(1000) / 100.0
    c, s = math.cos(0.4), math.sin(0.4)
    samples = samples_of(t, *level_at_rest(len(t)))
    samples["down"] = (0.0, s, c)  # roll 0.4
    samples["f"] = -9.80665 * samples["down"]
    samples["w"][600:, 0] = 1.0  # a gyro gone wild
    out = np.zeros(len(t), SOLUTION)
    Filter(registry.by_name("ins9"), Settings(imu=Imu(profile="m-g350")), Initial(yaw_deg=0.0), 100.0).run(samples, out)
    q = out["q_nb"][-1]
    assert 2 * math.atan2(q[1], q[0]) == pytest.approx(0.4, abs=1e-9)


def test_the_sigmas_of_dead_reckoning_are_those_of_many_runs():
    """30 sensors at rest: after 20 s the spread of the reckoned positions is what the filter says."""
    errors = []
    for seed in range(30):
        t = np.arange(2500) / 100.0
        samples = m_g350(np.random.default_rng(seed), t, *level_at_rest(len(t)))
        filter_ = Filter(
            registry.by_name("ins9"), Settings(imu=Imu(profile="m-g350")), Initial(lat_deg=0.0, lon_deg=0.0), 100.0
        )
        out = np.zeros(len(t), SOLUTION)
        filter_.run(samples, out)
        distance_var, _ = ins9.reckoning_variance(filter_.parameters[0], filter_.state[0], 0)
        errors.append(filter_.state["p"][0][:2] / np.sqrt(distance_var + filter_.state["P"][0, 0]))
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) < 1.3


def test_the_claims_hold():
    report = prasanna.reproduce(1)
    assert report.failed == []
    assert sum(row.holds is True for row in report.rows) >= 18
