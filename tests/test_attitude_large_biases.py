"""Sensors far worse than calibrated boards: the attitude filter finds their biases, or says how unsure it is."""

import numpy as np
import pytest
from attitude_runs import samples_from, yaw_sigma_deg
from attitude_simulation import DEG, MG, Flaws, after, errors_deg, simulate, wobble
from broad import solutions_of

from imud.estimators.records import ATTITUDE_VALID


@pytest.mark.parametrize("bias_dps", [(15.0, -12.0, 9.0), (-4.0, 18.0, -16.0), (12.0, 0.0, 3.0)])
def test_a_gyro_bias_of_the_worst_parts_is_found_at_the_first_rest(bias_dps):
    truth = simulate(60.0, 100.0, after(6.0, wobble(3, 1.0)), after(6.0, wobble(4, 1.0, 1.0, 4.0)), (20.0, -10.0, 30.0))
    out = solutions_of(samples_from(truth, Flaws(gyro_bias=tuple(np.multiply(bias_dps, DEG)))))
    assert np.abs(out["bg"][500] - np.multiply(bias_dps, DEG)).max() < 0.1 * DEG
    tilt, yaw = errors_deg(out["q_nb"], truth.attitude)
    turned = np.abs(np.unwrap(yaw, period=360.0) - yaw[0])
    assert tilt[500:].max() < 2.0
    assert (turned < np.maximum(5.0, 4.0 * yaw_sigma_deg(out)))[200:].all()


def test_a_turn_that_begins_after_the_first_rest_is_no_bias():
    """A turntable at 12 deg/s: the bias is known by then."""
    axis = np.array([0.0, 0.0, 12.0 * DEG])
    truth = simulate(30.0, 100.0, lambda t: axis * ((t > 8.0) & (t < 20.0))[:, None])
    out = solutions_of(samples_from(truth, Flaws(gyro_bias=(3.0 * DEG, -2.0 * DEG, 1.0 * DEG))))
    assert np.abs(out["bg"][1950] - np.multiply((3.0, -2.0, 1.0), DEG)).max() < 0.2 * DEG


@pytest.mark.parametrize("dps", [-4.0, -8.0])
def test_a_slow_turn_against_a_large_bias_is_not_taken_for_a_smaller_one(dps):
    bias = np.multiply((15.0, -12.0, 9.0), DEG)
    truth = simulate(80.0, 100.0, lambda t: np.outer((t > 15.0) & (t < 40.0), [0.0, 0.0, dps * DEG]))
    out = solutions_of(samples_from(truth, Flaws(gyro_bias=tuple(bias))))
    assert np.abs(out["bg"][[1400, -1]] - bias).max() < 0.1 * DEG
    yaw = np.unwrap(errors_deg(out["q_nb"], truth.attitude)[1], period=360.0)
    assert np.abs(yaw[1400:] - yaw[1400]).max() < 5.0


def test_a_turn_that_was_taken_for_a_bias_is_found_when_it_ends():
    """A turntable that turns at 15 deg/s from the start, for 10 s."""
    truth = simulate(60.0, 100.0, lambda t: np.outer(t < 10.0, [0.0, 0.0, 15.0 * DEG]))
    out = solutions_of(samples_from(truth, Flaws()))
    assert out["bg"][900, 2] > 10.0 * DEG
    assert np.abs(out["bg"][-1]).max() < 0.2 * DEG


@pytest.mark.parametrize("dps", [10.0, 15.0, 25.0])
def test_a_turn_from_the_start_that_passes_for_a_bias_is_stated_in_the_yaw(dps):
    """A turntable: the yaw is turned back when the rate is taken for a bias, by as much as it had turned until then."""
    truth = simulate(8.0, 100.0, lambda t: np.outer(np.ones_like(t), [0.0, 0.0, dps * DEG]))
    out = solutions_of(samples_from(truth, Flaws()))
    yaw = errors_deg(out["q_nb"], truth.attitude)[1]
    turned = np.abs(np.unwrap(yaw, period=360.0) - yaw[0])
    assert turned.max() > 20.0
    assert (turned < np.maximum(5.0, 4.0 * yaw_sigma_deg(out))).all()


def test_an_accelerometer_that_weighs_wrongly_is_as_bad_level_as_it_is_upright():
    """70 mg too light at rest: the level axes may be as wrong, of which nothing is seen."""
    truth = simulate(20.0, 100.0)
    for level_mg in (0.0, 60.0, 90.0):
        out = solutions_of(samples_from(truth, Flaws(accel_bias=(level_mg * MG, 0.0, 70.0 * MG))))
        tilt = errors_deg(out["q_nb"], truth.attitude)[0]
        sure = (out["status"] & ATTITUDE_VALID) != 0
        assert (tilt < 3.0 * np.degrees(out["sigma_rpy"][:, :2].max(axis=1)))[sure & (truth.t > 2.0)].all()
