"""Before the first rest: the bank of hypotheses of how the body moves, and what follows from it."""

import numpy as np
import pytest
from attitude_monte_carlo import ACCEL_BIAS, sensor
from attitude_runs import Fields, tilt_variance_deg2, yaw_sigma_deg
from attitude_simulation import G, Truth, errors_deg, measure
from broad import samples_of, solutions_of
from replay_in_process import new_filter, replay, smoothed_solutions
from scipy.spatial.transform import Rotation
from vehicle_simulation import RATE, ahead, levels, smooth, way

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.estimators.ahrs import hypothesis_filters
from imud.estimators.ahrs.power_on import reset_biases
from imud.estimators.ahrs.setup import configure, start
from imud.estimators.ahrs.state import ATTITUDE, GYRO_BIAS, HYPOTHESES, STATES
from imud.estimators.ahrs.velocity_hypotheses import (
    HANDS,
    correct_yaw,
    correction_variance,
    follow_hypotheses,
    measure_hypotheses,
    mix_hypotheses,
    start_hypotheses,
    tilt_error_of_others,
)
from imud.estimators.records import ATTITUDE_VALID
from imud.math.kalman import packed_index


def begun():
    """Parameters and state of a filter whose hypotheses have just begun."""
    p, s = Fields(configure(Settings(), 100.0)[0]), Fields(start(configure(Settings(), 100.0), Initial())[0])
    interpreted(start_hypotheses)(p, s)
    return p, s


@pytest.mark.parametrize("leading", [0, 1])
def test_the_error_that_the_others_suppose_is_that_of_a_mixture_of_two(leading):
    """Of a tilt known to .01 rad about each axis by those who lead, and by the others to .02 and .2 away."""
    _, s = begun()
    bank, others = s.hypotheses, slice(HANDS) if leading else slice(HANDS, None)
    s.cov.P[:] = 0.0
    for axis in range(2):
        s.cov.P[interpreted(packed_index)(STATES, ATTITUDE + axis, ATTITUDE + axis)] = 0.01**2
    bank.leading = leading
    bank.log_likelihood[:] = -100.0
    bank.log_likelihood[others.start or 0], bank.log_likelihood[0 if not leading else HANDS] = np.log(0.3), np.log(0.7)
    bank.P[:], bank.x[:], bank.covariance[:], bank.mean[:] = 0.0, 0.0, 0.0, 0.0
    bank.P[others, :2, :2] = 0.02**2 * np.eye(2)
    bank.x[others, 0] = 0.2
    bank.covariance[:2, :2] = 0.01**2 * np.eye(2)
    stated2 = 2.0 * 0.01**2 + 2.0 * interpreted(tilt_error_of_others)(s) ** 2
    np.testing.assert_allclose(stated2, 0.7 * 2.0 * 0.01**2 + 0.3 * (2.0 * 0.02**2 + 0.2**2), rtol=1e-9)


def dense_step(x, P, h, b, p):
    """x, P after the transition and the comparison, by matrices; the turn of what is carried by exact rotation."""
    speed, time, carried = hypothesis_filters.SPEED[h], hypothesis_filters.TIME[h], h >= hypothesis_filters.FREE
    F, bias, v = np.eye(11), np.array(b.turn_by_bias), x[7:9].copy()
    F[5, 1], F[6, 0] = b.force, -b.force
    F[:2, 2:5], F[5:7, 2:5] = b.tilt_by_bias, b.velocity_by_bias
    F[5, 9] = F[6, 10] = b.time
    turned = bias @ x[2:5]
    hidden = (bias @ P[2:5, 2:5] @ bias) / b.time**2 * P[[8, 7], [8, 7]] * carried
    F[5, 2:5] -= v[1] * bias
    F[6, 2:5] += v[0] * bias
    F[5, 8], F[6, 7] = -turned, turned
    angle = b.turn * carried
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    kept, constant = np.exp(-b.time / time), np.exp(-b.time / 60.0)
    F[7:9, 7:9], F[9:, 9:] = kept * turn, constant * turn
    noise = np.zeros(11)
    noise[:2], noise[2:5], noise[5:7] = b.attitude_noise, p.gyro_bias_psd * b.time, b.velocity_noise
    noise[7:9] = speed**2 * (1.0 - kept**2)
    noise[9:] = (p.accel_bias_var + hidden) * (1.0 - constant**2)
    moved = F @ x
    moved[5:7] += turned * np.array([v[1], -v[0]])  # the product of two errors is in F twice
    moved[:7] += b.shift
    P = F @ P @ F.T + np.diag(noise)
    H = np.zeros((2, 11))
    H[0, [5, 7, 1]], H[1, [6, 8, 0]] = (1.0, -1.0, -0.5 * b.force), (1.0, -1.0, 0.5 * b.force)
    S = H @ P @ H.T + (0.05**2 + (0.1 * speed) ** 2) * np.eye(2)
    innovation = -H @ moved - np.array(b.displacement) / b.time
    K = P @ H.T @ np.linalg.inv(S)
    likelihood = -0.5 * (np.log(np.linalg.det(S)) + innovation @ np.linalg.inv(S) @ innovation)
    return moved + K @ innovation, P - K @ H @ P, likelihood


