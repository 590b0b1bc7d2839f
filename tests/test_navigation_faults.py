"""What goes wrong in the field: jumps, outages, gaps, rubbish, the ends of the map. The filter says so and recovers."""

import numpy as np
import pytest
from navigation_runner import fixes_of, navigate, samples_of, settings_of
from navigation_simulation import Later, at_antenna, drive, errors, received, sensed

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Navigation, Settings
from imud.drivers.sample import SUSPECT
from imud.estimators.ins.integrity.reset_inflation import propagate_inflation
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import ACCEL_BIAS, DRIFT_FAULT, ONSETS, POSITION, VELOCITY
from imud.estimators.records import AT_REST, COASTING, HEADING_VALID, POSITION_VALID, REJECTING

RATE = 100
D = Later(drive, 160.0)
PARKED = Later(drive, 160.0, rest=1e3)
START = Initial(yaw_deg=float(np.degrees(0.7)))
places = pytest.mark.parametrize("d", [PARKED, D], ids=["parked", "driving"])


def at(seconds):
    return int(seconds * RATE)


def data(seed=1, d=D):
    rng = np.random.default_rng(seed)
    return sensed(d, rng), received(d, rng, late=0.2)


def moved(fixes, begin, end, metres, per_second=0.0):
    fixes = fixes.copy()
    t = fixes["t_ns"] * 1e-9 - 100.0
    m = (t >= begin) & (t < end)
    fixes["lat"][m] += (metres + per_second * (t[m] - begin)) / 6.37e6
    return fixes


def finite(out):
    assert np.isfinite(out["q_nb"]).all()
    assert np.isfinite(out["sigma_rpy"]).all()
    assert np.isfinite(out["sigma_bg"]).all()
    assert np.isfinite(out["sigma_ba"]).all()
    placed = out[(out["status"] & POSITION_VALID) > 0]
    for name in ("lat", "lon", "height", "v", "sigma_p", "sigma_v"):
        assert np.isfinite(placed[name]).all(), name


