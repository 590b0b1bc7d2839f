"""Covariance propagation against dense Phi P Phi' + Q by the matrix exponential; measurements against the textbook."""

import numpy as np
import pytest
from in_c import in_c
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Initial, Settings
from imud.estimators.ins.ekf import set_jacobian
from imud.estimators.ins.fusion import correct_state, gated_update, propagate_errors
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import (
    ACCEL_BIAS,
    ATTITUDE,
    GNSS_BIAS,
    GNSS_LEVER_ARM,
    GNSS_VELOCITY_BIAS,
    GYRO_BIAS,
    GYRO_SCALE,
    MOUNT_PITCH,
    MOUNT_YAW,
    NAVIGATING,
    NHC_LEVER_ARM,
    POSITION,
    STATES,
    TIME_OFFSET,
    VELOCITY,
    VELOCITY_TIME_OFFSET,
)
from imud.math.kalman import unpack

set_jacobian = in_c(set_jacobian)
correct_state = in_c(correct_state)
gated_update = in_c(gated_update)
propagate_errors = in_c(propagate_errors)


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def block(i, n=3):
    return slice(i, i + n)


def made(seed):
    """Parameters and a navigating core with a random full covariance."""
    rng = np.random.default_rng(seed)
    p = configure(Settings(), 100.0)
    s = start(p, Initial(lat_deg=50.0, lon_deg=8.0, yaw_deg=10.0))
    c = s["core"][0, 0]
    scale = np.repeat(
        [2.0, 0.3, 0.02, 1e-3, 0.1, 2.0, 0.03, 0.1, 0.01, 0.5, 0.1, 0.02, 5.0, 0.05, 0.3],
        [3, 3, 3, 3, 3, 3, 2, 1, 9, 1, 1, 1, 1, 3, 3],
    )
    root = rng.standard_normal((STATES, STATES)) * scale[:, None]
    P = root @ root.T / STATES
    c["alignment"]["mode"] = NAVIGATING
    c["cov"]["P"] = P[np.triu_indices(STATES)]
    attitude = Rotation.random(random_state=seed)
    c["nav"]["q_nb"] = np.roll(attitude.as_quat(), 1)
    c["gnss"]["reported_sigma"] = (1.5, 3.0)
    c["imu"]["accel_n"], c["imu"]["rate_b"] = rng.standard_normal(3), rng.standard_normal(3)
    c["stationarity"]["vibration_level"], c["stationarity"]["attitude_noise_level"] = 0.4, 0.6
    return p, s, c, P, attitude.as_matrix(), rng


@pytest.mark.parametrize("seed", range(4))
def test_one_interval_is_that_of_the_matrix_exponential(seed):
    p, _, c, P, C, rng = made(seed)
    dt = 0.01
    force = rng.standard_normal(3) * 3 + (0, 0, -9.8)
    c["imu"]["delta_v"], c["imu"]["delta_theta"], c["imu"]["integration_time"] = force * dt, c["imu"]["rate_b"] * dt, dt
    tuning = p.view(np.recarray)[0].tuning
    mean = np.array([0.04, -0.02]) * seed  # of the level force: from none to mostly more than noise
    c["imu"]["level_force"] = mean
    mean = mean + dt / tuning.level_force_time_s * (force[:2] - mean)
    noise = tuning.level_force_gate * (p[0]["accel_psd"] + tuning.vibration_vrw**2 * 0.4) / tuning.level_force_time_s
    known = force * np.append([max(1.0 - noise / (mean @ mean), 0.0)] * 2, 1.0)
    F = np.zeros((STATES, STATES))
    F[block(POSITION), block(VELOCITY)] = np.eye(3)
    F[block(VELOCITY), block(ATTITUDE)] = -skew(known)
    F[block(VELOCITY), block(ACCEL_BIAS)] = -C
    F[block(ATTITUDE), block(GYRO_BIAS)] = -C
    for j, rate in enumerate(c["imu"]["rate_b"]):
        F[block(ATTITUDE), block(GYRO_SCALE + 3 * j)] = -C * rate
    F[block(GNSS_BIAS), block(GNSS_BIAS)] = -np.eye(3) / tuning.gnss_bias_time_s
    velocity_bias = block(GNSS_VELOCITY_BIAS)
    F[velocity_bias, velocity_bias] = -np.eye(3) / tuning.gnss_velocity_bias_time_s
    q = np.zeros(STATES)
    tilt2, heading2 = np.mean(np.diag(P)[block(ATTITUDE, 2)]), P[ATTITUDE + 2, ATTITUDE + 2]
    r = p[0]
    q[block(VELOCITY)] = (
        r["accel_psd"]
        + tuning.vibration_vrw**2 * 0.4
        + r["accel_scale"] ** 2 * np.sum(c["imu"]["accel_n"] ** 2) * tuning.accel_scale_time_s
        + heading2
        * (0.5 * heading2 * np.sum(c["imu"]["accel_n"] ** 2) + 9.80665**2 * tilt2)
        * tuning.second_order_time_s
    )
    q[block(ATTITUDE)] = (
        r["gyro_psd"] + r["gyro_scale"] ** 2 * np.sum(c["imu"]["rate_b"] ** 2) * tuning.gyro_scale_time_s
    )
    q[block(GYRO_BIAS)] = r["gyro_bias_psd"]
    q[block(ACCEL_BIAS)] = r["accel_bias_psd"] + tuning.vibration_bias_walk**2 * 0.4
    q[block(GNSS_BIAS)] = 2.0 / tuning.gnss_bias_time_s * np.array([1.5, 1.5, 3.0]) ** 2
    q[velocity_bias] = 2.0 / tuning.gnss_velocity_bias_time_s * tuning.gnss_velocity_bias_sigma**2
    q[GNSS_VELOCITY_BIAS + 2] *= tuning.vertical_ratio**2
    q[[MOUNT_PITCH, MOUNT_YAW]] = tuning.mount_psd
    q[block(GYRO_SCALE, 9)] = tuning.gyro_scale_psd
    q[NHC_LEVER_ARM] = tuning.nhc_lever_arm_psd
    phi = expm(F * dt)
    expected = phi @ P @ phi.T + np.diag(q) * dt
    propagate_errors(p[0], c)
    sigma = np.sqrt(np.diag(expected))
    assert np.abs((unpack(c["cov"]["P"], STATES) - expected) / np.outer(sigma, sigma)).max() < 2e-3
    growth = np.diag(unpack(c["cov"]["P"], STATES)) - np.diag(phi @ P @ phi.T)
    noisy = q[block(GYRO_BIAS, 6)]
    assert growth[block(GYRO_BIAS, 6)] == pytest.approx(noisy * dt, rel=1e-3)
    assert c["imu"]["integration_time"] == 0.0


