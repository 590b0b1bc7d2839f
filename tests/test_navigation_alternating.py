"""A receiver whose positions alternate between places: nothing tells which are right, so none is valid."""

import math

import numpy as np
import pytest
from navigation_runner import navigate
from navigation_simulation import drive, errors, received, sensed

from imud.estimators.records import HEIGHT_VALID, POSITION_VALID

SECONDS = 90


@pytest.fixture(scope="module", params=["at rest", "under way"])
def run(request):
    d = drive(SECONDS, rest=1e9 if request.param == "at rest" else 10.0)
    return d, sensed(d, np.random.default_rng(3))


def fixes_of(d, elsewhere, metres=math.inf):
    """One each second; the marked ones are so many m north of the truth, or at its antipode."""
    fixes = received(d, np.random.default_rng(3))
    marked = elsewhere(np.arange(len(fixes)))
    if metres < math.inf:
        fixes["lat"][marked] += metres / 6.37e6
    else:
        fixes["lat"][marked] *= -1.0
        fixes["lon"][marked] += math.pi
    return fixes


def valid(out, bit=POSITION_VALID):
    """Whether the position is, or the height, for each second."""
    return ((out["status"] & bit) > 0).reshape(SECONDS, -1).all(axis=1)


@pytest.mark.thorough
@pytest.mark.parametrize("metres", [200.0, 1000.0, math.inf])
@pytest.mark.parametrize("fixes_each", [1, 2, 5, 10])
def test_it_has_no_valid_position_after_the_second_return(run, fixes_each, metres):
    d, samples = run
    out, _, _ = navigate(samples, fixes_of(d, lambda k: k // fixes_each % 2 == 1, metres))
    position, _, _ = errors(d, out)
    off, sigma = np.hypot(*position[:, :2].T), np.hypot(*out["sigma_p"][:, :2].T)
    wrong_and_sure = ((out["status"] & POSITION_VALID) > 0) & (off > 5.0) & (off > 4.0 * sigma)
    assert not wrong_and_sure.any()
    if fixes_each < 10:  # else the filter is reset, and at the antipode the velocities contradict each other as well
        assert not valid(out)[4 * fixes_each + 3 :].any()


def test_it_is_valid_again_when_the_positions_are_in_one_place(run):
    d, samples = run
    out, _, _ = navigate(samples, fixes_of(d, lambda k: (k < 30) & (k % 2 == 1)))
    for bit in (POSITION_VALID, HEIGHT_VALID):
        assert not valid(out, bit)[10:30].any()
        assert valid(out, bit)[60:].all()


@pytest.mark.parametrize("rate_hz", [5, 10])
@pytest.mark.parametrize("seconds_each", [3, 5])
def test_many_positions_in_each_place_are_no_reason_to_believe_one_of_them(rate_hz, seconds_each):
    """It begins at the wrong place; at 10 Hz that was valid, and sure, for all of the time."""
    d = drive(SECONDS, rest=1e9)
    fixes = received(d, np.random.default_rng(3), every=1.0 / rate_hz)
    fixes["lat"][np.arange(len(fixes)) // (rate_hz * seconds_each) % 2 == 0] += 200.0 / 6.37e6
    out, _, _ = navigate(sensed(d, np.random.default_rng(3)), fixes)
    assert not valid(out)[4 * seconds_each + 3 :].any()


@pytest.mark.parametrize("outliers", [0.05, 0.1])
def test_outliers_are_rejected_and_the_position_stays_valid(run, outliers):
    d, samples = run
    chosen = np.random.default_rng(1).random(10 * SECONDS) < outliers
    out, _, _ = navigate(samples, fixes_of(d, lambda k: chosen[k] & (k > 5), 1000.0))
    assert valid(out)[2:].all()


def test_a_jump_that_lasts_costs_no_validity(run):
    d, samples = run
    out, _, _ = navigate(samples, fixes_of(d, lambda k: k > 40, 200.0))
    assert valid(out)[2:].all()


def test_the_sigma_does_not_shrink_while_what_it_was_reset_to_is_contradicted():
    """Reset to the antipode, where a vehicle under way would move the other way: all later positions are rejected."""
    d = drive(60, rest=10.0)
    out, _, _ = navigate(sensed(d, np.random.default_rng(3)), fixes_of(d, lambda k: k // 10 % 2 == 1))
    position, _, _ = errors(d, out)
    off, sigma = np.hypot(*position[:, :2].T), np.hypot(*out["sigma_p"][:, :2].T)
    assert off[-1] > 1e7
    assert (off[5500:] < 2.0 * sigma[5500:]).all()
