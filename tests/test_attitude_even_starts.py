"""A start on a body that moves evenly passes for rest; the sigmas say that it may, where it is shaken or may turn."""

import numpy as np
import pytest
from attitude_even_starts import car_in_curve, run, standing, table, train_accelerating, train_in_curve, turntable
from attitude_runs import samples_from
from attitude_simulation import DEG, Flaws, simulate, steady
from broad import solutions_of

from imud.estimators.records import AT_REST

FIRST_S = 10


def means(body, runs=12):
    """(mean squared tilt, NEES, seconds wrong and sure beyond 1 and 5 deg, of yaw, squared bias) of these runs."""
    return np.mean([run((body, "auto", number, ())) for number in range(runs)], axis=0)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("body", "most_nees", "most_wrong_s"),
    [(train_in_curve, 5.5, 20.0), (train_accelerating, 5.0, 18.0), (car_in_curve, 4.5, 14.0), (turntable, 0.8, 1.0)],
)
def test_even_motion_that_passes_for_rest_is_in_the_sigmas(body, most_nees, most_wrong_s):
    """NEES without it: 9.0, 6.9, 7.4, 1.1; seconds of two minutes beyond 1 deg and 4 sigma: 36, 29, 18, 3.3."""
    _, nees, one_deg, _, _, _ = means(body)
    assert nees < most_nees and one_deg < most_wrong_s


@pytest.mark.thorough
@pytest.mark.parametrize("body", [standing, table])
def test_bodies_that_do_rest_pay_little(body):
    tilt2, nees, _, five_deg, _, _ = means(body)
    assert np.sqrt(tilt2) < 2.0 and 0.2 < nees < 1.5 and five_deg < 2.5


def shaken(samples, vibration):
    samples["f"] += np.random.default_rng(5).normal(0.0, vibration, samples["f"].shape)
    return samples


def test_only_what_is_shaken_may_move():
    """Nothing that moves is as still as its sensor's noise; a rest that lasts is one."""
    samples = samples_from(simulate(150.0, 100.0), Flaws(gyro_bias=(0.2 * DEG,) * 3))
    still, moved = solutions_of(samples, "m-g350"), solutions_of(shaken(samples, 0.1), "m-g350")
    at = FIRST_S * 100
    assert still["status"][at] & AT_REST and moved["status"][at] & AT_REST
    sigmas = np.degrees([out["sigma_rpy"][[at, -1], 0] for out in (still, moved)])
    assert sigmas[0, 0] < 0.6 and sigmas[1, 0] > 1.5 and sigmas[1, 1] < 0.6 * sigmas[1, 0]
    yaw = np.degrees([out["sigma_rpy"][at, 2] for out in (still, moved)])
    assert yaw[1] > 2.0 * yaw[0]


def test_a_rate_about_the_vertical_alone_may_be_a_turn_and_the_sigma_of_yaw_says_so():
    truth = simulate(30.0, 100.0, steady((0.0, 0.0, 1.5 * DEG), -1.0, 40.0))
    out = solutions_of(samples_from(truth, Flaws(gyro_bias=(0.05 * DEG, -0.03 * DEG, 0.0))), "m-g350")[-1]
    assert out["status"] & AT_REST
    assert 4.0 * out["sigma_bg"][2] > 1.4 * DEG and 4.0 * out["sigma_rpy"][2] > 0.9 * 29.0 * 1.5 * DEG
    assert np.all(out["sigma_bg"][:2] < 0.1 * DEG)
