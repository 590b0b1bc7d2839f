"""The heading from fixes: as of plain least squares and dense covariances, and blind to what the filter corrects."""

import numpy as np
import pytest
from navigation_simulation import drive

from imud.configuration.settings import Initial, Settings
from imud.estimators.navigation import correction, covariance, matching, posterior, strapdown, whitening
from imud.estimators.navigation.setup import configure, start
from imud.estimators.navigation.state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, RATES, STATES

RATE = 100
G = 9.80665
VARIANCE = 0.1**2


def core():
    p = configure(Settings(), RATE)
    s = start(p, Initial())
    c = s["core"][0, 0]
    matching.clear_matching(c)
    return p[0], s, c  # c is of s


def carried(corrections, seconds=20.0, at_s=8.0):
    """(running integrals, core) of a drive of which the strapdown is corrected on the way."""
    p, s, c = core()
    d = drive(seconds, rest=0.0, fast_start=True)
    c["q"], c["v"], c["lat"] = np.roll(d.attitude[0].as_quat(), 1), d.v[0], d.lat[0]
    c["w"], c["f"] = d.w[0], d.f[0]
    for k in range(1, len(d.t)):
        strapdown.integrate(c, d.w[k], d.f[k], 1.0 / RATE)
        c["w"], c["f"] = d.w[k], d.f[k]
        c["rate"] = d.w[k] - c["bg"]
        covariance.predict(p, c)
        if k == int(at_s * RATE):
            for state, value in corrections.items():
                c["x"][state] = value
            correction.correct(c)
    return c["running"].copy(), s


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
    assert s["core"][0, 0]["shifted"].any() or s["core"][0, 0]["frame"] != 0.0
    assert running[matching.ZETA] == pytest.approx(untouched[matching.ZETA], abs=0.12)  # second order in 0.3 m/s^2
    assert running[matching.SWAY] == pytest.approx(untouched[matching.SWAY], abs=0.05)


def test_a_drift_found_is_one_from_then_on():
    _, s = carried({GYRO_BIAS + 2: 0.004})
    c = s["core"][0, 0]
    assert c["frame_rate"] == pytest.approx(0.004, rel=1e-3)
    assert c["drifted"] == pytest.approx(0.004 * 12.0, abs=2e-4)


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


def match(c, z, u, seen, ages):
    for i in range(len(z)):
        c["t_ns"] = round(1e9 * ages[i])
        for k, value in enumerate([seen[i], z[i], *u[i], 0.0]):  # felt at the fix: its integral with age is nothing
            c["left"][k] = value.real, value.imag
        matching.accumulate(c, VARIANCE, ages[i])


def sums(c):
    return [c[name].copy() for name in ("felt", "smeared", "normal", "match", "seen", "energy", "smear", "weight")]


def test_corrections_taken_over_are_as_if_made_before():
    rng = np.random.default_rng(3)
    data = pairs(rng, 0.3, 0.0, 0.02 * np.eye(3))
    d = 1e-4 * (rng.standard_normal(3) + 1j * rng.standard_normal(3))
    _, _, c = core()
    match(c, *data)
    c["shifted"] = np.stack([d.real, d.imag], axis=-1)
    matching.rebase(c)
    taken = sums(c)
    c["t_ns"] = 0
    matching.clear_matching(c)
    match(c, data[0] + data[1] @ d, *data[1:])
    for a, b in zip(taken, sums(c), strict=True):
        assert a == pytest.approx(b, rel=1e-7, abs=1e-6)


