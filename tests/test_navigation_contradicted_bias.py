"""A vehicle stands, and its rate contradicts the gyro bias: by a step of the bias, or by a turn on the spot."""

import numpy as np
import pytest
from in_c import in_c
from navigation_runner import navigate, settings_of
from navigation_simulation import errors, received, sensed
from vehicle_simulation import RATE, ahead, smooth, way

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.estimators.ins.aiding.contradicted_bias import add_step
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.power_on import reset_biases
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import ATTITUDE, GYRO_BIAS, STATES
from imud.estimators.records import HEADING_VALID
from imud.math.kalman import packed_index

STOPS_S, SECONDS = 62.0, 130.0


def stop(seed, stands_s, step_dps=0.0, turn_dps=0.0, turns_s=np.inf, silent_s=(np.inf, np.inf)):
    """(yaw error, its sigma, deg; SOLUTION rows; times, s) of a drive that stops after a minute, and goes on.

    From the stop on the gyro's bias about the vertical is another by `step_dps`, or the vehicle turns on the spot, for
    `turns_s` in twice that. The receiver is silent between the times `silent_s`.
    """
    rng, t = np.random.default_rng(seed), np.arange(int(SECONDS * RATE)) / RATE
    drives = ((t > 8.0) & (t < STOPS_S - 4.0)) | (t > STOPS_S + stands_s)
    speed = smooth(np.where(drives, 6.0 + 3.0 * np.sin(0.3 * t), 0.0), 1.5)
    bends = smooth(np.where(t < STOPS_S - 4.0, 0.3 * np.sin(0.2 * t + seed), 0.0), 1.0) * (speed > 0.5)
    at_stop = np.clip(t - STOPS_S, 0.0, stands_s)
    turns = (at_stop > 0.0) & (at_stop < stands_s) & (at_stop % (2.0 * turns_s) < turns_s)
    yaw = 1.0 + np.cumsum(bends + np.radians(turn_dps) * turns) / RATE
    d = way(t, ahead(speed, yaw), yaw, 0.0 * t, 0.0 * t)
    samples, shaken = sensed(d, rng, gyro_psd=1e-4, accel_psd=1e-3), smooth((speed > 0.2).astype(float), 0.5)[:, None]
    samples["w"] += 0.02 * shaken * rng.standard_normal((len(t), 3))
    samples["f"] += 0.15 * shaken * rng.standard_normal((len(t), 3))
    samples["w"][t >= STOPS_S, 2] += np.radians(step_dps)
    fixes = received(d, rng, late=0.1)
    fixes_s = fixes["t_ns"] * 1e-9 - 100.0
    fixes = fixes[(fixes_s < silent_s[0]) | (fixes_s > silent_s[1])]
    out = navigate(samples, fixes, settings_of("free"))[0]
    return np.degrees(errors(d, out)[2][:, 2]), np.degrees(out["sigma_rpy"][:, 2]), out, t


@pytest.mark.parametrize("stands_s", [6.0, 12.0])
@pytest.mark.parametrize("step_dps", [0.7, -1.5])
def test_a_step_is_part_of_the_stated_sigma_and_the_motion_that_follows_corrects_the_heading(stands_s, step_dps):
    for seed in (1, 2):
        error, sigma, out, t = stop(seed, stands_s, step_dps=step_dps)
        wrong = (np.abs(error) > 5.0) & (np.abs(error) > 4.0 * sigma) & (out["status"] & HEADING_VALID != 0)
        assert wrong.sum() / RATE < 1.0
        moves = t > STOPS_S + stands_s + 15.0
        assert np.sqrt(np.mean(error[moves] ** 2)) < 3.0


