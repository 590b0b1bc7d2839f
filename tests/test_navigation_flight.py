"""A multicopter: idle motors, take-off, moves and hovering. It is no land vehicle, and hovering is no rest."""

from functools import cache

import numpy as np
import pytest
from navigation_runner import navigate, samples_of, settings_of
from navigation_simulation import Drive, curvature, errors, ideal_sensor, received
from scipy.spatial.transform import Rotation

from imud.estimators.records import AT_REST, HEADING_VALID

RATE, SECONDS, IDLE_S, AIRBORNE_S = 200, 110, 3.0, 10.0
HOVER_S, OUTAGE_S = (45.0, 65.0), (75.0, 95.0)


def smooth(x, seconds):
    kernel = np.hanning(round(2 * seconds * RATE))
    return np.convolve(x, kernel / kernel.sum(), "same")


@cache
def flight(seed):
    """Moves of some m/s with the tilt that they need, a jitter of the position held, yaw as it likes."""
    rng = np.random.default_rng(seed)
    t = np.arange(SECONDS * RATE) / RATE
    n, block = len(t), 3 * RATE
    aloft = np.clip((t - AIRBORNE_S) / 2.0, 0.0, 1.0)
    free = aloft * (1.0 - np.clip((t - HOVER_S[0]) / 2, 0, 1) * np.clip((HOVER_S[1] - t) / 2, 0, 1))
    moves = lambda sigma: smooth(np.repeat(sigma * rng.standard_normal(n // block + 1), block)[:n], 0.8)  # noqa: E731
    jitter = lambda sigma: sigma * smooth(np.sqrt(RATE) * rng.standard_normal(n), 0.4)  # noqa: E731
    climb = -smooth(((t > AIRBORNE_S) & (t < AIRBORNE_S + 3.0)).astype(float), 0.5)
    v = np.column_stack([free * moves(s) + aloft * jitter(0.05) for s in (1.5, 1.5, 0.5)])
    v[:, 2] += climb
    yaw = rng.uniform(-3.0, 3.0) + aloft * smooth(moves(1.0), 1.0)
    level = Rotation.from_euler("Z", yaw[:, None]).inv().apply(np.gradient(v, t, axis=0))
    pitch = aloft * (jitter(0.005) - np.arctan(level[:, 0] / 9.8)) + 0.01
    roll = aloft * (jitter(0.005) + np.arctan(level[:, 1] / 9.8)) - 0.015
    attitude = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))
    way = np.cumsum(v, axis=0) / RATE
    north, east = curvature(np.radians(48.0))
    lat, height = np.radians(48.0) + way[:, 0] / north, 500.0 - way[:, 2]
    lon = np.radians(11.0) + way[:, 1] / (east * np.cos(lat))
    return Drive(t, lat, lon, height, v, attitude, *ideal_sensor(t, lat, height, v, attitude))


def shaken(d, rng, strength):
    """SAMPLE rows of a consumer sensor over motors at 70 revolutions a second; biases 1 deg/s and 0.2 m/s2.

    Its scale factors are 1 % off, its axes 0.35 %.
    """
    motors = strength * np.where(d.t < IDLE_S, 0.0, np.where(d.t < AIRBORNE_S, 0.25, 1.0))[:, None]
    tone = np.sin(2 * np.pi * 70.0 * d.t[:, None] + np.arange(3))
    rough = [np.diff(rng.standard_normal((len(d.t) + 1, 3)), axis=0) for _ in range(2)]
    w = d.w + np.radians(rng.standard_normal(3)) + motors * (0.04 * tone + 0.02 * rough[0])
    f = d.f + 0.2 * rng.standard_normal(3) + motors * (0.8 * tone + 0.5 * rough[1])
    w, f = w + 0.0024 * rng.standard_normal(w.shape), f + 0.03 * rng.standard_normal(f.shape)
    return samples_of(100.0 + d.t, w + w @ (rng.standard_normal((3, 3)) * (0.0035 + 0.0065 * np.eye(3))), f)


def fly(seed, kind):
    """Truth and what the filter makes of it, with an outage of the fixes."""
    d, rng = flight(seed), np.random.default_rng([7, seed])
    samples = shaken(d, rng, 1.0)
    if kind == "rtk":
        fixes = received(d, rng, every=0.2, late=0.05, sigma=0.0, white=0.02)
        fixes["speed"] = fixes["course"] = fixes["hdop"] = np.nan
        fixes["sigma"] = (0.02, 0.02, 0.04)
    else:
        white, speed = (1.5, 0.15) if kind == "nmea" else (0.1, 0.05)
        fixes = received(d, rng, every=1.0, late=0.2, sigma=1.5, white=white, speed_sigma=speed)
    t = fixes["t_ns"] * 1e-9 - 100.0
    return d, *navigate(samples, fixes[(t < OUTAGE_S[0]) | (t > OUTAGE_S[1])], settings_of())


@pytest.mark.parametrize("kind", ["receiver", "nmea", "rtk"])
def test_it_flies_free_and_its_sigmas_are_honest_through_an_outage(kind):
    squares = []
    for seed in range(3):
        d, out, _, state = fly(seed, kind)
        p, v, a = errors(d, out)
        status = out["status"]
        assert state["core"][0, 0]["nhc"]["enabled"] == 0
        assert not (status[d.t > AIRBORNE_S + 1.0] & AT_REST).any()
        assert (status[d.t > 45.0] & HEADING_VALID).all()
        end = np.searchsorted(d.t, OUTAGE_S[1]) - 1
        assert (np.abs(p[end]) < 4.0 * out["sigma_p"][end]).all()
        assert np.hypot(*p[end, :2]) < 40.0
        k = (d.t > 40.0) & (np.arange(len(d.t)) % RATE == 0)
        assert np.abs(a[k, :2]).max() < np.radians(1.5)
        tilt = a[k, :2] / out["sigma_rpy"][k, :2]
        squares.append([np.mean(e**2) for e in (p[k] / out["sigma_p"][k], v[k] / out["sigma_v"][k], tilt)])
    for nees in np.mean(squares, axis=0):
        assert 0.1 < nees < 2.0


def test_hovering_smoothly_is_no_rest_even_where_the_filter_has_seen_nothing_else():
    d = flight(1)
    rng = np.random.default_rng(5)
    samples, fixes = shaken(d, rng, 0.1), received(d, rng, late=0.2, sigma=1.5)
    hover = (d.t > HOVER_S[0] + 2.0) & (d.t < HOVER_S[1])
    begin = 100.0 + HOVER_S[0] + 2.0
    out, _, _ = navigate(samples[hover], fixes[(fixes["t_ns"] > begin * 1e9) & (fixes["t_ns"] < 165e9)])
    assert not (out["status"] & AT_REST).any()
    assert not (out["status"] & HEADING_VALID).any()  # nothing tells it
