"""Single readings that no motion makes are not integrated, and said; taps and motion are no spikes."""

import numpy as np
import pytest
from attitude_simulation import DEG, Flaws, errors_deg, measure, simulate, wobble
from broad import samples_of
from replay_in_process import new_filter, replay

from imud.estimators.records import AT_REST, SOLUTION
from imud.sensor_monitor.findings import words
from imud.sensor_monitor.health import recent_findings


def in_a_hand(rate_hz, seed, turning=1.0, seconds=30.0):
    truth = simulate(seconds, rate_hz, wobble(seed, turning), wobble(seed + 50, 2.0, 3.0, 9.0))
    w, f = measure(truth, Flaws(gyro_bias=(0.2 * DEG,) * 3), np.random.default_rng(seed))
    return truth, samples_of(truth.t, w, f)


def difference(samples):
    """(what the monitor adds to rates and forces, what it says)."""
    filter_, seen = new_filter("attitude", samples), samples.copy()
    filter_.run(seen, np.zeros(len(seen), SOLUTION))
    return {name: seen[name] - samples[name] for name in "wf"}, words(recent_findings(filter_.health))


def replaced(samples):
    """(which rates are replaced, what the monitor says)."""
    changed, said = difference(samples)
    return np.flatnonzero(changed["w"].any(axis=1)), said


@pytest.mark.parametrize("rate_hz", [100.0, 285.0, 1000.0])
def test_spikes_are_found_and_cost_little(rate_hz):
    truth, samples = in_a_hand(rate_hz, 1)
    rng = np.random.default_rng(2)
    at = 50 + 100 * np.arange((len(samples) - 100) // 100)
    for k in at:
        samples["w"][k, rng.integers(3)] += rng.choice([-1.0, 1.0]) * rng.uniform(5.0, 30.0)
    found, said = replaced(samples)
    assert np.array_equal(found, at)
    assert said[-1].startswith("gyro") and said[-1].endswith("shows spikes")
    tilt, _ = errors_deg(replay(new_filter("attitude", samples), samples)[0]["q_nb"], truth.attitude)
    assert tilt[len(tilt) // 5 :].max() < 3.0


def test_motion_has_no_spikes():
    for seed in range(10):
        for rate_hz in (100.0, 500.0):
            _, samples = in_a_hand(rate_hz, seed, turning=10.0 ** (seed / 9.0 - 0.5))
            assert len(replaced(samples)[0]) == 0, (seed, rate_hz)


def test_a_tap_that_turns_the_sensor_is_no_spike():
    """What is withheld of it comes with the next sample: rotation and velocity are not lost."""
    _, samples = in_a_hand(285.0, 3)
    for k in range(500, 8000, 300):
        samples["w"][k : k + 2, 1] += (4.0, -3.0)
        samples["f"][k : k + 2, 2] += (60.0, -40.0)
    changed, said = difference(samples)
    assert not any("spikes" in text for text in said)
    assert np.array_equal(np.unique(np.flatnonzero(changed["w"].any(axis=1)) % 300), [200, 201])
    for name in ("w", "f"):
        np.testing.assert_allclose(changed[name][500:8000].reshape(-1, 300, 3).sum(axis=1), 0.0, atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_spike_of_a_rate_beside_a_knock_is_no_motion(axis):
    """The force may have been motion, the rate was none: it was added to the third sample."""
    _, samples = in_a_hand(50.0, 7)
    at = np.arange(100, 1500, 90)
    samples["w"][at, axis] += 26.0
    samples["f"][at[:, None] + [0, 1, 2], 1] += (4.5, 3.0, 2.4)
    changed, said = difference(samples)
    assert said[-1] == f"gyro {'xyz'[axis]} shows spikes"
    turned = sum(changed["w"][at + i, axis] for i in range(4))
    np.testing.assert_allclose(turned, -26.0, atol=2.0)


@pytest.mark.parametrize("rate_hz", [100.0, 285.0])
def test_samples_of_which_all_is_damaged_cost_little(rate_hz):
    truth, samples = in_a_hand(rate_hz, 5)
    rng = np.random.default_rng(6)
    at = 50 + 100 * np.arange((len(samples) - 100) // 100)
    samples["w"][at] = rng.uniform(-35.0, 35.0, (len(at), 3))
    samples["f"][at] = rng.uniform(-160.0, 160.0, (len(at), 3))
    tilt, _ = errors_deg(replay(new_filter("attitude", samples), samples)[0]["q_nb"], truth.attitude)
    assert tilt[len(tilt) // 5 :].max() < 3.0  # 20 to 40 deg if they are integrated


def test_a_rate_that_stays_was_motion_and_no_rotation_is_lost():
    _, samples = in_a_hand(200.0, 4)
    samples["w"][3000:, 2] += 6.0
    changed = difference(samples)[0]["w"]
    assert np.array_equal(np.flatnonzero(changed.any(axis=1)), [3000, 3001])
    np.testing.assert_allclose(changed.sum(axis=0), 0.0, atol=1e-12)


def test_two_damaged_samples_in_a_row_are_both_replaced():
    """Only if the second were near the first, or the same way further on, would it be motion."""
    for seed in range(4):
        truth, samples = in_a_hand(200.0, 7 + seed)
        at = np.arange(300, 5700, 200)
        for k in at:
            samples["w"][k], samples["w"][k + 1] = (20.0, 10.0, -15.0), (-18.0, 14.0, 12.0)
            samples["f"][k], samples["f"][k + 1] = (90.0, -60.0, 100.0), (-70.0, -80.0, 60.0)
        found, _ = replaced(samples)
        assert np.array_equal(found, np.sort(np.concatenate([at, at + 1])))
        tilt, _ = errors_deg(replay(new_filter("attitude", samples), samples)[0]["q_nb"], truth.attitude)
        assert tilt[1000:].max() < 3.0, seed


@pytest.mark.parametrize("rate_hz", [285.0, 1000.0])
def test_spikes_of_the_accelerometer_alone_are_found_and_said(rate_hz):
    _, samples = in_a_hand(rate_hz, 8)
    at = np.arange(100, len(samples) - 100, 100)
    rng = np.random.default_rng(9)
    samples["f"][at, rng.integers(3, size=len(at))] += rng.choice([-1.0, 1.0], len(at)) * rng.uniform(
        15.0, 150.0, len(at)
    )
    changed, said = difference(samples)
    assert np.array_equal(np.flatnonzero(changed["f"].any(axis=1)), at)
    assert said == ("accelerometer xyz shows spikes",)


def test_spikes_do_not_end_a_rest():
    """The rest that the gyro bias is learned from lasts, although every fifth of a second a sample is damaged."""
    truth = simulate(8.0, 1000.0)
    w, f = measure(truth, Flaws(0.0157 * DEG, 2.5e-3, gyro_bias=(0.5 * DEG,) * 3), np.random.default_rng(1))
    samples, rng = samples_of(truth.t, w, f), np.random.default_rng(2)
    at = np.arange(100, 7900, 200)
    samples["w"][at], samples["f"][at] = (
        rng.uniform(-35.0, 35.0, (len(at), 3)),
        rng.uniform(-160.0, 160.0, (len(at), 3)),
    )
    out, _ = replay(new_filter("attitude", samples), samples)
    assert (out["status"][2000:] & AT_REST).mean() > 0.9
    np.testing.assert_allclose(out["bg"][-1], 0.5 * DEG, atol=0.02 * DEG)
