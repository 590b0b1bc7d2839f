"""Suh's three filters against dense matrices written from the paper, and the paper's experiment."""

import math

import numpy as np
import pytest

from imud.configuration.settings import Imu, Initial, Settings
from imud.estimators import registry
from imud.estimators.papers import suh as suh_filters
from imud.estimators.papers.suh import ABSOLUTE, ADAPTIVE, SIGNED, SQUARE, STANDARD, TWO_STEP
from imud.estimators.records import ATTITUDE_VALID, HEADING_VALID, SOLUTION
from imud.experiments import suh, suh_cart
from imud.experiments.simulate import level_at_rest, m_g350, samples_of
from imud.pipeline import Filter

pytestmark = pytest.mark.usefixtures("papers_as_c")

T, G = 0.05, 9.80665
MODES = {"suh-standard": STANDARD, "suh-adaptive": ADAPTIVE, "suh-two-step": TWO_STEP}


def tumbling(seconds, rate=20.0, seed=4):
    """Samples of a body that rolls, pitches and is pushed; gravity of its true attitude."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate)) / rate
    roll, pitch = 0.9 * np.sin(0.7 * t), 0.6 * np.sin(0.43 * t + 1.0)
    droll, dpitch, yaw_rate = 0.63 * np.cos(0.7 * t), 0.258 * np.cos(0.43 * t + 1.0), 0.2
    w = np.column_stack(
        [
            droll - yaw_rate * np.sin(pitch),
            dpitch * np.cos(roll) + yaw_rate * np.sin(roll) * np.cos(pitch),
            -dpitch * np.sin(roll) + yaw_rate * np.cos(roll) * np.cos(pitch),
        ]
    )
    f = G * np.column_stack([np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)])
    f[200:300, 1] += 4.0 * np.sin(3.0 * t[200:300])
    return m_g350(rng, t, w, f), np.column_stack([pitch, roll])


def test_a_pitch_beyond_the_vertical_is_the_same_attitude_with_the_same_covariance():
    """Pitch over the top is pi - pitch with roll and yaw turned round: only the sign of pitch's error changes."""
    s = registry.by_name("suh-standard").start(None, Initial())
    upper = np.triu_indices(5)
    A = np.random.default_rng(1).standard_normal((5, 5))
    P = A @ A.T
    s["x"], s["yaw"], s["P"] = [math.radians(95.0), 0.2, 0.3, 0.4, 0.5], 0.1, P[upper]
    suh_filters.wrap_angles(s[0])
    J = np.diag([-1.0, 1, 1, 1, 1])
    np.testing.assert_allclose(s["P"][0], (J @ P @ J)[upper], rtol=1e-15)
    assert s["x"][0, :2] == pytest.approx([math.radians(85.0), 0.2 - math.pi])
    assert s["yaw"][0] == pytest.approx(0.1 - math.pi)


