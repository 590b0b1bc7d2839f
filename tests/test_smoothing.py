"""Smoothing: time reversal against the simulated truth, averages against closed forms, and what it gives to users."""

import csv
import dataclasses
import gc
import itertools
import math
import warnings

import accuracy_simulated
import numpy as np
import pytest
from attitude_simulation import DEG, Flaws, measure, simulate, wobble
from emulated_recording import record
from navigation_runner import settings_of
from navigation_simulation import Drive, drive, errors, received, sensed
from replay_in_process import new_filter, replay, smoothed_solutions
from scipy.spatial.transform import Rotation

import imud
from imud.commands import main
from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.drivers.sample import POWER_ON, SAMPLE
from imud.estimators import registry
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.setup import backward_fixes, start
from imud.estimators.ins.state import EXACT_EPOCHS, STATES, TIME_OFFSET
from imud.estimators.records import FIX, HEADING_VALID, MEASUREMENT, NEW_RECEIVER, POSITION_VALID, SOLUTION
from imud.firmware_sim.motion import Trajectory
from imud.firmware_sim.scenarios import SCENARIOS
from imud.math.kalman import packed_index
from imud.pipeline import Filter
from imud.smoothing.average import average, combined
from imud.smoothing.reversal import reversed_fixes, reversed_measurements, reversed_samples
from imud.smoothing.two_filter import WIDER, _backward_filter

IMU_COLUMNS = ("gx_radps", "gy_radps", "gz_radps", "ax_mps2", "ay_mps2", "az_mps2")
DARK = (120.0, 160.0)  # s, without fixes


@pytest.fixture(scope="module")
def driven():
    return drive(220.0, speed=12.0)


def truth_of(d):
    """SOLUTION rows of the truth, all valid."""
    rows = np.zeros(len(d.t), SOLUTION)
    rows["lat"], rows["lon"], rows["height"], rows["v"] = d.lat, d.lon, d.height, d.v
    rows["q_nb"] = np.roll(d.attitude.as_quat(), 1, axis=1)
    rows["status"] = 15
    return rows


def table_of(samples, fixes):
    """As the library takes them."""
    sigmas = {f"s{axis}_m": fixes["sigma"][:, i] for i, axis in enumerate("ned")}
    columns = {"t_s": fixes["t_ns"] * 1e-9, "lat_deg": np.degrees(fixes["lat"]), "lon_deg": np.degrees(fixes["lon"])}
    columns |= {"height_m": fixes["height"], "hdop": fixes["hdop"], "speed_mps": fixes["speed"], **sigmas}
    columns["course_deg"] = np.degrees(fixes["course"])
    return (samples["t_ns"] * 1e-9, samples["w"], samples["f"]), columns


def test_dead_reckoning_runs_backward_along_the_same_way(driven):
    """Ideal sensors, no fixes: what remains are sampling errors. Without its corrections the earth makes it 100 m."""
    samples = sensed(driven, np.random.default_rng(1), gyro_psd=0.0, accel_psd=0.0)
    turned = np.concatenate(list(reversed_samples(samples, truth_of(driven), False)))
    assert np.all(np.diff(turned["t_ns"]) > 0) and turned["t_ns"][0] == 0
    end = truth_of(driven)[-1]
    yaw, pitch, roll = driven.attitude[-1].as_euler("ZYX", degrees=True).tolist()
    vn, ve, vd = (-end["v"]).tolist()
    lat, lon, height = math.degrees(end["lat"]), math.degrees(end["lon"]), float(end["height"])
    filter_ = Filter(
        registry.by_name("navigation"), Settings(), Initial(lat, lon, height, vn, ve, vd, roll, pitch, yaw), 100.0
    )
    out = np.zeros(6000, SOLUTION)
    filter_.run(turned[:6000], out)
    last = Drive(*(getattr(driven, field.name)[-6000:] for field in dataclasses.fields(Drive)))
    p, _, attitude = errors(last, out[::-1])
    assert np.abs(p[:, :2]).max() < 3.0
    assert np.degrees(np.abs(attitude)).max() < 0.05


def _backward_view(rows):
    rows = rows.copy()
    rows["v"] = -rows["v"]
    return rows


