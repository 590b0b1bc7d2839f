"""The lever arm of the antenna as error states: found where the vehicle turns, and never surer than it may be."""

from types import SimpleNamespace

import numpy as np
import pytest
from in_c import in_c
from navigation_runner import fixes_of, navigate
from navigation_simulation import at_antenna, drive, errors, received, sensed, walk
from replay_in_process import new_filter, replay
from scipy.spatial.transform import Rotation

from imud.compile.jit import interpreted
from imud.configuration.settings import Imu, Initial, Navigation, Settings
from imud.daemon.status_reporter import StatusReporter
from imud.daemon.utc import Utc
from imud.estimators.ins.aiding.lever_arm_prior import odds_of_mistake, set_gnss_lever_arm, weigh_lever_arm
from imud.estimators.ins.ekf import inflate
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import ATTITUDE, GNSS_LEVER_ARM, LEVER_ARM_FAULT, NAVIGATING, POSITION, STATES
from imud.estimators.ins.velocity_epoch import find_velocity_epoch
from imud.math.kalman import packed_index, unpack
from imud.process.contained import ContainedErrors
from imud.sensor_errors.profiles import PROFILES
from imud.sensors.gnss import is_precise

SIGMA = 0.7  # m
TRUE = np.array([1.0, -0.5, -1.4])


def run(seed, survey, sigma=SIGMA, mistake=None, given=None, late=0.2):
    """(error and covariance of the lever arm, errors of position, velocity and attitude, their sigmas) of a drive."""
    profile, rng = PROFILES["consumer-mems"], np.random.default_rng(seed)
    d = drive(120.0, speed=float(rng.uniform(4.0, 15.0)))
    bg = profile.gyro_bias_initial * rng.standard_normal(3)
    ba = profile.accel_bias_initial * rng.standard_normal(3)
    samples = sensed(d, rng, profile.gyro_noise, profile.accel_noise, bg, ba)
    fixes = received(d, rng, late=late, sigma=0.0, white=0.02) if survey else received(d, rng, late=late)
    fixes = at_antenna(d, fixes, TRUE)
    fixes["speed"] += 0.05 * rng.standard_normal(len(fixes))
    if survey:
        fixes["sigma"], fixes["hdop"] = (0.02, 0.02, 0.04), np.nan
    if given is None:
        given = TRUE + (SIGMA * rng.standard_normal(3) if mistake is None else mistake)
    arm = {"lever_arm_m": given if isinstance(given, str) else tuple(map(float, given)), "lever_arm_sigma_m": sigma}
    out, _, state = navigate(samples, fixes, Settings(imu=Imu(profile="consumer-mems"), navigation=Navigation(**arm)))
    c = state["core"][0, 0]
    P = unpack(c["cov"]["P"], STATES)[GNSS_LEVER_ARM:, GNSS_LEVER_ARM:]
    k = np.arange(6000, len(d.t), 100)
    of = [e[k] for e in errors(d, out)]
    return TRUE - c["nav"]["gnss_lever_arm"], P, of, [out[name][k] for name in ("sigma_p", "sigma_v", "sigma_rpy")]


def nees(runs):
    """Mean squared error over variance, per axis: of the lever arm, position, velocity and attitude."""
    arm = np.mean([e @ np.linalg.solve(P, e) / 3.0 for e, P, _, _ in runs])
    return [arm, *(np.mean([(of[i] / sigmas[i]) ** 2 for _, _, of, sigmas in runs]) for i in range(3))]


@pytest.mark.thorough
@pytest.mark.parametrize("survey", [True, False], ids=["survey", "receiver"])
def test_the_errors_are_as_large_as_their_sigmas_say(survey):
    runs = [run(seed, survey) for seed in range(12)]
    arm, p, v, a = nees(runs)
    assert 0.2 < arm < 2.0
    assert 0.2 < p < 2.0
    assert 0.1 < v < 2.0
    assert 0.1 < a < 2.0  # as with an exact lever arm: scale factor errors are allowed for, and there are none here
    level = np.sqrt(np.mean([e[:2] ** 2 for e, _, _, _ in runs]))
    assert level < 0.1 * SIGMA


