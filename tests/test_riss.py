"""The reduced inertial estimator: honest on the emulator's motions, and its covariances against numeric derivatives."""

import math
from dataclasses import replace

import numpy as np
import pytest
from in_c import Module
from riss_runs import RATE_HZ, SETTINGS, drive, errors, normalised
from simulated import estimated, motion, received, rpy, sensed

from imud.configuration.settings import Initial, Settings
from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.sample import NO_FORCE, NO_RATE
from imud.estimators import registry
from imud.estimators.records import (
    AT_REST,
    ATTITUDE_VALID,
    COASTING,
    HEADING_VALID,
    HEIGHT_VALID,
    POSITION_VALID,
    REJECTING,
)
from imud.estimators.riss import ekf as ekf_kernels
from imud.estimators.riss import forces as forces_kernels
from imud.estimators.riss import state
from imud.firmware_sim.rga300 import RGA300
from imud.setup import choices

ekf, forces = Module(ekf_kernels), Module(forces_kernels)
UPPER = np.triu_indices(state.STATES)
ALL_VALID = ATTITUDE_VALID | HEADING_VALID | POSITION_VALID | HEIGHT_VALID


def test_errors_are_small_and_the_sigmas_say_how_small_they_are():
    runs = [drive(seed, seconds=240.0) for seed in range(4)]
    squares, ratios = (np.mean(values, axis=0) for values in zip(*map(normalised, runs), strict=True))
    north, east, _, vn, ve, _, roll, pitch, yaw = np.sqrt(squares)
    assert math.hypot(north, east) < 1.5 * math.sqrt(2.0)  # the emulated receiver's lasting error
    assert max(vn, ve) < 0.2
    assert np.degrees(max(roll, pitch, yaw)) < 1.0
    assert 0.6 < np.mean(ratios) < 1.5
    assert np.max(ratios) < 2.5
    for m, out, _, _ in runs:
        assert (out["status"][m.t > 20.0] & ALL_VALID == ALL_VALID).all()
        assert (out["status"][m.t < 4.0] & HEADING_VALID == 0).all()


def test_innovations_are_as_large_as_they_are_said_to_be():
    rows = np.concatenate([drive(seed, seconds=240.0)[3] for seed in range(3)])
    assert (rows["used"] == 1).mean() > 0.99
    for kind in np.unique(rows["kind"]):
        these = rows[rows["kind"] == kind]
        assert 0.1 < np.mean(these["value"] ** 2 / these["variance"]) < 1.8


@pytest.mark.parametrize("begin", [10.6, 14.5, 24.0])
def test_a_start_at_speed_is_where_the_vehicle_is_not_where_the_fix_was(begin):
    for seed in range(3):
        m, out, _, innovations = drive(seed, seconds=begin + 20.0, begin=begin, late=0.4)
        assert np.linalg.norm(m.truth.v_n[int(begin * RATE_HZ)]) > 8.0
        e, sigma = errors(m, out)
        placed = out["status"] & POSITION_VALID != 0
        assert placed[int((begin + 3.0) * RATE_HZ) :].all()
        assert np.max(np.abs(e[placed, :2] / sigma[placed, :2])) < 4.0
        assert (innovations["used"] == 1).mean() > 0.95


@pytest.mark.parametrize("old", [-0.1, 0.25])
def test_fixes_that_are_older_or_younger_than_their_epochs_say_turn_no_heading(old):
    """A receiver without a pulse per second is late by something else than `gnss.latency_s`."""
    runs = [drive(seed, seconds=240.0, late=0.3, old=old) for seed in range(20, 22)]
    _, ratios = (np.mean(values, axis=0) for values in zip(*map(normalised, runs), strict=True))
    assert np.max(ratios) < 2.5
    for m, out, _, _ in runs:
        e, sigma = errors(m, out)
        late = m.t > 60.0
        assert np.max(np.abs(e[late] / sigma[late])[:, [3, 4, 8]]) < 5.0