@pytest.mark.parametrize("metres", [30.0, 100.0, 500.0])
def test_a_jump_of_a_few_seconds_is_rejected(metres):
    samples, fixes = data()
    out, rows, _ = navigate(samples, moved(fixes, 100.0, 103.0, metres))
    clean = navigate(samples, fixes)[0]
    assert np.nanmax(np.abs(errors(D, out)[0] - errors(D, clean)[0])) < 1.0
    assert (out["status"][at(101.0) : at(103.0)] & REJECTING).any()
    assert not (out["status"][at(106.0)] & REJECTING)
    refused = rows[(rows["used"] == 0) & (rows["kind"] == 0)]
    assert set(refused["t_ns"] // 10**9) == {200, 201, 202}


def test_a_lasting_jump_is_accepted_in_bounded_time():
    samples, fixes = data()
    out, _, _ = navigate(samples, moved(fixes, 100.0, 1e9, 100.0))
    p, v, a = errors(D, out)
    assert abs(p[at(105.0), 0]) < 5.0
    assert abs(p[at(115.0), 0] + 100.0) < 6.0
    assert np.abs(v[at(120.0) :, :2]).max() < 0.5
    assert np.abs(a[at(120.0) :, 2]).max() < np.radians(2.0)


def test_a_drifting_position_is_detected():
    samples, fixes = data()
    out, _, _ = navigate(samples, moved(fixes, 100.0, 1e9, 0.0, per_second=1.0))
    noticed = np.flatnonzero(out["status"][at(100.0) :] & REJECTING)
    assert len(noticed) and noticed[0] < at(25.0)
    assert abs(errors(D, out)[0][at(100.0) + noticed[0], 0]) < 12.0


def surprise(d, out, begin):
    """North error, m, and in sigmas where no fix is being refused."""
    p = np.abs(errors(d, out)[0][at(begin) :, 0])
    row = out[at(begin) :]
    return p, np.where(row["status"] & REJECTING, 0.0, p / row["sigma_p"][:, 0])


@places
@pytest.mark.parametrize(("speed", "most"), [(0.5, np.inf), (2.0, 6.0)])
def test_positions_that_drift_against_the_velocity_are_rejected_or_inflate_the_covariance(d, speed, most):
    """0.5 m/s takes half a minute to tell from a receiver's wander, and may be given in to, with doubt."""
    samples, fixes = data(d=d)
    out, _, _ = navigate(samples, moved(fixes, 80.0, 120.0, 0.0, per_second=speed), None, START)
    p, sigmas = surprise(d, out, 80.0)
    assert p.max() < most
    assert sigmas.max() < 6.0  # worst of nine seeds: 5.5
    assert (out["status"][at(80.0) : at(120.0)] & REJECTING).any()
    assert not (out["status"][at(145.0) :] & (REJECTING | COASTING)).any()
    assert p[at(70.0) :].max() < 3.0


@pytest.mark.parametrize(("speed", "most"), [(1.0, np.inf), (5.0, 4.0)])
def test_drifting_positions_of_a_parked_vehicle_are_rejected_without_a_speed_of_the_receiver(speed, most):
    for seed in range(3):
        samples, fixes = data(seed, PARKED)
        fixes["speed"] = fixes["course"] = np.nan
        out, _, _ = navigate(samples, moved(fixes, 80.0, 120.0, 0.0, per_second=speed), None, START)
        p, sigmas = surprise(PARKED, out, 80.0)
        assert p.max() < most
        assert sigmas.max() < 6.0
        assert (out["status"][at(80.0) : at(120.0)] & REJECTING).any()


@pytest.mark.parametrize("speed", [1.0, 3.0])
def test_drifting_positions_of_a_car_are_rejected_without_a_speed_of_the_receiver(speed):
    worst = []
    for seed in range(6):
        samples, fixes = data(seed)
        fixes["speed"] = fixes["course"] = np.nan
        out, _, _ = navigate(samples, moved(fixes, 100.0, 140.0, 0.0, per_second=speed))
        p, sigmas = surprise(D, out, 100.0)
        assert p.max() < 18.0  # followed, it would be 40 and 120 m
        worst.append(sigmas.max())
        assert (out["status"][at(120.0) : at(140.0)] & REJECTING).all()
        assert not (out["status"][at(142.0) :] & REJECTING).any()
    assert np.mean(worst) < 5.0
    assert max(worst) < 9.0


def wrong_and_sure_s(d, out):
    """Seconds with a horizontal error of more than 2.5 m and 4 sigma."""
    p = np.abs(errors(d, out)[0][:, :2])
    return float(((p > 2.5) & (p > 4.0 * out["sigma_p"][:, :2])).any(1).sum()) / RATE


def test_a_likely_drift_is_part_of_the_stated_sigma():
    stated = silent = 0.0
    for seed in range(4):
        samples, fixes = data(seed)
        fixes = moved(fixes, 90.0, 150.0, 0.0, per_second=0.5)
        stated += wrong_and_sure_s(D, navigate(samples, fixes)[0])
        off = settings_of(tuning={"likely_drift_chi2": 1e9})
        silent += wrong_and_sure_s(D, navigate(samples, fixes, off)[0])
    assert silent > 20.0
    assert stated < 0.1 * silent


def test_positions_of_a_survey_that_drift_are_rejected_or_inflate_the_covariance():
    """Without a velocity the filter is reset to them; the drift goes on. One of six is taken for a gust."""
    wrong = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        samples, fixes = sensed(D, rng), received(D, rng, late=0.1, sigma=0.0, white=0.01)
        fixes["sigma"], fixes["speed"], fixes["course"] = (0.02, 0.02, 0.04), np.nan, np.nan
        out = navigate(samples, moved(fixes, 90.0, 150.0, 0.0, per_second=1.0), settings_of())[0]
        wrong.append(wrong_and_sure_s(D, out))
    assert sorted(wrong)[-2] < 6.0  # silent: 25 s at least


def test_the_inflation_of_the_velocity_adds_to_that_of_the_position():
    c = start(configure(Settings(), 100.0), Initial())["core"][0, 0].view(np.recarray)
    c.integrity.position_inflation[:], c.integrity.velocity_inflation[:] = (9.0, 0.0, 4.0), (1.0, 0.0)
    for _ in range(2000):
        interpreted(propagate_inflation)(c, 0.01, np.exp(-0.01 / 40.0))
    assert np.sqrt(c.integrity.position_inflation) == pytest.approx(np.exp(-0.5) * np.array([23, 0, 2]), rel=1e-3)
    assert np.sqrt(c.integrity.velocity_inflation) == pytest.approx([np.exp(-0.5), 0], rel=1e-6)


def test_the_effect_of_a_drift_on_the_estimate_is_predicted():
    """Against the difference of two runs, one with a creep so slow that the filter is linear in it.

    Of a free vehicle: how loosely a land vehicle keeps to its axis is learned from what the creep does, too. So is the
    receiver's noise, but for here.
    """
    free = Settings(navigation=Navigation(vehicle="free", tuning={"warm_up_share": 0.0, "noise_gain": 0.0}))
    rng = np.random.default_rng(1)
    samples, fixes = sensed(D, rng), received(D, rng, late=0.2, sigma=0.1)
    cut = fixes[fixes["t_ns"] < 258 * 10**9]
    still, _, s = navigate(samples[: at(158.2)], cut, free)
    c, rate = s["core"][0, 0], 2e-5  # of 1e-4 one fit of the acceleration has another length
    for j in range(ONSETS):
        since = 1e-9 * c["drift"]["onset_ns"][j] - 100.0
        crept, _, _ = navigate(samples[: at(158.2)], moved(cut, since, 1e9, 0.0, per_second=rate), free)
        pull = c["faults"]["sensitivity"][:, DRIFT_FAULT + 2 * j]
        assert 0.1 < pull[POSITION] < 60.0
        dp = (crept["lat"][-1] - still["lat"][-1]) * 6.37e6 / rate
        assert pull[POSITION] == pytest.approx(dp, rel=0.005)
        assert pull[VELOCITY : VELOCITY + 3] == pytest.approx((crept["v"][-1] - still["v"][-1]) / rate, abs=0.01)
        assert pull[ACCEL_BIAS : ACCEL_BIAS + 3] == pytest.approx((crept["ba"][-1] - still["ba"][-1]) / rate, abs=1e-3)


@places
@pytest.mark.parametrize("metres", [30.0, 200.0, 500.0])
def test_a_jump_for_half_a_minute_is_rejected_or_inflates_the_covariance(d, metres):
    samples, fixes = data(d=d)
    out, _, _ = navigate(samples, moved(fixes, 80.0, 110.0, metres), None, START)
    p, sigmas = surprise(d, out, 81.5)  # from the first such fix on
    assert sigmas.max() < 4.0
    assert p[at(45.0) :].max() < 3.0
    assert not (out["status"][at(130.0) :] & REJECTING).any()
    assert out["status"][-1] & HEADING_VALID


@places
def test_another_position_after_an_outage_is_accepted_in_bounded_time(d):
    samples, fixes = data(d=d)
    t = fixes["t_ns"] * 1e-9 - 100.0
    out, _, _ = navigate(samples, moved(fixes[(t < 80.0) | (t > 110.0)], 100.0, 1e9, 300.0), None, START)
    p = errors(d, out)[0][:, 0]
    assert abs(p[at(109.0)]) < 100.0
    assert np.abs(p[at(122.0) :] + 300.0).max() < 6.0


def test_repeated_positions_under_way_are_not_used():
    samples, fixes = data()
    frozen = fixes.copy()
    t = fixes["t_ns"] * 1e-9 - 100.0
    repeated = np.flatnonzero((t >= 100.0) & (t < 130.0))
    for name in ("lat", "lon", "height", "speed", "course"):
        frozen[name][repeated] = fixes[name][repeated[0]]
    out, _, _ = navigate(samples, frozen)
    p, v, _ = errors(D, out)
    assert (np.abs(p[at(100.0) :, :2]) < 5.0 * out["sigma_p"][at(100.0) :, :2]).all()
    assert np.abs(v[at(100.0) :, :2]).max() < 1.5
    assert out["status"][at(128.0)] & COASTING
    assert not (out["status"][at(133.0) :] & REJECTING).any()


def test_a_height_has_no_veto():
    samples, fixes = data()
    t = fixes["t_ns"] * 1e-9 - 100.0
    fixes["height"][t >= 100.0] += 60.0
    out, rows, _ = navigate(samples, fixes)
    late = rows[rows["t_ns"] > 200 * 10**9]
    assert late["used"][late["kind"] < 2].all()  # north and east
    heights = late[late["kind"] == 2]
    assert not heights["used"][:5].any()
    assert heights["used"][15:].all()
    p = errors(D, out)[0]
    assert np.abs(p[at(100.0) :, :2]).max() < 5.0
    assert np.abs(p[at(120.0) :, 2] - 60.0).max() < 10.0
    assert out["status"][at(103.0)] & REJECTING
    assert not (out["status"][at(120.0) :] & REJECTING).any()


def test_an_outage_coasts_with_honest_sigmas():
    samples, fixes = data()
    t = fixes["t_ns"] * 1e-9 - 100.0
    for vehicle in ("free", "auto"):
        settings = Settings(navigation=Navigation(vehicle=vehicle))
        out, _, _ = navigate(samples, fixes[(t < 95.0) | (t > 155.0)], settings)
        p, _, _ = errors(D, out)
        end = at(154.9)
        assert out["status"][end] & COASTING
        assert out["status"][end] & POSITION_VALID
        assert not (out["status"][at(94.0)] & COASTING)
        assert (np.abs(p[end]) < 4.0 * out["sigma_p"][end]).all()
        assert out["sigma_p"][end, 0] > 1.5 * out["sigma_p"][at(95.0), 0]


def test_a_wrong_heading_from_the_user_is_found_out():
    samples, fixes = data()
    out, _, _ = navigate(samples, fixes, None, Initial(yaw_deg=-120.0))
    _, v, a = errors(D, out)
    assert np.abs(a[at(140.0) :, 2]).max() < np.radians(3.0)
    assert np.abs(v[at(140.0) :, :2]).max() < 0.5


def test_gaps_in_the_samples_widen_the_sigmas_and_pass():
    samples, fixes = data()
    keep = np.ones(len(samples), bool)
    keep[at(80.0) : at(82.0)] = False
    out, _, _ = navigate(samples[keep], fixes)
    clean = navigate(samples, fixes)[0]
    p = errors(D, clean)[0]
    after = at(80.0)
    assert (out["sigma_v"][after] > 5.0 * clean["sigma_v"][at(82.0)]).all()
    assert (np.abs(out["v"][after] - D.v[at(82.0)]) < 3.0 * out["sigma_v"][after]).all()
    finite(out)
    assert np.abs(out["lat"][-1] - D.lat[-1]) * 6.37e6 < np.abs(p[-1, 0]) + 3.0
    keep[at(80.0) : at(140.0)] = False
    finite(navigate(samples[keep], fixes)[0])


def test_invalid_samples_are_replaced_by_the_last_valid_one():
    samples, fixes = data()
    bad = samples.copy()
    bad["w"][at(50.0) : at(50.2)] = np.nan
    bad["f"][at(90.0) : at(90.3)] = 1e9
    bad["flags"][at(90.0) : at(90.3)] = SUSPECT
    out, _, _ = navigate(bad, fixes)
    finite(out)
    assert np.abs(errors(D, out)[1][-1]).max() < 0.5


@pytest.mark.parametrize(
    "w, f", [((0, 0, 0), (0, 0, 0)), ((0.1, 0.2, 0.3), (1, 2, -9)), ((30, -30, 30), (150, -150, 150))]
)
def test_constant_data_never_make_a_nan(w, f):
    n = 3000
    samples = samples_of(100.0 + np.arange(n) / RATE, np.tile(np.float64(w), (n, 1)), np.tile(np.float64(f), (n, 1)))
    t = 101.0 + np.arange(25)
    columns = {"t_s": t, "arrival_s": t + 0.2, "lat_deg": 45 + 0 * t, "lon_deg": 8 + 0 * t, "height_m": 50 + 0 * t}
    for fixes in (fixes_of(columns, 25), fixes_of({**columns, "speed_mps": 0 * t, "course_deg": 0 * t}, 25)):
        finite(navigate(samples, fixes)[0])
        finite(navigate(samples, fixes, None, Initial(yaw_deg=10.0, roll_deg=0.0, pitch_deg=0.0))[0])


@pytest.mark.parametrize("yaw_deg", [None, 20.0])
def test_an_hour_at_rest(yaw_deg):
    rng = np.random.default_rng(0)
    n = 3600 * 20
    w = 0.002 * rng.standard_normal((n, 3)) + (0.01, -0.01, 0.0)
    f = 0.01 * rng.standard_normal((n, 3)) + (0.1, 0.0, -9.81)
    t = 101.0 + np.arange(3590)
    columns = {
        "t_s": t, "arrival_s": t + 0.2, "lat_deg": 45 + 0 * t, "lon_deg": 8 + 0 * t, "height_m": 50 + 0 * t,
        "hdop": 1 + 0 * t, "speed_mps": 0.05 + 0 * t, "course_deg": 10 + 0 * t,
    }  # fmt: skip
    out, _, _ = navigate(
        samples_of(100.0 + np.arange(n) / 20, w, f), fixes_of(columns, len(t)), None, Initial(yaw_deg=yaw_deg)
    )
    finite(out)
    assert (out["status"][200:] & AT_REST).mean() > 0.99
    assert ((out["status"][-1] & HEADING_VALID) > 0) == (yaw_deg is not None)
    assert np.abs(out["bg"][-1] - (0.01, -0.01, 0.0)).max() < 2e-4
    assert np.abs(out["v"][-1]).max() < 0.15
    assert abs(np.degrees(out["lat"][-1]) - 45.0) * 111e3 < 3.0


@pytest.mark.parametrize("lat_deg", [89.9999, -89.9999, 90.0])
def test_at_the_poles_nothing_breaks(lat_deg):
    d = drive(60.0, lat_deg=np.clip(lat_deg, -89.9999, 89.9999))
    rng = np.random.default_rng(0)
    fixes = received(d, rng, late=0.2)
    if lat_deg == 90.0:
        fixes["lat"] = 0.5 * np.pi
    finite(navigate(sensed(d, rng), fixes)[0])


def test_across_the_date_line():
    d = drive(100.0, lat_deg=10.0, lon_deg=179.9999)
    assert np.degrees(d.lon.max()) > 180.0
    rng = np.random.default_rng(0)
    fixes = received(d, rng, late=0.2)
    fixes["lon"] = (fixes["lon"] + np.pi) % (2 * np.pi) - np.pi
    out, _, _ = navigate(sensed(d, rng), fixes)
    assert ((out["lon"][at(50.0) :] >= -np.pi) & (out["lon"][at(50.0) :] < np.pi)).all()
    p, v, _ = errors(d, out)
    assert np.abs(p[at(60.0) :, :2]).max() < 5.0
    assert np.abs(v[at(60.0) :, :2]).max() < 0.5


def test_lever_arm_is_taken_out():
    rng = np.random.default_rng(2)
    lever = np.array([1.0, -2.0, -1.5])
    fixes = at_antenna(D, received(D, rng, late=0.2, sigma=0.0, white=0.02), lever)
    fixes["sigma"], fixes["hdop"] = (0.02, 0.02, 0.04), np.nan
    samples = sensed(D, rng)
    set_ = Settings(navigation=Navigation(lever_arm_m=tuple(lever)))
    with_arm = errors(D, navigate(samples, fixes, set_)[0])[0][at(80.0) :]
    without = errors(D, navigate(samples, fixes, settings_of())[0])[0][at(80.0) :]
    assert np.sqrt(np.mean(with_arm**2)) < 0.15
    assert np.sqrt(np.mean(without**2)) > 1.0