def test_a_wrong_lever_arm_does_not_turn_the_heading():
    """Of a survey by a metre: taken as exact it is an error of the attitude, as states it is none."""
    wrong = np.array([0.0, 1.0, 0.0])
    exact, estimated = (run(3, True, sigma, wrong)[2] for sigma in (0.0, SIGMA))
    yaw = [np.degrees(np.sqrt(np.mean(of[2][:, 2] ** 2))) for of in (exact, estimated)]
    level = [np.sqrt(np.mean(of[0][:, :2] ** 2)) for of in (exact, estimated)]
    assert level[0] > 0.5
    assert level[1] < 0.1
    assert yaw[1] < 0.7 < yaw[0]


@pytest.mark.thorough
@pytest.mark.parametrize("stamp", [0.0, 0.03], ids=["exact", "30 ms late"])
def test_walks_with_an_antenna_away_from_the_hand(stamp):
    """An error of the time stamp displaces the antenna, which swings about the hand, not the sensor alone."""
    arm, squares = np.array([0.6, -0.3, -0.7]), []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        d = walk(120.0, rng)
        samples = sensed(d, rng, bg=0.005 * rng.standard_normal(3), ba=0.1 * rng.standard_normal(3))
        fixes = received(d, rng, every=0.1, late=0.2, stamp=stamp)
        fixes = at_antenna(d, fixes, arm, 0.05 * rng.standard_normal((len(fixes), 3)))
        settings = Settings(imu=Imu(profile="consumer-mems"), navigation=Navigation(lever_arm_m=tuple(arm)))
        out, _, _ = navigate(samples, fixes, settings)
        k = np.arange(6000, len(d.t), 100)
        squares.append(np.mean((errors(d, out)[2][k] / out["sigma_rpy"][k]) ** 2, axis=0))
    assert np.max(squares) < 4.0
    assert np.mean(squares) < 2.0


def test_without_a_sigma_it_stays_as_given():
    error, P, _, _ = run(5, True, 0.0, np.array([0.3, 0.2, -0.1]))
    assert error == pytest.approx([-0.3, -0.2, 0.1], abs=1e-12)
    assert not P.any()


def test_one_that_is_not_set_is_estimated_from_positions_of_centimetres():
    runs = [run(seed, True, "auto", given="auto") for seed in range(4)]
    assert np.sqrt(np.mean([e[:2] ** 2 for e, _, _, _ in runs])) < 0.1
    for e, P, of, sigmas in runs:
        assert (np.abs(e) < 3.0 * np.sqrt(np.diag(P))).all()
        assert (np.abs(of[2][:, 2]) < 4.0 * sigmas[2][:, 2]).all()


def test_one_that_is_not_set_is_estimated_from_positions_of_metres():
    """Taken as zero, its velocity in turns is an error of the velocity."""
    estimated, zero = ([run(seed, False, sigma, given="auto") for seed in range(4)] for sigma in ("auto", 0.0))
    assert np.sqrt(np.mean([e[:2] ** 2 for e, _, _, _ in estimated])) < 0.2
    for e, P, _, _ in estimated:
        assert (np.abs(e) < 3.0 * np.sqrt(np.diag(P))).all()
    velocity = [np.sqrt(np.mean([of[1][:, :2] ** 2 for _, _, of, _ in runs])) for runs in (estimated, zero)]
    assert velocity[0] < 0.5 * velocity[1]


@pytest.mark.parametrize(
    "given", [TRUE + np.array([0.3, 0.2, -0.1]), np.zeros(3)], ids=["0.4 m wrong", "at the sensor"]
)
def test_a_given_one_is_exact_for_a_survey(given):
    """Also [0, 0, 0], which says that the antenna is at the sensor."""
    d = drive(60.0)
    rng = np.random.default_rng(5)
    samples, fixes = sensed(d, rng), at_antenna(d, received(d, rng, sigma=0.0, white=0.02), given)
    fixes["sigma"], fixes["hdop"] = (0.02, 0.02, 0.04), np.nan
    c = navigate(samples, fixes, Settings(navigation=Navigation(lever_arm_m=tuple(given))))[2]["core"][0, 0]
    assert c["nav"]["gnss_lever_arm"] == pytest.approx(given, abs=1e-12)
    assert not unpack(c["cov"]["P"], STATES)[GNSS_LEVER_ARM:, GNSS_LEVER_ARM:].any()