def test_between_two_steps_the_yaw_goes_on():
    m, out, _, _ = drive(3, seconds=60.0)
    yaw, truth = (np.unwrap(angles[:, 2]) for angles in (rpy(out["q_nb"]), m.truth.rpy))
    turning = (m.t[1:] > 30.0) & (np.abs(np.diff(truth)) > 0.2 / RATE_HZ)
    assert turning.sum() > RATE_HZ
    assert np.median(np.abs(np.diff(yaw) - np.diff(truth))[turning]) < 0.05 / RATE_HZ


def test_thirty_seconds_without_a_fix():
    ends, ratios = [], []
    for seed in range(4):
        m, out, _, _ = drive(seed, seconds=190.0, outage=(150.0, 180.0))
        e, sigma = errors(m, out)
        end = np.searchsorted(m.t, 180.0)
        assert out["status"][end] & (ALL_VALID | COASTING) == ALL_VALID | COASTING
        ends.append(np.hypot(e[end, 0], e[end, 1]))
        ratios.append(np.mean((e[end, :2] / sigma[end, :2]) ** 2))
    assert np.sqrt(np.mean(np.square(ends))) < 40.0
    assert np.mean(ratios) < 4.0


@pytest.mark.parametrize("scenario", ["rest", "car", "turntable"])
def test_without_a_receiver_the_tilt_is_honest_and_nothing_else_is_claimed(scenario):
    ratios = []
    for seed in range(5):
        m = motion(scenario, 100.0, RATE_HZ, rpy=(0.17, -0.09, 1.0))
        samples, _ = sensed(m, np.random.default_rng(seed), RGA300)
        samples["w"][:, :2] = 0.0
        out, _ = estimated("riss", samples, settings=SETTINGS)
        e, sigma = errors(m, out)
        ratios.append(np.mean((e[500:, 6:8] / sigma[500:, 6:8]) ** 2))
        assert (out["status"] & (HEADING_VALID | POSITION_VALID | AT_REST) == 0).all()
        assert np.isnan(out["lat"]).all() and np.isnan(out["v"]).all()
    assert np.mean(ratios) < 2.0


def test_a_drive_that_begins_with_a_stop_is_at_rest_and_leaves_it_in_time():
    """The car stands until 5 s; what is believed at rest must not outlast it."""
    m, out, _, _ = drive(2, seconds=60.0)
    speed = np.linalg.norm(m.truth.v_n, axis=1)
    rest = out["status"] & AT_REST > 0
    assert rest[(m.t > 4.3) & (m.t < 5.0)].all()
    assert not rest[speed > 0.15].any()


def spoilt(change, seconds=150.0, seed=3):
    """The car with samples and fixes that `change(t of samples, samples, t of fixes, fixes)` has spoilt."""
    rng = np.random.default_rng(seed)
    m = motion("car", seconds, RATE_HZ)
    samples, _ = sensed(m, rng, RGA300)
    samples["w"][:, :2] = 0.0
    fixes = received(m, rng)
    change(m.t, samples, fixes["t_ns"] * 1e-9 - 1.0, fixes)
    return m, *estimated("riss", samples, fixes, SETTINGS)


def test_an_outlier_is_rejected():
    def jump(_t, _samples, t, fixes):
        fixes["lat"][np.argmin(np.abs(t - 80.0))] += 500.0 / 6.37e6

    m, out, innovations = spoilt(jump)
    e, _ = errors(m, out)
    assert np.hypot(e[:, 0], e[:, 1])[m.t > 20.0].max() < 8.0
    assert (innovations["used"] == 0).sum() >= 1


def test_a_receiver_that_stays_elsewhere_is_believed_in_the_end():
    def move(_t, _samples, t, fixes):
        fixes["lon"][t > 80.0] += 300.0 / 4.26e6

    m, out, _ = spoilt(move)
    e, _ = errors(m, out)
    between = (m.t > 85.0) & (m.t < 89.0)
    assert (out["status"][between] & REJECTING > 0).all()
    assert np.abs(e[between, 1]).max() < 20.0
    assert e[-1, 1] == pytest.approx(300.0, abs=8.0)
    assert out["status"][-1] & (HEADING_VALID | REJECTING) == HEADING_VALID


