"""What is assumed instead of measured shows as innovations too: rest, and a vehicle that neither slips nor jumps."""

import numpy as np
import pytest
from in_c import in_c
from navigation_runner import navigate
from navigation_simulation import drive, received, sensed
from replay_in_process import replay

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Navigation, Settings
from imud.estimators import registry
from imud.estimators.ins.aiding.contradicted_bias import watch_bias
from imud.estimators.ins.aiding.zero_velocity import fuse_rest, reset_velocity
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import ATTITUDE, COARSE_ALIGNMENT, FAULTS, GYRO_BIAS, NAVIGATING, STATES, VELOCITY
from imud.estimators.records import (
    INNOVATION,
    NHC_LATERAL,
    NHC_VERTICAL,
    PENDING_MAX,
    REST_D,
    REST_N,
    REST_X,
    REST_Z,
    SOLUTION,
)
from imud.math.kalman import packed_index
from imud.pipeline import Filter

RATE = 100
REST_S, SKID_S = 10.0, (80.0, 83.0)


def innovations_of(samples, fixes):
    """(solutions, innovations) as `imud replay` has them, of a sensor that is warm."""
    settings = Settings(navigation=Navigation(tuning={"warm_up_share": 0.0}))
    filter_ = Filter(registry.by_name("navigation"), settings, Initial(yaw_deg=np.degrees(0.7)), RATE)
    return replay(filter_, samples, fixes)


@pytest.fixture(scope="module")
def run():
    """A rest, a drive, and on it a skid of 3 s across the road: solutions and innovations."""
    rng = np.random.default_rng(1)
    d = drive(120.0, rest=REST_S)
    skid = (d.t >= SKID_S[0]) & (d.t < SKID_S[1])
    d.f[skid, 1] += 2.0 * np.sign(np.mean(SKID_S) - d.t[skid])
    return innovations_of(sensed(d, rng), received(d, rng, late=0.25))


def of(rows, first, last=None):
    return rows[(rows["kind"] >= first) & (rows["kind"] <= (first if last is None else last))]


def test_each_pseudo_measurement_is_reported_once_though_late_fixes_have_samples_integrated_twice(run):
    _, rows = run
    assert rows.dtype == INNOVATION
    for first, last, period_s in ((REST_N, REST_D, 0.5), (REST_X, REST_Z, 0.5), (NHC_LATERAL, NHC_VERTICAL, 0.1)):
        for kind in range(first, last + 1):
            gaps = np.diff(of(rows, kind)["t_ns"] * 1e-9)
            assert gaps.min() > 0.6 * period_s
            assert np.median(gaps) == pytest.approx(period_s, abs=0.03)
    resting = of(rows, REST_X)["t_ns"] * 1e-9 - 100.0
    assert 12 < np.count_nonzero(resting < REST_S) <= 20
    assert of(rows, NHC_LATERAL)["t_ns"].min() * 1e-9 - 100.0 > REST_S


def test_value_and_variance_are_those_of_the_gain_that_was_applied(run):
    out, rows = run
    row = of(rows, REST_X)[1]  # nothing but rest has innovations_of of the bias yet
    k = np.searchsorted(out["t_ns"], row["t_ns"])
    before, after = out[k - 1], out[k]
    assert row["variance"] > before["sigma_bg"][0] ** 2
    correction = before["sigma_bg"][0] ** 2 / row["variance"] * row["value"]
    assert after["bg"][0] - before["bg"][0] == pytest.approx(correction, rel=0.05)


def test_a_skid_is_no_valid_constraint(run):
    _, rows = run
    slips = of(rows, NHC_LATERAL)
    t = slips["t_ns"] * 1e-9 - 100.0
    skidding = (t > SKID_S[0] + 0.2) & (t < SKID_S[1] - 0.3)
    assert not slips["used"][skidding].all()
    quiet = (t > 60.0) & (t < SKID_S[0])
    assert slips["used"][quiet].all()
    assert (slips["value"][quiet] ** 2 / slips["variance"][quiet]).mean() < 2.0


def test_pending_innovations_are_kept_up_to_a_limit_and_harm_nothing():
    rng = np.random.default_rng(2)
    d = drive(60.0, rest=1e3)
    filter_ = Filter(registry.by_name("navigation"), Settings(), Initial(), RATE)
    samples = np.tile(sensed(d, rng), 5)
    samples["t_ns"] = 10**11 + 10**7 * np.arange(len(samples))
    filter_.run(samples, np.zeros(len(samples), SOLUTION))
    kept = filter_.pending_innovations().copy()
    assert len(kept) == PENDING_MAX
    assert (np.diff(kept["t_ns"]) >= 0).all()
    assert not len(filter_.pending_innovations())