def in_motion(seed):
    """A bank in the middle of a motion: random states, a random second."""
    rng = np.random.default_rng(seed)
    p, s = begun()
    b = s.hypotheses
    b.x[:] = rng.normal(0.0, 0.1, b.x.shape)
    for h in range(HYPOTHESES):
        root = rng.normal(0.0, 0.1, (11, 11))
        b.P[h] = root @ root.T
    b.time, b.force, b.turn, b.attitude_noise = 1.0, -9.8, 0.3, 1e-4
    for name in ("tilt_by_bias", "velocity_by_bias", "turn_by_bias", "shift", "displacement"):
        getattr(b, name)[:] = rng.normal(0.0, 0.5, getattr(b, name).shape)
    b.velocity_noise[:] = 0.02, 0.03
    return p, s


def test_each_filter_takes_the_step_that_matrices_take():
    p, s = in_motion(1)
    b = s.hypotheses
    for h in range(HYPOTHESES):
        x, P, likelihood = dense_step(np.array(b.x[h]), np.array(b.P[h]), h, b, p)
        interpreted(hypothesis_filters.propagate_hypothesis)(p, s, h)
        found = interpreted(hypothesis_filters.compare_velocity)(p, s, h)
        np.testing.assert_allclose(b.x[h], x, atol=1e-9)
        np.testing.assert_allclose(b.P[h], P, atol=1e-9)
        np.testing.assert_allclose(found, likelihood, atol=1e-9)


def test_the_mixture_has_the_mean_and_the_covariance_of_its_parts():
    _, s = in_motion(2)
    b = s.hypotheses
    b.log_weight[:] = np.random.default_rng(3).normal(size=HYPOTHESES)
    weights = np.exp(b.log_weight[HANDS:]) / np.exp(b.log_weight[HANDS:]).sum()
    mean = weights @ b.x[HANDS:]
    apart = b.x[HANDS:] - mean
    interpreted(mix_hypotheses)(s)
    np.testing.assert_allclose(b.mean, mean)
    expected = np.einsum("h,hij->ij", weights, b.P[HANDS:] + apart[:, :, None] * apart[:, None, :])
    np.testing.assert_allclose(b.covariance, expected, atol=1e-12)


@pytest.mark.parametrize(("speed", "leads"), [(0.3, 0), (3.0, 1)])
def test_only_a_body_that_travels_is_led(speed, leads):
    p, s = begun()
    b = s.hypotheses
    b.log_likelihood[:HANDS] = -10.0
    b.P[:] = 1e-4 * np.eye(11)
    b.x[:, 7], b.time, b.displacement[0] = speed, 1.0, speed
    interpreted(measure_hypotheses)(p, s)
    assert b.hand < 0.1 and b.leading == leads


def test_the_yaw_follows_the_gyro_bias_that_has_turned_it():
    p, s = begun()
    b, slope, before, after, other2 = s.hypotheses, (-20.0, 3.0, -7.0), (1e-4, 2e-4, 3e-4), (4e-6, 5e-5, 6e-4), 1e-3
    at = lambda i, j: interpreted(packed_index)(STATES, i, j)  # noqa: E731
    yaw = ATTITUDE + 2
    s.cov.P[at(yaw, yaw)] = other2 + np.dot(np.square(slope), before)
    for i in range(3):
        s.cov.P[at(GYRO_BIAS + i, GYRO_BIAS + i)], s.cov.P[at(yaw, GYRO_BIAS + i)] = before[i], slope[i] * before[i]
        b.covariance[2 + i, 2 + i], b.mean[2 + i] = after[i], 1e-3 * (i + 1)
    b.due = 1
    interpreted(follow_hypotheses)(p, s)
    assert s.scratch.x[yaw] == 0.0  # until the first rest
    interpreted(correct_yaw)(s)
    assert s.scratch.x[yaw] == pytest.approx(np.dot(slope, b.mean[2:5]))
    assert s.cov.P[at(yaw, yaw)] == pytest.approx(other2 + np.dot(np.square(slope), after))
    for i in range(3):
        assert s.cov.P[at(yaw, GYRO_BIAS + i)] == pytest.approx(slope[i] * after[i])


def test_the_yaw_is_as_uncertain_as_the_vertical_was_while_the_bias_turned_it():
    """Of many tilts as the hypotheses have them: the vertical part of a bias that turns the body for `times`."""
    _, s = begun()
    b, times, bias, sigma = s.hypotheses, np.array([-20.0, 3.0, -7.0]), np.array([1e-3, 2e-3, -3e-3]), 0.1
    b.mean[2:5] = bias
    b.covariance[0, 0] = b.covariance[1, 1] = sigma**2
    rng, down = np.random.default_rng(5), times / np.linalg.norm(times)
    tilts = rng.normal(0.0, sigma, (20000, 3))
    tilts -= np.outer(tilts @ down, down)  # about level axes
    expected = np.var(np.cross(tilts, times) @ bias)
    found = interpreted(correction_variance)(s, tuple(times))
    assert found == pytest.approx(expected, rel=0.05)


