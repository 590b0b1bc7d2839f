"""The heading from fixes: as of plain least squares and dense covariances, and blind to what the filter corrects."""

import numpy as np
import pytest
from in_c import Module, in_c
from navigation_simulation import drive
from scipy.spatial.transform import Rotation

from imud.compile.jit import kernel
from imud.configuration.settings import Initial, Settings
from imud.estimators.ins import fusion as fusion_kernels
from imud.estimators.ins import mechanization as mechanization_kernels
from imud.estimators.ins.alignment import force_integrals, heading_posterior, hypothesis_bank
from imud.estimators.ins.alignment import whitening as whitening_kernels
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, HYPOTHESES, STATES

fusion, mechanization = Module(fusion_kernels), Module(mechanization_kernels)
matching, posterior = Module(force_integrals), Module(heading_posterior)
hypotheses, whitening = Module(hypothesis_bank), Module(whitening_kernels)

RATE = 100
G = 9.80665
VARIANCE = 0.1**2

PARAMETERS = configure(Settings(), RATE)[0]
TUNING = PARAMETERS["tuning"]


def core():
    p = configure(Settings(), RATE)
    s = start(p, Initial())
    c = s["core"][0, 0]
    matching.clear_integrals(c)
    return p[0], s, c  # c is of s


def carried(corrections, seconds=20.0, at_s=8.0):
    """(running integrals, core) of a drive of which the strapdown is corrected on the way."""
    p, s, c = core()
    d = drive(seconds, rest=0.0, fast_start=True)
    c["nav"]["q_nb"], c["nav"]["v_n"], c["nav"]["lat"] = np.roll(d.attitude[0].as_quat(), 1), d.v[0], d.lat[0]
    c["imu"]["w"], c["imu"]["f"] = d.w[0], d.f[0]
    x = np.zeros(STATES)
    for state, value in corrections.items():
        x[state] = value
    signal = np.hstack([d.w, d.f])[1:].reshape(-1)
    follow(p, c, signal, int(at_s * RATE), 1.0 / RATE, x)
    return c["alignment"]["integrals"].copy(), s


@in_c
@kernel
def set_prior(c, hypothesis):
    """Of a record: C has no array alone whose elements are all assigned at once."""
    heading_posterior.set_prior(c, hypothesis.prior)


@in_c
@kernel
def follow(p, c, signal, at, period, corrections):
    """Propagate through rates and forces, six numbers each; `at`: the sample behind which it is corrected."""
    for k in range(len(signal) // 6):
        w = signal[6 * k :]
        f = signal[6 * k + 3 :]
        mechanization_kernels.integrate_strapdown(c, w, f, period)
        for i in range(3):
            c.imu.w[i], c.imu.f[i] = w[i], f[i]
            c.imu.rate_b[i] = w[i] - c.nav.bg[i]
        fusion_kernels.propagate_errors(p, c)
        if k + 1 == at:
            for i in range(len(corrections)):
                c.scratch.x[i] = corrections[i]
            fusion_kernels.correct_state(p, c)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "corrections",
    [
        {ATTITUDE: 0.02, ATTITUDE + 1: -0.03},
        {GYRO_BIAS: 0.002, GYRO_BIAS + 1: -0.001},
        {ACCEL_BIAS: 0.2, ACCEL_BIAS + 1: -0.3},
        {ATTITUDE + 2: 1.0},
        {ATTITUDE: 0.01, ATTITUDE + 2: -0.1, GYRO_BIAS: 0.001, ACCEL_BIAS + 1: 0.1},
    ],
)
def test_what_the_filter_corrects_leaves_the_integrals_as_they_were(corrections):
    untouched, _ = carried({})
    running, s = carried(corrections)
    assert s["core"][0, 0]["alignment"]["corrections"].any() or s["core"][0, 0]["alignment"]["frame_azimuth"] != 0.0
    assert running[matching.DELTA_V] == pytest.approx(
        untouched[matching.DELTA_V], abs=0.12
    )  # second order in 0.3 m/s^2
    assert running[matching.HEADING_INTEGRAL] == pytest.approx(untouched[matching.HEADING_INTEGRAL], abs=0.05)


def test_a_gyro_bias_found_is_corrected_from_then_on():
    _, s = carried({GYRO_BIAS + 2: 0.004})
    c = s["core"][0, 0]
    assert c["alignment"]["bias_correction"] == pytest.approx(0.004, rel=1e-3)
    assert c["alignment"]["corrected_rotation"] == pytest.approx(0.004 * 12.0, abs=2e-4)


def complex_(a):
    return a[..., 0] + 1j * a[..., 1]


