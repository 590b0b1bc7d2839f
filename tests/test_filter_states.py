"""What the filter estimates beside its solution: true within its sigma, consistent with the solution, and only that."""

import csv
import math

import numpy as np
import pytest
from attitude_simulation import Flaws, after, measure, simulate, wobble
from in_c import in_c
from navigation_runner import samples_of
from navigation_simulation import drive, received, sensed
from replay_in_process import new_filter
from scipy.spatial.transform import Rotation
from test_navigation_barometer import pressures
from test_navigation_odometer import readings

from imud.batch import NO_MEASUREMENT, play
from imud.compile.jit import interpreted
from imud.configuration.settings import Imu, Navigation, Settings
from imud.drivers.sample import MOUNTING_UNKNOWN, UNCONFIRMED_RATE
from imud.estimators.ahrs.solution import write_solution as write_attitude
from imud.estimators.filter_states import FILTER_STATES, OncePerPeriod, cells
from imud.estimators.ins.solution import write_solution as write_navigation
from imud.estimators.ins.state import STATES as ERROR_STATES
from imud.estimators.records import FIX, SOLUTION
from imud.filter_state_names import COVARIANCES, STATES
from imud.math.kalman import unpack
from imud.math.rotation import UNKNOWN_ANGLE
from imud.sensor_errors.mounting_error import set_covariance
from imud.tables.filter_states import FilterStates, write_states

MOUNT = Rotation.from_euler("ZYX", [20.0, -6.0, 0.0], degrees=True)  # of the vehicle in the body: yaw, pitch


def record(rows):
    """The one row, as kernels see it."""
    return rows.view(np.recarray)[0]


@pytest.fixture(scope="module")
def driven():
    """(filter, solutions, table's rows, columns by name) of a drive with wheels, a barometer and late fixes."""
    rng = np.random.default_rng(5)
    d = drive(240.0, arm=1.3)
    samples = sensed(d, rng, mount=MOUNT)
    fixes = received(d, rng, late=0.3, stamp=0.15, sigma=1.0, speed_sigma=0.05)
    rows = np.concatenate([readings(d, rng, scale=0.03), pressures(d, rng, offset=7.0, weather=0.0, scale=0.0)])
    return played(samples, fixes, rows[np.argsort(rows["arrival_ns"], kind="stable")])


def played(samples, fixes, measurements=NO_MEASUREMENT, settings=None):
    filter_, table, out = new_filter("navigation", samples, settings), FilterStates(), []
    play(
        filter_,
        samples.copy(),
        fixes,
        lambda block: out.append(block.copy()),
        aiding=measurements,
        each_second=lambda t_ns: table.take(filter_, t_ns),
    )
    return filter_, np.concatenate(out), table.rows


def matrix(row):
    full = np.zeros((9, 9))
    full[np.triu_indices(9)] = row["covariance"]
    return full + np.triu(full, 1).T


def test_what_was_simulated_is_found_within_its_sigma(driven):
    found = cells(driven[2][-1:])
    truth = {
        "time_offset_s": 0.15,
        "odometer_scale": 0.03,
        "baro_offset_m": 7.0,
        "mount_yaw_deg": 20.0,
        "mount_pitch_deg": -6.0,
        "nhc_lever_arm_m": 1.3,
    }
    most = dict(zip(truth, (0.05, 0.01, 3.0, 1.0, 1.0, 1.0), strict=True))
    for name, value in truth.items():
        sigma = found[f"s{name}"][0]
        assert 0.0 < sigma < most[name], name
        assert abs(found[name][0] - value) < 3.5 * sigma, name


def jacobian(q_nb):
    """Of roll, pitch and yaw by a small rotation in navigation axes: scipy's angles."""
    attitude = Rotation.from_quat(np.roll(q_nb, -1))
    step = 1e-6
    turned = [(Rotation.from_rotvec(step * axis) * attitude).as_euler("ZYX")[::-1] for axis in np.eye(3)]
    return (np.transpose(turned) - attitude.as_euler("ZYX")[::-1, None]) / step


def test_the_covariance_is_that_of_the_solution(driven):
    filter_, out, _ = driven
    newest, P = out[-1], matrix(filter_.filter_states()[0])
    assert np.sqrt(np.diag(P)[:3]) == pytest.approx(newest["sigma_p"], rel=1e-12)
    assert np.sqrt(np.diag(P)[3:6]) == pytest.approx(newest["sigma_v"], rel=1e-12)
    J = jacobian(newest["q_nb"])
    assert np.sqrt(np.diag(J @ P[6:, 6:] @ J.T)) == pytest.approx(newest["sigma_rpy"], rel=1e-4)
    assert np.linalg.eigvalsh(P).min() > 0.0
    whole = unpack(filter_.state["core"][0, 0]["cov"]["P"], ERROR_STATES)
    off_diagonal = ~np.eye(9, dtype=bool)
    assert (P[off_diagonal] == whole[:9, :9][off_diagonal]).all()


