"""Wheel speed in the reduced inertial estimator, and how it goes on after a restart of the program."""

import math

import numpy as np
import pytest
from in_c import Module
from replay_in_process import replay
from riss_runs import RATE_HZ, SETTINGS, errors
from simulated import motion, received, sensed
from test_riss import UPPER, nominal, some_state

from imud.batch import NO_MEASUREMENT
from imud.configuration.settings import Initial
from imud.estimators import registry
from imud.estimators.filter_states import cells
from imud.estimators.records import (
    AT_REST,
    FIX,
    HEADING_VALID,
    INNOVATION,
    MEASUREMENT,
    ODOMETER,
    ODOMETER_SOURCE,
    SOLUTION,
)
from imud.estimators.riss import state
from imud.estimators.riss import wheels as wheel_kernels
from imud.firmware_sim.rga300 import RGA300
from imud.pipeline import Filter, Stored

wheels = Module(wheel_kernels)
SCALE = 0.02  # the wheels show so much too much


def readings(m, rng, is_signed=True, every=10):
    """MEASUREMENT rows of wheels with a scale error, and noise of 0.05 m/s."""
    at = np.arange(every, len(m.t), every)
    yaw, v = m.truth.rpy[at, 2], m.truth.v_n[at]
    speed = (1.0 + SCALE) * (v[:, 0] * np.cos(yaw) + v[:, 1] * np.sin(yaw)) + 0.05 * rng.standard_normal(len(at))
    rows = np.zeros(len(at), MEASUREMENT)
    rows["t_ns"] = np.round((1.0 + m.t[at]) * 1e9)
    rows["arrival_ns"] = rows["t_ns"] + 60_000_000
    rows["kind"], rows["sigma"] = ODOMETER_SOURCE, np.nan
    rows["value"][:, 0] = speed if is_signed else np.abs(speed)
    return rows


def driven(seed, outage=(150.0, 180.0), seconds=190.0, change=None, with_wheels=True, is_signed=True):
    """(motion, solutions, innovations, the filter) of a drive with wheels."""
    rng = np.random.default_rng(seed)
    m = motion("car", seconds, RATE_HZ)
    samples, _ = sensed(m, rng, RGA300)
    samples["w"][:, :2] = 0.0
    fixes = received(m, rng)
    t = fixes["t_ns"] * 1e-9 - 1.0
    fixes = fixes[(t < outage[0]) | (t > outage[1])]
    aiding = readings(m, rng, is_signed)
    if change:
        change(aiding)
    filter_ = Filter(registry.by_name("riss"), SETTINGS, Initial(), RATE_HZ)
    return m, *replay(filter_, samples, fixes, aiding if with_wheels else NO_MEASUREMENT), filter_


@pytest.mark.parametrize("is_signed", [True, False])
def test_wheels_shorten_an_outage_and_the_sigmas_know_it(is_signed):
    ends, ratios, scales = [], [], []
    for seed in range(6):
        m, out, noted, filter_ = driven(seed, is_signed=is_signed)
        e, sigma = errors(m, out)
        end = np.searchsorted(m.t, 180.0)
        ends.append(np.hypot(*e[end, :2]))
        known = m.t > np.min(m.t[(out["status"] & HEADING_VALID) > 0]) + 10.0
        ratios.append(np.mean((e[known] / sigma[known]) ** 2))
        s = filter_.state[0]
        scales.append((s["x"][state.WHEEL_SCALE] - SCALE) / math.sqrt(s["P"][np.flatnonzero(UPPER[0] == UPPER[1])[-1]]))
        rows = noted[noted["kind"] == ODOMETER]
        assert len(rows) > 1000 and np.mean(rows["used"]) > 0.98
        assert np.mean(rows["value"] ** 2 / rows["variance"]) < 1.5
    without = [driven(seed, with_wheels=False) for seed in range(6)]
    far = [np.hypot(*errors(m, out)[0][np.searchsorted(m.t, 180.0), :2]) for m, out, _, _ in without]
    assert np.sqrt(np.mean(np.square(ends))) < 0.7 * np.sqrt(np.mean(np.square(far)))
    assert np.sqrt(np.mean(np.square(ends))) < 12.0
    assert 0.4 < np.mean(ratios) < 1.6
    assert np.mean(np.square(scales)) < 2.5


def test_wheels_that_spin_are_left_out():
    def spin(aiding):
        at = aiding["t_ns"] * 1e-9 - 1.0
        aiding["value"][(at > 100.0) & (at < 103.0), 0] += 4.0

    m, out, noted, _ = driven(3, change=spin)
    rows = noted[noted["kind"] == ODOMETER]
    at = rows["t_ns"] * 1e-9 - 1.0
    assert (rows["used"][(at > 100.0) & (at < 103.0)] == 0).all()
    e, _ = errors(m, out)
    assert np.hypot(e[:, 3], e[:, 4])[(m.t > 100.0) & (m.t < 104.0)].max() < 0.8


