"""Receivers whose stamps are late, before the heading is known: what is stated, and how the age is found."""

import accuracy_simulated
import numpy as np
import pytest
from accuracy_simulated import figures
from navigation_runner import navigate, settings_of
from navigation_simulation import errors, received, sensed
from scipy.optimize import minimize_scalar
from vehicle_simulation import vehicle

from imud.compile.jit import interpreted
from imud.estimators.ins.alignment.fix_age import residual_energy
from imud.estimators.ins.alignment.hypothesis_bank import accumulate_products
from imud.estimators.ins.alignment.records import FIX_AGE
from imud.estimators.records import HEADING_VALID, POSITION_VALID


def start(kind, late, seed=1, survey=True, seconds=90.0, **tuning):
    """(the drive, the solutions, the filter's time offset): positions of a survey, or of a common receiver."""
    rng = np.random.default_rng([seed, 77])
    d = vehicle(kind, seed, seconds)
    samples = sensed(d, rng, bg=np.radians(rng.normal(0.0, 0.2, 3)), ba=rng.normal(0.0, 0.04, 3))
    accuracy = {"sigma": 0.02, "white": 0.01, "hdop": 0.05} if survey else {"sigma": 1.2, "white": 0.3}
    fixes = received(d, rng, late=0.1, stamp=late, **accuracy)
    if survey:
        fixes["speed"] = fixes["course"] = np.nan
    fixes["arrival_ns"] = np.maximum(fixes["arrival_ns"], fixes["t_ns"])
    out, _, state = navigate(samples, fixes, settings_of(tuning=tuning))
    return d, out, float(state["core"][0, 0]["nav"]["time_offset"])


def test_before_the_heading_is_known_the_sigma_of_the_position_has_that_of_the_time_offset():
    d, out, _ = start("motorway", 0.2, seconds=30.0)
    position, _, _ = errors(d, out)
    before = ((out["status"] & POSITION_VALID) > 0) & ((out["status"] & HEADING_VALID) == 0)
    fast = before & (np.hypot(*d.v[:, :2].T) > 8.0)
    assert fast.sum() > 50
    away = np.hypot(position[fast, 0], position[fast, 1])
    stated = np.hypot(out["sigma_p"][fast, 0], out["sigma_p"][fast, 1])
    assert away.max() > 1.5
    assert np.all(away < 3.0 * stated)
    assert np.all(stated < 1.0 + 0.21 * np.hypot(*d.v[fast, :2].T))


@pytest.mark.parametrize("survey", [True, False], ids=["positions of a survey", "a receiver's velocities"])
@pytest.mark.parametrize("kind", ["city", "walk", "drone"])
def test_stamps_that_are_a_second_late_give_no_wrong_heading_and_are_found(kind, survey):
    d, out, offset = start(kind, 1.0, survey=survey)
    assert offset == pytest.approx(1.0, abs=0.1)
    valid = (out["status"] & HEADING_VALID) > 0
    yaw = np.abs(np.degrees(errors(d, out)[2][valid, 2]))
    assert valid[-1]
    assert not np.any((yaw > 5.0) & (yaw > 4.0 * np.degrees(out["sigma_rpy"][valid, 2])))


@pytest.mark.parametrize("kind", ["city", "robot", "drone"])
def test_right_stamps_keep_the_heading_waiting_for_nothing(kind):
    """The same to the last bit as without the comparison, which is switched off by a prior of zero."""
    _, out, _ = start(kind, 0.0)
    _, without, _ = start(kind, 0.0, fix_age_prior=0.0)
    assert (out["status"][-1] & HEADING_VALID) > 0
    assert out.tobytes() == without.tobytes()


def test_a_few_pairs_of_a_sensor_that_is_shaken_prove_no_age():
    """Some age explains the first pairs of a helicopter that takes off: it was taken for certain, and 0.9 s wrong."""
    row = figures("helicopter", "1 Hz", 0.0, 0)
    assert (row["position s"], row["yaw s"], row["no yaw s"]) == (0.0, 0.0, 0.0)
    assert row["position m"] < 3.0


def test_what_take_off_does_not_show_of_the_age_is_found_in_flight(monkeypatch):
    """Its heading is found while it accelerates straight ahead; stamps late by 0.7 s then cost 8 m for minutes."""
    right = accuracy_simulated.received

    def late(*how):
        fixes = right(*how)
        fixes["t_ns"] += 700_000_000
        fixes["arrival_ns"] += 700_000_000
        return fixes

    monkeypatch.setattr(accuracy_simulated, "received", late)
    away = [figures("plane", "1 Hz", 0.0, seed)["position m"] for seed in (110, 111, 112)]
    assert np.median(away) < 5.0


@pytest.mark.parametrize(("kind", "seed"), [("lorry", 108), ("ship", 109)])
def test_levelling_in_slow_acceleration_does_not_make_right_stamps_look_late(kind, seed):
    """A lorry's were taken for 1 s late, and its position was 13 m off at centimetres; a ship's for 0.5 s."""
    row = figures(kind, "RTK", 0.0, seed)
    assert (row["position s"], row["yaw s"]) == (0.0, 0.0)
    assert row["position m"] < 0.5


def test_the_residual_energy_is_that_of_least_squares():
    """Against numpy's solution for psi, by search, and for tilt and biases with their prior; and that without force."""
    rng = np.random.default_rng(4)
    white = lambda *shape: rng.standard_normal(shape) + 1j * rng.standard_normal(shape)  # noqa: E731
    a, regressors, root = white(12), white(12, 3), white(3, 3)
    measured = np.exp(0.7j) * (a + regressors @ white(3)) + 0.2 * white(12)
    ages = np.zeros(1, FIX_AGE).view(np.recarray)[0]
    prior = root @ root.conj().T
    ages["prior"][:, :, 0], ages["prior"][:, :, 1] = prior.real, prior.imag
    weight = 1.0 / 0.2**2
    for row in np.column_stack([measured, a, regressors]):
        interpreted(accumulate_products)(ages["products"][3], np.column_stack([row.real, row.imag]), weight)
    energy, without = interpreted(residual_energy)(ages, 3)

    def least(target):
        rows = np.vstack([np.sqrt(weight) * regressors, np.linalg.inv(root)])
        target = np.append(np.sqrt(weight) * target, np.zeros(3))
        return np.sum(np.abs(target - rows @ np.linalg.lstsq(rows, target)[0]) ** 2)

    best = minimize_scalar(
        lambda psi: least(measured - np.exp(1j * psi) * a),
        bounds=(0.0, 1.5),
        method="bounded",
        options={"xatol": 1e-10},
    )
    assert energy == pytest.approx(best.fun, rel=1e-9)
    assert without == pytest.approx(least(measured), rel=1e-9)
    assert best.x == pytest.approx(0.7, abs=0.2)
