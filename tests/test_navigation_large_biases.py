"""Gyros whose bias is as large as the worst data sheets allow: the navigation filter finds it, or does not claim to."""

import accuracy_simulated
import numpy as np
import pytest
from navigation_runner import navigate
from navigation_simulation import drive, errors, received, sensed
from simulated_errors import ERRORS

RATE = 100


@pytest.mark.parametrize("bias_dps", [(15.0, -12.0, 9.0), (-4.0, 18.0, -16.0), (9.0, 9.0, 0.0)])
def test_the_bias_of_the_worst_parts_is_found_at_rest_before_the_body_moves(bias_dps):
    """Without a receiver's word: gravity does not turn as these rates say. The tilt is right a second and a half on."""
    d, bias = drive(30.0, rest=12.0), np.radians(bias_dps)
    out, _, _ = navigate(sensed(d, np.random.default_rng(1), bg=tuple(bias)), received(d, np.random.default_rng(1)))
    tilt = np.degrees(np.hypot(*errors(d, out)[2][:, :2].T))
    assert tilt[3 * RATE :].max() < 3.0
    at_the_end = out[int(11.5 * RATE)]
    assert np.abs(at_the_end["bg"] - bias).max() < np.radians(0.1)
    assert (np.abs(at_the_end["bg"] - bias) < 4.0 * at_the_end["sigma_bg"]).all()


def test_a_steady_turn_on_the_spot_is_not_taken_for_a_bias_across_the_force():
    d = drive(20.0, rest=20.0)
    samples = sensed(d, np.random.default_rng(2))
    samples["w"] += np.radians([0.0, 0.0, 15.0])  # of a turntable: a turn about the vertical turns no gravity
    out, _, _ = navigate(samples[: 4 * RATE], received(d, np.random.default_rng(2))[:0])
    assert np.abs(out["bg"][-1, :2]).max() < np.radians(0.5)
    assert out["sigma_bg"][-1, 2] > np.radians(5.0)


@pytest.mark.parametrize(
    ("vehicle", "receiver"), [("city", "5 Hz"), ("helicopter", "5 Hz"), ("plane", "5 Hz"), ("robot", "1 Hz")]
)
def test_vehicles_with_the_worst_gyros_have_a_heading_and_are_not_wrong_and_sure(vehicle, receiver):
    """Before: yaw and tilt of these for minutes."""
    row = accuracy_simulated.figures(vehicle, receiver, 0.0, 1700, error="large gyro bias")
    assert row["yaw s"] + row["tilt s"] + row["position s"] < 1.0
    assert row["no yaw s"] < 30.0


def with_vertical_bias(monkeypatch, vehicle, receiver, dps):
    def biased(d, samples, fixes, _):
        samples = samples.copy()
        samples["w"][:, 2] += np.radians(dps)
        return d, samples, fixes

    monkeypatch.setitem(ERRORS, "vertical", biased)
    return accuracy_simulated.figures(vehicle, receiver, 0.0, 1700, error="vertical")


def test_a_vertical_bias_beyond_all_frame_rates_is_found_under_way(monkeypatch):
    """A walker, who never rests: the bank of 5.6 deg/s on either side moves to where the bias is."""
    row = with_vertical_bias(monkeypatch, "walker", "5 Hz", -7.0)
    assert row["yaw s"] + row["tilt s"] < 1.0 and row["yaw deg"] < 5.0
    assert row["no yaw s"] < 30.0


@pytest.mark.parametrize("dps", [9.0, 12.0, 15.0])
def test_a_vertical_bias_that_a_rest_has_measured_leaves_the_heading_to_be_found(monkeypatch, dps):
    """It was beyond all frame rates of the bank that had begun before the rest."""
    row = with_vertical_bias(monkeypatch, "city", "1 Hz", dps)
    assert row["yaw s"] + row["tilt s"] < 1.0 and row["no yaw s"] == 0.0


def test_the_usual_biases_still_give_a_heading():
    row = accuracy_simulated.figures("city", "5 Hz", 0.0, 1700)
    assert row["no yaw s"] == 0.0 and row["yaw s"] == 0.0