def test_a_given_one_that_is_wrong_by_a_metre_is_found_by_positions_of_metres():
    runs = [run(seed, False, "auto", mistake=np.array([0.0, 1.0, 0.0])) for seed in range(4)]
    assert np.abs([e[1] for e, _, _, _ in runs]).max() < 0.3
    assert all((np.abs(of[2][:, 2]) < 4.0 * sigmas[2][:, 2]).all() for _, _, of, sigmas in runs)


@pytest.mark.parametrize("mistake", [(0.0, 1.0, 0.0), (-1.2, 0.0, 0.0)])
@pytest.mark.parametrize("late", [0.0, 0.2], ids=["survey", "receiver"])
def test_a_given_one_that_is_wrong_by_a_metre_is_found_by_positions_of_centimetres(mistake, late):
    """By the GLR test or by the odds, and estimated from there on; without, the position is wrong by the metre."""
    for seed in range(3):
        error, P, of, sigmas = run(seed, True, "auto", mistake=np.array(mistake), late=late)
        assert np.abs(error[:2]).max() < 0.3
        assert (np.abs(error) < 4.0 * np.sqrt(np.diag(P))).all()
        assert np.sqrt(np.mean(of[0][-20:, :2] ** 2)) < 0.3
        assert (np.abs(of[2][-20:, 2]) < 4.0 * sigmas[2][-20:, 2]).all()


def test_a_given_one_that_is_wrong_by_six_metres_is_found_by_a_survey():
    """As of 3 m with the wrong sign."""
    for seed in range(2):
        error, _, of, sigmas = run(seed, True, "auto", mistake=np.array([0.0, 6.0, 0.0]), late=0.0)
        assert np.abs(error[:2]).max() < 0.5
        assert (np.abs(of[2][-20:, 2]) < 4.0 * sigmas[2][-20:, 2]).all()


def test_one_that_is_wrong_by_decimetres_is_found_by_a_receiver_of_centimetres():
    """Before, the position was off by them, at a stated centimetre or two."""
    runs = [run(seed, True, "auto", mistake=np.array([0.25, -0.3, 0.1])) for seed in range(4)]
    _, p, _, a = nees(runs)
    assert p < 2.0
    assert a < 2.0
    assert np.sqrt(np.mean([e[:2] ** 2 for e, _, _, _ in runs])) < 0.05


def test_one_that_is_right_stays_as_given():
    """And its sigma is the ruler's at most, as that of the position."""
    for seed in range(4):
        error, P, _, sigmas = run(seed, True, "auto", mistake=np.zeros(3))
        assert np.abs(error).max() < 0.05
        assert (np.sqrt(np.diag(P)) <= 0.03 + 1e-9).all()
        assert np.median(sigmas[0][-20:, :2]) < 0.06


def test_before_a_turn_the_sigma_says_that_the_lever_arm_may_be_wrong():
    """At rest nothing shows an error of it."""
    parked = drive(60.0, rest=1e3)
    samples, fixes = (
        sensed(parked, np.random.default_rng(1)),
        received(parked, np.random.default_rng(2), late=0.2, sigma=0.0, white=0.01),
    )
    fixes["sigma"], fixes["hdop"] = (0.01, 0.01, 0.02), np.nan
    out = navigate(samples, fixes, Settings(navigation=Navigation(lever_arm_m=(0.0, 0.0, 0.0))), Initial(yaw_deg=0.0))[
        0
    ]
    share = 0.5 * (0.2**2 - 0.03**2) + 0.03**2
    assert out["sigma_p"][-1, :2] == pytest.approx(np.sqrt(share), rel=0.1)


def test_the_odds_are_those_of_two_filters():
    """Against the likelihoods of n readings of a constant whose prior has one sigma or the other."""
    rng, ruler, wide, noise = np.random.default_rng(8), 0.03, 0.2, 0.1
    p = configure(Settings(), 100.0)[0].view(np.recarray)
    rho2 = 1.0 / (1.0 / ruler**2 - 1.0 / wide**2)
    for n, true in ((1, 0.0), (30, 0.0), (30, 0.1), (10, -0.2)):
        y = true + noise * rng.standard_normal(n)
        likelihoods = []
        for prior in (wide, ruler):
            S = prior**2 * np.ones((n, n)) + noise**2 * np.eye(n)
            likelihoods.append(-0.5 * (y @ np.linalg.solve(S, y) + np.linalg.slogdet(S)[1]))
        P = 1.0 / (1.0 / ruler**2 + n / noise**2)
        odds = interpreted(odds_of_mistake)(p, rho2, -P * y.sum() / noise**2, rho2 - P)
        assert np.log(odds) == pytest.approx(likelihoods[0] - likelihoods[1], abs=1e-9)


