"""Where filters break: an hour at rest at 1 kHz, the poles, the date line, upside down and standing on end."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated import G350, M_G350, ImuErrors, estimated, rpy, samples_of, unknown_fixes

from imud.configuration.settings import Initial
from imud.estimators import registry
from imud.estimators.records import AT_REST, ATTITUDE_VALID, POSITION_VALID, SOLUTION
from imud.pipeline import Filter

G = 9.80665
RATE_HZ, HOUR_S = 1000, 3600
LAT, LON = math.radians(48.0), math.radians(11.0)
EARTH = 7.292115e-5 * np.array([math.cos(LAT), 0.0, -math.sin(LAT)])
KNOW_ATTITUDE = ("attitude", "navigation", "tilt", "stationary", "suh-standard", "suh-adaptive", "suh-two-step", "ins9")
KNOW_POSITION = ("navigation", "stationary", "gps-track", "ins9")


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "received"), [("attitude", False), ("navigation", True), ("navigation", False)])
def test_an_hour_at_rest_at_1_khz(name, received):
    """3.6 million samples of an M-G350: errors stay within their sigmas, which stay small."""
    rng = np.random.default_rng(21)
    errors = ImuErrors(M_G350, rng, RATE_HZ)
    filter_ = Filter(registry.by_name(name), G350, Initial(), RATE_HZ)
    ideal = np.tile([*EARTH, 0.0, 0.0, -G], (RATE_HZ, 1))
    fix, out = unknown_fixes(1), np.zeros(RATE_HZ, SOLUTION)
    fix["speed"], fix["hdop"] = 0.0, 1.0
    wander, rows = np.zeros(3), []
    for second in range(HOUR_S):
        samples = samples_of(second + np.arange(RATE_HZ) / RATE_HZ, errors.corrupt(ideal))
        filter_.run(samples, out)
        if received:
            wander += -wander / 30.0 + 0.4 * rng.standard_normal(3)
            fix["t_ns"], fix["arrival_ns"] = samples["t_ns"][0], samples["t_ns"][200]
            fix["lat"], fix["lon"] = LAT + wander[0] / 6.37e6, LON + wander[1] / (6.39e6 * math.cos(LAT))
            fix["height"] = 500.0 + wander[2]
            filter_.update(fix)
        rows.append(out[-1].copy())
    rows = np.array(rows)[60:]
    assert (rows["status"] & (ATTITUDE_VALID | AT_REST) == ATTITUDE_VALID | AT_REST).mean() > 0.99
    tilt = rpy(rows["q_nb"])[:, :2]
    assert (np.abs(tilt) < 4.0 * rows["sigma_rpy"][:, :2]).all()
    assert np.degrees(rows["sigma_rpy"][-1, :2]).max() < 0.6  # 8 mg
    assert (np.abs(rows["bg"][-1] - errors.bias[:3]) < 1e-3).all()
    assert np.isfinite(rows["sigma_bg"]).all()
    if received:
        assert (rows["status"] & POSITION_VALID > 0).all()
        north, east = (rows["lat"] - LAT) * 6.37e6, (rows["lon"] - LON) * 6.39e6 * math.cos(LAT)
        assert (np.hypot(north, east) < 4.0 * np.hypot(*rows["sigma_p"][:, :2].T)).all()
        assert np.hypot(north, east).max() < 8.0
        assert np.abs(rows["v"]).max() < 0.2
    else:
        assert np.isnan(rows["lat"]).all()


@pytest.mark.parametrize("name", ["tilt", "stationary", "suh-standard", "suh-adaptive", "suh-two-step"])
def test_an_hour_at_rest_of_the_others(name):
    """72,000 samples at 20 Hz, Suh's rate: the tilt stays within its sigmas, and these what they were."""
    rng = np.random.default_rng(24)
    ideal = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, -G], (20 * HOUR_S, 1))
    values = ImuErrors(M_G350, rng, 20).corrupt(ideal)
    out, _ = estimated(name, samples_of(np.arange(len(ideal)) / 20.0, values), every=20)
    late = out[60:]
    assert (late["status"] & ATTITUDE_VALID > 0).all()
    tilt = rpy(late["q_nb"])[:, :2]
    assert (np.abs(tilt) < 4.0 * late["sigma_rpy"][:, :2]).all()
    assert np.degrees(np.abs(tilt)).max() < 4.0 * 0.6  # 8 mg, 1 sigma
    np.testing.assert_allclose(late["sigma_rpy"][-600:, :2].mean(), late["sigma_rpy"][:600, :2].mean(), rtol=0.05)


