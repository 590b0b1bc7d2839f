"""Rates given in deg/s: gravity in the sensor turns 57 times less than they say. It is said, and ends the attitude."""

import numpy as np
import pytest
from attitude_simulation import DEG, Flaws, after, measure, simulate, wobble
from broad import samples_of
from replay_in_process import new_filter

from imud.drivers.sample import NO_RATE, UNCONFIRMED_RATE
from imud.estimators.records import ATTITUDE_VALID, SOLUTION
from imud.sensor_monitor.findings import words
from imud.sensor_monitor.health import recent_findings


def seen(rate_hz, seed, turning, moving, factor):
    """(samples as the monitor leaves them, solutions, its findings in words) of a sensor in a hand."""
    truth = simulate(40.0, rate_hz, wobble(seed, turning), wobble(seed + 50, moving, 2.0 + moving, 9.0 + moving))
    w, f = measure(truth, Flaws(gyro_bias=(0.2 * DEG,) * 3), np.random.default_rng(seed))
    samples = samples_of(truth.t, factor * w, f)
    filter_, out = new_filter("attitude", samples), np.zeros(len(samples), SOLUTION)
    filter_.run(samples, out)
    return samples, out, words(recent_findings(filter_.health))


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 400.0])
def test_rates_in_degrees_end_the_attitude_and_are_said(rate_hz):
    for seed in range(3):
        _, out, said = seen(rate_hz, seed, 0.4, 0.3, 180.0 / np.pi)
        assert any("deg/s" in text for text in said), (seed, said)
        late = out["status"][round(20.0 * rate_hz) :]
        assert not (late & ATTITUDE_VALID).any()


def test_a_unit_once_known_stays_known():
    """Also while the sensor is shaken so hard, or turned so little, that nothing shows it."""
    samples, _, _ = seen(200.0, 1, 0.4, 0.3, 180.0 / np.pi)
    known = (samples["flags"] & NO_RATE) != 0
    first = np.flatnonzero(known)[0]
    assert first < 200 * 5
    shaken = simulate(40.0, 200.0, wobble(2, 0.1), wobble(3, 15.0, 5.0, 20.0))
    w, f = measure(shaken, Flaws(), np.random.default_rng(4))
    both = samples_of(np.arange(16000) / 200.0, np.zeros((16000, 3)), np.zeros((16000, 3)))
    both["w"], both["f"] = (np.concatenate(parts) for parts in ((samples["w"], 57.3 * w), (samples["f"], f)))
    new_filter("attitude", both).run(both, np.zeros(len(both), SOLUTION))
    assert ((both["flags"] & NO_RATE) != 0)[10 * 200 :].all()