@pytest.mark.parametrize(("odds", "is_wrong"), [(19.0, False), (21.0, True)])
def test_odds_of_twenty_give_a_component_its_larger_prior(odds, is_wrong):
    """Then its variance is that of a filter which began with it."""
    p = configure(Settings(navigation=Navigation(lever_arm_m=(0.0, 0.0, 0.0))), 100.0)[0]
    c = start(configure(Settings(), 100.0), Initial())[0]["core"][0]
    c["alignment"]["mode"], c["gnss"]["lever_arm_is_measured"] = NAVIGATING, (0, 1, 0)
    ruler2, wide2, information = 0.03**2, 0.2**2, 1.0 / 0.05**2
    rho2, known = 1.0 / (1.0 / ruler2 - 1.0 / wide2), 1.0 / (1.0 / ruler2 + information)
    s = rho2 - known
    z = np.sqrt(2.0 * s * np.log(odds * np.sqrt(s * (wide2 + rho2)) / rho2))
    right = interpreted(packed_index)(STATES, GNSS_LEVER_ARM + 1, GNSS_LEVER_ARM + 1)
    c["nav"]["gnss_lever_arm"][1], c["cov"]["P"][right] = z, known
    assert in_c(weigh_lever_arm)(p, c) == is_wrong
    assert c["cov"]["P"][right] == pytest.approx(1.0 / (1.0 / wide2 + information) if is_wrong else known)
    assert c["gnss"]["lever_arm_is_measured"][1] == (not is_wrong)


def test_a_component_gets_its_larger_prior_also_after_an_outage_has_inflated_the_covariance():
    """No variance is negative then: what its prior is taken back from must not have grown beyond it."""
    p = configure(Settings(navigation=Navigation(lever_arm_m=(0.0, 0.0, 0.0))), 100.0)[0]
    c = start(configure(Settings(), 100.0), Initial())[0]["core"][0]
    c["alignment"]["mode"], c["gnss"]["lever_arm_is_measured"] = NAVIGATING, (0, 1, 0)
    P, right = np.diag(np.full(STATES, 0.1)), GNSS_LEVER_ARM + 1
    P[right, right] = 0.025**2
    P[POSITION, right] = P[right, POSITION] = 0.5 * np.sqrt(0.1) * 0.025
    c["cov"]["P"], c["nav"]["gnss_lever_arm"][1] = P[np.triu_indices(STATES)], 0.3
    in_c(inflate)(c, 25.0)
    assert in_c(weigh_lever_arm)(p, c)
    P = unpack(c["cov"]["P"], STATES)
    rho2 = 1.0 / (1.0 / 0.03**2 - 1.0 / 0.2**2)
    assert P[right, right] == pytest.approx(1.0 / (1.0 / 0.025**2 - 1.0 / rho2))
    assert P[POSITION, POSITION] > 2.5
    assert np.linalg.eigvalsh(P)[0] > 0.0


def test_a_component_that_another_fault_has_opened_keeps_its_variance():
    p = configure(Settings(navigation=Navigation(lever_arm_m=(0.0, 0.0, 0.0))), 100.0)[0]
    c = start(configure(Settings(), 100.0), Initial())[0]["core"][0]
    c["alignment"]["mode"], c["gnss"]["lever_arm_is_measured"] = NAVIGATING, (0, 1, 0)
    right = interpreted(packed_index)(STATES, GNSS_LEVER_ARM + 1, GNSS_LEVER_ARM + 1)
    c["cov"]["P"][right], c["nav"]["gnss_lever_arm"][1] = 0.05**2, 0.3
    assert not in_c(weigh_lever_arm)(p, c)
    assert c["cov"]["P"][right] == 0.05**2
    assert c["gnss"]["lever_arm_is_measured"][1] == 0


