"""The packed-triangle covariance arithmetic against plain numpy on dense matrices."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_c import Module

from imud.math import kalman

kalman = Module(kalman)

SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.integers(1, 12)


def random_covariance(rng, n):
    """Dense P, badly scaled on purpose, of full or less than full rank."""
    scales = 10.0 ** rng.uniform(-4, 2, n)
    root = scales[:, None] * rng.normal(size=(n, rng.integers(1, n + 2)))
    return root @ root.T


def packed(P):
    return P[np.triu_indices(len(P))].copy()


def close(got, wanted, scale=None):
    """Equal to rounding of the elements' own size, sqrt(P_ii P_jj)."""
    sigma = np.sqrt(np.abs(np.diag(wanted if scale is None else scale))) + 1e-300
    assert np.all(np.abs(got - wanted) <= 1e-11 * np.outer(sigma, sigma))


@given(SIZES)
def test_the_triangle_is_addressed_row_by_row_and_symmetrically(n):
    rows, columns = np.triu_indices(n)
    for place, (i, j) in enumerate(zip(rows, columns, strict=True)):
        assert kalman.packed_index(n, i, j) == kalman.packed_index(n, j, i) == place


@given(SEEDS, SIZES)
def test_unpack_inverts_packing(seed, n):
    P = random_covariance(np.random.default_rng(seed), n)
    assert np.array_equal(kalman.unpack(packed(P), n), np.triu(P) + np.triu(P, 1).T)


@given(SEEDS, st.integers(2, 12), st.floats(-1e3, 1e3))
def test_shear_is_a_congruence(seed, n, a):
    rng = np.random.default_rng(seed)
    i, j = rng.permutation(n)[:2]
    P = random_covariance(rng, n)
    E = np.eye(n)
    E[i, j] = a
    p = packed(P)
    kalman.shear(p, n, i, j, a)
    close(kalman.unpack(p, n), E @ P @ E.T, np.abs(E) @ np.abs(P) @ np.abs(E).T)


@given(SEEDS, st.integers(4, 12))
def test_shear3_is_a_congruence(seed, n):
    rng = np.random.default_rng(seed)
    j = int(rng.integers(1, n - 2))
    i = int(rng.integers(0, j))
    P = random_covariance(rng, n)
    E = np.eye(n)
    E[i, j : j + 3] = rng.normal(size=3)
    p = packed(P)
    kalman.shear3(p, n, i, j, *E[i, j : j + 3])
    close(kalman.unpack(p, n), E @ P @ E.T, np.abs(E) @ np.abs(P) @ np.abs(E).T)


@given(SEEDS, st.integers(6, 12))
def test_shear33_is_shear3_three_times_to_the_last_bit(seed, n):
    rng = np.random.default_rng(seed)
    i = int(rng.integers(0, n - 5))
    j = int(rng.integers(i + 3, n - 2))
    A = rng.normal(size=(3, 3))
    once = packed(random_covariance(rng, n))
    thrice = once.copy()
    kalman.shear33(once, n, i, j, tuple(A.ravel()))
    for k in range(3):
        kalman.shear3(thrice, n, i + k, j, *A[k])
    assert np.array_equal(once, thrice)


@given(SEEDS, SIZES, st.floats(-2.0, 2.0))
def test_scale_is_a_congruence(seed, n, a):
    rng = np.random.default_rng(seed)
    i = rng.integers(n)
    P = random_covariance(rng, n)
    E = np.eye(n)
    E[i, i] = a
    p = packed(P)
    kalman.scale(p, n, i, a)
    close(kalman.unpack(p, n), E @ P @ E.T, P)


@given(SEEDS, st.integers(3, 12), st.floats(-2.0, 2.0))
def test_scale3_is_scale_three_times_to_the_last_bit(seed, n, a):
    rng = np.random.default_rng(seed)
    i = int(rng.integers(0, n - 2))
    once = packed(random_covariance(rng, n))
    thrice = once.copy()
    kalman.scale3(once, n, i, a)
    for k in range(3):
        kalman.scale(thrice, n, i + k, a)
    assert np.array_equal(once, thrice)


@given(SEEDS, SIZES, st.floats(0.0, 1e6))
def test_reset_makes_a_state_independent(seed, n, variance):
    rng = np.random.default_rng(seed)
    i = rng.integers(n)
    P = random_covariance(rng, n)
    p = packed(P)
    kalman.reset(p, n, i, variance)
    P[i, :] = P[:, i] = 0.0
    P[i, i] = variance
    assert np.array_equal(kalman.unpack(p, n), np.triu(P) + np.triu(P, 1).T)


def random_row(rng, n):
    """A sparse measurement row as columns (in any order), values, and dense."""
    m = rng.integers(1, n + 1)
    columns, values = rng.permutation(n)[:m], rng.normal(size=m)
    h = np.zeros(n)
    h[columns] = values
    return columns, values, h


@given(SEEDS, SIZES)
def test_measure_gives_the_cross_covariance_and_the_predicted_variance(seed, n):
    rng = np.random.default_rng(seed)
    P = random_covariance(rng, n)
    columns, values, h = random_row(rng, n)
    d = np.full(n, np.nan)
    v = kalman.measure(packed(P), n, columns, values, len(columns), d)
    sigma = np.sqrt(np.diag(P))
    size = np.abs(h) @ sigma
    assert np.all(np.abs(d - P @ h) <= 1e-12 * (sigma * size + 1e-300))
    assert v == pytest.approx(h @ P @ h, abs=1e-12 * size**2 + 1e-300)