def test_rates_in_radians_never_are():
    for seed in range(24):
        turning, moving = 10.0 ** (seed % 6 / 3.0 - 0.7), 10.0 ** (seed // 6 / 1.5 - 1.0)
        samples, _, said = seen((50.0, 200.0)[seed % 2], seed, turning, moving, 1.0)
        assert not (samples["flags"] & NO_RATE).any(), seed
        assert not any("deg/s" in text for text in said), seed


def test_slow_turns_show_degrees_within_three_seconds():
    """Of a hand that also moves: the changes of the force from sample to sample show it after 3.8 s and 2.5 s."""
    for seed, latest_s in ((1, 2.5), (2, 1.8)):
        rates, acceleration = wobble(seed, 0.3), wobble(seed + 50, 1.0, 3.0, 12.0)
        truth = simulate(12.0, 100.0, after(2.0, rates), after(2.0, acceleration), (10.0, 20.0, 0.0))
        w, f = measure(truth, Flaws(gyro_bias=(0.2 * DEG,) * 3), np.random.default_rng(seed))
        samples = samples_of(truth.t, w / DEG, f)
        new_filter("attitude", samples).run(samples, np.zeros(len(samples), SOLUTION))
        assert np.flatnonzero(samples["flags"] & NO_RATE)[0] < (2.0 + latest_s) * 100.0


@pytest.mark.parametrize("seed", [14, 29, 39])
def test_the_force_at_the_end_of_an_arm_shows_no_degrees(seed):
    """It turns with the body, and so more slowly than the rates say."""
    arm, rates = np.random.default_rng(seed).normal(0.0, 0.4, 3), wobble(seed, 8.0, 0.3, 4.0)
    truth, h = simulate(30.0, 100.0, rates), 1e-4
    middle = truth.t - 0.005
    w, change = rates(middle), (rates(middle + h) - rates(middle - h)) / (2.0 * h)
    samples = samples_of(truth.t, w, truth.f + np.cross(w, np.cross(w, arm)) + np.cross(change, arm))
    new_filter("attitude", samples).run(samples, np.zeros(len(samples), SOLUTION))
    assert not (samples["flags"] & NO_RATE).any()


@pytest.mark.parametrize("rate_hz", [50.0, 200.0])
def test_fast_turns_show_degrees_within_half_a_second(rate_hz):
    """Of a hand that turns the sensor and moves it little; a decision after each 1.25 s of turning is later."""
    for seed in range(3):
        truth = simulate(20.0, rate_hz, after(5.0, wobble(seed, 1.0)), rpy_deg=(10.0, 20.0, 0.0))
        w, f = measure(truth, Flaws(), np.random.default_rng(seed))
        samples = samples_of(truth.t, w / DEG, f)
        new_filter("attitude", samples).run(samples, np.zeros(len(samples), SOLUTION))
        assert np.flatnonzero(samples["flags"] & NO_RATE)[0] < 5.5 * rate_hz


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 400.0])
def test_rates_in_degrees_are_unconfirmed_before_they_are_found(rate_hz):
    """While they have turned the attitude by less than 60 deg. Until they were found it was VALID, for seconds."""
    for seed in range(3):
        rates, acceleration = wobble(seed, 0.3), wobble(seed + 50, 0.5, 3.0, 12.0)
        truth = simulate(12.0, rate_hz, after(3.0, rates), after(3.0, acceleration), (10.0, 20.0, 0.0))
        w, f = measure(truth, Flaws(), np.random.default_rng(seed))
        samples, out = samples_of(truth.t, w / DEG, f), np.zeros(len(truth.t), SOLUTION)
        new_filter("attitude", samples).run(samples, out)
        claimed_deg = np.cumsum(np.linalg.norm(w / DEG, axis=1)) / rate_hz / DEG
        late = claimed_deg > 60.0
        assert not (out["status"][late] & ATTITUDE_VALID).any(), seed
        assert np.degrees(out["sigma_rpy"][late]).min() > 10.0, seed


def unconfirmed_s(rates, seed, rate_hz=100.0, seconds=20.0, thrust=False):
    """For how long rates in rad/s are unconfirmed.

    thrust: the force stays along the body's z axis, as a multicopter's.
    """
    truth = simulate(seconds, rate_hz, rates, wobble(seed + 50, 0.3, 3.0, 12.0))
    w, f = measure(truth, Flaws(), np.random.default_rng(seed))
    f = f - truth.f + [0.0, 0.0, -9.8] if thrust else f
    samples = samples_of(truth.t, w, f)
    new_filter("attitude", samples).run(samples, np.zeros(len(samples), SOLUTION))
    return np.count_nonzero(samples["flags"] & UNCONFIRMED_RATE) / rate_hz


def test_the_rates_of_a_sensor_that_a_hand_turns_are_confirmed():
    assert [unconfirmed_s(wobble(seed, 2.0), seed) for seed in range(6)] == [0.0] * 6


def test_the_rates_of_a_flight_are_confirmed_if_it_begins_gently_and_at_last_in_any_case():
    """Thrust does not turn with the rates, and is no evidence of degrees: there is no finding that would end it."""
    gentle, wild = wobble(3, 0.5), wobble(4, 2.5)
    gentle_at_first = lambda t: np.where((t < 8.0)[:, None], gentle(t), wild(t))  # noqa: E731
    assert unconfirmed_s(gentle_at_first, 1, thrust=True) == 0.0
    assert 0.5 < unconfirmed_s(wild, 1, thrust=True) <= 10.0
