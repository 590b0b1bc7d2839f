"""The strapdown kernel against a plain-numpy mechanization in the earth-centred frame, and against a closed path."""

import math

import numpy as np
import pymap3d
import pytest
from in_c import in_c
from navigation_simulation import RATE, curvature, drive, normal_gravity
from scipy.spatial.transform import Rotation

from imud.estimators.ins.core import CORE
from imud.estimators.ins.mechanization import integrate_strapdown
from imud.math.rotation import wrap_angle

integrate_strapdown = in_c(integrate_strapdown)


def core_at(lat, lon, height, v, attitude, w, f):
    c = np.zeros(1, CORE)[0]
    c["nav"]["lat"], c["nav"]["lon"], c["nav"]["height"], c["nav"]["v_n"] = lat, lon, height, v
    c["nav"]["q_nb"] = np.roll(attitude.as_quat(), 1)
    c["imu"]["w"], c["imu"]["f"] = w, f
    return c


def run(c, w, f, dt):
    for k in range(1, len(w)):
        integrate_strapdown(c, w[k], f[k], dt)
        c["imu"]["w"], c["imu"]["f"] = w[k], f[k]


def ned_of(lat, lon):
    """Matrices (n, 3, 3) from the earth-centred frame to north, east, down, at n places."""
    sl, cl, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    rows = [[-sl * co, -sl * so, cl], [-so, co, np.zeros_like(lat)], [-cl * co, -cl * so, -sl]]
    return np.moveaxis(np.array(rows), -1, 0)


def earth_centred(lat, lon, height, v, attitude, w, f, dt, substeps=4):
    """Position, velocity (NED), attitude by midpoint steps in the turning earth-centred frame, rates linear in time.

    Of n bodies, which begin at latitudes `lat` and move alike.
    """
    r = np.column_stack(pymap3d.geodetic2ecef(lat, np.full_like(lat, lon), np.full_like(lat, height), deg=False))
    first = ned_of(lat, np.full_like(lat, lon))
    u = v @ first
    c = Rotation.from_matrix(np.swapaxes(first, 1, 2)) * attitude
    spin = np.array([0.0, 0.0, RATE])

    def pull(r):
        la, lo, h = pymap3d.ecef2geodetic(*r.T, deg=False)
        return normal_gravity(la, h)[:, None] * ned_of(la, lo)[:, 2]

    h = dt / substeps
    half_back, back = (Rotation.from_rotvec(-spin * part) for part in (h / 2, h))
    for k in range(1, len(w)):
        for j in range(substeps):
            s = (j + 0.5) / substeps
            wm, fm = w[k - 1] + s * (w[k] - w[k - 1]), f[k - 1] + s * (f[k] - f[k - 1])
            half = half_back * c * Rotation.from_rotvec(wm * h / 2)
            middle = u + 0.5 * h * (c.apply(fm) + pull(r) - 2 * np.cross(spin, u))
            u_new = u + h * (half.apply(fm) + pull(r + 0.5 * h * u) - 2 * np.cross(spin, middle))
            r = r + 0.5 * h * (u + u_new)
            c = back * c * Rotation.from_rotvec(wm * h)
            u = u_new
    la, lo, ht = pymap3d.ecef2geodetic(*r.T, deg=False)
    down = ned_of(la, lo)
    return la, lo, ht, np.einsum("nij,nj->ni", down, u), Rotation.from_matrix(down) * c