def pairs(rng, psi, rate, prior, n=30):
    """Innovations felt and received, regressors, ages: nuisance parameters are drawn from their prior."""
    x = np.linalg.cholesky(prior) @ (rng.standard_normal(3) + 1j * rng.standard_normal(3))
    ages = np.arange(n) + 0.5
    u = rng.standard_normal((n, 3)) + 1j * rng.standard_normal((n, 3))
    seen = 1.5 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    noise = 0.05 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    return seen * np.exp(-1j * (psi + rate * ages)) - u @ x + noise, u, seen, ages


def match(b, z, u, seen, ages):
    """As if they had been followed: each hypothesis turns back what was felt in its frame."""
    for i in range(len(z)):
        for k in range(HYPOTHESES):
            turn = np.exp(1j * hypotheses.frame_rate(PARAMETERS, k) * ages[i])
            for j, value in enumerate([seen[i], turn * z[i], *(turn * u[i])]):
                b["innovations"][j] = value.real, value.imag
            hypotheses.accumulate_products(b["products"][k], b["innovations"], 1.0 / VARIANCE)
        hypotheses.add_energy(b, 1.0 / VARIANCE, ages[i])


def test_corrections_taken_over_are_as_if_made_before():
    rng = np.random.default_rng(3)
    data = pairs(rng, 0.3, 0.0, 0.02 * np.eye(3))
    d = 1e-4 * (rng.standard_normal(3) + 1j * rng.standard_normal(3))
    _, s, c = core()
    b = s["bank"][0, 0]
    match(b, *data)
    c["alignment"]["corrections"] = np.stack([d.real, d.imag], axis=-1)
    hypotheses.apply_corrections(PARAMETERS, c, b)
    taken = b["products"].copy()
    hypotheses.clear_hypotheses(b)
    match(b, data[0] + data[1] @ d, *data[1:])
    assert taken == pytest.approx(b["products"], rel=1e-7, abs=1e-6)


