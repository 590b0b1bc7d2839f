"""Single positions far away, one in twenty: they are rejected, and no fault is found that they look like."""

import numpy as np
import pytest
from navigation_runner import navigate
from navigation_simulation import Later, drive, errors, received, sensed
from simulated_errors import outliers

from imud.configuration.settings import Navigation, Settings

D = Later(drive, 160.0, speed=12.0)
LONG = Later(drive, 260.0, speed=12.0)
STRAIGHT = Later(drive, 160.0, speed=12.0, straight_s=5.0)  # it hardly shows the lever arm


def run(fixes, d=D):
    """(horizontal errors, m; estimate; state)."""
    out, _, state = navigate(sensed(d, np.random.default_rng(1), bg=(0.002, -0.001, 0.0015)), fixes)
    return errors(d, out)[0][:, :2], out, state


@pytest.mark.parametrize("sigma_m", [20.0, 100.0])
@pytest.mark.parametrize("kind", ["1 Hz", "5 Hz", "rtk"])
def test_outliers_do_not_move_the_estimate(kind, sigma_m):
    """Those of a receiver that goes on for 20 s with right positions first; then as without them, to a metre."""
    rng = np.random.default_rng(4)
    sigma = 0.02 if kind == "rtk" else 1.0
    fixes = received(D, rng, late=0.1, sigma=sigma, white=0.3 * sigma, every=1.0 if kind == "1 Hz" else 0.2)
    if kind == "rtk":
        fixes["sigma"] = (0.03, 0.03, 0.05)
    k = fixes["t_ns"] > 120 * 10**9
    wrong = fixes.copy()
    wrong[k] = outliers(D, fixes[k], np.random.default_rng(5), sigma_m)
    clean, _, _ = run(fixes)
    p, _, state = run(wrong)
    assert np.nanmax(np.abs(p - clean)) < (1.0 if kind == "rtk" else 2.5)
    assert state["velocity_discrepancy"]["verdict"][0] == 0
    assert abs(state["core"][0, 0]["nav"]["time_offset"]) < 0.15


@pytest.mark.parametrize(("speed_error", "metres"), [(3.0, -180.0), (1.0, -45.0)])
def test_an_outlier_is_no_drift_that_ends_where_the_velocity_is_known_to_be_wrong(speed_error, metres):
    """It is where the positions would be if the velocity had been right for the last minute."""
    fixes = received(LONG, np.random.default_rng(4), late=0.1, sigma=1.0)
    t = fixes["t_ns"] * 1e-9 - 100.0
    v = np.exp(1j * fixes["course"]) * fixes["speed"] - speed_error * (t > 30.0)
    fixes["speed"], fixes["course"] = np.abs(v), np.angle(v)
    fixes["lat"][np.round(t) == 240.0] += metres / 6.37e6
    p, _, _ = run(fixes, LONG)
    assert np.abs(p[23900:, :2]).max() < 15.0


def test_the_filter_is_not_reset_to_an_outlier():
    """Without a velocity, when a jump of 60 m has been rejected for long enough."""
    fixes = received(D, np.random.default_rng(4), late=0.1, sigma=1.0)
    t = fixes["t_ns"] * 1e-9 - 100.0
    fixes["speed"] = fixes["course"] = np.nan
    fixes["lat"][t >= 99.5] += 60.0 / 6.37e6
    for at_s in range(105, 112):
        one = fixes.copy()
        one["lat"][np.round(t) == at_s] += 200.0 / 6.37e6
        assert np.nanmax(np.abs(run(one)[0][:, 0])) < 90.0


def test_outliers_do_not_keep_the_filter_from_positions_that_have_jumped():
    """Of 40 m for good: the filter is reset to them after reset_s, though one in eight is an outlier."""
    fixes = received(D, np.random.default_rng(4), late=0.1, sigma=1.0)
    t = fixes["t_ns"] * 1e-9 - 100.0
    fixes["lat"][t >= 80.0] += 40.0 / 6.37e6
    fixes["lat"][np.isin(np.round(t), (83.0, 91.0, 99.0, 107.0))] += 200.0 / 6.37e6
    p, out, _ = run(fixes)
    at = int(100 * 95.0)
    assert abs(p[at, 0]) == pytest.approx(40.0, abs=5.0)
    assert out["sigma_p"][at, 0] > 10.0  # either may be right