@pytest.mark.thorough
def test_wheels_are_fused_as_a_dense_filter_does_with_numeric_derivatives():
    p, s = some_state()
    p["odometer_lever_arm"] = 0.3, -0.7, 0.1
    s["started"], s["fix_count"], s["t_ns"] = 1, 1, s["step_ns"]
    s["x"][0, state.WHEEL_SCALE] = 0.03
    s["yaw_rate"] = 0.2
    A = np.random.default_rng(5).standard_normal((state.STATES, state.STATES)) * 1e-3
    P = A @ A.T
    s["P"] = P[UPPER]
    m = np.zeros(1, MEASUREMENT)
    m["t_ns"], m["sigma"] = s["step_ns"], (0.1, np.nan, np.nan, np.nan)

    def predicted(x):
        return (1.0 + x[state.WHEEL_SCALE]) * (x[state.SPEED] + 0.7 * 0.2)

    x, h = nominal(s), 1e-6
    H = np.array([(predicted(x + h * e) - predicted(x - h * e)) / (2 * h) for e in np.eye(state.STATES)])
    z = 0.05
    m["value"][0, 0] = reading = predicted(x) + z
    slip = (0.004 + 0.004 * abs(x[state.ACCEL])) * reading
    P[state.WHEEL_SCALE, state.WHEEL_SCALE] += 5e-5**2  # the walk of a second before the first reading
    S = H @ P @ H + 0.01 + slip**2
    rows = np.zeros(1, INNOVATION)
    assert wheels.fuse_wheel_speed(p, s[0], m[0], rows) == 1
    assert rows["value"][0] == pytest.approx(z) and rows["variance"][0] == pytest.approx(S) and rows["used"][0] == 1
    K = P @ H / (S + slip**2)
    np.testing.assert_allclose((nominal(s) - x)[3:], K[3:] * z, rtol=0, atol=1e-9)
    np.testing.assert_allclose(s["P"][0], (P - np.outer(K, K) * (S + slip**2))[UPPER], rtol=0, atol=1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize(("value", "current"), [(np.nan, np.nan), (50.0, np.nan), (12.0, 0.5)])
def test_a_reading_of_no_use_changes_nothing(value, current):
    """One through the water, in a current, is of no use here."""
    p, s = some_state()
    s["started"], s["fix_count"] = 1, 1
    m = np.zeros(1, MEASUREMENT)
    m["t_ns"], m["sigma"], m["value"] = s["step_ns"], (0.1, current, np.nan, np.nan), value
    s["P"] = 1e-4 * np.eye(state.STATES)[UPPER]
    before, rows = s["x"].copy(), np.zeros(1, INNOVATION)
    assert wheels.fuse_wheel_speed(p, s[0], m[0], rows) == (1 if value == 50.0 else 0)
    assert rows["used"][0] == 0
    np.testing.assert_array_equal(s["x"], before)
    m["value"], m["t_ns"] = 12.0, s["step_ns"] - 3_000_000_000
    assert wheels.fuse_wheel_speed(p, s[0], m[0], rows) == 0


# --- a restart of the program ---


def samples_and_fixes(seed=1, seconds=120.0):
    rng = np.random.default_rng(seed)
    m = motion("car", seconds, RATE_HZ)
    samples, _ = sensed(m, rng, RGA300)
    samples["w"][:, :2] = 0.0
    return m, samples, received(m, rng)


def played(filter_, samples, fixes):
    return replay(filter_, samples, fixes)[0]


def fresh():
    return Filter(registry.by_name("riss"), SETTINGS, Initial(), RATE_HZ)


def test_a_restart_without_a_pause_changes_no_bit():
    _, samples, fixes = samples_and_fixes()
    half = len(samples) // 2
    begins_ns = samples["t_ns"][half - 1]
    whole, first = fresh(), fresh()
    expected = played(whole, samples, np.zeros(0, FIX))[half:]
    played(first, samples[:half], np.zeros(0, FIX))
    second = fresh()
    assert second.restore(Stored(checkpoint=first.checkpoint()))
    out = np.zeros(len(samples) - half, SOLUTION)
    second.run(samples[half:].copy(), out)
    assert out.tobytes() == expected.tobytes()
    assert begins_ns < samples["t_ns"][half] and len(fixes)


def test_a_restart_of_twenty_seconds_keeps_the_heading_and_admits_the_gap():
    ratios = []
    for seed in range(6):
        m, samples, fixes = samples_and_fixes(seed)
        first, second = fresh(), fresh()
        before = samples["t_ns"] <= 61_000_000_000
        after = samples["t_ns"] > 81_000_000_000
        played(first, samples[before], fixes[fixes["arrival_ns"] < 61_000_000_000])
        assert second.restore(Stored(checkpoint=first.checkpoint()))
        out = played(second, samples[after], fixes[fixes["arrival_ns"] > 81_000_000_000])
        assert out["status"][0] & AT_REST == 0
        e, sigma = _errors(m, after, out)
        ratios.append((e[10] / sigma[10]) ** 2)
        assert np.hypot(*e[-1, :2]) < 5.0 and (out["status"][-1] & HEADING_VALID) > 0
    assert np.mean(np.array(ratios)[:, [0, 1, 6, 7, 8]]) < 2.5


def _errors(m, part, out):
    """`errors` of a part of the motion."""
    whole = np.zeros(len(m.t), SOLUTION)
    whole["q_nb"][:, 0] = 1.0
    whole[np.flatnonzero(part)] = out
    return tuple(values[part] for values in errors(m, whole))


def test_what_is_known_beside_the_solution_is_shown():
    """The wheels' scale as simulated, and of the receiver what the fixes have shown; without wheels no scale."""
    *_, filter_ = driven(11)
    found = {name: values[0] for name, values in cells(filter_.filter_states()).items()}
    assert abs(found["odometer_scale"] - SCALE) < 3.5 * found["sodometer_scale"] < 0.02
    scale = filter_.estimator.source_estimates(filter_.state)[ODOMETER_SOURCE]["scale"]
    assert scale == pytest.approx(1.0 + found["odometer_scale"], abs=1e-5)
    assert 0.0 < found["gnss_noise_horizontal_m"] < 2.0 and 0.0 < found["sgnss_bias_n_m"] < 3.0
    assert found["cov_pn_pn"] == pytest.approx(filter_.state[0]["P"][0])  # NORTH is the first state
    *_, without = driven(11, seconds=20.0, with_wheels=False)
    assert "odometer_scale" not in cells(without.filter_states())
    assert without.estimator.source_estimates(without.state) == {}