@pytest.mark.parametrize(("mistake", "is_looked_for"), [(0.0, False), (1.0, True)])
@pytest.mark.parametrize(("late", "least"), [(0.0, "min_lever_arm_error"), (0.1, "lever_arm_odds")])
def test_smoothing_looks_for_an_error_only_where_the_forward_run_has_found_one(mistake, is_looked_for, late, least):
    rng, d = np.random.default_rng(4), drive(60.0)
    samples, fixes = sensed(d, rng), at_antenna(d, received(d, rng, every=0.2, late=late, sigma=0.0, white=0.02), TRUE)
    fixes["sigma"], fixes["hdop"] = (0.02, 0.02, 0.04), np.nan
    given = Settings(navigation=Navigation(lever_arm_m=(1.0, -0.5 + mistake, -1.4)))
    filter_ = new_filter("navigation", samples, given)
    out = replay(filter_, samples, fixes)[0]
    tuning = filter_.estimator.backward_tuning(filter_.parameters[0], filter_.state, out[-1], 5.0)
    assert (least not in tuning) == is_looked_for


def test_what_an_error_does_is_predicted():
    """Against the difference of two runs, one with a lever arm that is given wrong by a tenth of a millimetre."""
    rng, d, off = np.random.default_rng(4), drive(60.0), 1e-4
    samples, fixes = sensed(d, rng), at_antenna(d, received(d, rng, every=0.2, sigma=0.0, white=0.02), TRUE)
    fixes["sigma"], fixes["hdop"] = (0.02, 0.02, 0.04), np.nan
    for j in range(2):
        cores = []
        for wrong in (0.0, off):
            given = Navigation(
                lever_arm_m=tuple(TRUE - wrong * np.eye(3)[j]), tuning={"epoch_mistake_s": 0.0}
            )  # of a survey whose epochs are never confirmed, which would be a step
            filter_ = new_filter("navigation", samples, Settings(navigation=given))
            replay(filter_, samples, fixes)
            cores.append(filter_.state["core"][0, 0])
        V = cores[0]["faults"]["sensitivity"][:, LEVER_ARM_FAULT + j]
        turned = 2.0 * (cores[1]["nav"]["q_nb"] - cores[0]["nav"]["q_nb"])[3] / cores[0]["nav"]["q_nb"][0] / off
        moved = (cores[1]["nav"]["lat"] - cores[0]["nav"]["lat"]) * 6.38e6 / off
        assert V[POSITION] == pytest.approx(moved, abs=0.1)
        assert V[ATTITUDE + 2] == pytest.approx(turned, abs=0.02)
        assert max(abs(moved), abs(turned)) > 0.1


@pytest.mark.parametrize(("mistake", "expected"), [(1.0, 1), (0.1, 0)])
def test_a_finding_names_a_lever_arm_that_the_fixes_contradict(mistake, expected):
    rng, d = np.random.default_rng(3), drive(120.0)
    samples, fixes = sensed(d, rng), at_antenna(d, received(d, rng, late=0.2), TRUE)
    settings = Settings(navigation=Navigation(lever_arm_m=tuple(map(float, TRUE + np.array([0.0, mistake, 0.0])))))
    filter_ = new_filter("navigation", samples, settings)
    assert filter_.findings() == ()
    replay(filter_, samples, fixes)
    assert sum("navigation.lever_arm_m" in text for text in filter_.findings()) == expected


def test_the_daemon_warns_once_of_one_that_is_estimated_because_it_is_not_set():
    rng, warnings = np.random.default_rng(1), []
    d = drive(60.0)
    samples, fixes = sensed(d, rng), received(d, rng, late=0.2, sigma=0.0, white=0.02)
    at_sensor = (0.0, 0.0, 0.0)
    cases = ((0.02, {}, 1), (2.0, {}, 0), (0.02, {"lever_arm_sigma_m": 0.0}, 0), (0.02, {"lever_arm_m": at_sensor}, 0))
    for sigma, given, expected in cases:
        fixes["sigma"] = sigma
        filter_ = new_filter("navigation", samples, Settings(navigation=Navigation(**given)))
        replay(filter_, samples, fixes)
        inertial = SimpleNamespace(pipeline=SimpleNamespace(filter=filter_))
        used = SimpleNamespace(gnss=SimpleNamespace(sensor=SimpleNamespace(is_precise=is_precise(fixes[-1]))))
        devices = SimpleNamespace(selection=SimpleNamespace(inertial=inertial), in_use=used)
        reporter = StatusReporter(devices, ContainedErrors(), Utc())
        reporter._log = SimpleNamespace(warning=warnings.append)
        for second in range(3):
            reporter._warn_if_lever_arm_is_unset(second * 10**9)
        assert len(warnings) == expected
        assert all("navigation.lever_arm_m" in text for text in warnings)
        warnings.clear()


