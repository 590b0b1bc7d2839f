"""Scale factors and misalignments of the gyros, which a flight with rolls, climbs and banked turns shows."""

from dataclasses import fields

import numpy as np
import pytest
from msgspec.structs import replace
from navigation_runner import navigate, settings_of
from navigation_simulation import Drive, curvature, errors, ideal_sensor, received, sensed
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Noise
from imud.estimators.ins.state import GYRO_SCALE, STATES
from imud.math.kalman import unpack

RATE, SECONDS, AIRBORNE_S = 100, 180, 20.0


def flight():
    """A plane at 18 m/s: coordinated turns to both sides, climbs and dives, and a roll every 17 s from 40 s on."""
    t = np.arange(SECONDS * RATE) / RATE
    aloft = np.clip((t - AIRBORNE_S) / 5.0, 0.0, 1.0)
    aloft = aloft**2 * (3.0 - 2.0 * aloft)
    speed = aloft * (18.0 + 3.0 * np.sin(t / 7.0))
    track = 0.7 + np.cumsum(aloft * (0.3 * np.sin(t / 6.0) + 0.25 * np.sin(t / 2.6))) / RATE
    climb = aloft * 0.3 * np.sin(t / 4.1)
    v = np.column_stack([np.cos(climb) * np.cos(track), np.cos(climb) * np.sin(track), -np.sin(climb)]) * speed[:, None]
    lift = Rotation.from_euler("Z", track[:, None]).inv().apply(np.gradient(v, t, axis=0) - (0.0, 0.0, 9.81))
    roll = np.arctan2(lift[:, 1], -lift[:, 2])
    for k, begin in enumerate(range(40, SECONDS - 10, 17)):
        part = np.clip((t - begin) / 2.0, 0.0, 1.0)
        roll += (-1) ** k * 2.0 * np.pi * part**2 * (3.0 - 2.0 * part)
    attitude = Rotation.from_euler("ZYX", np.column_stack([track, climb, roll]))
    way, (north, east) = np.cumsum(v, axis=0) / RATE, curvature(np.radians(48.0))
    lat, height = np.radians(48.0) + way[:, 0] / north, 500.0 - way[:, 2]
    lon = np.radians(11.0) + way[:, 1] / (east * np.cos(lat))
    return Drive(t, lat, lon, height, v, attitude, *ideal_sensor(t, lat, height, v, attitude))


def flown(seed, seconds, settings=None):
    """A flight with a consumer's sensor; errors and sigmas of its scale factors and misalignments in the end."""
    rng, d = np.random.default_rng(seed), flight()
    d = Drive(*(getattr(d, field.name)[: seconds * RATE] for field in fields(Drive)))
    M = rng.standard_normal((3, 3)) * (0.0067 + 0.0033 * np.eye(3))
    d.w = d.w + d.w @ M.T
    out, _, state = navigate(
        sensed(d, rng), received(d, rng, late=0.1), settings or settings_of(profile="consumer-mems")
    )
    c = state["core"][0, 0]
    P = unpack(c["cov"]["P"], STATES)
    sigma = np.sqrt(np.diag(P))[GYRO_SCALE : GYRO_SCALE + 9].reshape(3, 3).T
    return d, out, c["nav"]["gyro_scale"].reshape(3, 3).T - M, sigma


@pytest.mark.parametrize("seed", range(2))
def test_all_scale_factors_and_misalignments_are_found_in_flight(seed):
    d, out, wrong, sigma = flown(seed, SECONDS)
    assert (np.abs(wrong) < 4.0 * sigma).all()
    assert (np.diag(sigma) < 0.004).all()  # 0.01 before the flight
    attitude = np.degrees(errors(d, out)[2])[d.t > 120.0]
    assert np.sqrt(np.mean(attitude[:, 2] ** 2)) < 0.6
    assert np.sqrt(np.mean(attitude[:, :2] ** 2)) < 0.4


@pytest.mark.parametrize("percent, honest", [(0.0, False), (0.67, True)])
def test_misalignments_are_within_their_sigmas_if_the_user_says_how_large_they_may_be(percent, honest):
    """Gyros with twice the misalignment of the profile, in a flight of a minute."""
    settings = replace(settings_of(profile="consumer-mems"), noise=Noise(gyro_misalignment_percent=percent))
    nees = []
    for seed in range(4):
        _, _, wrong, sigma = flown(seed, 60, settings)
        nees.append(np.mean((wrong / sigma)[~np.eye(3, dtype=bool)] ** 2))
    assert (np.mean(nees) < 1.5) == honest
