"""The process noise is learned from the fixes: the derivatives of the likelihood, drives of any noise, bumps."""

import numpy as np
import pytest
from in_c import in_c
from navigation_runner import nanoseconds, navigate, settings_of
from navigation_simulation import drive, errors, received, sensed
from vehicle_simulation import vehicle

from imud.configuration.settings import Initial, Navigation, Settings
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.process_noise import (
    inflate_earlier_estimates,
    learn_process_noise,
    propagate_learning,
    update_learning,
)
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, STATES
from imud.estimators.ins.stationarity import update_attitude_noise_level
from imud.estimators.records import REJECTING
from imud.math.kalman import unpack

inflate_earlier_estimates = in_c(inflate_earlier_estimates)
learn_process_noise = in_c(learn_process_noise)
propagate_learning = in_c(propagate_learning)
update_learning = in_c(update_learning)
update_attitude_noise_level = in_c(update_attitude_noise_level)

N = 9  # position, velocity, attitude
FIXES, DT, STEPS, R = 12, 0.25, 4, 0.04**2


def transition(force):
    """Phi of position, velocity and attitude over DT in the order of the elementary matrices that the kernels apply."""
    position, velocity = np.eye(N), np.eye(N)
    position[:3, 3:6] = DT * np.eye(3)
    fx, fy, fz = force
    velocity[3:6, 6:9] = -np.array([[0, -fz, fy], [fz, 0, -fx], [-fy, fx, 0]])
    return velocity @ position


def rows(rng):
    """Jacobians of each fix: two positions, two velocities with a part of the attitude."""
    h = np.zeros((FIXES, 4, N))
    for axis in range(2):
        h[:, axis, axis] = h[:, 2 + axis, 3 + axis] = 1.0
    h[:, 2:, 6:] = 0.1 * rng.standard_normal((FIXES, 2, 3))
    return h


def filtered(log_psd, forces, h, z):
    """(log likelihood, innovations with variance and P h) of a dense Kalman filter with this process noise."""
    P, x, total, used = np.diag(np.repeat([1.0, 0.3, 0.02], 3) ** 2), np.zeros(N), 0.0, []
    for k in range(FIXES):
        for force in forces[k]:
            phi = transition(force)
            P, x = phi @ P @ phi.T, phi @ x
            P[3:, 3:] += np.diag(np.repeat(np.exp(log_psd), 3)) * DT
        for i in range(4):
            d = P @ h[k, i]
            s, v = h[k, i] @ d + R, z[k, i] - h[k, i] @ x
            used.append((v, s, d))
            total -= 0.5 * (np.log(s) + v * v / s)
            P, x = P - np.outer(d, d) / s, x + d * v / s
    return total, used


@pytest.mark.parametrize("seed", range(3))
def test_the_scores_are_the_derivatives_of_the_log_likelihood(seed):
    """By finite differences of a dense filter. With a prior of next to nothing estimates move by sigma^2 score."""
    rng = np.random.default_rng(seed)
    forces = (rng.standard_normal((FIXES, STEPS, 3)) * 3.0 + (0, 0, -9.8)) * DT
    h, z, log_psd, sigma2 = rows(rng), 0.3 * rng.standard_normal((FIXES, 4)), np.log([0.02, 1e-5]), 1e-9
    used = filtered(log_psd, forces, h, z)[1]
    expected = [
        (filtered(log_psd + step, forces, h, z)[0] - filtered(log_psd - step, forces, h, z)[0]) / 2e-4
        for step in 1e-4 * np.eye(2)
    ]
    tuning = {"process_noise_walk": 0.0, "max_learned_nis": 1e9}
    p = configure(Settings(navigation=Navigation(tuning=tuning)), 100.0)
    c = start(p, Initial())["core"][0, 0]
    g, scratch = c["process_noise"], c["scratch"]
    g["log_psd"], g["psd"], g["log_psd_covariance"] = log_psd, np.exp(log_psd), (sigma2, 0.0, sigma2)
    g["covariances"][:, 0] = np.diag(np.repeat([1.0, 0.3, 0.02], 3) ** 2)[np.triu_indices(N)]
    c["stationarity"]["vibration_level"], c["stationarity"]["attitude_noise_level"] = 1.0, 1.0
    scratch["transition"]["interval"] = DT
    scratch["transition"]["velocity_psd"], scratch["transition"]["attitude_psd"] = np.exp(log_psd)
    for k in range(FIXES):
        for force in forces[k]:
            scratch["transition"]["delta_v"] = force
            propagate_learning(p[0], c, scratch["transition"])
        for i in range(4):
            v, s, d = used[4 * k + i]
            columns = np.flatnonzero(h[k, i])
            m = len(columns)
            scratch["columns"][:m], scratch["values"][:m] = columns, h[k, i, columns]
            scratch["d"][:N], scratch["gain"][:N] = d, d / s
            learn_process_noise(p[0], c, m, v, s)
            update_learning(c, m, v, s)
    assert (g["log_psd"] - log_psd) / sigma2 == pytest.approx(expected, rel=1e-3, abs=1e-3)


