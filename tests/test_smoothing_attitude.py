"""Smoothed attitudes: the recursion against Rauch, Tung and Striebel's, and what it gives on simulated sensors."""

import numpy as np
import pytest
from attitude_runs import samples_from, tilt_variance_deg2
from attitude_simulation import DEG, Flaws, errors_deg, simulate, wobble
from replay_in_process import new_filter, replay, smoothed_solutions

from imud.estimators.ahrs.state import ACCEL_BIAS, GYRO_BIAS, STATES
from imud.estimators.records import ATTITUDE_VALID, SOLUTION
from imud.smoothing.fixed_interval import smoothed_estimates
from imud.smoothing.intervals import INTERVAL, record_intervals
from imud.smoothing.rows import Rows


def record_transition(state, c, dt):
    """Record a transition that has elements of each kind (docs/ahrs.md); returns it as a matrix."""
    phi = np.eye(STATES)
    state["time"], state["delta_v"] = dt, (0.1, -0.2, -0.5)
    state["c"], state["c_outer_w"], state["c_diag_f"] = c[:9], c[:27], 2.0 * c[:9]
    state["c_f_cross_w"] = c[:3]
    phi[0:3, 3:6] = -c[:9].reshape(3, 3)
    phi[0:3, 12:21] = -c[:27].reshape(3, 9)
    phi[6:9, 9:12], phi[6:9, 21:24], phi[6:9, 24] = -c[:9].reshape(3, 3), -2.0 * c[:9].reshape(3, 3), c[:3]
    phi[6, 1], phi[7, 0], phi[8, 0], phi[8, 1] = -0.5, 0.5, -0.2, -0.1
    phi[25:28, 6:9] = dt * np.eye(3)
    phi[25:28, 25:28] *= 1.0 - dt / 10.0
    return phi


def test_the_recursion_is_that_of_rauch_tung_and_striebel():
    """Forward by plain numpy with random measurements."""
    rng, n = np.random.default_rng(3), 12
    rows, known = np.zeros(n, INTERVAL), []
    x, P, Q = np.zeros(STATES), np.diag(rng.uniform(0.5, 2.0, STATES)), np.diag(rng.uniform(0.01, 0.1, STATES))
    upper = np.triu_indices(STATES)
    for k in range(n):
        history = rows["history"][k]
        phi = record_transition(history, rng.normal(0.0, 0.1, 27), 0.05)
        before_x, before_P = phi @ x, phi @ P @ phi.T + Q
        x, P = before_x.copy(), before_P.copy()
        for m, i in enumerate((6, 7, 25)):
            s = P[i, i] + 0.3
            innovation = rng.normal() * np.sqrt(s)
            history["state"][m], history["innovation"][m], history["innovation_var"][m] = i, innovation, s
            history["ph"][STATES * m : STATES * (m + 1)] = P[i]
            gain = P[i] / s
            x, P = x + gain * innovation, P - np.outer(gain, P[i])
        history["count"] = 3
        rows["P"][k] = P[upper]
        known.append((x, P, before_x, before_P, phi))
    found = smoothed_estimates(rows, 10.0)
    smoothed_x, smoothed_P = known[-1][:2]
    which = np.r_[0:3, GYRO_BIAS : GYRO_BIAS + 3, ACCEL_BIAS : ACCEL_BIAS + 3]
    for k in reversed(range(n)):
        x, P = known[k][:2]
        if k < n - 1:
            _, _, after_x, after_P, phi = known[k + 1]
            gain = P @ phi.T @ np.linalg.inv(after_P)
            smoothed_x, smoothed_P = x + gain @ (smoothed_x - after_x), P + gain @ (smoothed_P - after_P) @ gain.T
        assert found["x"][k] == pytest.approx((smoothed_x - x)[which], abs=1e-9)
        assert found["attitude_var"][k].reshape(3, 3) == pytest.approx(smoothed_P[:3, :3], abs=1e-9)
        assert found["bias_var"][k] == pytest.approx(np.diag(smoothed_P)[which][3:], abs=1e-9)


