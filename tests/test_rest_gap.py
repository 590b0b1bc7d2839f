"""After a gap at rest: a body that was left alone keeps its heading, and one that shows that it was moved does not."""

import numpy as np
import pytest
from navigation_runner import navigate
from navigation_simulation import Later, drive, errors, received, sensed
from scipy.spatial.transform import Rotation
from test_power_on import PROFILE, RATE, SETTINGS, YAW, switch_on_biases

from imud.drivers.sample import POWER_ON, RECONNECTED
from imud.estimators.records import HEADING_VALID
from imud.math.rotation_arrays import wrapped

BEFORE_S, AFTER_S = 8.0, 12.0
GIVEN_SIGMA = np.radians(5.0)  # of the heading that a user gives
JUDGED, TURN_RATE, ANY2 = slice(round(1.2 * RATE), None), np.radians(3.0), np.pi**2 / 3.0


def around_gap(
    away_s, seed=0, *, moved=None, metres=0.0, flag=RECONNECTED, fixes_after=True, rest_s=1e6, after_s=AFTER_S,
    lon_deg=11.0,
):  # fmt: skip
    """(solutions before the gap, those from the first sample after it on, their attitude errors if it was not moved).

    moved: how it stands afterwards, against before; metres: how far north of its place.
    """
    rng = np.random.default_rng(seed)
    d = Later(drive, BEFORE_S + away_s + after_s, rate=RATE, rest=rest_s, lon_deg=lon_deg)
    off, on = round(BEFORE_S * RATE), round((BEFORE_S + away_s) * RATE)
    noise, biases = (PROFILE.gyro_noise, PROFILE.accel_noise), switch_on_biases(rng)
    later = biases if flag == RECONNECTED else switch_on_biases(rng)
    before, after = sensed(d, rng, *noise, *biases), sensed(d, rng, *noise, *later, moved)
    samples = np.concatenate([before[:off], after[on:]])
    samples["flags"][off] |= flag
    fixes = received(d, rng, late=0.2, sigma=1.8, speed_sigma=0.1)
    is_later = fixes["t_ns"] > samples["t_ns"][off]
    fixes["lat"][is_later] += metres / 6.37e6
    fixes["lon"] = wrapped(fixes["lon"])
    fixes = fixes[(fixes["arrival_ns"] <= samples["t_ns"][off - 1]) | (is_later & fixes_after)]
    solutions, _, _ = navigate(samples, fixes, SETTINGS, YAW)
    whole = np.zeros(len(d.t), solutions.dtype)
    whole["q_nb"][:, 0] = 1.0
    whole[np.r_[0:off, on : len(whole)]] = solutions
    return solutions[:off], solutions[off:], errors(d, whole)[2][on:]


def after_gap(*arguments, **options):
    return around_gap(*arguments, **options)[1:]


def has_heading(solutions):
    return (solutions["status"] & HEADING_VALID) != 0


@pytest.mark.parametrize("fixes_after", [True, False])
@pytest.mark.parametrize(("away_s", "most_deg"), [(1.5, 1.5), (3.0, 2.5), (10.0, 8.0), (20.0, 19.0), (25.0, 27.0)])
def test_left_alone_its_heading_is_known_within_1_2_s_and_less_so_the_longer_the_gap(away_s, most_deg, fixes_after):
    for seed in range(4):
        before, out, error = around_gap(away_s, seed, fixes_after=fixes_after)
        assert has_heading(out[JUDGED]).all()
        turned = np.degrees(np.sqrt(out["sigma_rpy"][JUDGED, 2] ** 2 - before["sigma_rpy"][-1, 2] ** 2))
        assert 0.5 * most_deg < turned[0] < most_deg * (1.0 if not fixes_after else 2.0)
        assert (np.abs(error[:, 2]) < 3.5 * out["sigma_rpy"][:, 2]).all()


def test_after_half_a_minute_it_is_not_known_any_more():
    out, _ = after_gap(29.5)
    assert not has_heading(out[JUDGED]).any()


@pytest.mark.parametrize("away_s", [3.0, 10.0, 20.0])
@pytest.mark.parametrize("tilts_deg", [(1.0, 0.0), (0.0, -1.0), (0.6, 0.7), (-4.0, 2.0)])
def test_where_it_stands_at_another_tilt_it_was_moved_and_its_heading_is_not_known(away_s, tilts_deg):
    out, _ = after_gap(away_s, moved=Rotation.from_euler("xyz", [*tilts_deg, 90.0], degrees=True))
    assert not has_heading(out[2 * RATE :]).any()


@pytest.mark.parametrize("away_s", [3.0, 20.0])
def test_where_the_fixes_are_elsewhere_it_was_moved_and_its_heading_is_not_known(away_s):
    out, _ = after_gap(away_s, moved=Rotation.from_euler("z", 90.0, degrees=True), metres=40.0)
    assert not has_heading(out[round(2.5 * RATE) :]).any()


def test_on_the_date_line_two_fixes_on_either_side_are_the_same_place():
    """Before: longitudes of 180 and of -180 degrees were a way round the earth, and the heading was lost."""
    for seed in range(4):
        assert has_heading(after_gap(3.0, seed, lon_deg=180.0)[0]).all()


@pytest.mark.parametrize("away_s", [3.0, 10.0])
def test_a_sensor_that_was_switched_off_shows_less_of_its_tilt(away_s):
    kept, off = (after_gap(away_s, flag=flag)[0]["sigma_rpy"][2 * RATE, 2] for flag in (RECONNECTED, POWER_ON))
    assert np.degrees(off) > 1.15 * np.degrees(kept)


@pytest.mark.parametrize("starts_s", [0.5, 2.0, 3.5, 5.0])  # since the gap began
def test_one_that_drives_off_meanwhile_or_soon_after_is_not_taken_for_moved(starts_s):
    for seed in range(3):
        out, error = after_gap(3.0, seed, rest_s=BEFORE_S + starts_s, after_s=30.0)
        assert (np.abs(error[:, 2]) < 4.0 * out["sigma_rpy"][:, 2]).all()
        assert has_heading(out[20 * RATE :]).all()


def test_on_average_over_all_that_may_have_happened_the_variance_is_that_of_the_gap():
    """Bayes' rule: what gravity shows makes some surer and others less sure."""
    away_s, rng = 10.0, np.random.default_rng(7)
    prior = (TURN_RATE * away_s) ** 2 / ANY2  # that it was moved

    def stated(seed, moved):
        out, _ = after_gap(away_s, seed, moved=moved, after_s=2.5, fixes_after=False)
        return out["sigma_rpy"][-1, 2] ** 2 - GIVEN_SIGMA**2

    level = np.arange(40) < 0.05 * 40
    places = [
        Rotation.from_euler("xyz", [*np.radians(~k * rng.standard_normal(2)), rng.uniform(-3.0, 3.0)]) for k in level
    ]
    moved = np.mean([stated(k, place) for k, place in enumerate(places)])
    left_alone = np.mean([stated(k, None) for k in range(10)])
    assert prior * moved + (1.0 - prior) * left_alone == pytest.approx(prior * ANY2, rel=0.1)
    assert left_alone < 0.1 * prior * ANY2