@pytest.mark.thorough
@pytest.mark.parametrize(("shaken", "turned_deg"), [(0.05, 0.0), (0.1, 0.0), (0.3, 0.0), (0.05, 0.3)])
def test_the_process_noise_of_a_drive_is_found(shaken, turned_deg):
    """Each has white acceleration, m/s/sqrt(s), and rate, deg/sqrt(s), beyond the sensor's; fixes with velocity."""
    d = drive(240.0)
    moving, late = d.t > 10.0, d.t > 90.0
    nees, found = [], []
    for seed in (8, 9, 10, 11):
        rng = np.random.default_rng(seed)
        samples = sensed(d, rng)
        samples["f"][moving] += shaken * 10.0 * rng.standard_normal((moving.sum(), 3))  # 100 Hz
        samples["w"][moving] += np.radians(turned_deg) * 10.0 * rng.standard_normal((moving.sum(), 3))
        out, innovations, state = navigate(samples, received(d, rng), settings_of("free"))
        found += [np.sqrt(state["core"]["process_noise"]["psd"][0, 0])]
        assert innovations["used"][innovations["t_ns"] > nanoseconds(160.0)].all()
        nees += [np.mean((errors(d, out)[1][late, :2] / out["sigma_v"][late, :2]) ** 2)]
    assert np.mean(nees) < 1.6
    assert np.mean(found, axis=0)[0] == pytest.approx(shaken, rel=0.6)
    assert np.degrees(np.mean(found, axis=0)[1]) == pytest.approx(turned_deg, rel=0.6, abs=0.2)  # 0.1 m/s in a second


def test_fixes_are_not_refused_after_a_bump():
    """Blows of 0.4 m/s that the sensor does not show, and centimetre positions: followed at once, nothing refused."""
    rng = np.random.default_rng(3)
    d = drive(200.0)
    samples = sensed(d, rng)
    for k in np.arange(8000, 20000, 2000):
        samples["f"][k] += rng.choice([-1.0, 1.0], 3) * (40.0, 40.0, 0.0)  # in 0.01 s
    fixes = received(d, rng, sigma=0.01, white=0.01)
    fixes["sigma"], fixes["speed"], fixes["course"], fixes["arrival_ns"] = (
        (0.02, 0.02, 0.04),
        np.nan,
        np.nan,
        fixes["t_ns"],
    )
    out = navigate(samples, fixes, settings_of("free"))[0]
    late = (d.t > 60.0) & np.isin(samples["t_ns"], nanoseconds(100.0 + np.arange(300)))
    assert np.abs(errors(d, out)[0][late, :2]).max() < 1.3
    assert ((out["status"][d.t > 60.0] & REJECTING) > 0).mean() < 0.02