def test_a_step_that_stays_corrects_bias_and_heading_while_the_vehicle_stands():
    error, sigma, out, _ = stop(1, 30.0, step_dps=1.5)
    at = [int((STOPS_S + after) * RATE) for after in (18.0, 28.0)]
    assert abs(error[at[0]]) > 20.0
    assert abs(error[at[1]]) < 3.0
    assert 10.0 < sigma[at[1]] < 20.0  # that it has turned stays possible
    assert np.degrees(out["bg"][at[1], 2]) == pytest.approx(1.5, abs=0.1)


@pytest.mark.parametrize(("stands_s", "turn_dps"), [(12.0, 1.5), (30.0, 10.0)])
def test_a_turn_on_the_spot_is_none(stands_s, turn_dps):
    """What is too large for a step of the bias may last; what is not, as long as a turn may be even."""
    error, _, out, t = stop(1, stands_s, turn_dps=turn_dps)
    assert np.abs(error[t > STOPS_S]).max() < 8.0
    assert np.sqrt(np.mean(error[t > STOPS_S + stands_s + 15.0] ** 2)) < 2.0
    assert (out["status"][t > STOPS_S] & HEADING_VALID != 0).all()


@pytest.mark.parametrize("turns_s", [7.7, 8.3])
def test_a_turn_that_ends_while_the_vehicle_stands_is_no_step(turns_s):
    """It turns, and rests for as long, and again: the rate changes, as that of a bias does not."""
    error, _, out, t = stop(1, 60.0, turn_dps=1.0, turns_s=turns_s)
    assert np.abs(error[t > STOPS_S]).max() < 5.0
    assert np.abs(np.degrees(out["bg"][t > STOPS_S, 2])).max() < 0.3


def test_fixes_that_stop_while_the_vehicle_turns_decide_nothing():
    error, _, out, t = stop(1, 18.0, turn_dps=1.0, silent_s=(70.0, 90.0))
    assert np.abs(error[(t > STOPS_S) & (t < STOPS_S + 18.0)]).max() < 5.0
    assert np.abs(np.degrees(out["bg"][(t > STOPS_S) & (t < STOPS_S + 18.0), 2])).max() < 0.3


def test_a_step_adds_the_covariance_of_its_errors():
    """P += e e' of biases and heading, against numpy."""
    c = start(configure(Settings(), RATE), Initial())["core"][0, 0]
    c["nav"]["q_nb"] = np.array([0.9, 0.1, -0.2, 0.3]) / np.linalg.norm([0.9, 0.1, -0.2, 0.3])
    c["nav"]["bg"] = (0.001, -0.002, 0.003)
    s = c["stationarity"]
    s["contradicting_w"], s["contradiction_count"], s["duration"] = (0.011, 0.006, -0.02), 8, 0.5
    before = c["cov"]["P"].copy()
    in_c(add_step)(c)
    w, x, y, z = c["nav"]["q_nb"]
    C_nb = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    earth = 7.292115e-5 * np.array([np.cos(c["nav"]["lat"]), 0.0, -np.sin(c["nav"]["lat"])])
    step = s["contradicting_w"] - c["nav"]["bg"] - C_nb.T @ earth
    turn = C_nb @ step * 4.0
    e = np.zeros(STATES)
    e[GYRO_BIAS : GYRO_BIAS + 3], e[ATTITUDE + 2] = step, -turn[2]
    expected = np.outer(e, e)
    for i in range(2):
        expected[ATTITUDE + i, ATTITUDE + i] += turn[i] ** 2
    added = c["cov"]["P"] - before
    index = interpreted(packed_index)
    got = np.array([[added[index(STATES, min(i, k), max(i, k))] for k in range(STATES)] for i in range(STATES)])
    np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-12)


def test_biases_of_a_new_power_on_are_no_step():
    """A sensor whose bias has stepped is switched off and on while the vehicle stands."""
    settings, c = configure(Settings(), RATE), start(configure(Settings(), RATE), Initial())["core"][0, 0]
    c["stationarity"]["contradiction_count"] = 20
    in_c(reset_biases)(settings[0], c)
    assert c["stationarity"]["contradiction_count"] == 0
