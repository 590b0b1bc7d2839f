"""Farrell's filter: check values against Van Loan, a dense textbook filter beside the kernels, what the row says."""

import numpy as np
import pytest
import scipy  # imports scipy.stats when it is used
from in_c import Module
from replay_in_process import replay
from scipy.linalg import expm

from imud.configuration.settings import Imu, Initial, Settings
from imud.estimators import registry
from imud.estimators.papers import stationary
from imud.estimators.records import (
    AT_REST,
    FIX,
    HEIGHT_VALID,
    INNOVATION,
    POSITION_VALID,
    REJECTING,
    REST_POSITION_X,
    REST_POSITION_Y,
    REST_POSITION_Z,
    SOLUTION,
)
from imud.experiments import farrell, whiteness
from imud.experiments.simulate import level_at_rest, m_g350, samples_of
from imud.pipeline import Filter
from imud.setup import config

pytestmark = pytest.mark.usefixtures("papers_as_c")
stationary = Module(stationary)

SETTINGS = Settings(imu=Imu(profile="m-g350"))
LEVEL = Initial(roll_deg=0.0, pitch_deg=0.0, yaw_deg=0.0)
PHI = [[1, 1, 0.49983337], [0, 1, 0.99950017], [0, 0, 0.9990005]]
Q_D = 1e-6 * np.array(
    [[0.54644452, 1.21933361, 1.33200073], [1.21933361, 3.1046676, 3.99600233], [1.33200073, 3.99600233, 7.99200533]]
)


def van_loan(T, rate=1e-3, q_n=4.4e-7, q_w=8e-6):
    F = np.array([[0, 1, 0], [0, 0, 1], [0, 0, -rate]])
    block = np.zeros((6, 6))
    block[:3, :3], block[:3, 3:], block[3:, 3:] = -F, np.diag([0, q_n, q_w]), F.T
    e = expm(block * T)
    phi = e[3:, 3:].T
    return phi, phi @ e[:3, 3:]


@pytest.mark.thorough
@pytest.mark.parametrize("steps", [1, 1000])
def test_transition_and_noise_to_the_printed_digits(steps):
    phi, q_d = farrell.discrete(steps)
    np.testing.assert_allclose(phi, PHI, atol=5e-9)
    np.testing.assert_allclose(q_d, Q_D, atol=6e-15)


@pytest.mark.parametrize("T", [1e-3, 0.01, 0.3, 1.0, 60.0])
def test_one_step_against_van_loan(T):
    p = farrell.parameters()
    packed = np.zeros(6)
    stationary.add_process_noise(p[0], T, packed)
    phi, q_d = van_loan(T)
    np.testing.assert_allclose(stationary.transition(1e-3, T), [phi[0, 2], phi[1, 2], phi[2, 2]], rtol=1e-13)
    np.testing.assert_allclose(packed, q_d[np.triu_indices(3)], rtol=1e-9 if T < 10 else 1e-6)


def dense(u, T, p, every, start=None):
    """Solution 7 in full matrices, Joseph form, u constant over each step; returns states and covariances."""
    phi, q_d = van_loan(T, p["bias_rate"][0], p["accel_psd"][0], p["bias_psd"][0])
    H, R = np.array([[1.0, 0.0, 0.0]]), np.array([[p["position_var"][0]]])
    x, P = start or (np.zeros(3), np.diag([0.0, 0.0, p["bias_var"][0]]))
    states, covariances = [x], [P]
    for k in range(1, len(u)):
        x = phi @ x + u[k] * np.array([0.5 * T * T, T, 0.0])
        P = phi @ P @ phi.T + q_d
        if k % every == 0:
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            x = x - K[:, 0] * x[0]
            I_KH = np.eye(3) - K @ H
            P = I_KH @ P @ I_KH.T + K @ R @ K.T
        states.append(x)
        covariances.append(P)
    return np.array(states), np.array(covariances)


def test_the_filter_agrees_with_a_dense_one():
    rng = np.random.default_rng(3)
    t = np.arange(3001) / 100.0
    samples = m_g350(rng, t, *level_at_rest(len(t)))
    p = farrell.parameters()
    states, covariances = dense(samples["f"][:, 0], 0.01, p, 100)
    run = farrell.filtered(samples, np.zeros(len(t)))
    np.testing.assert_allclose(run.states, states, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.sigmas**2, np.diagonal(covariances, axis1=1, axis2=2), rtol=1e-6, atol=1e-15)