def test_the_attitude_filter_finds_its_sensors_errors_and_states_its_covariance():
    """On a body that rocks; the gyro's scale about its x axis is 1 % too large, the accelerometer's along z 0.5 %."""
    truth = simulate(300.0, 100.0, after(5.0, wobble(3, 0.9)), after(5.0, wobble(4, 0.3)))
    gyro_matrix = np.diag([0.01, 0.0, 0.0])
    flaws = Flaws(gyro_matrix=gyro_matrix, accel_scale=(0.0, 0.0, 0.005))
    w, f = measure(truth, flaws, np.random.default_rng(8))
    samples, out = samples_of(100.0 + truth.t, w, f), []
    settings = Settings(imu=Imu(profile="consumer-mems"))
    filter_ = new_filter("attitude", samples, settings)
    prior = filter_.state[0]["cov"]["P"].copy()
    play(filter_, samples, np.zeros(0, FIX), lambda block: out.append(block.copy()))
    rows, newest = filter_.filter_states(), out[-1][-1]
    found = cells(rows)
    for name, value in (("gyro_scale_xx", 0.01), ("accel_scale_z", 0.005), ("gyro_scale_yx", 0.0)):
        assert abs(found[name][0] - value) < 3.5 * found[f"s{name}"][0], name
    assert found["sgyro_scale_xx"][0] < 0.5 * math.sqrt(unpack(prior, 28)[12, 12])
    P, J = matrix(rows[0]), jacobian(newest["q_nb"])
    assert np.isnan(P[:6]).all()
    stated = np.diag(J @ P[6:, 6:] @ J.T)[:2]
    assert np.sqrt(stated) == pytest.approx(newest["sigma_rpy"][:2], rel=0.02)
    s = filter_.state[0]
    s["cov"]["unseen_tilt"], s["cov"]["unseen_yaw"] = 0.5, 0.3
    s["variance_factor"]["tilt_scale"] = 0.5, 0.8
    scales = np.outer([0.5, 0.8, 1.0], [0.5, 0.8, 1.0])
    block = scales * unpack(s["cov"]["P"], 28)[:3, :3] + np.diag([0.25, 0.25, 0.09])
    assert matrix(filter_.filter_states()[0])[6:, 6:] == pytest.approx(block, rel=1e-12)


@pytest.mark.parametrize("flag", [0, UNCONFIRMED_RATE])
def test_what_the_attitude_filter_adds_to_its_stated_sigmas_is_in_the_covariance(flag):
    """Also while the unit of the rates is not confirmed: then nothing is known of the attitude."""
    truth = simulate(10.0, 100.0, after(20.0, wobble(3, 0.9)))
    w, f = measure(truth, Flaws(), np.random.default_rng(8))
    samples = samples_of(100.0 + truth.t, w, f)
    filter_ = new_filter("attitude", samples, Settings(imu=Imu(profile="consumer-mems")))
    out = record(np.zeros(1, SOLUTION))
    filter_.run(samples, np.zeros(len(samples), SOLUTION))
    s = filter_.state[0]
    s["clipping"]["missing_angle"], s["hypotheses"]["possible_tilt_error"] = 0.1, 0.2
    s["attitude_step"]["possible_tilt_error"], s["motion"]["hidden_tilt"] = 0.3, 0.1
    s["stationarity"]["hidden_tilt"] = 0.2
    interpreted(write_attitude)(record(filter_.parameters), record(filter_.state), flag, out)
    P, J = matrix(filter_.filter_states()[0])[6:, 6:], jacobian(out.q_nb)
    assert np.sqrt(np.diag(J @ P @ J.T))[:2] == pytest.approx(out.sigma_rpy[:2], rel=0.05)
    assert out.sigma_rpy[0] == pytest.approx(UNKNOWN_ANGLE if flag else math.sqrt(0.19), rel=0.05)
    assert np.linalg.eigvalsh(P).min() > 0.0


def test_the_sigma_of_a_mounting_is_in_the_covariance(driven):
    filter_ = driven[0]
    plain = matrix(filter_.filter_states()[0])
    known, unknown = np.zeros((9, 9)), np.zeros((9, 9))
    unknown[[6, 7, 8], [6, 7, 8]] = math.pi**2
    body = np.diag([1e-4, 4e-5, 1e-5]) + 1e-5
    turn = Rotation.from_quat(np.roll(driven[1][-1]["q_nb"], -1)).as_matrix()
    known[6:, 6:] = turn @ body @ turn.T
    try:
        set_covariance(filter_.correction["mounting_error"], body)
        assert matrix(filter_.filter_states()[0]) == pytest.approx(plain + known, rel=0.001, abs=1e-9)
        filter_.correction["flags"] = MOUNTING_UNKNOWN
        assert matrix(filter_.filter_states()[0]) == pytest.approx(plain + unknown, rel=1e-12)
    finally:
        filter_.correction["mounting_error"], filter_.correction["flags"] = 0, 0