def test_the_noise_is_found_where_positions_share_an_error_with_the_lever_arm():
    """A multicopter with centimetre positions and an antenna of which nobody has said where it is.

    With the gains of all states the sensitivities grow without end, and the attitude's noise was a third of the truth.
    """
    found, turned_deg = [], 0.3
    for seed in range(4):
        rng = np.random.default_rng(seed)
        d = vehicle("drone", seed)
        samples = sensed(d, rng)
        flying = d.t > 8.0
        samples["w"][flying] += np.radians(turned_deg) * 10.0 * rng.standard_normal((flying.sum(), 3))  # 100 Hz
        samples["f"][flying] += 0.1 * 10.0 * rng.standard_normal((flying.sum(), 3))
        fixes = received(d, rng, every=0.2, late=0.05, sigma=0.0, white=0.015)
        fixes["speed"] = fixes["course"] = fixes["hdop"] = np.nan
        fixes["sigma"] = (0.02, 0.02, 0.04)
        state = navigate(samples, fixes, settings_of("free", "auto", lever_arm_sigma_m="auto"))[2]
        found += [np.degrees(np.sqrt(state["core"]["process_noise"]["psd"][0, 0, 1]))]
    assert found == pytest.approx([turned_deg] * 4, rel=0.4)


@pytest.mark.parametrize("shaken", [0.13, 0.27])
def test_a_shaken_car_with_positions_of_centimetres_alone_is_within_its_sigmas(shaken):
    """It is shaken ten times as hard as the first values say. Until that is known, biases take what is noise; and a
    time offset must not be found from a velocity whose error is that of the position (it was wrong by 0.2 s, 5 m).
    """
    wrong = []
    for seed in (2, 6, 13):
        rng = np.random.default_rng([3, seed])
        d = vehicle("motorway", seed)
        bg = np.radians(0.3) * rng.standard_normal(3)
        samples = sensed(d, rng, ba=0.05 * rng.standard_normal(3), bg=bg)
        moving = d.t > 4.0
        samples["f"][moving] += shaken * 10.0 * rng.standard_normal((moving.sum(), 3))  # 100 Hz
        fixes = received(d, rng, every=0.2, late=0.05, sigma=0.0, white=0.015)
        fixes["speed"] = fixes["course"] = fixes["hdop"] = np.nan
        fixes["sigma"] = (0.02, 0.02, 0.04)
        out = navigate(samples, fixes)[0]
        position, _, attitude = errors(d, out)
        for error, sigma, least in (
            (position, out["sigma_p"], 2.0),
            (attitude, out["sigma_rpy"], np.radians(2.0)),
        ):
            size, stated = (np.hypot(*x[d.t > 25.0, :2].T) for x in (error, sigma))
            wrong += [((size > 4.0 * stated) & (size > least)).mean()]
    assert max(wrong) == 0.0


def test_what_was_estimated_with_too_small_a_noise_is_opened_but_not_the_gyro_biases():
    parameters = configure(Settings(), 100.0)
    p, c = parameters[0], start(parameters, Initial())["core"][0, 0]
    c["process_noise"]["log_psd_covariance"], c["process_noise"]["log_psd"] = 0.0, 10.0
    before = np.diag(unpack(c["cov"]["P"], STATES)).copy()
    inflate_earlier_estimates(p, c)
    added = np.diag(unpack(c["cov"]["P"], STATES)) - before
    assert added[ACCEL_BIAS : ACCEL_BIAS + 3] == pytest.approx([float(p["accel_bias_sigma"]) ** 2] * 3)
    assert (added[ATTITUDE : ATTITUDE + 3] > 0.0).all()
    assert (added[GYRO_BIAS : GYRO_BIAS + 3] == 0.0).all()


def test_the_attitudes_noise_follows_the_vibration_of_the_gyros():
    """Learned on roads of all kinds, it belongs to their mean: numpy's average, without the windows at rest."""
    p = configure(Settings(), 100.0)
    s = start(p, Initial())["core"][0, 0]["stationarity"]
    rng = np.random.default_rng(4)
    powers, levels = 1e-6 * rng.lognormal(0.0, 1.0, 400), np.where(rng.random(400) < 0.8, 0.99, 0.1)
    levels[0], s["duration"] = 0.99, 0.5
    share, most = p[0]["tuning"]["constant_noise_share"], p[0]["tuning"]["max_vibration_ratio"]
    for k, (power, level) in enumerate(zip(powers, levels, strict=True)):
        s["vibration_gyro_psd"], s["vibration_level"] = power, level
        update_attitude_noise_level(p[0], s)
        ratio = min(power / powers[: k + 1][levels[: k + 1] > 0.5].mean(), most)
        assert s["attitude_noise_level"] == pytest.approx(level * (share + (1.0 - share) * ratio))