@pytest.mark.parametrize("flag", [NO_RATE, NO_FORCE])
def test_a_part_of_the_sensor_that_fails_is_left_out(flag):
    def fail(t, samples, _t, _fixes):
        gone = (t > 90.0) & (t < 100.0)
        samples["flags"][gone] = flag
        samples["outage_s"][gone] = t[gone] - 90.0
        samples["w" if flag == NO_RATE else "f"][gone] = np.nan
        if flag == NO_FORCE:
            samples["down"][gone] = 0.0, 0.0, 1.0

    m, out, _ = spoilt(fail)
    e, sigma = errors(m, out)
    known = m.t > 20.0
    assert np.isfinite(out["q_nb"]).all() and np.isfinite(out["lat"][known]).all()
    assert np.mean((e[known][:, [0, 1, 6, 7, 8]] / sigma[known][:, [0, 1, 6, 7, 8]]) ** 2) < 2.0
    worse = 8 if flag == NO_RATE else 6
    assert sigma[m.t > 99.9][0, worse] > 1.25 * sigma[m.t > 89.9][0, worse]


def test_a_given_heading_saves_the_drive():
    rng = np.random.default_rng(1)
    m = motion("rest", 20.0, RATE_HZ, rpy=(0.05, 0.02, 1.0))
    samples, _ = sensed(m, rng, RGA300)
    samples["w"][:, :2] = 0.0
    out, _ = estimated("riss", samples, received(m, rng), SETTINGS, Initial(yaw_deg=math.degrees(1.0)))
    assert out["status"][-1] & ALL_VALID == ALL_VALID
    assert rpy(out["q_nb"][-1:])[0, 2] == pytest.approx(1.0, abs=0.1)


# --- the equations ---


def some_state(seed=0):
    """A state on its way, and parameters."""
    estimator = registry.by_name("riss")
    p = estimator.configure(SETTINGS, RATE_HZ)
    s = estimator.start(p, Initial(lat_deg=48.0))
    rng = np.random.default_rng(seed)
    s["lat"], s["lon"], s["aligned"], s["step_ns"] = 0.8, 0.2, 1, 10**9
    s["x"][0, state.SPEED :] = 0.01 * rng.standard_normal(state.STATES - state.SPEED)
    s["x"][0, [state.SPEED, state.ACCEL, state.YAW, state.ROLL]] = 12.0, 1.5, 0.7, 0.06
    s["fix_var"] = 2.0
    return p[0], s


def nominal(s):
    """x with the position in m, north, east, down, from (0.8, 0.2)."""
    x = s["x"][0].copy()
    x[0], x[1] = (s["lat"][0] - 0.8) * 6.3685e6, (s["lon"][0] - 0.2) * 6.3892e6 * math.cos(0.8)
    x[2] = -s["height"][0]
    return x


def shifted(s, i, by):
    other = s.copy()
    if i < 3:
        other[("lat", "lon", "height")[i]] += by * (1 / 6.3685e6, 1 / 6.3892e6 / math.cos(0.8), -1.0)[i]
    else:
        other["x"][0, i] += by
    return other


def test_the_covariance_is_propagated_by_the_derivative_of_the_process():
    T, rate, h = 0.05, 0.3, 1e-5
    p, s = some_state()
    A = np.random.default_rng(2).standard_normal((state.STATES, state.STATES)) * 1e-3
    P = A @ A.T
    F = np.empty((state.STATES, state.STATES))
    for i in range(state.STATES):
        ends = []
        for sign in (1.0, -1.0):
            moved = shifted(s, i, sign * h)
            ekf.propagate(p, moved[0], rate, 0.0, T)
            ends.append(nominal(moved))
        F[:, i] = (ends[0] - ends[1]) / (2.0 * h)
    zero, full = s.copy(), s.copy()
    zero["P"], full["P"] = 0.0, P[UPPER]
    ekf.propagate(p, zero[0], rate, 0.0, T)
    ekf.propagate(p, full[0], rate, 0.0, T)
    # terms of the second order in the step, and of the tilt in the yaw rate, are left out: 2 % of P's diagonal
    left_out = 0.02 * np.max(np.diag(P))
    np.testing.assert_allclose(full["P"] - zero["P"], (F @ P @ F.T)[UPPER][None], rtol=0, atol=left_out)
    assert np.abs(F @ P @ F.T - P).max() > 0.2 * P[0, 0]
    assert (zero["P"][0] >= 0.0).all() and zero["P"].any()


