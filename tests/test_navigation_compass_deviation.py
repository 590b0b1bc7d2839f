"""A compass near iron: its headings deviate with the heading or the place. How far is learned, and no more claimed."""

import numpy as np
import pytest
from fault_matrix import DEGREES, scene, settings_of
from navigation_simulation import errors
from replay_in_process import new_filter, replay
from test_navigation_aiding import headings

from imud.estimators.records import HEADING_VALID

SIGMA = np.radians(0.5)


def run(where, seed, deviation, every_s=0.2, gyro_scale=0.0):
    """(the filter's record of the compass, seconds of a yaw wrong and sure, RMS of its sigma in degrees).

    deviation: of the compass, rad, by time, s, way, m, and heading, rad.
    """
    d, samples, fixes = scene(seed, where)
    samples = samples.copy()
    samples["w"][:, 2] *= 1.0 + gyro_scale
    rows = headings(d, np.random.default_rng(seed), every_s, sigma=SIGMA)
    t = rows["t_ns"] * 1e-9 - 100.0
    way = np.cumsum(np.hypot(d.v[:, 0], d.v[:, 1])) * (d.t[1] - d.t[0])
    rows["value"][:, 0] += deviation(t, np.interp(t, d.t, way), rows["value"][:, 0])
    rows["value"][:, 0] = np.round(rows["value"][:, 0], 9)
    filter_ = new_filter("navigation", samples, settings_of(None, where))
    out, _ = replay(filter_, samples, fixes, rows)
    error, sigma = np.abs(np.degrees(errors(d, out)[2][:, 2])), np.degrees(out["sigma_rpy"][:, 2])
    sure = (error > DEGREES) & (error > 4.0 * sigma) & (out["status"] & HEADING_VALID != 0) & (d.t > 50.0)
    found = filter_.state["core"][0, 0]["heading_aid"]
    return found, float(sure.sum() * (d.t[1] - d.t[0])), float(np.sqrt(np.mean(sigma[d.t > 50.0] ** 2)))


def none(t, way, heading):
    return 0.0


def of_the_vehicle(deg):
    return lambda t, way, heading: np.radians(deg) * np.sin(heading + 2.0)


def of_places(t, way, heading):
    return np.radians(20.0) * np.exp(-0.5 * ((way % 160.0 - 80.0) / 20.0) ** 2)


def jump(t, way, heading):
    return np.radians(25.0) * ((t > 60.0) & (t < 70.0))


@pytest.mark.parametrize(
    ("where", "seed", "deviation"),
    [
        ("boat", 42, of_the_vehicle(10.0)),  # it hardly accelerates, and its gyros' biases are not known
        ("boat", 44, of_the_vehicle(10.0)),
        ("boat", 42, of_places),
        ("boat", 44, of_places),
    ],
)
def test_a_compass_near_iron_is_not_believed(where, seed, deviation):
    found, sure_s, _ = run(where, seed, deviation)
    assert sure_s == 0.0
    assert found["mean_excess"] > 0.0 and not found["distrusted"]


@pytest.mark.parametrize(("every_s", "gyro_scale"), [(0.2, 0.0), (1.0, 0.0), (0.2, 0.01)])
@pytest.mark.parametrize("where", ["city", "robot", "boat"])
def test_a_right_compass_does_not_deviate(where, every_s, gyro_scale):
    """Nor where the gyros' scale factors are off."""
    found, sure_s, sigma = run(where, 43, none, every_s, gyro_scale)
    assert found["opened_variance"] < SIGMA**2
    assert sure_s == 0.0 and sigma < 3.0


def test_a_compass_that_repeats_its_reading_does_not_deviate():
    """It has stopped: its headings are outside the gate, and the yaw stays as well known as before."""

    def stopped(t, way, heading):
        last = heading[t < 60.0][-1]
        return np.where(t < 60.0, 0.0, last - heading)

    found, sure_s, sigma = run("city", 43, stopped)
    assert found["opened_variance"] < np.radians(1.0) ** 2
    assert sure_s == 0.0 and sigma < 1.0


def test_a_jump_is_no_deviation():
    """A reflection of ten seconds is left out; what the compass tells before and after counts as before."""
    found, sure_s, sigma = run("city", 43, jump)
    assert found["opened_variance"] < np.radians(1.0) ** 2
    assert sure_s == 0.0 and sigma < 1.0