def test_what_is_constant_is_smoothed_to_one_value():
    """The record leaves nothing out: a bias without a walk, corrected by what follows, is the same at any time."""
    truth = simulate(30.0, 100.0, wobble(3, 1.5), wobble(4, 1.0, 1.0, 4.0))
    samples = samples_from(truth, Flaws(gyro_bias=(0.3 * DEG, -0.2 * DEG, 0.1 * DEG)))
    filter_, rows, filtered = new_filter("attitude", samples), Rows(INTERVAL), []
    filter_.parameters["accel_bias_psd"] = 0.0
    append = rows.append

    def appended(row):
        append(row)
        filtered.append(filter_.state["nav"]["ba"][0].copy())

    rows.append = appended
    record_intervals(filter_, samples, Rows(SOLUTION), rows)
    found = smoothed_estimates(rows.array(), 10.0)
    biases = np.array(filtered) + found["x"][:, 6:]
    assert np.ptp(biases, axis=0).max() < 1e-9
    assert np.ptp(filtered, axis=0).max() > 1e-3


@pytest.mark.thorough
def test_a_bias_learnt_late_corrects_the_yaw_from_the_start_and_sigmas_are_true():
    yaws, tilts, nees = [], [], []
    for seed in range(6):
        truth = simulate(60.0, 100.0, wobble(seed, 1.0), wobble(seed + 9, 1.0, 1.0, 4.0), (10.0, -20.0, 0.0))
        flaws = Flaws(gyro_bias=(0.3 * DEG, -0.2 * DEG, 0.4 * DEG), accel_bias=(0.02, -0.02, 0.01))
        samples = samples_from(truth, flaws, seed)
        causal, _ = replay(new_filter("attitude", samples), samples)
        smooth = smoothed_solutions(new_filter("attitude", samples), samples)
        assert np.array_equal(smooth["t_ns"], causal["t_ns"]) and np.all(smooth["status"] & ATTITUDE_VALID)
        of_both = [errors_deg(out["q_nb"], truth.attitude) for out in (causal, smooth)]
        tilts.append([np.mean(tilt**2) for tilt, _ in of_both])
        yaws.append([np.std(yaw) for _, yaw in of_both])
        nees.append(np.mean(of_both[1][0] ** 2 / tilt_variance_deg2(smooth)))
        assert np.mean(np.abs(smooth["sigma_bg"][200])) < 0.5 * np.mean(causal["sigma_bg"][200])
    causal, smooth = np.sqrt(np.mean(tilts, axis=0))
    assert smooth < 0.6 * causal
    causal, smooth = np.mean(yaws, axis=0)
    assert smooth < 0.6 * causal
    assert np.mean(nees) < 1.5


def test_the_smoothed_variance_of_the_tilt_is_about_half_the_least_causal_one_around_or_more():
    """A walk, begun in motion: its lasting accelerations are more than the filter's noises, from both sides."""
    truth = simulate(30.0, 100.0, wobble(5, 0.5), wobble(6, 3.0, 0.05, 0.2))
    samples = samples_from(truth, Flaws(accel_bias=(0.2, -0.2, 0.1)))
    causal = tilt_variance_deg2(replay(new_filter("attitude", samples), samples)[0])
    smooth = tilt_variance_deg2(smoothed_solutions(new_filter("attitude", samples), samples))
    least = np.array([causal[max(k - 200, 0) : k + 200].min() for k in range(len(causal))])
    assert np.all(smooth > 0.35 * least)  # 0.2 without the limit; each axis by itself has at least 0.5


def test_the_causal_filter_records_nothing():
    samples = samples_from(simulate(5.0, 100.0))
    filter_ = new_filter("attitude", samples)
    replay(filter_, samples)
    assert not filter_.state["history"][0].tobytes().strip(b"\0")
