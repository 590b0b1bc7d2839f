"""Left and right wheel in the navigation filter: a yaw rate within its sigma, and slips of one wheel."""

import numpy as np
import pytest
from navigation_simulation import drive, errors, received, sensed
from test_navigation_aiding import estimated
from test_navigation_odometer import without

from imud.configuration.settings import Aiding, Settings
from imud.estimators import registry
from imud.estimators.records import MEASUREMENT, ODOMETER, ODOMETER_SOURCE, WHEEL_YAW_RATE
from imud.sensors.aiding import DatagramDecoder

TRACK_M = 1.4
SETTINGS = Settings(aiding=Aiding(track_width_m=TRACK_M))
SIGMA = 0.02


def wheels(d, rng, track_m=TRACK_M, difference=0.0, sigma=SIGMA):
    """MEASUREMENT rows at 10 Hz of an axle whose left wheel seems faster by the share `difference`."""
    k = slice(10, None, 10)
    forward = np.sum(d.attitude.apply([1.0, 0.0, 0.0]) * d.v, axis=1)[k]
    rows = np.zeros(len(forward), MEASUREMENT)
    rows["t_ns"] = np.round(1e9 * (100.0 + d.t[k]))
    rows["arrival_ns"] = rows["t_ns"] + 20_000_000
    rows["kind"], rows["value"], rows["sigma"] = ODOMETER_SOURCE, np.nan, np.nan
    left, right = (
        (1.0 + side * 0.5 * difference) * (forward + side * 0.5 * track_m * d.w[k, 2])
        + sigma * rng.standard_normal(len(forward))
        for side in (1.0, -1.0)
    )
    rows["value"][:, 0], rows["value"][:, 1] = 0.5 * (left + right), left - right
    rows["sigma"][:, 0] = max(sigma, 1e-3)
    return rows


def driven(seed, seconds=150.0, speed=2.0, gyro_psd=1.7e-4, **wheel):
    """A slow vehicle, and no receiver from 70 s on."""
    rng = np.random.default_rng(seed)
    d = drive(seconds, speed=speed)
    bias = np.radians(0.2) * rng.standard_normal(3)
    samples = sensed(d, rng, gyro_psd=gyro_psd, bg=bias)
    return d, bias, samples, without(received(d, rng, sigma=1.0), 70.0, seconds), wheels(d, rng, **wheel)


def kind(innovations, which):
    return innovations[innovations["kind"] == which]


@pytest.mark.thorough
def test_the_yaw_rate_of_two_wheels_is_within_its_sigma_with_the_errors_that_last():
    """Radii that differ by 0.5 % are 0.4 deg/s at 2 m/s: of the bias they tell little, and no more than that."""
    nees, alone_nees, gains, nis = [], [], [], []
    for seed in range(12):
        rng = np.random.default_rng(1000 + seed)
        lasting = {"track_m": TRACK_M * (1 + 0.02 * rng.standard_normal()), "difference": 0.005 * rng.standard_normal()}
        d, bias, samples, fixes, rows = driven(seed, **lasting)
        out, innovations = estimated(samples, fixes, rows, SETTINGS)
        one = rows.copy()
        one["value"][:, 1:] = np.nan
        alone, _ = estimated(samples, fixes, one, SETTINGS)
        end = len(d.t) - 1
        nees.append(((out["bg"][end, 2] - bias[2]) / out["sigma_bg"][end, 2]) ** 2)
        alone_nees.append(((alone["bg"][end, 2] - bias[2]) / alone["sigma_bg"][end, 2]) ** 2)
        gains.append(out["sigma_bg"][end, 2] / alone["sigma_bg"][end, 2])
        found = kind(innovations, WHEEL_YAW_RATE)
        nis.append(np.mean(found["value"] ** 2 / found["variance"]))
        assert found["used"].mean() > 0.98
        assert (np.abs(errors(d, out)[2][end, 2]) < 4.0 * out["sigma_rpy"][end, 2]).all()
    assert np.mean(nees) < 1.9  # of 12: chi-square's 97.5 %
    assert np.mean(nees) > 0.5 * np.mean(alone_nees)  # the yaw rate is not wider than it need be
    assert max(gains) <= 1.0
    assert 0.2 < np.mean(nis) < 1.3


def test_while_one_wheel_slips_the_other_one_holds_the_speed():
    d, _, samples, fixes, rows = driven(1, speed=8.0)
    t = rows["t_ns"] * 1e-9 - 100.0
    spins = (t > 80.0) & (t % 10.0 < 3.0)
    spin = 0.3 * rows["value"][spins, 0] + 0.5
    rows["value"][spins, 0] += 0.5 * spin
    rows["value"][spins, 1] += spin
    out, innovations = estimated(samples, fixes, rows, SETTINGS)
    at = innovations["t_ns"] * 1e-9 - 100.0
    during = (at > 80.0) & (at % 10.0 < 3.0)
    rejected = (innovations["kind"] == WHEEL_YAW_RATE) & during
    assert innovations["used"][rejected].mean() < 0.1
    assert innovations["used"][(innovations["kind"] == ODOMETER) & during].mean() > 0.9
    late = d.t > 80.0
    v = errors(d, out)[1][late, :2]
    assert np.mean((v / out["sigma_v"][late, :2]) ** 2) < 2.0


@pytest.mark.parametrize("mistake", ["swapped", "half the track"])
def test_a_wrong_axle_is_rejected_and_harms_nothing(mistake):
    d, _, samples, fixes, rows = driven(2, speed=6.0)
    if mistake == "swapped":
        rows["value"][:, 1] *= -1.0
    settings = SETTINGS if mistake == "swapped" else Settings(aiding=Aiding(track_width_m=0.5 * TRACK_M))
    out, innovations = estimated(samples, fixes, rows, settings)
    assert 0.01 < np.mean(kind(innovations, WHEEL_YAW_RATE)["used"] == 0) < 0.99
    _, v, attitude = errors(d, out)[:3]
    late = d.t > 60.0
    assert (np.abs(v[late, :2]) < 4.0 * out["sigma_v"][late, :2]).all()
    assert (np.abs(attitude[late, 2]) < 4.0 * out["sigma_rpy"][late, 2]).all()


def test_without_a_track_width_two_wheels_are_their_mean():
    _, _, samples, fixes, rows = driven(3, seconds=90.0)
    mean = rows.copy()
    mean["value"][:, 1:] = np.nan
    both, innovations = estimated(samples, fixes, rows)
    assert both.tobytes() == estimated(samples, fixes, mean)[0].tobytes()
    assert not len(kind(innovations, WHEEL_YAW_RATE))


def test_a_datagram_has_one_speed_or_two():
    sources = registry.by_name("navigation").sources
    lines = ['{"class":"ODO","speed":1}', '{"class":"ODO","left":1,"right":2}', '{"class":"ODO","left":1}']
    receiver = DatagramDecoder()
    one, two = (row for _, row in receiver.decode("\n".join(lines).encode(), sources, 10**9, 10**18))
    np.testing.assert_array_equal(one["value"][0, :2], [1.0, np.nan])
    np.testing.assert_array_equal(two["value"][0, :2], [1.5, -1.0])
    assert "ODO without speed" in " ".join(receiver.messages)
