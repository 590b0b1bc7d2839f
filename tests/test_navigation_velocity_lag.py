"""A receiver whose velocity lags behind its own positions, as it smooths it, or whose positions lag behind that."""

import numpy as np
import pytest
from accuracy_simulated import wheel_speeds
from navigation_runner import navigate, settings_of
from navigation_simulation import Later, drive, errors, received, sensed
from replay_in_process import new_filter, smoothed_solutions
from simulated_errors import averaged

from imud.estimators.ins.checkpoint import checkpoint, resume
from imud.estimators.ins.findings import findings
from imud.estimators.ins.integrity.velocity_lag import LATE
from imud.estimators.records import HEADING_VALID, NEW_RECEIVER, POSITION_VALID

D = Later(drive, 180.0, speed=12.0)
SETTINGS = {"vehicle": [0], "lever_arm_is_set": [1], "tuning": {"max_lag_s": [0.2]}}


def fixes_with(lag_s, seed, every=0.2):
    return received(D, np.random.default_rng(seed), every=every, late=0.1, lag=lag_s)


def run(fixes, seed=1):
    """(position errors north and east, m, yaw errors, deg, solutions, state)"""
    samples = sensed(D, np.random.default_rng(seed), bg=(0.002, -0.001, 0.0015), ba=(0.03, -0.02, 0.02))
    out, _, state = navigate(samples, fixes)
    position, _, attitude = errors(D, out)
    return position[:, :2], np.degrees(attitude[:, 2]), out, state


def regressed_lag(fixes):
    """The lag by numpy's least squares, on one fix in a second."""
    every = fixes[::5] if fixes["t_ns"][1] - fixes["t_ns"][0] < 900_000_000 else fixes
    t = every["t_ns"] * 1e-9
    place = every["lat"] * 6.371e6 + 1j * every["lon"] * 6.371e6 * np.cos(every["lat"][0])
    velocity = every["speed"] * np.exp(1j * every["course"])
    travel = 0.5 * np.diff(t) * (velocity[1:] + velocity[:-1])
    rows = np.column_stack([np.diff(velocity), travel])
    (lag, _), *_ = np.linalg.lstsq(
        np.vstack([rows.real, rows.imag]), complex_parts(np.diff(place) - travel), rcond=None
    )
    return lag


def complex_parts(values):
    return np.concatenate([values.real, values.imag])


@pytest.mark.parametrize("lag_s", [0.0, 0.15, 1.0])
@pytest.mark.parametrize("every", [0.2, 1.0])
def test_the_lag_is_that_of_a_regression_by_numpy(lag_s, every):
    fixes = fixes_with(lag_s, 3, every)
    g = run(fixes)[3]["velocity_lag"][0]
    assert g["lag"] == pytest.approx(lag_s, abs=4.0 * np.sqrt(g["variance"]))
    assert g["lag"] == pytest.approx(regressed_lag(fixes), abs=0.05)
    assert np.sqrt(g["variance"]) < 0.06
    assert (g["late"] != 0) == (lag_s > 0.5)


@pytest.mark.parametrize("every", [0.2, 1.0])
@pytest.mark.parametrize("seed", [4, 5, 6])
def test_a_velocity_that_lags_by_a_second_is_not_used_and_makes_nothing_wrong_and_sure(seed, every):
    position, yaw, out, state = run(fixes_with(1.0, seed, every), seed)
    valid = (out["status"] & POSITION_VALID) != 0
    far = valid[:, None] & (np.abs(position) > np.maximum(4.0 * out["sigma_p"][:, :2], 5.0))
    known = (out["status"] & HEADING_VALID) != 0
    turned = known & (np.abs(yaw) > np.maximum(4.0 * np.degrees(out["sigma_rpy"][:, 2]), 5.0))
    assert 0.01 * far.any(axis=1).sum() < 2.0
    assert 0.01 * turned.sum() < 2.0
    assert np.abs(position[-6000:]).max() < 8.0
    assert known[-6000:].all()
    assert state["velocity_lag"]["late"][0] != 0


def test_a_late_velocity_is_a_finding():
    _, _, _, state = run(fixes_with(1.0, 7))
    assert "lags behind its positions" in findings(SETTINGS, state)[0]
    assert findings(SETTINGS, run(fixes_with(0.1, 7))[3]) == ()


