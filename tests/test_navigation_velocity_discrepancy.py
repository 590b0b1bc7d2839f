"""A receiver whose velocity contradicts its own positions: what is stated covers both until one of them is excluded."""

import numpy as np
import pytest
from accuracy_simulated import figures
from navigation_runner import navigate
from navigation_simulation import Later, drive, errors, received, sensed

from imud.estimators.records import POSITION_VALID

SECONDS = 120.0
D = Later(drive, SECONDS, speed=8.0)
AT_REST = Later(drive, SECONDS, rest=1e6)


def fixes_of(d, seed=1, **how):
    return received(d, np.random.default_rng(seed), late=0.1, sigma=1.2, **how)


def run(d, fixes, seed=1):
    """(seconds after the start, horizontal errors of position and velocity over their sigmas, solutions, state)."""
    samples = sensed(d, np.random.default_rng(seed), bg=(0.002, -0.001, 0.0015), ba=(0.03, -0.02, 0.02))
    out, _, state = navigate(samples, fixes)
    p, v, _ = errors(d, out)
    return p[:, :2], v[:, :2], out, state


def sure_s(error, sigma, large, out):
    """How long an error was beyond 4 sigma and large while the position is valid, s."""
    wrong = (np.abs(error) > 4.0 * sigma[:, :2]) & (np.abs(error) > large)
    return 0.01 * np.sum(wrong.any(axis=1) & ((out["status"] & POSITION_VALID) != 0))


@pytest.mark.thorough
@pytest.mark.parametrize("offset", [False, True])
@pytest.mark.parametrize("speed", [1.0, 3.0, 10.0])
@pytest.mark.parametrize("begin", [0.0, 60.0])
@pytest.mark.parametrize("d", [D, AT_REST], ids=["under way", "at rest"])
def test_a_false_velocity_is_never_sure_for_more_than_seconds(d, begin, speed, offset):
    """Constant, or a constant offset. A small one is not told from noise until its positions are away."""
    fixes = fixes_of(d)
    k = fixes["t_ns"] * 1e-9 - 100.0 >= begin
    v = np.exp(1j * fixes["course"][k]) * fixes["speed"][k] if offset else 0.0
    v = v + speed * np.exp(0.5j)
    fixes["speed"][k], fixes["course"][k] = np.abs(v), np.angle(v)
    p, v, out, state = run(d, fixes)
    agrees = d is D and (begin, speed, offset) == (
        0.0,
        3.0,
        False,
    )  # for a while: the car drives so then
    assert sure_s(p, out["sigma_p"], 5.0, out) < 10.0
    assert sure_s(v, out["sigma_v"], 1.0, out) < (20.0 if agrees else 15.0)
    if speed > 1.0:
        assert state["velocity_discrepancy"]["verdict"][0] > 0
        assert np.hypot(*p[-1]) < (30.0 if agrees else 15.0)


@pytest.mark.thorough
def test_a_constant_false_velocity_is_seldom_sure():
    """In whatever direction: which of them look right for a while, as the car drives so then, is chance."""
    seconds = []
    for speed in (2.0, 3.0, 4.0):
        for course in range(6):
            fixes = fixes_of(D)
            fixes["speed"], fixes["course"] = speed, course
            _, v, out, _ = run(D, fixes)
            seconds.append(sure_s(v, out["sigma_v"], 1.0, out))
    assert np.mean(seconds) < 6.0 and np.sum(np.greater(seconds, 15.0)) <= 1


def test_a_false_velocity_at_rest_with_positions_that_stand_still_to_the_last_digit():
    fixes = fixes_of(AT_REST)
    for name in ("lat", "lon", "height"):
        fixes[name] = fixes[name][0]
    fixes["speed"], fixes["course"] = 3.0, 0.0
    p, v, out, _ = run(AT_REST, fixes)
    assert sure_s(p, out["sigma_p"], 5.0, out) < 1.0
    assert sure_s(v, out["sigma_v"], 1.0, out) < 6.0


def test_a_drift_of_the_positions_is_covered_too():
    fixes = fixes_of(D)
    t = fixes["t_ns"] * 1e-9 - 100.0
    fixes["lat"] += np.clip(t - 50.0, 0.0, 40.0) / 6.37e6
    p, _, out, _ = run(D, fixes)
    assert sure_s(p, out["sigma_p"], 5.0, out) == 0.0


@pytest.mark.parametrize("every", [0.2, 1.0])
@pytest.mark.parametrize("sigma", [1.0, 5.0])
def test_noise_lag_and_jumps_are_no_discrepancy(sigma, every):
    fixes = received(D, np.random.default_rng(3), late=0.1, sigma=sigma, hdop=sigma, every=every, lag=0.3)
    t = fixes["t_ns"] * 1e-9 - 100.0
    fixes["lat"][(t > 60.0) & (t < 61.5)] += 100.0 / 6.37e6
    fixes["lat"][t > 90.0] += 30.0 / 6.37e6
    _, _, _, state = run(D, fixes)
    assert state["velocity_discrepancy"]["verdict"][0] == 0
    assert state["velocity_discrepancy"]["count"][0] > 100


def test_a_receiver_that_is_right_again_is_used_again():
    fixes = fixes_of(D)
    t = fixes["t_ns"] * 1e-9 - 100.0
    wrong = (t > 50.0) & (t < 70.0)
    fixes["speed"][wrong], fixes["course"][wrong] = 3.0, 0.0
    p, v, out, state = run(D, fixes)
    assert state["velocity_discrepancy"]["verdict"][0] == 0
    late = D.t > 90.0
    assert np.sqrt(np.mean(v[late] ** 2)) < 0.15
    assert sure_s(p, out["sigma_p"], 5.0, out) == 0.0


@pytest.mark.parametrize(("vehicle", "seed"), [("rally", 1701), ("tractor", 1700)])
def test_positions_that_drift_and_come_back_are_used_at_once(vehicle, seed):
    """An RTK receiver's, half a metre a second for 40 s, which its velocity contradicts: the estimate follows them."""
    row = figures(vehicle, "RTK", 0.0, seed, error="creeping")
    assert row["position s"] < 5.0  # 60 s, where they are rejected
    assert row["yaw s"] < 5.0