def predicted_force(s):
    """f along and across by SciPy's rotation of the specific force, biases added."""
    from scipy.spatial.transform import Rotation

    x = s["x"][0]
    a, across = x[state.ACCEL], x[state.SPEED] * s["yaw_rate"][0]
    roll, pitch = x[state.ROLL] - x[state.LEAN] * across, x[state.PITCH] + x[state.SQUAT] * a
    f = Rotation.from_euler("YX", [pitch, roll]).inv().apply([a, across, -s["gravity"][0]])
    return f[:2] + x[[state.ACCEL_BIAS_X, state.ACCEL_BIAS_Y]]


def test_forces_are_fused_as_a_dense_filter_does_with_numeric_derivatives():
    h, T, rate = 1e-6, 0.05, 0.3
    p, s = some_state()
    ekf.propagate(p, s[0], rate, 0.0, T)
    rng = np.random.default_rng(5)
    A = rng.standard_normal((state.STATES, state.STATES)) * 1e-3
    P = A @ A.T
    s["P"] = P[UPPER]

    def at(i, by):
        moved = shifted(s, i, by)
        x = moved["x"][0]
        c = math.cos(ekf.roll_of(s[0])) / math.cos(ekf.pitch_of(s[0]))
        moved["yaw_rate"] = c * (rate * (1.0 - x[state.GYRO_SCALE]) - x[state.GYRO_BIAS])
        return predicted_force(moved)

    H = np.column_stack([(at(i, h) - at(i, -h)) / (2.0 * h) for i in range(state.STATES)])
    R = p["accel_psd"] / T + p["tuning"]["force_sigma"] ** 2
    both = P[state.SPEED, state.SPEED] * (
        P[state.GYRO_BIAS, state.GYRO_BIAS] + rate**2 * P[state.GYRO_SCALE, state.GYRO_SCALE]
    )
    z = np.array([0.02, -0.03])
    S = H @ P @ H.T + np.diag([R, R + both])
    K = P @ H.T @ np.linalg.inv(S)
    before, f = nominal(s), predicted_force(s) + z
    forces.fuse_forces(p, s[0], (f[0], f[1], -9.8), rate, T)
    np.testing.assert_allclose((nominal(s) - before)[3:], (K @ z)[3:], rtol=0, atol=0.01 * np.abs(K @ z).max())
    np.testing.assert_allclose(s["P"][0], (P - K @ S @ K.T)[UPPER], rtol=0, atol=0.01 * P[0, 0])
    assert np.abs(K @ S @ K.T).max() > 0.2 * P[0, 0]


def test_the_device_and_its_receiver_choose_it():
    dmu = ImuConfigured(Identity("crossbow", "DMU RGA300CA"), 100.0, 790, 0, 24, gyro_axes=(False, False, True))
    none = replace(dmu, gyro_axes=(False, False, False))
    both, alone = choices.estimators(Settings(ports=("a", "b"))), choices.estimators(Settings(ports=("a",)))
    assert both.estimator_for(dmu)[0].name == "riss"
    assert "no gyro about x, y: riss instead of navigation" in both.estimator_for(dmu)[1]
    assert both.estimator_for(none)[0].name == "tilt"
    assert alone.estimator_for(dmu)[0].name == "tilt"
    assert set(both.possible) == {"navigation", "tilt", "riss"}