def test_a_changed_setting_begins_anew():
    def parameters(arm, sigma):
        return configure(Settings(navigation=Navigation(lever_arm_m=arm, lever_arm_sigma_m=sigma)), 100.0)[0]

    settings = [((1.0, 2.0, 3.0), 0.5), ((1.0, 2.0, -3.0), 0.5), ((1.0, 2.0, -3.0), 0.2)]
    c, fix = (
        start(configure(Settings(), 100.0), Initial())[0]["core"][0],
        fixes_of({"t_s": [0.0]}, 1)[0],
    )
    for arm, sigma in settings:
        in_c(set_gnss_lever_arm)(parameters(arm, sigma), c, fix)
        assert tuple(c["nav"]["gnss_lever_arm"]) == arm
        variances = [c["cov"]["P"][interpreted(packed_index)(STATES, i, i)] for i in range(GNSS_LEVER_ARM, STATES)]
        assert variances == pytest.approx([sigma**2] * 3)
        c["nav"]["gnss_lever_arm"] += 0.1  # found by the filter: kept
        in_c(set_gnss_lever_arm)(parameters(arm, sigma), c, fix)
        assert tuple(c["nav"]["gnss_lever_arm"]) == pytest.approx(np.add(arm, 0.1))


def test_the_lever_arm_moves_the_antenna_as_the_body_turned_when_the_velocity_was_true():
    """A body that swings turns otherwise by the time at which the fix is fused: against C [w x] of a swing."""
    p = configure(Settings(), 100.0)[0]
    s = start(configure(Settings(), 100.0), Initial(lat_deg=50.0, lon_deg=8.0, yaw_deg=10.0))[0]
    c, snapshots = s["core"][0], s["snapshots"]
    t, lag, frequency = 0.05 * np.arange(41), 0.15, 2.0 * np.pi * 0.5
    rate, angle = 2.0 * np.cos(frequency * t), 2.0 / frequency * np.sin(frequency * t)  # about the vertical
    rows = [(snapshots[i], k) for i, k in enumerate(range(40))] + [(c, 40)]
    for row, k in rows:
        row["nav"]["t_ns"], row["alignment"]["mode"] = round(1e9 * t[k]), NAVIGATING
        row["imu"]["w"], row["nav"]["bg"] = (0.0, 0.0, rate[k]), 0.0
        row["nav"]["q_nb"] = np.cos(angle[k] / 2.0), 0.0, 0.0, np.sin(angle[k] / 2.0)
    c["nav"]["velocity_time_offset"] = 0.0
    in_c(find_velocity_epoch)(p, s, 40, lag)
    k = 37  # 0.15 s before
    expected = Rotation.from_rotvec([0.0, 0.0, angle[k]]).as_matrix() @ [[0, -rate[k], 0], [rate[k], 0, 0], [0, 0, 0]]
    assert c["scratch"]["velocity_epoch"]["by_lever_arm"] == pytest.approx(expected, abs=0.02)
    now = Rotation.from_rotvec([0.0, 0.0, angle[40]]).as_matrix() @ [[0, -rate[40], 0], [rate[40], 0, 0], [0, 0, 0]]
    assert np.abs(now - expected).max() > 0.2


def test_the_finding_of_a_lever_arm_that_is_not_set_does_not_say_that_it_is():
    rng, d = np.random.default_rng(3), drive(120.0)
    samples = sensed(d, rng)
    fixes = at_antenna(d, received(d, rng, late=0.2), TRUE + np.array([0.0, 2.0, 0.0]))
    filter_ = new_filter("navigation", samples, Settings())
    replay(filter_, samples, fixes)
    (text,) = filter_.findings()
    assert "away from the sensor, and navigation.lever_arm_m is not set" in text