def test_a_correction_of_the_yaw_by_old_biases_is_not_made_after_a_power_on():
    p, s = begun()
    yaw = interpreted(packed_index)(STATES, ATTITUDE + 2, ATTITUDE + 2)
    for restart in (reset_biases, start_hypotheses):
        before, s.hypotheses.yaw_correction = s.cov.P[yaw], 0.3
        interpreted(restart)(p, s)
        interpreted(correct_yaw)(s)
        assert s.scratch.x[ATTITUDE + 2] == 0.0
        assert s.cov.P[yaw] == pytest.approx(before + 0.3**2)  # it may be wrong by as much


def plane(seed, seconds):
    """A small aircraft under way: coordinated turns, climbs."""
    rng, t = np.random.default_rng(seed), np.arange(int(seconds * RATE)) / RATE
    speed = 22.0 + smooth(levels(rng, t, -4.0, 4.0, 15.0), 4.0)
    bank = smooth(levels(rng, t, -0.6, 0.6, 10.0) * (levels(rng, t, 0.0, 1.0, 8.0) > 0.35), 1.5)
    climb = smooth(levels(rng, t, -0.12, 0.15, 12.0), 3.0)
    yaw = 1.0 + np.cumsum(9.8 / speed * np.tan(bank)) / RATE
    return way(t, ahead(speed, yaw, climb), yaw, climb + 0.03, bank)


def entered(drive, seed):
    """(RMS tilt in deg, mean NEES, part that is valid) from 5 s on of a minute that begins in motion."""
    rng, part = np.random.default_rng([seed, 7]), slice(-60 * RATE, None)
    flaws = sensor(rng, next(iter(ACCEL_BIAS)))
    shaken = rng.normal(size=(2, 60 * RATE, 3)) * [[[0.006]], [[0.3]]]  # rad/s, m/s^2: nothing that flies is quiet
    truth = Truth(drive.t[: 60 * RATE], drive.attitude[part], drive.w[part] + shaken[0], drive.f[part] + shaken[1])
    out = solutions_of(samples_of(truth.t, *measure(truth, flaws, rng)))[5 * RATE :]
    tilt, _ = errors_deg(out["q_nb"], truth.attitude[5 * RATE :])
    valid = np.mean(out["status"] & ATTITUDE_VALID != 0)
    return np.sqrt(np.mean(tilt**2)), np.mean(tilt**2 / tilt_variance_deg2(out)), valid


def test_a_flight_entered_under_way_is_levelled_by_the_hypotheses():
    """Without their correction: 17.8 deg, NEES 6.7, valid for 61 % of the time."""
    tilt, nees, valid = np.array([entered(plane(seed, 80.0), seed) for seed in range(6)]).mean(axis=0)
    assert tilt < 10.0 and nees < 4.0 and valid > 0.9


def landed(seed, smoothed=False):
    """(errors of the yaw less the first one, their sigmas), deg, in a minute at rest after such a minute of flight."""
    drive, rng, moving, resting = plane(seed, 80.0), np.random.default_rng([seed, 7]), 60 * RATE, 60 * RATE
    flaws = sensor(rng, next(iter(ACCEL_BIAS)))
    shaken = rng.normal(size=(2, moving, 3)) * [[[0.006]], [[0.3]]]
    last = drive.attitude[-1]
    attitude = Rotation.concatenate([drive.attitude[-moving:], *[last] * resting])
    w = np.vstack([drive.w[-moving:] + shaken[0], np.zeros((resting, 3))])
    f = np.vstack([drive.f[-moving:] + shaken[1], np.tile(last.inv().apply([0.0, 0.0, -G]), (resting, 1))])
    truth = Truth(np.arange(moving + resting) / RATE, attitude, w, f)
    samples = samples_of(truth.t, *measure(truth, flaws, rng))
    filter_ = new_filter("attitude", samples)
    out = smoothed_solutions(filter_, samples) if smoothed else replay(filter_, samples)[0]
    yaw = errors_deg(out["q_nb"], truth.attitude)[1]
    return ((yaw - yaw[0] + 180.0) % 360.0 - 180.0)[moving:], yaw_sigma_deg(out)[moving:]


def test_after_a_flight_entered_under_way_the_yaw_is_as_good_as_stated():
    """NEES 5.1 if the correction by the gyro bias is taken as exact."""
    yaw, sigma = np.array([[run[-1] for run in landed(seed)] for seed in range(20)]).T
    assert np.mean((yaw / sigma) ** 2) < 2.0


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_smoothing_carries_the_correction_of_the_yaw_back_over_the_first_rest(seed):
    """Without: up to 18 sigmas at the begin of the rest, before it is found."""
    yaw, sigma = landed(seed, smoothed=True)
    assert np.all(np.abs(yaw) < 4.0 * sigma)