def test_fixes_and_measurements_are_turned_round():
    fixes = np.zeros(2, FIX)
    fixes["t_ns"], fixes["arrival_ns"], fixes["course"] = (1_000_000_000, 2_000_000_000), 2_050_000_000, (0.5, 4.0)
    fixes["v"] = (1.0, 2.0, 3.0)
    turned = reversed_fixes(fixes, 10_000_000_000, 0.25)
    assert turned["t_ns"].tolist() == [8_250_000_000, 9_250_000_000]
    assert turned["arrival_ns"].tolist() == [8_300_000_000, 9_450_000_000]  # as late as they were, but 0.2 s at most
    assert turned["course"] == pytest.approx([4.0 - math.pi, 0.5 + math.pi])
    assert turned["v"].tolist() == [[-1.0, -2.0, -3.0]] * 2
    sources = registry.by_name("navigation").sources
    rows = np.zeros(len(sources), MEASUREMENT)
    rows["kind"], rows["value"] = [source.kind for source in sources], 2.0
    turned = reversed_measurements(rows, sources, 0)
    signs = dict(zip(turned["kind"].tolist(), turned["value"][:, 0].tolist(), strict=True))
    assert {source.name: signs[source.kind] for source in sources}["odometer"] == -2.0
    assert {source.name: signs[source.kind] for source in sources}["heading"] == 2.0


def test_an_interruption_is_marked_on_its_other_side():
    samples = np.zeros(6, SAMPLE)
    samples["t_ns"], samples["flags"][4] = np.arange(6), POWER_ON
    (turned,) = reversed_samples(samples, np.zeros(6, SOLUTION), False)
    assert turned["flags"].tolist() == [0, 0, POWER_ON, 0, 0, 0]  # on sample 3: the last one before it


def test_another_receiver_is_marked_on_its_other_side():
    fixes = np.zeros(5, FIX)
    fixes["t_ns"] = fixes["arrival_ns"] = np.arange(5)
    fixes["flags"][[0, 3]] = NEW_RECEIVER
    turned = reversed_fixes(fixes, 4, 0.0)
    assert turned["flags"].tolist() == [0, 0, NEW_RECEIVER, 0, 0]  # on fix 2: the last one of the receiver before it


def test_on_the_date_line_the_mean_is_a_longitude(driven):
    forward = truth_of(driven)[:2]
    forward["sigma_rpy"] = forward["sigma_p"] = forward["sigma_v"] = 0.1
    backward = _backward_view(forward)
    forward["lon"], backward["lon"] = math.radians(179.99999), math.radians(-179.99997)
    assert np.degrees(combined(forward, backward)["lon"]) == pytest.approx([-179.99999] * 2, abs=1e-9)


def test_a_reading_of_an_interval_goes_with_its_other_end():
    samples = np.zeros(4, SAMPLE)
    samples["t_ns"], samples["w"][:, 0] = np.arange(4), np.arange(4)
    (turned,) = reversed_samples(samples, np.zeros(4, SOLUTION), True)
    assert turned["t_ns"].tolist() == [0, 1, 2, 3]
    assert turned["w"][:, 0].tolist() == [-3.0, -3.0, -2.0, -1.0]


def test_averages_are_those_of_two_gaussians():
    a, b, sa, sb = 1.0, 1.5, 0.5, 1.0
    x = np.linspace(-8.0, 8.0, 200_001)
    density = np.exp(-0.5 * ((x - a) / sa) ** 2 - 0.5 * ((x - b) / sb) ** 2)
    mean = np.sum(x * density) / np.sum(density)
    spread = np.sqrt(np.sum((x - mean) ** 2 * density) / np.sum(density))
    found = average(*(np.array([number]) for number in (a, b, sa, sb)))
    assert (found[0][0], found[1][0]) == pytest.approx((mean, spread))


def test_what_one_of_them_does_not_know_is_the_others():
    nan = math.nan
    mean, sigma, weight = average(*map(np.array, ([nan, 1.0, nan], [2.0, nan, nan], [1.0, 0.5, 1.0], [0.1, 0.1, nan])))
    assert mean[:2].tolist() == [2.0, 1.0] and sigma[:2].tolist() == [0.1, 0.5] and weight[:2].tolist() == [1.0, 0.0]
    assert np.isnan(mean[2])


def test_two_that_contradict_each_other_are_doubted():
    _, sigma, _ = average(np.zeros(1), np.array([20.0]), np.ones(1), np.ones(1))
    assert sigma[0] == pytest.approx(math.sqrt(0.5) * 20.0 / math.sqrt(2.0) / 2.0)


def test_rotations_are_averaged_along_the_shorter_way(driven):
    forward = truth_of(driven)[:3]
    forward["sigma_rpy"] = forward["sigma_p"] = forward["sigma_v"] = 0.1
    backward = _backward_view(forward)
    backward["q_nb"] = -backward["q_nb"]  # the same rotation
    out = combined(forward, backward)
    assert np.abs(np.sum(out["q_nb"] * forward["q_nb"], axis=1)) == pytest.approx(np.ones(3))
    assert out["sigma_rpy"] == pytest.approx(0.1 * math.sqrt(0.5)) and out["v"] == pytest.approx(forward["v"])


