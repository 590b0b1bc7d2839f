"""Starts in flight: roll, pitch and heading of an aircraft that turns from the first sample on, and its constraint."""

import numpy as np
import pytest
from navigation_runner import navigate, samples_of
from navigation_simulation import Drive, curvature, errors, ideal_sensor, received
from scipy.spatial.transform import Rotation

from imud.estimators.records import HEADING_VALID

RATE, SPEED, G = 100, 18.0, 9.81


def turns(seconds, bank_deg):
    """A plane in coordinated turns to one side and to the other; the nose is 3 deg up."""
    t = np.arange(seconds * RATE) / RATE
    side = np.tanh(2.0 * np.sin(2.0 * np.pi * (t + 4.0) / 30.0))
    roll = np.convolve(np.radians(bank_deg) * side, np.hanning(100) / np.hanning(100).sum(), "same")
    course = 0.5 + np.cumsum(G * np.tan(roll) / SPEED) / RATE
    v = SPEED * np.column_stack([np.cos(course), np.sin(course), 0.0 * t])
    attitude = Rotation.from_euler("ZYX", np.column_stack([course, 0.05 + 0.0 * t, roll]))
    way = np.cumsum(v, axis=0) / RATE
    north, east = curvature(np.radians(48.0))
    lat, height = np.radians(48.0) + way[:, 0] / north, 500.0 + 0.0 * t
    lon = np.radians(11.0) + way[:, 1] / (east * np.cos(lat))
    return Drive(t, lat, lon, height, v, attitude, *ideal_sensor(t, lat, height, v, attitude))


def fly(d, seed, every):
    """(solutions, state); gyro biases of some 0.5 deg/s, 0.1 m/s^2, and a receiver that is 0.15 s late."""
    rng = np.random.default_rng(seed)
    w = d.w + np.radians(0.5 * rng.standard_normal(3)) + 0.002 * rng.standard_normal(d.w.shape)
    f = d.f + 0.1 * rng.standard_normal(3) + 0.05 * rng.standard_normal(d.f.shape)
    fixes = received(d, rng, every=every, late=0.15, sigma=1.0, white=0.3)
    out, _, state = navigate(samples_of(100.0 + d.t, w, f), fixes)
    return out, state["core"][0, 0]


def tilt_deg(d, out):
    down = Rotation.from_quat(np.roll(out["q_nb"], -1, axis=1)).inv().apply([0.0, 0.0, 1.0])
    return np.degrees(np.arccos(np.clip(np.sum(down * d.attitude.inv().apply([0.0, 0.0, 1.0]), axis=1), -1.0, 1.0)))


@pytest.mark.parametrize("every", [0.2, 1.0])
@pytest.mark.parametrize("bank_deg", [30.0, 50.0])
def test_a_start_in_a_turn_finds_roll_and_pitch_and_then_the_heading(bank_deg, every):
    """Levelled by mean forces alone, it found no heading within the minute."""
    d = turns(60, bank_deg)
    largest_tilt = []
    for seed in range(3):
        out, _ = fly(d, seed, every)
        yaw, sigma = np.abs(errors(d, out)[2][:, 2]), out["sigma_rpy"][:, 2]
        valid = (out["status"] & HEADING_VALID) > 0
        assert valid.any() and d.t[np.argmax(valid)] < 35.0
        largest_tilt.append(tilt_deg(d, out)[d.t > 25.0].max())
        assert not (valid & (yaw > np.radians(5.0)) & (yaw > 4.0 * sigma)).any()
    assert np.mean(largest_tilt) < 5.0 and max(largest_tilt) < 6.7


def test_who_leans_like_an_aircraft_is_no_land_vehicle():
    """Its velocity keeps to its axis as a car's does."""
    d = turns(120, 40.0)
    out, c = fly(d, 1, 0.2)
    assert c["nhc"]["enabled"] == 0
    assert (out["status"][d.t > 60.0] & HEADING_VALID).all()