@pytest.mark.parametrize("name", KNOW_ATTITUDE)
@pytest.mark.parametrize(
    "angles", [(180, 0, 0), (0, 180, 0), (0, 90, 0), (0, -90, 0), (90, 0, 0), (-90, 30, 0), (179, 89, 5)]
)
def test_every_attitude_at_rest(name, angles):
    """Roll, pitch, yaw in deg: down is known in the body wherever it points, and every number is one."""
    roll, pitch, yaw = angles
    attitude = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)
    down = attitude.inv().apply([0.0, 0.0, 1.0])
    rng = np.random.default_rng(22)
    n = 1200
    w = attitude.inv().apply(EARTH) + 5e-4 * rng.standard_normal((n, 3))
    f = -G * down + 6e-3 * rng.standard_normal((n, 3))
    out, _ = estimated(name, samples_of(np.arange(n) / 100.0, np.hstack([w, f])))
    q = out["q_nb"][600:]
    assert np.isfinite(q).all()
    seen = Rotation.from_quat(np.roll(q, -1, axis=1)).inv().apply([0.0, 0.0, 1.0])
    off = np.degrees(2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(seen - down, axis=1), 1.0)))
    assert off.max() < 1.0
    assert np.isfinite(out["sigma_rpy"][600:]).all()
    assert (out["sigma_rpy"][600:] <= math.pi).all()


def resting(lat_deg, lon_deg, n=40, east_mps=0.0):
    """Fixes once per second of a receiver that goes east, and samples at 100 Hz of a level sensor at rest."""
    fixes = unknown_fixes(n)
    t = np.arange(n) + 0.5
    fixes["t_ns"] = 1_000_000_000 + np.rint(t * 1e9).astype(np.int64)
    fixes["arrival_ns"] = fixes["t_ns"] + 100_000_000
    cosine = max(math.cos(math.radians(lat_deg)), 1e-9)
    lon = math.radians(lon_deg) + east_mps * t / (6.38e6 * cosine)
    fixes["lat"], fixes["lon"] = math.radians(lat_deg), (lon + np.pi) % (2.0 * np.pi) - np.pi
    fixes["height"], fixes["hdop"], fixes["speed"], fixes["course"] = 100.0, 1.0, east_mps, 0.5 * np.pi
    values = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, -9.81], (100 * n, 1))
    values += np.random.default_rng(23).normal(0.0, [5e-4] * 3 + [6e-3] * 3, values.shape)
    return samples_of(np.arange(100 * n) / 100.0, values), fixes


@pytest.mark.parametrize("name", KNOW_POSITION)
@pytest.mark.parametrize("lat_deg", [90.0, -90.0, 89.99999, -89.9])
def test_everything_is_finite_at_the_poles(name, lat_deg):
    out, _ = estimated(name, *resting(lat_deg, 30.0), initial=Initial(yaw_deg=0.0))
    out = out[500:]
    assert (out["status"] & POSITION_VALID > 0).all()
    for column in ("lat", "lon", "v", "sigma_p", "sigma_v"):
        known = out[column] if name != "gps-track" or out[column].ndim == 1 else out[column][:, :2]
        assert np.isfinite(known).all()
    assert (np.abs(out["lat"]) <= 0.5 * math.pi).all()
    assert np.abs(out["lat"] - math.radians(lat_deg)).max() * 6.4e6 < 10.0
    assert (np.abs(out["lon"]) <= math.pi).all()


@pytest.mark.parametrize("name", KNOW_POSITION)
def test_across_the_date_line(name):
    """The track goes east from 179.9999 deg; what only rests has its origin there and dithers across."""
    going = 2.0 if name == "gps-track" else 0.0
    samples, fixes = resting(10.0, 179.99999 if name == "gps-track" else 180.0 - 1e-10, east_mps=going)
    if name == "ins9":
        samples["f"][600:800, 1] += 1.0  # 1 m/s^2 east for 2 s
    out, _ = estimated(name, samples, fixes, initial=Initial(yaw_deg=0.0))
    out = out[500:]
    assert ((out["lon"] >= -math.pi) & (out["lon"] < math.pi)).all()
    if name in ("gps-track", "ins9"):
        assert out["lon"][-1] < 0.0
    east = (out["lon"] % (2.0 * math.pi) - math.pi) * 6.38e6 * math.cos(math.radians(10.0))
    assert np.abs(np.diff(east)).max() < 1.0  # no leap