def test_residuals_are_white_and_standard_normal_on_model_data():
    rng = np.random.default_rng(8)
    run = farrell.filtered(*farrell.model_samples(rng))
    eta = run.normalised
    assert len(eta) == farrell.SECONDS
    assert scipy.stats.kstest(eta, scipy.stats.norm.cdf).pvalue > 0.01
    assert whiteness.normal_distance(eta) == pytest.approx(
        scipy.stats.kstest(eta, scipy.stats.norm.cdf).statistic, rel=1e-9
    )
    assert scipy.stats.chi2.cdf(eta @ eta, len(eta)) == pytest.approx(0.5, abs=0.49)
    assert scipy.stats.chi2.ppf(0.99, whiteness.LAGS) == pytest.approx(whiteness.CHI2_99, abs=0.01)
    assert whiteness.ljung_box(eta) < whiteness.CHI2_99


def test_a_coloured_sequence_is_not_called_white():
    rng = np.random.default_rng(0)
    x = rng.standard_normal(600)
    assert whiteness.ljung_box(x[1:] + 0.5 * x[:-1]) > whiteness.CHI2_99


@pytest.mark.thorough
def test_the_claims_hold():
    assert farrell.reproduce(1).failed == []


def rows(samples, initial, fix=None):
    filter_ = Filter(registry.by_name("stationary"), SETTINGS, initial, 100.0)
    out = np.zeros(len(samples), SOLUTION)
    if fix is not None:
        assert len(filter_.update(fix)) == 0
    filter_.run(samples, out)
    return out


def fix_at(lat, lon):
    fix = np.zeros(1, FIX)
    fix["lat"], fix["lon"], fix["height"], fix["quality"], fix["sigma"] = lat, lon, 50.0, 1, np.nan
    return fix


def test_a_tilted_sensor_rests_where_it_is():
    rng = np.random.default_rng(2)
    t = np.arange(2000) / 100.0
    bias = np.array([0.05, -0.04, 0.03])
    c, s = np.cos(0.3), np.sin(0.3)  # roll 0.3 rad
    f = np.tile([0.0, -9.80665 * s, -9.80665 * c], (len(t), 1)) + bias + 0.001 * rng.standard_normal((len(t), 3))
    initial = Initial(roll_deg=np.degrees(0.3), pitch_deg=0.0, yaw_deg=90.0)
    out = rows(samples_of(t, np.zeros((len(t), 3)), f), initial, fix_at(0.8, 0.2))[-1]
    assert out["status"] & (AT_REST | POSITION_VALID) == AT_REST | POSITION_VALID
    np.testing.assert_allclose(out["ba"], bias, atol=0.01)
    assert (np.abs(out["ba"] - bias) < 4 * out["sigma_ba"]).all()
    np.testing.assert_allclose([out["lat"], out["lon"]], [0.8, 0.2], atol=1e-9)
    np.testing.assert_allclose(out["f"] - (f[-1] - out["ba"]), 0.0, atol=1e-12)
    assert np.isnan(out["bg"]).all()
    assert out["sigma_rpy"][2] > 1.5


@pytest.mark.parametrize("roll_deg", [0.0, 40.0])
def test_what_the_tilt_absorbs_of_the_bias_is_in_its_sigma(roll_deg):
    """Drawn sensors, their tilt not given: error over sigma of `ba` is standard normal across gravity."""
    t, angle = np.arange(1000) / 100.0, np.radians(roll_deg)
    w, f = level_at_rest(len(t))
    f = np.column_stack([f[:, 0], f[:, 2] * np.sin(angle), f[:, 2] * np.cos(angle)])
    rng, ratios, tilts = np.random.default_rng(4), [], []
    for _ in range(100):
        samples = m_g350(rng, t, w, f)
        bias = samples["f"][-100:].mean(axis=0) - f[-1]
        end = rows(samples, Initial())[-1]
        ratios.append((end["ba"] - bias) / end["sigma_ba"])
        roll = np.arctan2(2 * end["q_nb"][0] * end["q_nb"][1], 1 - 2 * end["q_nb"][1] ** 2)
        tilts.append((roll - angle) / end["sigma_rpy"][0])
    x, y, z = np.mean(np.square(ratios), axis=0)
    low, high = scipy.stats.chi2.ppf([1e-4, 1 - 1e-4], 100) / 100
    assert low < x < high and low < np.mean(np.square(tilts)) < high
    if roll_deg == 0.0:
        assert low < y < high and z < 0.5  # along gravity there is no tilt, and Q_omega is larger than a sensor's
    else:
        assert 0.2 < y < high and 0.2 < z < high


