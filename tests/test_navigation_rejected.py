"""A rejected position is part of the stated sigma where only the IMU supports the estimate, which may be wrong.

After an outage it is as likely to be wrong as the receiver, and what has grown with the error is corrected with it.
"""

import numpy as np
import pytest
from accuracy_simulated import figures
from navigation_runner import fixes_of, navigate, without
from navigation_simulation import Later, drive, errors, received, sensed
from test_navigation_faults import RATE, START, at, data, moved

from imud.estimators.records import REJECTING

OUTAGE = (100.0, 103.5)  # s; the next fix is at 104 s and contradicts the estimate
LONG_OUTAGE = (100.0, 112.5)
AFTER_S = 1.2  # from the end of an outage until a fix has been rejected
METRES = 40.0


def without_velocity(fixes):
    fixes = fixes.copy()
    for name in ("v", "speed", "course"):
        fixes[name] = np.nan
    return fixes


def solutions(fixes, outage=OUTAGE):
    """Solutions of a drive with an outage, without and with a jump of two positions north after it."""
    samples = data()[0]
    fixes = without(fixes, [(100.0 + outage[0], 100.0 + outage[1], 0)])
    return navigate(samples, fixes)[0], navigate(samples, moved(fixes, outage[1], outage[1] + 2.5, METRES))


def test_a_rejected_position_widens_the_stated_sigma_by_the_velocity_that_explains_it():
    clean, (out, rows, _) = solutions(without_velocity(data()[1]))
    position = rows[rows["kind"] == 0]
    k = at(OUTAGE[1] + AFTER_S)
    used = position[(position["used"] == 1) & (position["t_ns"] < out["t_ns"][at(OUTAGE[1])])]["t_ns"][-1]
    last = position[(position["used"] == 0) & (position["t_ns"] <= out["t_ns"][k])]["t_ns"][-1]
    assert out["status"][k] & REJECTING
    outage_s, since_s = 1e-9 * (last - used), 1e-9 * (out["t_ns"][k] - used)
    speed = np.hypot(*out["v"][np.searchsorted(out["t_ns"], last), :2])
    velocity = min(METRES / outage_s, np.hypot(0.25, 0.05 * speed))
    for field, error in (("sigma_p", velocity * since_s), ("sigma_v", velocity)):
        before = out[field][at(OUTAGE[1]), 0]
        assert error < out[field][k, 0] < 1.2 * np.hypot(error, before), field
    assert (out["sigma_p"][at(OUTAGE[1] + 5.5), :2] < 1.2 * clean["sigma_p"][at(OUTAGE[1] + 5.5), :2] + 1.0).all()


def test_a_rejected_position_is_not_stated_where_the_receiver_s_velocity_supports_the_estimate():
    clean, (out, _, _) = solutions(data()[1])
    assert out["status"][at(OUTAGE[1] + AFTER_S)] & REJECTING
    for field in ("sigma_p", "sigma_v"):
        assert (out[field][at(OUTAGE[1] + AFTER_S)] < 1.5 * clean[field][at(OUTAGE[1] + AFTER_S)]).all(), field


def test_after_an_outage_a_rejected_position_widens_all_that_has_grown_with_its_error():
    for fixes in (data()[1], without_velocity(data()[1])):
        clean, (out, _, _) = solutions(fixes, LONG_OUTAGE)
        k = at(LONG_OUTAGE[1] + AFTER_S)
        assert out["status"][k] & REJECTING
        assert METRES / 2.0 < out["sigma_p"][k, 0] < 2.0 * METRES
        for field in ("sigma_v", "sigma_rpy"):
            assert (out[field][k] > 2.0 * clean[field][k]).all(), field
        later = at(LONG_OUTAGE[1] + 15.0)
        assert (out["sigma_p"][later, :2] < 1.5 * clean["sigma_p"][later, :2]).all()


FAULTS = {"gyro z": ("w", 2, np.radians(0.3)), "forward force": ("f", 0, 0.4)}  # rad/s, m/s^2; in the outage
WAY = Later(drive, 160.0)
RTK = {"sigma": 0.01, "white": 0.01, "speed_sigma": 0.03}


def wrong_and_sure_s(fault, receiver, has_velocity, seed):
    """Seconds for which the position is, after an outage in which the IMU has a fault."""
    rng = np.random.default_rng(seed)
    begin, length = rng.uniform(55.0, 85.0), rng.uniform(8.0, 30.0)
    samples, fixes = sensed(WAY, rng), received(WAY, rng, late=0.2, **receiver)
    if receiver:
        fixes["sigma"] = 0.02
    if not has_velocity:
        fixes = without_velocity(fixes)
    field, axis, error = FAULTS[fault]
    samples[field][at(begin) : at(begin + length), axis] += error
    out, _, _ = navigate(samples, without(fixes, [(100.0 + begin, 100.0 + begin + length, 0)]), None, START)
    after = slice(at(begin + length + 1.0), None)
    p, sigma = errors(WAY, out)[0][after, :2], out["sigma_p"][after, :2]
    return ((np.abs(p) > 4.0 * sigma).any(axis=1) & (np.hypot(*p.T) > 5.0)).sum() / RATE