@pytest.mark.thorough
def test_in_the_frame_of_the_right_rate_forces_add_up_to_the_velocity_for_as_long_as_one_likes():
    """A drive of 40 s, tilted by half a degree, with a gyro bias about the vertical of 2.45 deg/s."""
    p, s, c = core()
    b = s["bank"][0, 0]
    d = drive(40.0, rest=0.0, fast_start=True)
    bias = np.array([0.0, 0.0, 7 * TUNING["frame_rate_step"]])
    c["nav"]["q_nb"] = np.roll((Rotation.from_rotvec([0.006, -0.006, 0.0]) * d.attitude[0]).as_quat(), 1)
    c["nav"]["v_n"], c["nav"]["lat"], c["imu"]["w"], c["imu"]["f"] = d.v[0], d.lat[0], d.w[0] + bias, d.f[0]
    hypotheses.clear_hypotheses(b)
    integrals = []
    for k in range(1, len(d.t)):
        mechanization.integrate_strapdown(c, d.w[k] + bias, d.f[k], 1.0 / RATE)
        c["imu"]["w"], c["imu"]["f"], c["imu"]["rate_b"] = d.w[k] + bias, d.f[k], d.w[k] + bias
        fusion.propagate_errors(p, c)
        c["nav"]["t_ns"] = round(1e9 * d.t[k])
        if k % RATE == 0:
            hypotheses.propagate_hypotheses(PARAMETERS, c, b, 1.0)
            integrals.append(complex_(b["integrals"]))
    v = (d.v[RATE::RATE] - d.v[0])[:, :2] @ (1.0, 1.0j)
    felt = np.array(integrals)
    right = felt[:, HYPOTHESES // 2 - 7]
    tilt = v - right[:, matching.DELTA_V]
    x = np.vdot(right[:, matching.TIME], tilt) / np.vdot(right[:, matching.TIME], right[:, matching.TIME])
    assert abs(x) == pytest.approx(G * 0.006 * np.sqrt(2.0), rel=0.2)  # the car rolls: its axis is not quite vertical
    assert np.abs(tilt).max() > 0.9
    assert np.abs(tilt - x * right[:, matching.TIME]).max() < 0.3
    assert np.abs(v - felt[:, HYPOTHESES // 2, matching.DELTA_V]).max() > 5.0


def test_innovations_are_those_of_the_dense_covariance_of_the_fixes():
    """Place, velocity and wander in one covariance: the same sum of squares over variances, and the same products."""
    rng = np.random.default_rng(4)
    b = core()[1]["bank"][0, 0]
    wander, white2, n, dt = 2.0, 0.5, 12, 1.5
    data = rng.standard_normal((2, n)) * 3.0
    whitening.reset_whitening(PARAMETERS, b, wander)
    products = np.zeros((2, 2))
    for k in range(n):
        if k:
            whitening.predict_whitening(PARAMETERS, b, wander, 0.0, dt)
        b["double_integrals"][0, matching.DELTA_V, 0] = data[1, k]
        s = whitening.whitened_variance(b, True, white2)
        whitening.whitened_innovations(b, 0, True, (data[0, k], 0.0), (0.0, 0.0))
        left = b["innovations"][:2, 0].copy()
        products += np.outer(left, left) / s
        whitening.update_hypothesis(b, 0, True, s)
        whitening.update_whitening(b, True, s)
    t = dt * np.arange(n)
    early = np.minimum.outer(t, t)
    V = TUNING["unmodelled_accel_psd"] * early**2 * (np.maximum.outer(t, t) / 2.0 - early / 6.0)
    V += (
        TUNING["whitening_position_sigma"] ** 2
        + TUNING["whitening_speed_sigma"] ** 2 * np.outer(t, t)
        + white2 * np.eye(n)
    )
    V += wander**2 * np.exp(-np.abs(t[:, None] - t) / TUNING["gnss_bias_time_s"])
    assert products == pytest.approx(data @ np.linalg.solve(V, data.T), rel=1e-4, abs=1e-4)


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(6))
def test_the_heading_is_that_of_a_least_squares_with_the_nuisance_marginalized(seed):
    rng = np.random.default_rng(seed)
    psi, k_true = rng.uniform(-np.pi, np.pi), rng.integers(10, 23)
    rate = hypotheses.frame_rate(PARAMETERS, k_true)
    half = rng.standard_normal((3, 3)) + 1j * rng.standard_normal((3, 3))
    prior = 0.02 * half @ half.conj().T + 0.01 * np.eye(3)
    z, u, seen, ages = pairs(rng, psi, rate, prior)
    _, s, c = core()
    b = s["bank"][0, 0]
    match(b, z, u, seen, ages)
    c["nav"]["t_ns"] = round(1e9 * ages[-1])
    b["prior"][:, :, 0], b["prior"][:, :, 1] = prior.real, prior.imag
    found, sigma, found_rate, _, _ = posterior.solve_heading(PARAMETERS, c, b, 0.1**2)
    inverse = np.linalg.inv(VARIANCE * np.eye(len(z)) + u @ prior @ u.conj().T)
    rates = (np.arange(HYPOTHESES) - HYPOTHESES // 2) * TUNING["frame_rate_step"]
    angles = np.linspace(-np.pi, np.pi, 1441)
    costs = np.empty((HYPOTHESES, len(angles)))
    for k, frame_rate in enumerate(rates):
        e = z[:, None] - seen[:, None] * np.exp(-1j * (angles + frame_rate * ages[:, None]))
        costs[k] = np.einsum("ia,ij,ja->a", e.conj(), inverse, e).real
    k, a = np.unravel_index(costs.argmin(), costs.shape)
    now = angles[a] + rates[k] * ages[-1]
    assert k == k_true
    assert abs(np.angle(np.exp(1j * (found - now)))) < 0.5 * sigma
    assert abs(np.angle(np.exp(1j * (found - psi - rate * ages[-1])))) < 4.0 * sigma
    assert sigma < np.radians(12.0)
    assert found_rate == pytest.approx(rate, abs=TUNING["frame_rate_step"])


@pytest.mark.thorough
def test_the_prior_is_the_filters_covariance_of_the_force_that_tilt_and_biases_make():
    rng = np.random.default_rng(1)
    _, s, c = core()
    b = s["bank"][0, 0]
    half = 0.1 * rng.standard_normal((STATES, STATES))
    P = half @ half.T
    c["cov"]["P"] = P[np.triu_indices(STATES)]
    c["nav"]["q_nb"] = np.array([0.8, 0.2, -0.3, 0.5]) / np.linalg.norm([0.8, 0.2, -0.3, 0.5])
    w, x, y, z = c["nav"]["q_nb"]
    C = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        ]
    )
    rows = np.zeros((3, STATES), complex)
    rows[0, ATTITUDE : ATTITUDE + 2] = G * 1j, -G  # i g (phi_n + i phi_e)
    rows[1, GYRO_BIAS : GYRO_BIAS + 3] = -1j * G * (C[0] + 1j * C[1])
    rows[2, ACCEL_BIAS : ACCEL_BIAS + 3] = -(C[0] + 1j * C[1])
    set_prior(c, b)
    assert complex_(b["prior"]) == pytest.approx(0.5 * rows @ P @ rows.conj().T, rel=1e-9, abs=1e-12)


def test_a_matrix_times_its_inverse_is_one():
    rng = np.random.default_rng(2)
    a = rng.standard_normal((3, 3)) + 1j * rng.standard_normal((3, 3)) + 4.0 * np.eye(3)
    b = np.stack([a.real, a.imag], axis=-1).copy()
    posterior.invert(b)
    assert a @ complex_(b) == pytest.approx(np.eye(3), abs=1e-12)