@pytest.mark.thorough
def test_agrees_with_an_earth_centred_mechanization_under_hard_motion():
    rng = np.random.default_rng(1)
    dt, n = 0.0025, 800
    t = np.arange(n) * dt
    phase = rng.uniform(0, 6, (6, 3))
    w = 1.5 * np.sin(9.0 * t[:, None] + phase[0]) + 0.7 * np.sin(4.0 * t[:, None] + phase[1])
    f = 4.0 * np.sin(8.0 * t[:, None] + phase[2]) + (0, 0, -9.8)
    v = np.array([30.0, -20.0, 1.0])
    attitude = Rotation.from_euler("ZYX", [1.0, 0.2, -0.3])
    latitudes = np.array([-0.9, 0.3, 1.2])
    truth = earth_centred(latitudes, 2.0, 300.0, v, attitude, w, f, dt)
    for lat, la, lo, h, v_ned, end in zip(latitudes, *truth, strict=True):
        c = core_at(lat, 2.0, 300.0, v, attitude, w[0], f[0])
        run(c, w, f, dt)
        meridian, prime_vertical = curvature(lat)
        assert abs(c["nav"]["lat"] - la) * meridian < 2e-3
        assert abs(c["nav"]["lon"] - lo) * prime_vertical * math.cos(lat) < 2e-3
        assert abs(c["nav"]["height"] - h) < 2e-3
        assert np.abs(c["nav"]["v_n"] - v_ned).max() < 1e-4
        assert (end * Rotation.from_quat(np.roll(c["nav"]["q_nb"], -1)).inv()).magnitude() < 1e-5
        assert np.linalg.norm(c["nav"]["q_nb"]) == pytest.approx(1.0, abs=1e-12)


def test_coning_terms_matter_and_are_right():
    """Classical coning: without the term the drift is twice as large (the other half is the trapezoid's own)."""
    dt, n, rate, angle = 0.01, 1000, 40.0, 0.05
    t = np.arange(n) * dt
    truth = Rotation.from_rotvec(angle * np.column_stack([np.cos(rate * t), np.sin(rate * t), 0 * t]))
    fine = 1e-6
    ahead = Rotation.from_rotvec(angle * np.column_stack([np.cos(rate * (t + fine)), np.sin(rate * (t + fine)), 0 * t]))
    w = (truth.inv() * ahead).as_rotvec() / fine
    c = core_at(0.0, 0.0, 0.0, np.zeros(3), truth[0], w[0], np.zeros(3))
    plain = truth[0]
    for k in range(1, n):
        integrate_strapdown(c, w[k], np.zeros(3), dt)
        c["imu"]["w"], c["nav"]["v_n"] = w[k], 0.0
        plain = plain * Rotation.from_rotvec(0.5 * (w[k] + w[k - 1]) * dt)
    earth = Rotation.from_rotvec([RATE * t[-1], 0.0, 0.0])
    drift = (truth[-1].inv() * earth * Rotation.from_quat(np.roll(c["nav"]["q_nb"], -1))).magnitude()
    drift_plain = (truth[-1].inv() * plain).magnitude()
    assert 0.4 * drift_plain < drift < 0.55 * drift_plain


def test_follows_a_simulated_drive():
    d = drive(60.0, rate=200, rest=5.0)
    c = core_at(d.lat[0], d.lon[0], d.height[0], d.v[0], d.attitude[0], d.w[0], d.f[0])
    run(c, d.w, d.f, 1 / 200)
    assert np.abs(c["nav"]["v_n"] - d.v[-1]).max() < 0.02
    assert abs(c["nav"]["lat"] - d.lat[-1]) * 6.37e6 < 0.5
    assert (d.attitude[-1] * Rotation.from_quat(np.roll(c["nav"]["q_nb"], -1)).inv()).magnitude() < 1e-4


def test_longitude_wraps_and_poles_stay_finite():
    assert wrap_angle(math.pi + 0.1) == pytest.approx(-math.pi + 0.1)
    still = np.array([0.0, 0.0, -9.8])
    c = core_at(0.5, math.pi - 1e-7, 0.0, [0.0, 50.0, 0.0], Rotation.identity(), np.zeros(3), still)
    run(c, np.zeros((200, 3)), np.tile(still, (200, 1)), 0.01)
    assert -math.pi <= c["nav"]["lon"] < -3.0
    c = core_at(0.5 * math.pi - 1e-6, 0.0, 0.0, [50.0, 5.0, 0.0], Rotation.identity(), np.zeros(3), still)
    run(c, np.zeros((2000, 3)), np.tile(still, (2000, 1)), 0.01)
    assert np.isfinite([c["nav"]["lat"], c["nav"]["lon"], *c["nav"]["v_n"], *c["nav"]["q_nb"]]).all()
    assert abs(c["nav"]["lat"]) <= 0.5 * math.pi