def test_what_likely_faults_add_to_a_stated_sigma_is_in_the_covariance(driven):
    filter_, _, _ = driven
    plain = matrix(filter_.filter_states()[0])
    state, p = filter_.state.copy(), filter_.parameters[0]
    core, solution = state["core"][0, 0], np.zeros(1, SOLUTION)
    for k, fault in enumerate(("gyro_bias_step", "velocity_drift", "compass_offset", "current"), 1):
        core[fault]["heading_variance"] += 1e-3 * k
    core["rest_gap"]["turn2"] += 5e-3
    core["integrity"]["position_inflation"][1] += 4.0
    in_c(write_navigation)(p, core, solution[0])
    stated = matrix(filter_.estimator.filter_states(state)[0])
    added = np.zeros((9, 9))
    added[1, 1], added[8, 8] = 4.0, 15e-3
    assert stated == pytest.approx(plain + added, rel=1e-12)
    assert solution["sigma_p"][0] ** 2 == pytest.approx(np.diag(stated)[:3])
    assert solution["sigma_rpy"][0, 2] ** 2 == pytest.approx(stated[8, 8], rel=0.01)


def test_a_source_that_is_not_there_has_no_column(driven):
    rng = np.random.default_rng(6)
    d = drive(60.0)
    fixes = received(d, rng)
    fixes["speed"] = fixes["course"] = np.nan
    at_sensor = Settings(navigation=Navigation(lever_arm_sigma_m=0.0))
    positions = cells(played(sensed(d, rng), fixes, settings=at_sensor)[2])
    names = set(positions) - set(COVARIANCES)
    assert {"time_offset_s", "stime_offset_s", "gnss_bias_n_m", "gnss_noise_vertical_m", "gyro_scale_zz"} <= names
    others = ("odometer", "baro", "age", "velocity_time", "gnss_velocity", "gnss_lever")
    assert not [name for name in names for other in others if name.removeprefix("s").startswith(other)]
    assert {"age_odometer_s", "odometer_scale", "baro_offset_m", "gnss_velocity_bias_n_mps"} <= set(cells(driven[2]))


def test_there_is_no_position_before_a_fix_and_nothing_before_a_sample():
    rng = np.random.default_rng(7)
    samples = sensed(drive(8.0), rng)
    filter_, _, rows = played(samples, np.zeros(0, FIX))
    assert not len(new_filter("navigation", samples).filter_states())
    assert not len(new_filter("attitude", samples).filter_states())
    tilt = new_filter("tilt", samples)
    play(tilt, samples.copy(), np.zeros(0, FIX), lambda _: None)
    assert not len(tilt.filter_states())
    assert np.isnan(matrix(rows[-1])[:6]).all() and np.isfinite(matrix(rows[-1])[6:, 6:]).all()
    assert filter_.filter_states()["t_ns"] == samples["t_ns"][-1]


def test_a_row_is_of_the_first_sample_of_each_second(driven):
    _, out, rows = driven
    assert rows["t_ns"].tolist() == [t for t in out["t_ns"].tolist() if t % 1_000_000_000 == 0]
    period = OncePerPeriod(10)
    assert [t for t in (3, 9, 10, 12, 19, 40, 41) if period.is_due(t)] == [3, 10, 40]


def test_the_table_has_what_was_estimated_at_any_time(tmp_path):
    rows = np.zeros(2, FILTER_STATES)
    rows["t_ns"], rows["value"], rows["sigma"] = (1_500_000_000, 2_000_000_001), np.nan, np.nan
    rows["covariance"][:, 0] = 4.0, np.nan
    mounted = next(i for i, state in enumerate(STATES) if state.name == "mount_yaw")
    rows["value"][1, mounted], rows["sigma"][1, mounted] = math.radians(30.0), math.radians(2.0)
    write_states(tmp_path / "states.csv", 100, rows)
    with (tmp_path / "states.csv").open() as file:
        first, second = csv.DictReader(file)
    assert list(first) == ["t_s", *COVARIANCES, "mount_yaw_deg", "smount_yaw_deg"]
    assert (first["t_s"], first["cov_pn_pn"], first["mount_yaw_deg"]) == ("101.500000000", "4", "")
    assert (second["t_s"], second["cov_pn_pn"], second["cov_pn_pe"]) == ("102.000000001", "", "0")
    assert (second["mount_yaw_deg"], second["smount_yaw_deg"]) == ("30", "2")
