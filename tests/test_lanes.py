"""Covariances beside each other, a lane for each, against the arithmetic of one and against plain numpy."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from in_c import Module

from imud.math import kalman, lanes

kalman, lanes = Module(kalman), Module(lanes)

SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.integers(6, 10)
LANES = 4


def covariances(rng, n):
    """Packed, a column for each lane."""
    roots = rng.normal(size=(LANES, n, n))
    return np.ascontiguousarray(np.transpose([(root @ root.T)[np.triu_indices(n)] for root in roots]))


def each_lane(S, act):
    """What `act` makes of each lane by itself."""
    columns = [S[:, lane].copy() for lane in range(LANES)]
    for column in columns:
        act(column)
    return np.transpose(columns)


@given(SEEDS, SIZES, st.booleans())
def test_shears_have_the_bits_of_one_covariance_in_each_lane(seed, n, single):
    rng = np.random.default_rng(seed)
    i = int(rng.integers(0, n - 3))
    j = int(rng.integers(i + 1, n - 2))
    name, factors = ("shear", rng.normal(size=1)) if single else ("shear3", rng.normal(size=3))
    S = covariances(rng, n)
    wanted = each_lane(S, lambda column: getattr(kalman, name)(column, n, i, j, *factors))
    getattr(lanes, name)(S, n, i, j, *factors)
    assert np.array_equal(S, wanted)


@given(SEEDS, SIZES)
def test_measure_has_the_bits_of_one_covariance_in_each_lane(seed, n):
    rng = np.random.default_rng(seed)
    S, m = covariances(rng, n), int(rng.integers(0, n + 1))
    columns, values = rng.permutation(n)[:m], rng.normal(size=m)
    d = np.full((n + 1, LANES), np.nan)
    lanes.measure(S, n, columns, values, m, d)
    for lane in range(LANES):
        alone = np.empty(n)
        assert kalman.measure(np.ascontiguousarray(S[:, lane]), n, columns, values, m, alone) == d[n, lane]
        assert np.array_equal(d[:n, lane], alone)


@given(SEEDS, SIZES)
def test_an_update_takes_the_gain_times_what_is_measured_out_of_all_lanes(seed, n):
    """(I - k h) S (I - k h)' by dense matrices, with the same gain k in all lanes."""
    rng = np.random.default_rng(seed)
    S, h, k = covariances(rng, n), rng.normal(size=n), rng.normal(size=n)
    full = [kalman.unpack(np.ascontiguousarray(S[:, lane]), n) for lane in range(LANES)]
    wanted = np.transpose([(X @ P @ X.T)[np.triu_indices(n)] for P in full for X in [np.eye(n) - np.outer(k, h)]])
    d = np.zeros((n + 1, LANES))
    lanes.measure(S, n, np.arange(n), h, n, d)
    lanes.subtract_update(S, n, np.repeat(k[:, None], LANES, axis=1), d, d[n])
    np.testing.assert_allclose(S, wanted, atol=1e-10)
