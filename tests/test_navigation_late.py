"""A fix belongs to its epoch, whenever it arrives."""

import numpy as np
import pytest
from navigation_runner import navigate, settings_of
from navigation_simulation import Later, drive, errors, received, sensed
from test_navigation_jacobians import record
from vehicle_simulation import vehicle

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.estimators.ins.core import SNAPSHOT
from imud.estimators.ins.fusion_horizon import restore_snapshot, rewind_to, store_snapshot
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import AIDING_RING
from imud.estimators.records import HEADING_VALID, INNOVATION, ODOMETER_SOURCE

RATE = 100
D = Later(drive, 120.0)


def data(seed=1, **how):
    rng = np.random.default_rng(seed)
    return sensed(D, rng), received(D, rng, **how)


def test_a_fix_that_comes_late_gives_the_state_of_one_that_came_soon():
    samples, fixes = data(late=1.2)  # the velocities that the acceleration at a fix is fitted to have come
    late = fixes.copy()
    late["arrival_ns"] += 280_000_000
    # without an age of the fixes: that is of integrals interpolated between the states that the filter keeps
    settings = settings_of(tuning={"fix_age_min_pairs": 1e9})
    prompt, _, prompt_state = navigate(samples, fixes, settings)
    out, _, late_state = navigate(samples, late, settings)
    between = np.arange(60 * RATE + 60, len(D.t), RATE)  # both have arrived by then
    assert np.abs(out["v"] - prompt["v"])[between].max() < 1e-9
    assert np.abs(out["q_nb"] - prompt["q_nb"])[between].max() < 1e-11
    assert np.abs(out["lat"] - prompt["lat"])[between].max() * 6.4e6 < 1e-6
    assert np.abs(out["sigma_p"] - prompt["sigma_p"])[between].max() < 1e-9
    assert np.abs(out["lat"] - prompt["lat"])[between - 30].max() * 6.4e6 > 1e-3  # and not before
    assert late_state["core"][0, 0]["imu"]["sample_count"] == prompt_state["core"][0, 0]["imu"]["sample_count"]


def test_the_same_input_gives_the_same_output_bit_for_bit():
    samples, fixes = data(late=0.25)
    first, first_rows, _ = navigate(samples, fixes)
    second, second_rows, _ = navigate(samples, fixes)
    assert first.tobytes() == second.tobytes()
    assert first_rows.tobytes() == second_rows.tobytes()


def test_an_unknown_latency_is_found():
    d = drive(300.0)
    rng = np.random.default_rng(2)
    samples = sensed(d, rng)
    fixes = received(d, rng, late=0.25, stamp=0.25)  # stamped with the time of arrival
    out, _, state = navigate(samples, fixes)
    assert state["core"][0, 0]["nav"]["time_offset"] == pytest.approx(0.25, abs=0.03)
    p = errors(d, out)[0][200 * RATE :, :2]
    known = errors(d, navigate(samples, received(d, np.random.default_rng(99), late=0.25))[0])[0][200 * RATE :, :2]
    assert np.sqrt(np.mean(p**2)) < 1.5 * np.sqrt(np.mean(known**2)) + 0.5


def test_a_late_velocity_is_distinguished_from_a_latency():
    d = drive(300.0)
    rng = np.random.default_rng(2)
    samples = sensed(d, rng)
    out, _, state = navigate(samples, received(d, rng, late=0.25, lag=0.1))
    core = state["core"][0, 0]
    assert core["nav"]["velocity_time_offset"] == pytest.approx(0.1, abs=0.03)
    assert core["nav"]["time_offset"] == pytest.approx(0.0, abs=0.03)
    late = slice(200 * RATE, None)
    errors_v = errors(d, out)[1][late, :2]
    known = errors(d, navigate(samples, received(d, np.random.default_rng(99), late=0.25))[0])[1][late, :2]
    assert np.sqrt(np.mean(errors_v**2)) < 1.5 * np.sqrt(np.mean(known**2))


@pytest.mark.parametrize("real_s", [0.05, 0.3])
def test_centimetres_stamped_with_an_assumed_latency_are_taken_back_to_their_epoch(real_s):
    d = drive(120.0)
    rng = np.random.default_rng(2)
    assumed_s = Settings().gnss.latency_s
    samples = sensed(d, rng)
    fixes = received(d, rng, late=real_s, stamp=real_s - assumed_s, sigma=0.0, white=0.01)
    fixes["sigma"] = (0.01, 0.01, 0.02)
    out, _, state = navigate(samples, fixes)
    assert state["core"][0, 0]["nav"]["time_offset"] == pytest.approx(real_s - assumed_s, abs=0.005)
    late = slice(60 * RATE, None)
    assert np.sqrt(np.mean(errors(d, out)[0][late, :2] ** 2)) < 0.05