def dense(samples, mode, literal, rule):
    """The paper's equations in full matrices with the corrections of the docstring; pitch, roll, diag P, r per step."""
    w, a = samples["w"], samples["f"] / G * [1, -1, 1]
    x = np.array([math.atan2(a[0, 0], math.hypot(a[0, 1], a[0, 2])), math.atan2(a[0, 1], -a[0, 2]), *w[0]])
    P, r = np.zeros((5, 5)), np.array([0.05, 0.05])
    C2, R2 = np.hstack([np.zeros((3, 2)), np.eye(3)]), np.eye(3)
    out = []

    def joseph(x, P, H, R, innovation):
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        A = np.eye(5) - K @ H
        return x + K @ innovation, A @ P @ A.T + K @ R @ K.T

    def accelerometer(x):
        sp, cp, sr, cr = math.sin(x[0]), math.cos(x[0]), math.sin(x[1]), math.cos(x[1])
        if literal:
            C = np.array([[cp, 0, 0, 0, 0], [0, cr * cp, 0, 0, 0]])
            return C, C @ x
        return np.array([[cp, 0, 0, 0, 0], [-sr * sp, cr * cp, 0, 0, 0]]), np.array([sp, sr * cp])

    for k in range(1, len(w)):
        sr, cr, tp = math.sin(x[1]), math.cos(x[1]), math.tan(x[0])
        W = np.array([[0, cr, -sr], [1, sr * tp, cr * tp]])
        Phi = np.block([[np.eye(2), W * T], [np.zeros((3, 2)), np.eye(3)]])
        Q = np.block([[T**3 / 3 * W @ W.T, T**2 / 2 * W], [T**2 / 2 * W.T, T * np.eye(3)]])
        x, P = Phi @ x, Phi @ P @ Phi.T + Q
        external = abs(a[k] @ a[k] - 1) > 0.005
        if mode == TWO_STEP:
            C1, _ = accelerometer(x)
            x, P = joseph(x, P, C2, R2, w[k] - C2 @ x)
            if not literal:
                C1, expected = accelerometer(x)
            e = a[k, :2] - (C1 @ x if literal else expected)
            more = {SIGNED: 10.0 * e, ABSOLUTE: 10.0 * abs(e), SQUARE: 10.0 / math.sqrt(0.005) * e**2}[rule]
            r = np.maximum(0.4 * r + more, 0.05) if external else 0.4 * r + (1.0 if literal else 0.6) * 0.05
            x, P = joseph(x, P, C1, np.diag(r), e)
        else:
            r = np.full(2, 5.0 if external and mode == ADAPTIVE else 0.05)
            C1, expected = accelerometer(x)
            R = np.diag([*r, 1, 1, 1])
            x, P = joseph(x, P, np.vstack([C1, C2]), R, np.concatenate([a[k, :2] - expected, w[k] - x[2:]]))
        out.append([x[0], x[1], P[0, 0], P[1, 1], *r])
    return np.array(out)


@pytest.mark.parametrize("name", suh.FILTERS)
def test_each_filter_agrees_with_a_dense_one(name):
    samples, truth = tumbling(30.0)
    estimator, literal, rule = suh.FILTERS[name]
    rows = np.zeros((len(samples), 7))
    p = estimator.configure(Settings(), 20.0)
    p["literal"], p["rule"] = literal, rule
    out = np.zeros(1, SOLUTION)
    n = suh._record(p, estimator.start(p, Initial()), samples, out, rows)
    expected = dense(samples, MODES[estimator.name], literal, rule)
    assert n == len(expected)
    np.testing.assert_allclose(rows[:n, 1:], expected, rtol=0, atol=1e-9)
    assert np.ptp(truth[:, 1]) > 1.5  # the run was not a trivial one


@pytest.mark.parametrize("name", MODES)
def test_faster_samples_are_averaged_to_the_papers_rate(name):
    rng = np.random.default_rng(5)
    t = np.arange(10_000) / 1000.0
    c, s = math.cos(0.2), math.sin(0.2)  # pitch 0.2 rad
    samples = m_g350(rng, t, np.zeros((len(t), 3)), np.tile([G * s, 0.0, -G * c], (len(t), 1)), switch_on=0.0)
    filter_ = Filter(registry.by_name(name), Settings(), Initial(yaw_deg=30.0), 1000.0)
    out = np.zeros(len(t), SOLUTION)
    filter_.run(samples, out)
    assert filter_.state["steps"][0] == len(t) / 50 - 1
    q = out["q_nb"][-1]
    pitch = math.asin(2 * (q[0] * q[2] - q[1] * q[3]))
    yaw = math.atan2(2 * (q[1] * q[2] + q[0] * q[3]), 1 - 2 * (q[2] ** 2 + q[3] ** 2))
    assert pitch == pytest.approx(0.2, abs=2e-3)
    assert yaw == pytest.approx(math.radians(30.0), abs=2e-3)
    assert out["status"][-1] & (ATTITUDE_VALID | HEADING_VALID) == ATTITUDE_VALID
    assert np.isnan(out["lat"][-1])
    assert out["sigma_rpy"][-1][2] > 1.5
    assert not np.isfinite(out["q_nb"][10]).any()  # nothing is known before the first step