def test_innovations_are_those_of_the_dense_covariance_of_the_fixes():
    """Place, velocity and wander in one covariance: the same sum of squares over variances, and the same products."""
    rng = np.random.default_rng(4)
    _, _, c = core()
    c["reported"][0], white2, n, dt = 2.0, 0.5, 12, 1.5
    data = rng.standard_normal((2, n)) * 3.0
    whitening.restart(c)
    products = np.zeros((2, 2))
    for k in range(n):
        if k:
            whitening.let_pass(c, dt)
        integrals = np.zeros((5, 2))
        integrals[matching.ZETA, 0] = data[1, k]
        s = whitening.innovate(c, True, data[0, k], 0.0, integrals, white2)
        left = np.array([c["left"][0, 0], c["left"][1 + matching.ZETA, 0]])
        products += np.outer(left, left) / s
        whitening.learn(c, True, s)
    t = dt * np.arange(n)
    early = np.minimum.outer(t, t)
    V = whitening.UNFELT_PSD * early**2 * (np.maximum.outer(t, t) / 2.0 - early / 6.0)
    V += whitening.ANYWHERE**2 + whitening.ANY_SPEED**2 * np.outer(t, t) + white2 * np.eye(n)
    V += 4.0 * np.exp(-np.abs(t[:, None] - t) / whitening.WANDER_S)
    assert products == pytest.approx(data @ np.linalg.solve(V, data.T), rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_the_heading_is_that_of_a_least_squares_with_the_nuisance_marginalized(seed):
    rng = np.random.default_rng(seed)
    psi, k_true = rng.uniform(-np.pi, np.pi), rng.integers(10, 23)
    rate = (k_true - RATES // 2) * posterior.RATE_STEP
    half = rng.standard_normal((3, 3)) + 1j * rng.standard_normal((3, 3))
    prior = 0.02 * half @ half.conj().T + 0.01 * np.eye(3)
    z, u, seen, ages = pairs(rng, psi, rate, prior)
    _, _, c = core()
    match(c, z, u, seen, ages)
    c["prior"][:, :, 0], c["prior"][:, :, 1] = prior.real, prior.imag
    found, sigma, found_rate, _, _ = posterior.solve(c, 0.1**2)
    inverse = np.linalg.inv(VARIANCE * np.eye(len(z)) + u @ prior @ u.conj().T)
    drifts = (np.arange(RATES) - RATES // 2) * posterior.RATE_STEP
    angles = np.linspace(-np.pi, np.pi, 1441)
    costs = np.empty((RATES, len(angles)))
    for k, drift in enumerate(drifts):
        e = z[:, None] - seen[:, None] * np.exp(-1j * (angles + drift * ages[:, None]))
        costs[k] = np.einsum("ia,ij,ja->a", e.conj(), inverse, e).real
    k, a = np.unravel_index(costs.argmin(), costs.shape)
    now = angles[a] + drifts[k] * ages[-1]
    assert k == k_true
    assert abs(np.angle(np.exp(1j * (found - now)))) < 0.5 * sigma
    assert abs(np.angle(np.exp(1j * (found - psi - rate * ages[-1])))) < 4.0 * sigma
    assert sigma < np.radians(12.0)
    assert found_rate == pytest.approx(rate, abs=posterior.RATE_STEP)


def test_a_force_felt_for_long_tells_the_heading_of_a_frame_that_turned_meanwhile():
    """Each innovation is of 10 s of a force that changes, in a frame that turns by 4 deg/s: of first order no error."""
    rng = np.random.default_rng(8)
    psi, rate, span = 0.7, 11 * posterior.RATE_STEP, 10.0
    s = np.linspace(-span, 0.0, 501)
    _, _, c = core()
    for age in 1.5 * np.arange(20) + span:
        force = np.exp(1j * rng.uniform(-3.0, 3.0)) * np.exp(1j * 0.3 * s) * 0.3 * (1.0 + np.sin(s + rng.uniform(0, 6)))
        felt = force * np.exp(-1j * (psi + rate * (age + s)))
        total = [np.trapezoid(x, s) if hasattr(np, "trapezoid") else np.trapz(x, s) for x in (force, felt, felt * s)]
        c["t_ns"] = round(1e9 * age)
        for k, value in enumerate([*total[:2], 0.0, 0.0, 0.0, total[2]]):
            c["left"][k] = np.real(value), np.imag(value)
        matching.accumulate(c, VARIANCE, matching.mean_age(c))
    c["prior"][:] = 0.0
    c["prior"][:, :, 0] = 1e-6 * np.eye(3)
    found, sigma, _, _, _ = posterior.solve(c, 0.1**2)
    assert sigma < np.radians(3.0)
    assert abs(np.angle(np.exp(1j * (found - psi - rate * 1e-9 * c["t_ns"])))) < 3.0 * sigma


def test_the_prior_is_the_filters_covariance_of_the_force_that_tilt_and_biases_make():
    rng = np.random.default_rng(1)
    _, _, c = core()
    half = 0.1 * rng.standard_normal((STATES, STATES))
    P = half @ half.T
    c["P"] = P[np.triu_indices(STATES)]
    c["q"] = np.array([0.8, 0.2, -0.3, 0.5]) / np.linalg.norm([0.8, 0.2, -0.3, 0.5])
    w, x, y, z = c["q"]
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
    posterior.believe(c)
    assert complex_(c["prior"]) == pytest.approx(0.5 * rows @ P @ rows.conj().T, rel=1e-9, abs=1e-12)


def test_a_matrix_times_its_inverse_is_one():
    rng = np.random.default_rng(2)
    a = rng.standard_normal((3, 3)) + 1j * rng.standard_normal((3, 3)) + 4.0 * np.eye(3)
    b = np.stack([a.real, a.imag], axis=-1).copy()
    posterior.invert(b)
    assert a @ complex_(b) == pytest.approx(np.eye(3), abs=1e-12)