@pytest.mark.parametrize("stamp", [-0.2, 0.0, 0.03, 0.2])
def test_the_stamps_of_a_survey_may_be_wrong(stamp):
    """Centimetres without speeds, stamped as they arrive: the heading is not turned to make up for it."""
    rng = np.random.default_rng(2)
    samples = sensed(D, rng, bg=0.01 * rng.standard_normal(3), ba=0.1 * rng.standard_normal(3))
    fixes = received(D, rng, stamp=stamp, sigma=0.0, white=0.02)
    fixes["sigma"], fixes["speed"], fixes["course"] = (0.02, 0.02, 0.04), np.nan, np.nan
    fixes["arrival_ns"] = fixes["t_ns"]
    out, _, state = navigate(samples, fixes, settings_of())
    heading, valid = errors(D, out)[2][:, 2], (out["status"] & HEADING_VALID) > 0
    assert valid[60 * RATE :].all()
    assert (np.abs(heading[valid]) < np.maximum(np.radians(5.0), 4.0 * out["sigma_rpy"][valid, 2])).all()
    assert state["core"][0, 0]["nav"]["time_offset"] == pytest.approx(stamp, abs=0.005)


def test_clocks_that_run_apart_make_no_position_of_rtk_wrong_and_sure():
    """On a motorway, by 0.15 s to and fro within 200 s. With a constant time offset it is for a fourth of the time."""
    rng, d = np.random.default_rng(2), vehicle("motorway", 2, 150.0)
    samples = sensed(d, rng, bg=0.003 * rng.standard_normal(3), ba=0.05 * rng.standard_normal(3))
    fixes = received(d, rng, every=0.2, late=0.1, sigma=0.01, white=0.015)
    fixes["sigma"] = (0.02, 0.02, 0.04)
    apart_s = 0.15 * np.sin(2.0 * np.pi * (fixes["t_ns"] * 1e-9 - 100.0) / 200.0)
    for name in ("t_ns", "arrival_ns"):
        fixes[name] += (1e9 * apart_s).astype(np.int64)
    out = navigate(samples, fixes, settings_of())[0]
    error = errors(d, out)[0][60 * RATE :, :2]
    sigma = out["sigma_p"][60 * RATE :, :2]
    assert not ((np.hypot(*error.T) > 5.0) & (np.hypot(*(error / sigma).T) > 4.0)).any()


def test_a_fix_older_than_one_already_fused_is_refused_with_a_record():
    samples, fixes = data(late=0.2)
    fixes["arrival_ns"][80] += 2_500_000_000
    out, rows, _ = navigate(samples, fixes)
    old = rows[rows["t_ns"] == fixes["t_ns"][80]]
    assert len(old) == 1
    assert old["used"][0] == 0
    assert np.isfinite(out["sigma_p"][-1]).all()


@pytest.mark.parametrize("late", [2.0, 6.0, 60.0])
def test_very_late_fixes_do_no_harm(late):
    samples, fixes = data(late=0.2)
    fixes["arrival_ns"][60:] += int(late * 1e9)
    out, rows, _ = navigate(samples, fixes)
    assert rows.dtype == INNOVATION
    p, _, _ = errors(D, out)
    assert (np.abs(p[100 * RATE]) < 5.0 * out["sigma_p"][100 * RATE]).all()


def test_fixes_of_the_future_are_refused():
    samples, fixes = data(late=0.2)
    fixes["t_ns"][70:] += 60_000_000_000
    out, rows, _ = navigate(samples, fixes)
    assert not rows["used"][rows["t_ns"] >= fixes["t_ns"][70]].any()
    assert np.isfinite(out["v"][-1]).all()


@pytest.mark.parametrize(("stored", "is_kept"), [(AIDING_RING - 1, True), (AIDING_RING, False)])
def test_a_rewind_needs_all_measurements_that_the_next_one_leaves_in_the_ring(stored, is_kept):
    """Before: in a full ring the oldest one, which was to be fused again, was the new one, which so was fused twice."""
    s = start(configure(Settings(), 100.0), Initial())
    s["aiding_start"], s["aiding_count"], s["aiding_ring"]["kind"] = 10, stored, ODOMETER_SOURCE
    s["sample_count"] = s["snapshot_count"] = 1
    s["snapshots"]["nav"]["fused_count"][0, 0], s["core"]["nav"]["t_ns"] = 10, 1_000_000_000
    assert interpreted(rewind_to)(record(s), 500_000_000) == is_kept


def test_a_rewind_restores_every_record():
    """Random bytes in each field of the core are stored, changed and restored."""
    s = start(configure(Settings(), 100.0), Initial())
    core, rng = s["core"][0], np.random.default_rng(3)
    filled = {name: rng.bytes(core[name].nbytes) for name in SNAPSHOT.names}
    for name, data in filled.items():
        core[name].view(np.uint8)[:] = np.frombuffer(data, np.uint8)
    state = record(s)
    interpreted(store_snapshot)(state)
    kept = s["snapshots"][0, 0]
    assert {name: kept[name].tobytes() for name in SNAPSHOT.names} == filled
    for name in SNAPSHOT.names:
        core[name].view(np.uint8)[:] = 0
    interpreted(restore_snapshot)(state.core[0], state.snapshots[0])
    assert {name: core[name].tobytes() for name in SNAPSHOT.names} == filled