@pytest.mark.thorough
@pytest.mark.parametrize("has_velocity", [False, True])
@pytest.mark.parametrize("receiver", [RTK, {}], ids=["rtk", "single"])
@pytest.mark.parametrize("fault", FAULTS)
def test_an_outage_in_which_the_imu_errs_more_than_stated_is_not_blamed_on_the_receiver(fault, receiver, has_velocity):
    assert sum(wrong_and_sure_s(fault, receiver, has_velocity, seed) for seed in range(12)) < 12.0


def test_a_reset_over_any_distance_ends_at_the_fix():
    """A receiver that first tells 0, 0: metres to the east at the equator are another angle at 47 degrees."""
    samples, t = data()[0][: at(60.0)], 100.0 + np.arange(60.0)
    early = t < 115.0
    lat, lon = np.where(early, 0.0, 47.0), np.where(early, 0.0, 8.0)
    columns = {"t_s": t, "arrival_s": t + 0.2, "lat_deg": lat, "lon_deg": lon}
    out, _, _ = navigate(samples, fixes_of(columns | {"height_m": np.full(60, 100.0), "hdop": np.ones(60)}, 60))
    reset = out["lat"] > np.radians(46.0)
    assert reset.any()
    assert np.degrees(out["lon"][reset]) == pytest.approx(8.0, abs=1e-2)
    assert np.degrees(out["lat"][reset]) == pytest.approx(47.0, abs=1e-2)


def test_multipath_that_ends_is_no_step_of_the_stamps():
    """A car on a motorway: fixes 35 m beside the way for seconds, then right ones, which looked late by a second."""
    row = figures("motorway", "RTK", 0.0, 1302, error="multipath")
    assert row["position s"] < 20.0
    assert row["position NEES"] < 6.0


def test_where_only_the_imu_contradicts_the_positions_it_does_no_longer_than_a_receiver_drifts():
    """A helicopter whose receiver, of positions alone, seemed to drift after multipath: the IMU was off by 4 km."""
    row = figures("helicopter", "1 Hz positions", 0.0, 1303, error="multipath")
    assert row["position m"] < 100.0
    assert row["velocity m/s"] < 10.0


@pytest.mark.parametrize("has_velocity", [True, False])
def test_positions_that_scatter_far_beyond_what_a_receiver_claims_are_soon_stated(has_velocity):
    """It claims RTK, and states no sigmas. One of two positions is wrong from the first that is rejected on.

    Of 60 s the positions were wrong by 5 sigma for 4 to 6 s, the heights for 12 to 25 s, when nothing stated them.
    """
    wrong_s = np.zeros((4, 2))
    for seed in range(4):
        rng, d = np.random.default_rng(seed), drive(60.0)
        samples, fixes = sensed(d, rng), received(d, rng, late=0.1, sigma=0.0, white=5.0, hdop=0.6)
        fixes["quality"] = 4
        out = navigate(samples, fixes if has_velocity else without_velocity(fixes))[0]
        found = np.abs(errors(d, out)[0]) / out["sigma_p"]
        wrong_s[seed] = (found[:, :2].max(axis=1) > 5.0).sum() / 100.0, (found[:, 2] > 5.0).sum() / 100.0
    assert (wrong_s.mean(axis=0) < (3.0, 4.0)).all(), wrong_s


def test_heights_that_are_rejected_widen_the_stated_sigma_by_their_share():
    """One alone is an outlier; from the second on the estimate may be the one that is wrong."""
    samples, fixes = data()[0], data()[1].copy()
    clean = navigate(samples, fixes)[0]
    t = fixes["t_ns"] * 1e-9 - 100.0
    fixes["height"][(t > 60.5) & (t < 63.5)] += 90.0
    out, rows, _ = navigate(samples, fixes)
    heights = rows[(rows["kind"] == 2) & (rows["used"] == 0)]
    assert heights["t_ns"] * 1e-9 - 100.0 == pytest.approx([61.0, 62.0, 63.0])
    added = np.sqrt(out["sigma_p"][:, 2] ** 2 - clean["sigma_p"][:, 2] ** 2)
    assert added[at(61.5)] < 1.0
    past = np.exp(-np.arange(2, 63) / 50.0).sum()  # weights of the heights before, each second
    share = (1.0 + np.exp(-1.0 / 50.0)) / (1.0 + past)
    assert added[at(62.5)] == pytest.approx(90.0 * np.sqrt(share), rel=0.1)
    assert added[at(64.5)] < 1.0, "a height that agrees with the estimate ends it"