def test_an_outage_is_bridged_from_both_sides_with_true_sigmas(driven):
    normalised, ratios = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        errors_of = {"gyro_psd": 5e-3, "accel_psd": 2e-2, "bg": (0.02, -0.01, 0.02), "ba": (0.03, -0.02, 0.02)}
        samples = sensed(driven, rng, **errors_of)
        fixes = received(driven, rng)
        age_s = fixes["t_ns"] * 1e-9 - 100.0
        imu, gnss = table_of(samples, fixes[(age_s < DARK[0]) | (age_s > DARK[1])])
        dark = (driven.t > DARK[0] + 1.0) & (driven.t < DARK[1])
        worst = []
        for smooth in (False, True):
            solution = imud.navigate(imu, gnss, smooth=smooth)
            p, _, _ = errors(driven, solution.records)
            worst.append(np.hypot(*p[dark, :2].T).max())
        normalised.append(np.mean((p / solution.records["sigma_p"])[dark, :2] ** 2))
        ratios.append(worst[1] / worst[0])
        aligned = solution.records["status"] & (POSITION_VALID | HEADING_VALID)
        assert aligned[600] == POSITION_VALID | HEADING_VALID  # at rest before the start, too: known from the end
    assert np.mean(ratios) < 0.5
    assert np.mean(normalised) < 2.0


@pytest.mark.thorough
def test_what_is_unknown_of_the_time_offset_is_in_the_smoothed_sigmas():
    """The backward filter took the delay that the forward one found as known, and stated 2 cm where 20 were missing."""
    squares = []
    for vehicle, seed in itertools.product(("plane", "motorway"), range(2)):
        d, index = accuracy_simulated.way(vehicle, seed), list(accuracy_simulated.VEHICLES).index(vehicle)
        rng = np.random.default_rng([seed, index])
        samples, fixes = accuracy_simulated.sensed(d, rng, 0.05, 0.02), accuracy_simulated.received(d, rng, "RTK")
        out = smoothed_solutions(new_filter("navigation", samples, settings_of()), samples, fixes)
        late = d.t > accuracy_simulated.SETTLED_S
        squares.append(np.mean((errors(d, out)[0] / out["sigma_p"])[late, :2] ** 2))
    assert np.mean(squares) < 2.0


@pytest.mark.parametrize(("late_s", "sigma_m", "is_exact"), [(0.0, 0.02, True), (0.1, 0.02, False), (0.0, 2.0, False)])
def test_backward_an_epoch_is_as_well_known_as_forward(driven, late_s, sigma_m, is_exact):
    rng = np.random.default_rng(7)
    filter_ = new_filter("navigation", samples := sensed(driven, rng))
    fixes = received(driven, rng, sigma=0.5 * sigma_m, white=0.5 * sigma_m, late=late_s)
    fixes["sigma"] = sigma_m
    out, _ = replay(filter_, samples, fixes)
    backward = _backward_filter(filter_, out[-1]).parameters[0]["tuning"]
    core, forward = filter_.state["core"][0, 0], filter_.parameters[0]["tuning"]
    variance = core["cov"]["P"][interpreted(packed_index)(STATES, TIME_OFFSET, TIME_OFFSET)]
    sigma = WIDER * math.sqrt(variance + core["time_evidence"]["missing_variance"])
    for name in ("reported_epoch_sigma", "survey_epoch_sigma", "time_offset_sigma", "averaging_delay_sigma"):
        assert backward[name] == pytest.approx(min(sigma, forward[name]))
    assert (core["integrity"]["epochs"] == EXACT_EPOCHS) == is_exact == (backward["epoch_mistake_s"] > 0.001)


def test_a_start_in_motion_is_known_from_what_follows():
    truth = simulate(60.0, 100.0, wobble(3, 0.6), wobble(4, 1.0, 1.0, 4.0))
    ratios = []
    for seed in range(3):
        flaws = Flaws(gyro_bias=(0.5 * DEG, -0.4 * DEG, 0.3 * DEG))
        gyro, accel = measure(truth, flaws, np.random.default_rng(seed))
        tilt = []
        for smooth in (False, True):
            q = imud.attitude(truth.t, gyro, accel, smooth=smooth).q
            estimate = Rotation.from_quat(np.roll(q, -1, axis=1))
            down = (truth.attitude.inv().apply([0.0, 0.0, 1.0]), estimate.inv().apply([0.0, 0.0, 1.0]))
            tilt.append(np.sqrt(np.mean(np.sum((down[0] - down[1]) ** 2, axis=1)[:1000])))
        ratios.append(tilt[1] / tilt[0])
    assert np.mean(ratios) < 0.6