def test_design_parameters_are_settings():
    """Another Q_omega, lambda, R, T, P0 and b(0) give the dense filter's numbers with them."""
    settings = config.loads(
        "", ["stationary.bias_rate=0.05", "stationary.bias_psd=1e-4", "stationary.position_var=1e-6",
             "stationary.interval_s=0.5", "stationary.initial_position_sigma_m=0.1",
             "stationary.initial_velocity_sigma_mps=0.2", "stationary.initial_bias_mps2=[0.05,0,0]",
             "noise.accel_bias_initial_mg=20", "imu.profile=m-g350"]
    )  # fmt: skip
    t = np.arange(301) / 100.0
    samples = m_g350(np.random.default_rng(3), t, *level_at_rest(len(t)))
    p = stationary.configure(settings, 100.0)
    expected = (0.05, 1e-4, 1e-6, 500_000_000, (0.02 * 9.80665) ** 2)
    for name, value in zip(("bias_rate", "bias_psd", "position_var", "interval_ns", "bias_var"), expected, strict=True):
        assert p[name][0] == pytest.approx(value)
    start = (np.array([0.0, 0.0, 0.05]), np.diag([0.01, 0.04, p["bias_var"][0]]))
    states, covariances = dense(samples["f"][:, 0], 0.01, p, 50, start)
    s = stationary.start(p, LEVEL)
    out = np.zeros(1, SOLUTION)
    for sample in samples:
        stationary.step(p[0], s[0], sample, out[0])
    got = [s["p"][0, 0], s["v"][0, 0], s["b"][0, 0]]
    np.testing.assert_allclose(got, states[-1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(s["P"][0, [0, 3, 5]], np.diagonal(covariances[-1]), rtol=1e-6)


def test_residuals_are_written_as_innovations():
    samples = m_g350(np.random.default_rng(6), np.arange(1001) / 100.0, *level_at_rest(1001))
    filter_ = Filter(registry.by_name("stationary"), SETTINGS, LEVEL, 100.0)
    _, noted = replay(filter_, samples)
    assert [list(noted["kind"]).count(kind) for kind in (REST_POSITION_X, REST_POSITION_Y, REST_POSITION_Z)] == [10] * 3
    along_x = noted[noted["kind"] == REST_POSITION_X]
    p, u = stationary.configure(SETTINGS, 100.0), samples["f"][:, 0]
    states, covariances = dense(u, 0.01, p, 100)
    phi, q_d = van_loan(0.01, 1e-3, p["accel_psd"][0], 8e-6)
    before = np.arange(99, 1000, 100)
    predicted = [phi[0] @ states[k] + 0.5 * 0.01**2 * u[k + 1] for k in before]
    variances = [(phi @ covariances[k] @ phi.T + q_d)[0, 0] + 1e-10 for k in before]
    np.testing.assert_allclose(along_x["value"], np.negative(predicted), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(along_x["variance"], variances, rtol=1e-6)


def test_long_gaps_are_bridged_in_closed_form():
    for x in (0.5, 1.5, 30.0):
        T = x / 1e-3
        phi = expm(np.array([[0, 1, 0], [0, 0, 1], [0, 0, -1e-3]]) * T)
        np.testing.assert_allclose(stationary.transition(1e-3, T), [phi[0, 2], phi[1, 2], phi[2, 2]], rtol=1e-9)


@pytest.mark.parametrize("height", [100.0, np.nan])
def test_a_height_is_valid_if_the_fix_of_the_origin_has_one(height):
    t = np.arange(200) / 100.0
    fix = fix_at(0.8, 0.2)
    fix["height"] = height
    last = rows(samples_of(t, *level_at_rest(len(t))), LEVEL, fix)[-1]
    assert bool(last["status"] & HEIGHT_VALID) == np.isfinite(height)
    np.testing.assert_allclose(last["height"], height, atol=0.01)
    assert np.isfinite(last["sigma_p"][2]) == np.isfinite(height)


def test_motion_contradicts_rest():
    t = np.arange(2000) / 100.0
    w, f = level_at_rest(len(t))
    f[1000:, 0] += 2.0 * np.sin(2 * np.pi * t[1000:] / 3.0)
    out = rows(samples_of(t, w, f), LEVEL)
    assert out["status"][900] & (AT_REST | REJECTING) == AT_REST
    assert out["status"][-1] & (AT_REST | REJECTING) == REJECTING
    assert out["status"][-1] & POSITION_VALID == 0
    assert np.isnan(out["lat"]).all()


def test_unusable_samples_and_fixes_change_nothing():
    t = np.arange(500) / 100.0
    samples = samples_of(t, *level_at_rest(len(t)))
    samples["f"][100:120] = np.nan
    out = rows(samples, LEVEL)
    assert np.isfinite(out["ba"]).all()
    filter_ = Filter(registry.by_name("stationary"), SETTINGS, LEVEL, 100.0)
    bad = fix_at(0.5, 0.5)
    bad["quality"] = 0
    assert stationary.set_origin(filter_.parameters[0], filter_.state[0], bad[0], np.zeros(4, INNOVATION)) == 0
    assert np.isnan(filter_.state["origin"]).all()
