"""How well a vehicle keeps to its axis, learned from sums of innovations; what a gap may hide, from what was seen."""

import numpy as np
import pytest
from in_c import in_c

from imud.compile.jit import kernel
from imud.configuration.settings import Initial, Settings
from imud.estimators.ins.aiding.nhc_noise import (
    add_innovation,
    clear_innovation_sums,
    learn_noise_scale,
)
from imud.estimators.ins.aiding.non_holonomic import disable_nhc, enable_nhc
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.propagation import gap_variance
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import ATTITUDE, GNSS_BIAS, GYRO_SCALE, MOUNT_PITCH, MOUNT_YAW, STATES
from imud.math.kalman import scale, unpack

clear_innovation_sums = in_c(clear_innovation_sums)
disable_nhc = in_c(disable_nhc)
enable_nhc = in_c(enable_nhc)
gap_variance = in_c(gap_variance)

PARAMETERS = configure(Settings(), 100.0).view(np.recarray)[0]
TUNING = PARAMETERS["tuning"]
SUM_LENGTH = int(TUNING["nhc_sum_length"])
NOISE_SCALE_RANGE = TUNING["nhc_min_noise_scale"], TUNING["nhc_max_noise_scale"]
INITIAL_NOISE_SCALE = np.sqrt(NOISE_SCALE_RANGE[0] * NOISE_SCALE_RANGE[1])


@in_c
@kernel
def all_fit(p, c, innovations, assumed):
    fits = True
    for i in range(len(innovations)):
        for k in range(2):
            add_innovation(c, k, innovations[i, k], c.nhc.noise_scale[k] * assumed)
        fits = not learn_noise_scale(p, c) and fits
    return fits


def learned(innovations, assumed, fix_age_s=0.0, known=True):
    """What is learned of `innovations` (rows of two), of a noise assumed to be `assumed`; whether all fits.

    Of a vehicle known for long to be as loose as is assumed, or of one of which nothing is known.
    """
    core = start(configure(Settings(), 100.0), Initial())["core"][0]
    c = core[0]
    c["nav"]["t_ns"] = 100 * 10**9
    c["gnss"]["last_used_ns"] = c["nav"]["t_ns"] - int(1e9 * fix_age_s)
    if known:
        c["nhc"]["noise_scale"], c["nhc"]["sum_count"] = 1.0, 100
    clear_innovation_sums(c)
    fits = all_fit(PARAMETERS, c, innovations, assumed)
    return c["nhc"]["noise_scale"].copy(), fits


def white(seed, n, sigma):
    return sigma * np.random.default_rng(seed).standard_normal((n, 2))


def test_honest_innovations_leave_the_noise_as_it_is():
    runs = [learned(white(seed, 30 * SUM_LENGTH, 0.1), 0.01) for seed in range(20)]
    assert all(fits for _, fits in runs)
    assert 0.6 < np.exp(np.mean([np.log(loose) for loose, _ in runs])) < 1.5


def test_without_slip_the_constraint_noise_decreases_within_bounds():
    loose, fits = learned(white(2, 30 * SUM_LENGTH, 0.01), 0.01)
    assert fits
    assert loose == pytest.approx(NOISE_SCALE_RANGE[0])


def test_the_constraint_noise_is_small_after_a_minute_without_slip():
    assert np.exp(np.mean(np.log(NOISE_SCALE_RANGE))) == pytest.approx(INITIAL_NOISE_SCALE)
    loose, fits = learned(white(4, SUM_LENGTH - 1, 0.05), 0.01, known=False)
    assert fits
    assert loose == pytest.approx(INITIAL_NOISE_SCALE)  # too few to tell
    for seed in range(10):
        loose, fits = learned(white(seed, 6 * SUM_LENGTH, 0.05), 0.01, known=False)
        assert fits
        assert (loose < 1.5).all()
    kerb = white(5, 6 * SUM_LENGTH, 0.05)
    kerb[150:160] += 1.5
    assert learned(kerb, 0.01, known=False)[1]


def test_a_drift_too_small_to_show_in_one_innovation_shows_in_their_sum():
    drift = white(3, 12 * SUM_LENGTH, 0.05)
    drift[:, 0] += 0.15  # one and a half of what is assumed
    assert not learned(drift, 0.01)[1]
    assert not learned(drift[: 6 * SUM_LENGTH], 0.01, known=False)[1]
    loose, fits = learned(drift, 0.01, fix_age_s=10.0)  # where nothing vouches for the velocity, nothing is learned
    assert fits
    assert (loose == 1.0).all()


def test_a_wrong_constraint_inflates_the_covariance():
    core = start(configure(Settings(), 100.0), Initial())["core"][0]
    c = core[0]
    c["nhc"]["down_sum"], c["nhc"]["principal_axis"] = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
    enable_nhc(PARAMETERS, c)
    began = np.diag(unpack(c["cov"]["P"], STATES))
    for i in range(STATES):
        scale(c["cov"]["P"], STATES, i, 0.1)
    disable_nhc(PARAMETERS, c, 4.0)
    doubted = np.diag(unpack(c["cov"]["P"], STATES))
    bent = [*range(ATTITUDE, GNSS_BIAS), *range(GYRO_SCALE, GYRO_SCALE + 9)]
    assert doubted[bent] == pytest.approx(began[bent])
    axis = [MOUNT_PITCH, MOUNT_YAW]  # it was wrong, too: as uncertain as before it was found
    assert doubted[axis] == pytest.approx(TUNING["unknown_mount_sigma"] ** 2)
    rest = np.setdiff1d(np.arange(STATES), [*bent, *axis])
    assert doubted[rest] == pytest.approx(0.01 * began[rest])
    assert c["nhc"]["enabled"] == 0


@pytest.mark.parametrize("gap", [0.2, 0.5, 1.0])
def test_a_gap_hides_what_a_random_walk_tied_at_both_ends_does(gap):
    """Against walks drawn at random: the mean over the gap, about that of its ends."""
    rng, q, n, runs = np.random.default_rng(4), 0.3, 100, 4000
    walks = np.cumsum(rng.standard_normal((runs, n)) * np.sqrt(q * gap / n), axis=1)
    walks = np.column_stack([np.zeros(runs), walks])
    bridges = walks - np.linspace(0.0, 1.0, n + 1) * walks[:, -1:]
    mean = np.var(bridges.mean(axis=1))
    assert gap_variance(PARAMETERS, 0.0, gap, q, 0.0, 10.0) == pytest.approx(mean, rel=0.1)


def test_a_gap_hides_more_where_its_ends_differ_or_shake_and_at_most_what_may_happen():
    assert gap_variance(PARAMETERS, 0.6**2, 0.2, 0.0, 0.0, 10.0) == pytest.approx(0.6**2 / 12)
    assert gap_variance(PARAMETERS, 0.0, 0.2, 0.0, 0.02, 10.0) == pytest.approx(0.01)
    assert gap_variance(PARAMETERS, 0.0, 1e3, 0.01, 0.0, 0.3) == pytest.approx(0.09)