@given(SEEDS, st.integers(4, 12))
def test_measure_adds_columns_in_the_order_of_the_row_to_the_last_bit(seed, n):
    rng = np.random.default_rng(seed)
    P = random_covariance(rng, n)
    first = int(rng.integers(0, n - 3))
    columns = np.array([n - 1, first, first + 1, first + 2], np.int64)  # with three beside each other
    values, d, wanted = rng.normal(size=4), np.empty(n), np.zeros(n)
    full = kalman.unpack(packed(P), n)
    kalman.measure(packed(P), n, columns, values, 4, d)
    for column, value in zip(columns, values, strict=True):
        wanted += full[:, column] * value
    assert d.tobytes() == wanted.tobytes()


@given(SEEDS, SIZES)
def test_the_predicted_variance_alone_is_that_of_measure(seed, n):
    rng = np.random.default_rng(seed)
    P = random_covariance(rng, n)
    columns, values, h = random_row(rng, n)
    alone = kalman.predicted_variance(packed(P), n, columns, values, len(columns))
    size = np.abs(h) @ np.sqrt(np.diag(P))
    assert alone == pytest.approx(h @ P @ h, abs=1e-12 * size**2 + 1e-300)


@given(SEEDS, SIZES, st.floats(-6.0, 3.0))
def test_update_is_joseph_s_form(seed, n, log_r):
    rng = np.random.default_rng(seed)
    P = random_covariance(rng, n)
    columns, values, h = random_row(rng, n)
    r, z = 10.0**log_r, rng.normal()
    s = h @ P @ h + r
    K = P @ h / s
    A = np.eye(n) - np.outer(K, h)
    p, x, d = packed(P), rng.normal(size=n), np.empty(n)
    before = x.copy()
    kalman.update(p, n, x, d, kalman.measure(p, n, columns, values, len(columns), d) + r, z)
    close(kalman.unpack(p, n), A @ P @ A.T + r * np.outer(K, K), P)
    np.testing.assert_allclose(x, before + K * z, rtol=1e-9, atol=1e-12)


@given(SEEDS, SIZES)
def test_update_by_gain_is_update_to_the_last_bit(seed, n):
    rng = np.random.default_rng(seed)
    p, x = packed(random_covariance(rng, n)), rng.normal(size=n)
    columns, values, _ = random_row(rng, n)
    d, z = np.empty(n), rng.normal()
    s = kalman.measure(p, n, columns, values, len(columns), d) + 0.5
    p2, x2 = p.copy(), x.copy()
    kalman.update(p, n, x, d, s, z)
    kalman.update_by_gain(p2, n, x2, d, d / s, z)
    assert (p2.tobytes(), x2.tobytes()) == (p.tobytes(), x.tobytes())


@given(SEEDS, st.integers(1, 10))
def test_noise_far_below_the_predicted_variance_leaves_a_covariance(seed, n):
    """To the ratio that the module promises, relative to the largest predicted variance that P's diagonal allows."""
    rng = np.random.default_rng(seed)
    p, x, d = packed(random_covariance(rng, n)), np.zeros(n), np.empty(n)
    sigma = np.sqrt(np.diag(kalman.unpack(p, n)))
    for _ in range(3):
        columns, values, h = random_row(rng, n)
        v = kalman.measure(p, n, columns, values, len(columns), d)
        kalman.update(p, n, x, d, v + 1e-13 * (np.abs(h) @ sigma) ** 2, rng.normal())
    P = kalman.unpack(p, n)
    assert np.all(np.diag(P) >= 0.0)
    assert np.linalg.eigvalsh(P / np.outer(sigma, sigma)).min() > -1e-13


@pytest.mark.thorough
@given(SEEDS, st.integers(2, 10))
def test_p_stays_a_covariance_through_any_sequence(seed, n):
    rng = np.random.default_rng(seed)
    p, x, d = packed(random_covariance(rng, n)), np.zeros(n), np.empty(n)
    size = np.sqrt(np.diag(kalman.unpack(p, n)))  # of what each state is a sum of: rounding errors are relative to it
    for _ in range(60):
        i, j = rng.permutation(n)[:2]
        kind = rng.integers(4)
        if kind == 0:
            a = rng.normal()
            kalman.shear(p, n, i, j, a)
            size[i] += abs(a) * size[j]
        elif kind == 1:
            a = rng.uniform(-1.0, 1.0)
            kalman.scale(p, n, i, a)
            size[i] *= abs(a)
        elif kind == 2:
            variance = 10.0 ** rng.uniform(-6, 2)
            kalman.reset(p, n, i, variance)
            size[i] = np.sqrt(variance)
        else:
            columns, values, h = random_row(rng, n)
            v = kalman.measure(p, n, columns, values, len(columns), d)
            r = 1e-9 + 1e-6 * (np.abs(h) @ size) ** 2 + v * 10.0 ** rng.uniform(-3, 1)
            kalman.update(p, n, x, d, v + r, rng.normal())
        P = kalman.unpack(p, n)
        assert np.all(np.diag(P) >= 0.0)
        assert np.linalg.eigvalsh(P / np.outer(size, size)).min() > -1e-12
    assert np.all(np.isfinite(x))


def test_scalar_updates_one_by_one_equal_the_vector_update():
    rng = np.random.default_rng(7)
    n, m = 6, 3
    P, H, R = random_covariance(rng, n) + np.eye(n), rng.normal(size=(m, n)), np.diag([0.1, 2.0, 0.5])
    z = rng.normal(size=m)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    p, x, d = packed(P), np.zeros(n), np.empty(n)
    for k in range(m):
        s = kalman.measure(p, n, np.arange(n), H[k], n, d) + R[k, k]
        kalman.update(p, n, x, d, s, z[k] - H[k] @ x)
    np.testing.assert_allclose(x, K @ z, rtol=1e-9)
    np.testing.assert_allclose(kalman.unpack(p, n), P - K @ H @ P, rtol=1e-9, atol=1e-9 * np.diag(P).max())