@pytest.mark.parametrize(
    ("noise", "growth_dps", "contradicts"), [(0.05, 0.0, False), (0.0, 0.0, True), (0.0, 0.1, False)]
)
@pytest.mark.parametrize("mode", [COARSE_ALIGNMENT, NAVIGATING])
def test_a_rate_at_rest_replaces_a_bias_if_it_is_beyond_its_noise_and_stays_the_same(
    noise, growth_dps, contradicts, mode
):
    """A window's mean rate of 1.2 deg/s: three of its own sigmas with noise of 0.05 rad/s, else of a wrong bias.

    A known heading is corrected by what it has turned; another one is off by that.
    """
    settings, navigating = configure(Settings(), RATE), mode == NAVIGATING
    p, c = settings[0], start(settings, Initial(lat_deg=50.0, lon_deg=8.0))["core"][0, 0]
    yaw = interpreted(packed_index)(STATES, ATTITUDE + 2, ATTITUDE + 2)
    for i in range(3):
        c["cov"]["P"][interpreted(packed_index)(STATES, GYRO_BIAS + i, GYRO_BIAS + i)] = np.radians(0.01) ** 2
    c["alignment"]["mode"], c["stationarity"]["low_motion_count"] = mode, 100
    c["nav"]["t_ns"] = c["gnss"]["last_used_ns"] = 10**12
    c["gnss"]["speed"] = 0.0
    c["stationarity"]["duration"], c["stationarity"]["sample_count"] = 0.5, 50
    c["stationarity"]["gyro_noise_floor"], c["nav"]["q_nb"] = noise, (1.0, 0.0, 0.0, 0.0)
    windows = int(p["tuning"]["known_heading_contradiction_windows" if navigating else "bias_contradiction_windows"])
    c["cov"]["P"][yaw], replaced = 0.0, []
    for k in range(windows + 5):
        c["stationarity"]["mean_w"][2] = np.radians(1.2 + growth_dps * k)
        in_c(watch_bias)(p, c, True)
        in_c(fuse_rest)(p, c)
        replaced += [abs(c["nav"]["bg"][2] - np.radians(1.2)) < np.radians(0.01)]
    assert replaced == [contradicts and k >= windows - 1 for k in range(windows + 5)]
    turned = np.radians(1.2) * 0.5 * windows if contradicts else 0.0
    w, _, _, z = c["nav"]["q_nb"]
    assert 2.0 * np.arctan2(z, w) == pytest.approx(-turned if navigating else 0.0, rel=0.02, abs=1e-3)
    share = float(p["tuning"]["turned_share"]) if navigating else 1.0
    assert np.sqrt(c["cov"]["P"][yaw]) == pytest.approx(share * turned, rel=0.02, abs=1e-3)


@pytest.mark.parametrize(("turns_s", "is_known"), [(2.4, False), (4.4, True)])
def test_a_rate_that_only_an_unknown_bias_explains_is_one_of_rest_after_three_seconds(turns_s, is_known):
    """As of a ship that rolls slowly when the sensor is switched on."""
    rng = np.random.default_rng(2)
    d = drive(20.0, rest=20.0)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.2, late=0.1)
    samples["w"][:, 0] += np.radians(1.5)
    last = navigate(samples[d.t < turns_s], fixes[fixes["arrival_ns"] < 100e9 + turns_s * 1e9], Settings())[0][-1]
    assert (last["sigma_bg"][0] < np.radians(0.1)) == is_known


def test_a_motion_that_begins_slowly_does_not_replace_the_gyro_bias():
    """As a multicopter that takes off: nothing else shows that its last window of rest was one of motion."""
    rng = np.random.default_rng(1)
    d = drive(20.0, rest=10.0)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.2, late=0.2)
    turning = (d.t > 9.5) & (d.t < 10.2)
    samples["w"][turning, 1] += np.radians(0.25)
    out = navigate(samples[d.t < 10.2], fixes, Settings())[0]
    assert np.abs(out["bg"][-1] - out["bg"][900]).max() < np.radians(0.02)


def test_a_velocity_that_is_set_to_zero_has_nothing_of_what_any_fault_has_done():
    c = start(configure(Settings(), RATE), Initial())["core"][0].view(np.recarray)[0]
    c.faults.sensitivity[:] = 1.0
    interpreted(reset_velocity)(c, 0.01)
    cleared = c.faults.sensitivity == 0.0
    assert cleared[VELOCITY : VELOCITY + 3].all() and cleared.sum() == 3 * FAULTS