@pytest.mark.parametrize("name", MODES)
def test_upside_down_through_the_vertical_and_a_gap(name):
    """Pitch turns through 360 deg, then the samples stop for a while: angles stay finite and right."""
    t = np.arange(0.0, 40.0, 0.05)
    angle = 2 * np.pi * np.minimum(t, 20.0) / 20.0
    w = np.column_stack([0 * t, np.where(t < 20.0, 2 * np.pi / 20.0, 0.0), 0 * t])
    f = G * np.column_stack([np.sin(angle), 0 * t, -np.cos(angle)])
    samples = samples_of(t, w, f)
    samples["t_ns"][600:] += 5_000_000_000
    out = np.zeros(len(t), SOLUTION)
    Filter(registry.by_name(name), Settings(), Initial(), 20.0).run(samples, out)
    q = out["q_nb"]
    assert np.isfinite(q).all()
    down = np.column_stack([2 * (q[:, 1] * q[:, 3] - q[:, 0] * q[:, 2]), 1 - 2 * (q[:, 1] ** 2 + q[:, 2] ** 2)])
    true = np.column_stack([-np.sin(angle), np.cos(angle)])
    error = np.degrees(np.arccos(np.clip(np.sum(down * true, axis=1), -1, 1)))
    # within 30 deg of the vertical the paper's Euler angles are not defined
    assert error[np.abs(np.cos(angle)) > 0.5].max() < 10.0
    assert error[-1] < 0.1


def test_the_claims_hold(monkeypatch):
    monkeypatch.setattr(suh, "CARTS", 5)
    report = suh.reproduce(1)
    assert report.failed == []
    quantities = [row.quantity for row in report.rows if row.holds is not None]
    for make in ("his sensors", "M-G350"):
        assert {f"{make}, {rule}: roll RMS in deg" for rule in ("141 e²", "10 |e|")} <= set(quantities)


def test_his_sensors_have_the_variances_that_he_prints():
    force, rate = suh_cart.averaged(suh_cart.still(np.random.default_rng(2), suh_cart.his))
    np.testing.assert_allclose(force.var(axis=0)[:2], (1.68e-5, 1.67e-5), rtol=0.15)
    np.testing.assert_allclose(rate.var(axis=0), (0.0032, 0.0040, 0.0031), rtol=0.15)
    better, _ = suh_cart.averaged(suh_cart.still(np.random.default_rng(2), suh_cart.zeroed()))
    assert 150.0 < np.mean(force.var(axis=0)[:2] / better.var(axis=0)[:2]) < 220.0


def test_the_attitude_filter_compensates_external_acceleration_better():
    """In the spirit of the two-step filter, it trusts each axis the less the livelier the motion along it."""
    for seed in range(3):
        samples, push = suh.cart(np.random.default_rng(seed), suh_cart.zeroed(0.0))  # a bias would be tilt to both
        assert np.abs(push).max() > 0.5 * G
        settings = Settings(imu=Imu(profile="m-g350"))
        out = np.zeros(len(samples), SOLUTION)
        Filter(registry.by_name("attitude"), settings, Initial(), suh.RATE_HZ).run(samples, out)
        w, x, y, z = out["q_nb"].T
        roll, pitch = np.arctan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y)), np.arcsin(2 * (w * y - x * z))
        two_step = suh.filtered("two-step", samples)
        assert np.degrees(np.sqrt(np.mean(roll**2))) < 0.2 * two_step.rms_deg(1)
        assert np.degrees(np.sqrt(np.mean(pitch**2))) < 0.6 * two_step.rms_deg(0)
        assert (np.abs(np.column_stack([roll, pitch])) < 3.0 * out["sigma_rpy"][:, :2]).all()


def test_bad_samples_are_left_out():
    t = np.arange(400) / 20.0
    clean = samples_of(t, *level_at_rest(len(t)))
    spoilt = clean.copy()
    spoilt["f"][200] = np.nan
    spoilt["w"][201], spoilt["flags"][201] = 100.0, 1
    ends = []
    for samples in (clean, spoilt):
        out = np.zeros(len(t), SOLUTION)
        Filter(registry.by_name("suh-two-step"), Settings(), Initial(), 20.0).run(samples, out)
        ends.append(out["q_nb"][-1])
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-6)