def test_many_intervals_stay_positive_definite():
    p, _, c, *_ = made(7)
    for i in range(2000):
        c["imu"]["delta_v"], c["imu"]["integration_time"] = (0.05 * np.sin(i), 0.02, -0.098), 0.01
        propagate_errors(p[0], c)
    P = unpack(c["cov"]["P"], STATES)
    sigma = np.sqrt(np.diag(P))
    assert np.linalg.eigvalsh(P / np.outer(sigma, sigma)).min() > 0.0


def test_scalar_measurements_are_one_textbook_update():
    _, _, c, P, _, rng = made(3)
    H = np.zeros((2, STATES))
    H[0, [VELOCITY, ATTITUDE + 1, TIME_OFFSET]] = 1.0, 2.0, -3.0
    H[1, [POSITION + 1, GNSS_BIAS + 1]] = 1.0, 1.0
    z, R = rng.standard_normal(2), np.diag([0.04, 0.5])
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    for h, zi, ri in zip(H, z, np.diag(R), strict=True):
        m = 0
        for i in np.flatnonzero(h):
            m = set_jacobian(c, m, i, h[i])
        gated_update(c, m, zi, ri, 0.0)
    assert c["scratch"]["x"] == pytest.approx(K @ z, abs=1e-10)
    assert unpack(c["cov"]["P"], STATES) == pytest.approx((np.eye(STATES) - K @ H) @ P, abs=1e-10)


def test_a_gated_measurement_changes_nothing():
    _, _, c, P, *_ = made(5)
    assert gated_update(c, set_jacobian(c, 0, VELOCITY, 1.0), 100.0, 0.01, 25.0)[2] < 0.0
    assert not c["scratch"]["x"].any()
    assert unpack(c["cov"]["P"], STATES) == pytest.approx(P)


def test_corrections_move_the_nominal_state_by_the_error():
    p, _, c, _, C, _ = made(6)
    lat, height, v = float(c["nav"]["lat"]), float(c["nav"]["height"]), c["nav"]["v_n"].copy()
    c["scratch"]["x"][POSITION : POSITION + 3] = 10.0, 0.0, 2.0
    c["scratch"]["x"][VELOCITY] = 0.5
    c["scratch"]["x"][ATTITUDE : ATTITUDE + 3] = 0.01, -0.02, 0.03
    c["scratch"]["x"][GNSS_LEVER_ARM : GNSS_LEVER_ARM + 3] = 0.4, -0.5, 0.6
    c["scratch"]["x"][TIME_OFFSET], c["scratch"]["x"][VELOCITY_TIME_OFFSET] = 0.1, 0.05
    correct_state(p[0], c)
    assert (c["nav"]["time_offset"], c["nav"]["velocity_time_offset"]) == pytest.approx((0.1, 0.05))
    assert c["nav"]["gnss_lever_arm"] == pytest.approx([0.4, -0.5, 0.6])
    assert (c["nav"]["lat"] - lat) * 6.3781e6 == pytest.approx(10.0, rel=0.01)
    assert (c["nav"]["height"] - height, c["nav"]["v_n"][0] - v[0]) == pytest.approx((-2.0, 0.5))
    tilted, headed = Rotation.from_rotvec([0.01, -0.02, 0.0]), Rotation.from_rotvec([0.0, 0.0, 0.03])
    turned = (headed * tilted).as_matrix() @ C
    assert Rotation.from_quat(np.roll(c["nav"]["q_nb"], -1)).as_matrix() == pytest.approx(turned, abs=1e-9)
    assert not c["scratch"]["x"].any()