@pytest.mark.parametrize("every", [0.2, 1.0])
def test_a_position_that_is_off_after_an_outage_bends_nothing_else(every):
    """The first one is 70 m off and comes back within 8 s; the velocity is right, and decides."""
    fixes = received(D, np.random.default_rng(6), late=0.1, sigma=1.0, every=every)
    t = fixes["t_ns"] * 1e-9 - 100.0
    off = np.where(t > 100.0, np.exp(-np.maximum(t - 100.0, 0.0) / 8.0), 0.0)
    fixes["lat"] += 50.0 * off / 6.37e6
    fixes["lon"] -= 50.0 * off / 6.37e6
    samples, fixes = sensed(D, np.random.default_rng(1)), fixes[(t < 80.0) | (t > 100.0)]
    out, _, _ = navigate(samples, fixes)
    position, velocity, attitude = errors(D, out)
    coming_back = navigate(samples[: int(100 * 105.0)], fixes[fixes["arrival_ns"] < 205 * 10**9])[2]
    assert coming_back["velocity_discrepancy"]["verdict"][0] < 3  # the velocity is not called wrong
    since = slice(int(100 * 101.5), None)
    assert np.abs(velocity[since, :2]).max() < 2.5
    assert np.degrees(np.abs(attitude[since, 2])).max() < 2.0
    assert np.hypot(*position[-1, :2]) < 5.0


@pytest.mark.parametrize("at", [26, 29, 32])
def test_an_outlier_of_a_survey_is_no_lever_arm(at):
    """Positions of centimetres alone, while little is known of the lever arm: one was 70 m, the position 190 m off."""
    fixes = received(STRAIGHT, np.random.default_rng(4), late=0.0, sigma=0.0, white=0.02)
    fixes["sigma"], fixes["hdop"] = (0.02, 0.02, 0.04), np.nan
    fixes["speed"] = fixes["course"] = np.nan
    fixes["lat"][at] += 30.0 / 6.37e6
    fixes["lon"][at] += 40.0 / 6.37e6
    samples = sensed(STRAIGHT, np.random.default_rng(1), bg=(0.002, -0.001, 0.0015))
    out, _, state = navigate(samples, fixes, Settings(navigation=Navigation(lever_arm_m=(0.0, 0.0, 0.0))))
    assert np.abs(errors(STRAIGHT, out)[0][6000:, :2]).max() < 1.0
    assert not state["core"][0, 0]["nav"]["gnss_lever_arm"].any()


def test_an_outlier_is_no_lag_of_the_velocity():
    """A robot's receiver: one position 40 m off was a lag of 2 s, so that its velocity was no longer used."""
    d = drive(160.0, speed=1.2)
    for at in (500, 520, 540, 560, 580, 600):
        fixes = received(d, np.random.default_rng(4), late=0.1, sigma=1.0, every=0.2)
        fixes["lat"][at] += 25.0 / 6.37e6
        fixes["lon"][at] -= 45.0 / 6.37e6
        _, _, state = run(fixes, d)
        assert np.atleast_1d(state["velocity_lag"]["late"])[0] == 0


@pytest.mark.parametrize("every", [0.2, 1.0])
@pytest.mark.parametrize(("north", "east"), [(25.0, -45.0), (-30.0, 20.0), (60.0, 60.0)])
def test_a_first_position_that_is_off_leaves_no_velocity_behind(north, east, every):
    """Positions alone of a car that is under way: the first was a velocity of 100 m/s, for half a minute."""
    d = drive(60.0, speed=12.0, fast_start=True)
    fixes = received(d, np.random.default_rng(4), late=0.1, sigma=0.01, white=0.01, every=every)
    fixes["sigma"], fixes["hdop"] = (0.02, 0.02, 0.04), np.nan
    fixes["speed"] = fixes["course"] = np.nan
    fixes["lat"][0] += north / 6.37e6
    fixes["lon"][0] += east / 4.26e6
    p, out, _ = run(fixes, d)
    settled = slice(int(100 * (1.0 + 5.0 * every)), None)
    assert np.hypot(*p[settled].T).max() < (4.0 if every < 1.0 else 12.0)
    assert out["sigma_p"][settled, :2].max() < 80.0  # the first one may be right instead


@pytest.mark.parametrize("n", [3, 4])
def test_several_positions_of_one_epoch_that_contradict_each_other_are_no_number_less(n):
    """Of several receivers in one table, say: no time has passed between them, so that none shows a velocity."""
    d, rng = drive(60.0, speed=12.0, fast_start=True), np.random.default_rng(4)
    fixes = np.repeat(received(d, rng, late=0.1, sigma=1.0), n)
    fixes["sigma"], fixes["hdop"] = (1.5, 1.5, 3.0), np.nan
    fixes["speed"] = fixes["course"] = np.nan
    at = np.arange(len(fixes)) % n
    fixes["lat"] += np.where(at == 0, 60.0, 0.1 * (at - 1)) / 6.37e6
    p, _, _ = run(fixes, d)
    assert np.isfinite(p[300:]).all()
    assert np.hypot(*p[1000:].T).max() < 80.0