def estimates(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_the_command_gives_what_the_library_gives(driven, tmp_path):
    rng = np.random.default_rng(5)
    imu, gnss = table_of(sensed(driven, rng)[:6000], received(driven, rng)[:50])
    _write(tmp_path / "imu.csv", {"t_s": imu[0], **dict(zip(IMU_COLUMNS, np.hstack(imu[1:]).T, strict=True))})
    _write(tmp_path / "gnss.csv", gnss)
    tables = ["--imu", str(tmp_path / "imu.csv"), "--gnss", str(tmp_path / "gnss.csv")]
    assert main(["replay", *tables, "--smooth", "-o", str(tmp_path / "est.csv")]) == 0
    rows = estimates(tmp_path / "est.csv")
    solution = imud.navigate(columns_of(tmp_path / "imu.csv"), columns_of(tmp_path / "gnss.csv"), smooth=True)
    assert len(rows) == len(solution)
    for name, column in (("lat_deg", solution.lat_deg), ("yaw_deg", solution.yaw_deg)):
        assert [float(row[name] or "nan") for row in rows[::500]] == pytest.approx(column[::500], abs=1e-5, nan_ok=True)
    assert main(["replay", *tables, "--smooth", "--rate", "5", "-o", str(tmp_path / "thin.csv")]) == 0
    assert estimates(tmp_path / "thin.csv") == rows[::20]


def _write(path, columns):
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(columns)
        rows.writerows(zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True))


def columns_of(path):
    rows = estimates(path)
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def test_a_recording_is_smoothed(tmp_path):
    record(tmp_path / "rest.mcap", Trajectory(SCENARIOS["rest"](0.0, 0.0, 0.0), 35.0, 139.0, 60.0), 8.0)
    assert main(["replay", str(tmp_path / "rest.mcap"), "--smooth", "-o", str(tmp_path / "smooth.csv")]) == 0
    assert main(["replay", str(tmp_path / "rest.mcap"), "-o", str(tmp_path / "causal.csv")]) == 0
    smooth, causal = (estimates(tmp_path / f"{name}.csv") for name in ("smooth", "causal"))
    assert [row["t_s"] for row in smooth] == [row["t_s"] for row in causal]
    first = [float(rows[100]["sbgx_radps"]) for rows in (smooth, causal)]
    assert first[0] < 0.8 * first[1]  # what comes later tells of the bias


@pytest.mark.parametrize("estimator", ["attitude", "navigation"])
def test_the_temporary_files_are_closed(estimator):
    t = np.arange(300) / 100.0
    fixes = {"t_s": np.array([1.0, 2.0]), **dict.fromkeys(("lat_deg", "lon_deg", "height_m"), np.array([48.0, 48.0]))}
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", ResourceWarning)
        imu = t, np.zeros((300, 3)), np.tile([0.0, 0.0, -9.8], (300, 1))
        assert len(imud.navigate(imu, fixes, estimator=estimator, smooth=True).t) == 300
        gc.collect()
    assert not [str(warning.message) for warning in found if warning.category is ResourceWarning]


def test_an_estimator_that_cannot_run_backward_is_named(tmp_path, capsys):
    _write(tmp_path / "imu.csv", {"t_s": np.arange(100) / 100.0, **dict.fromkeys(IMU_COLUMNS, np.ones(100))})
    arguments = [
        "replay",
        "--imu",
        str(tmp_path / "imu.csv"),
        "--estimator",
        "tilt",
        "--smooth",
        "-o",
        str(tmp_path / "est.csv"),
    ]
    assert main(arguments) == 64
    assert "tilt cannot be smoothed" in capsys.readouterr().err


def test_a_course_that_a_slow_receiver_holds_is_taken_out_before_fixes_are_reversed():
    """Backward the first of them would be the one that is held for longest."""
    fixes = np.zeros(7, FIX)
    fixes["v"], fixes["speed"], fixes["course"] = np.nan, 1.0, (0.1, 0.2, 0.2, 0.2, 0.2, 0.9, 0.9)
    parameters, state = configure(Settings(), 100.0), start(configure(Settings(), 100.0), Initial())
    held = np.isnan(backward_fixes(parameters, state, fixes)["course"])
    assert held.tolist() == [False, False, False, True, True, False, False]
    fixes["speed"] = 3.0
    assert not np.isnan(backward_fixes(parameters, state, fixes)["course"]).any()
    assert len(backward_fixes(parameters, state, fixes[:0])) == 0