def test_positions_that_lag_by_a_second_have_a_time_offset_of_a_second():
    """Averages of the last second lag by that where the velocity is steady."""
    fixes = averaged(D, fixes_with(0.0, 8), 1.0, velocities=False)
    position, _, _, state = run(fixes)
    c = state["core"][0, 0]
    assert c["nav"]["time_offset"] == pytest.approx(1.0, abs=0.25)
    assert c["nav"]["velocity_time_offset"] == pytest.approx(-c["nav"]["time_offset"], abs=0.15)
    assert np.sqrt(np.mean(position[-6000:] ** 2)) < 3.0


def test_the_velocity_of_another_receiver_is_used_again():
    fixes = fixes_with(1.0, 9)
    other = len(fixes) // 2
    fixes[other:] = fixes_with(0.0, 9)[other:]
    fixes["flags"][other] = NEW_RECEIVER
    assert run(fixes[:other])[3]["velocity_lag"]["late"][0] != 0
    assert run(fixes)[3]["velocity_lag"]["late"][0] == 0


def test_a_velocity_in_knots_that_is_taken_for_metres_is_no_lag():
    fixes = fixes_with(0.0, 10)
    fixes["speed"] *= 1.94
    assert run(fixes)[3]["velocity_lag"]["late"][0] == 0


def test_smoothed_positions_do_without_the_velocities_that_lag():
    """Backward in time they would lead."""
    samples = sensed(D, np.random.default_rng(4), bg=(0.002, -0.001, 0.0015), ba=(0.03, -0.02, 0.02))
    filter_ = new_filter("navigation", samples, settings_of())
    out = smoothed_solutions(filter_, samples, fixes_with(1.0, 4, 1.0))
    position, velocity, attitude = errors(D, out)
    settled = D.t > 40.0
    assert np.sqrt(np.mean(position[settled, :2] ** 2)) < 1.5
    assert np.sqrt(np.mean(velocity[settled, :2] ** 2)) < 0.15
    assert np.degrees(np.sqrt(np.mean(attitude[settled, 2] ** 2))) < 1.0


def test_the_filter_begins_without_the_late_velocity_though_measurements_of_other_sources_come_later_still():
    """They rewind the filter to before the fix by which it was found, which is then fused again."""
    fixes, begin = fixes_with(0.0, 4), 300
    fixes[begin:] = fixes_with(1.0, 4)[begin:]
    speeds = wheel_speeds(D, np.random.default_rng(4))
    speeds["arrival_ns"] = speeds["t_ns"] + 300_000_000
    out, _, state = navigate(sensed(D, np.random.default_rng(4)), fixes, aiding=speeds)
    assert state["velocity_lag"]["late"][0] == LATE
    known = (out["status"] & HEADING_VALID) != 0
    times = np.concatenate(([20.0], D.t[known & (D.t > 20.0)], D.t[-1:]))
    assert np.diff(times).max() > 10.0  # not known for so long; it is doubted for some tenths of a second before


def test_a_restart_of_the_program_keeps_what_was_found():
    _, _, _, state = run(fixes_with(1.0, 11))
    restarted = new_filter("navigation", sensed(D, np.random.default_rng(1)), settings_of()).state
    resume(restarted, checkpoint(state))
    assert restarted["velocity_lag"]["late"][0] == LATE
    assert findings(SETTINGS, restarted) == findings(SETTINGS, state)


def test_the_pair_of_fixes_across_a_change_of_receivers_is_left_out():
    """By how much their positions differ does not matter then; of one receiver a jump is noise of a pair."""

    def found(metres, flags):
        fixes = fixes_with(0.0, 12, 1.0)
        other = len(fixes) // 2
        fixes["lat"][other:] += metres / 6.371e6
        fixes["flags"][other] = flags
        return run(fixes[: other + 30])[3]["velocity_lag"][0]

    same, jumped = found(0.0, NEW_RECEIVER), found(5.0, NEW_RECEIVER)
    assert jumped["variance"] == pytest.approx(same["variance"], rel=0.1)
    assert jumped["lag"] == pytest.approx(same["lag"], abs=0.5 * np.sqrt(same["variance"]))
    assert abs(same["lag"]) < 4.0 * np.sqrt(same["variance"])
    assert found(5.0, 0)["variance"] > 1.3 * found(0.0, 0)["variance"]


def test_a_position_far_off_is_no_noise_of_a_pair():
    """What no credible lag explains does not count."""
    fixes = fixes_with(0.0, 12, 1.0)
    right = run(fixes.copy())[3]["velocity_lag"][0]["variance"]
    fixes["lat"][len(fixes) // 2] += 60.0 / 6.371e6
    assert run(fixes)[3]["velocity_lag"][0]["variance"] < 1.1 * right
