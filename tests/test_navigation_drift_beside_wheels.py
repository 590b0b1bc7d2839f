"""A receiver that drifts, or is wrong otherwise, beside an odometer that slips."""

import numpy as np
import pytest
from accuracy_simulated import figures
from navigation_simulation import errors, received, sensed
from test_navigation_aiding import estimated
from test_navigation_odometer import ramped, readings, without
from vehicle_simulation import RATE, ahead, smooth, way

from imud.estimators.records import REJECTING

STOP_S, DRIFT_S = 100.0, 104.5


def stopping(seed, seconds=180.0, speed=10.0, wait_s=12.0, turn=0.0, accel_psd=2e-3):
    """(Drive, samples, fixes, wheel readings) of a car that turns about, stops, and drives on.

    From STOP_S on it brakes by 2 m/s^2; turn: deg, when it drives on.
    """
    t, rng = np.arange(int(seconds * RATE)) / RATE, np.random.default_rng(seed)
    v = speed * np.clip((t - 30.0) / 5.0, 0.0, 1.0) * (1.0 - 0.2 * np.sin(t / 4.0) * (t < STOP_S - 8.0))
    stop = STOP_S + 0.5 * speed
    v *= np.clip((stop - t) / (stop - STOP_S), 0.0, 1.0) + np.clip((t - stop - wait_s) / 5.0, 0.0, 1.0)
    v = smooth(v, 0.5)
    rate = 0.4 * np.sin(t / 5.0) * ((t > 35.0) & (t < STOP_S - 8.0))
    rate += np.radians(turn) / 4.0 * ((t > stop + wait_s + 2.0) & (t < stop + wait_s + 6.0))
    yaw = 0.5 + np.cumsum(smooth(rate, 1.0)) / RATE
    d = way(t, ahead(v, yaw), yaw, 0.0 * t, 0.0 * t)
    samples = sensed(d, rng, accel_psd=accel_psd, bg=(0.002, -0.001, 0.0015), ba=(0.03, -0.02, 0.02))
    return d, samples, received(d, rng, late=0.1, sigma=1.2), readings(d, rng)


def slipping(rows, begin, end, share):
    """Wheels that show this share of the speed meanwhile."""
    t = rows["t_ns"] * 1e-9 - 100.0
    rows["value"][(t > begin) & (t < end), 0] *= share
    return rows


def heading_at(d, t_s):
    return d.attitude[int(t_s * RATE)].as_euler("ZYX")[0]


def test_a_slip_that_shrinks_as_the_vehicle_brakes_has_not_ended():
    """Half of 40 % of 10 m/s is what they are at 5 m/s."""
    d, samples, fixes, rows = stopping(1)
    rows = slipping(rows, STOP_S, STOP_S + 3.5, 1.4)
    out, _ = estimated(samples, without(fixes, STOP_S - 1.0, 130.0), rows)
    stands = (d.t > STOP_S + 3.5) & (d.t < STOP_S + 12.0)
    assert np.abs(errors(d, out)[1][stands, :2]).max() < 0.3
    assert np.hypot(*errors(d, out)[0][d.t < 130.0, :2][-1]) < 8.0


@pytest.mark.parametrize(
    ("seed", "share", "after_s", "angle"),
    [(2, 1.4, 0.5, 3.14), (2, 1.4, 1.5, 3.14), (3, 0.6, 0.5, 0.0), (3, 1.4, 2.5, 0.0)],
)
def test_a_receiver_that_begins_to_drift_while_the_wheels_slip_is_found(seed, share, after_s, angle):
    """Along the way, as the vehicle brakes; docs/aiding.md says how often it is not."""
    d, samples, fixes, rows = stopping(seed)
    rows = slipping(rows, STOP_S + 0.5, STOP_S + 4.0, share)
    onset = STOP_S + 0.5 + after_s
    out, _ = estimated(samples, ramped(fixes, onset, heading_at(d, STOP_S) + angle), rows)
    rejecting = d.t[(out["status"] & REJECTING) != 0]
    assert onset < rejecting[rejecting > onset].min() < onset + 15.0
    assert np.hypot(*errors(d, out)[0][d.t > onset, :2].T).max() < 10.0


@pytest.mark.parametrize("seed", [1, 2])
def test_a_receiver_that_begins_to_drift_as_the_vehicle_stops_leaves_the_position_within_10_m(seed):
    d, samples, fixes, rows = stopping(seed, turn=90.0)
    out, _ = estimated(samples, ramped(fixes, DRIFT_S, heading_at(d, DRIFT_S)), rows)
    assert np.hypot(*errors(d, out)[0][(d.t > DRIFT_S) & (d.t < DRIFT_S + 60.0), :2].T).max() < 10.0


@pytest.mark.parametrize(("seed", "begin", "angle"), [(1, 112.5, 1.57), (2, 112.5, 0.8), (3, 113.5, -1.57)])
def test_a_receiver_that_drifts_across_a_standing_vehicle_leaves_the_position_within_15_m(seed, begin, angle):
    """The constraint of a land vehicle holds the velocity across the way, of an accelerometer that is shaken."""
    d, samples, fixes, rows = stopping(seed, turn=90.0, accel_psd=0.05)
    out, _ = estimated(samples, ramped(fixes, begin, heading_at(d, begin) + angle), rows)
    assert np.hypot(*errors(d, out)[0][(d.t > begin) & (d.t < begin + 60.0), :2].T).max() < 15.0


@pytest.mark.parametrize("seed", [3, 4])
def test_a_drift_that_begins_where_fixes_are_missing_is_found(seed):
    d, samples, fixes, rows = stopping(seed)
    fixes = without(fixes, 75.0, 92.0)
    out, _ = estimated(samples, ramped(fixes, 92.0, heading_at(d, 92.0) + 1.57), rows)
    late = (d.t > 102.0) & (d.t < 150.0)
    sigmas = np.hypot(*(errors(d, out)[0][:, :2] / out["sigma_p"][:, :2]).T)
    assert (out["status"][late] & REJECTING).all()
    assert sigmas[late].max() < 3.0


def test_a_drifting_receiver_is_not_believed_as_soon_as_the_wheels_are_silent():
    """Ten seconds after the last reading nothing but the estimate contradicts it; it has to stay with one velocity."""
    d, samples, fixes, rows = stopping(1)
    fixes = ramped(fixes, 60.0, heading_at(d, 60.0), speed=2.0)
    rows = rows[rows["t_ns"] * 1e-9 - 100.0 < 80.0]
    out, _ = estimated(samples, fixes, rows)
    rejecting = (out["status"] & REJECTING) != 0
    assert rejecting[(d.t > 75.0) & (d.t < 93.0)].all()


@pytest.mark.parametrize(("vehicle", "seed"), [("motorway", 1300), ("bicycle", 1301), ("tractor", 1300)])
def test_rounded_positions_of_centimetres_are_not_made_worse_by_wheels(vehicle, seed):
    """Positions of centimetres that are rounded to metres: wheels must not make them worse than they are."""
    row = figures(vehicle, "RTK", 0.0, seed, error="rounded", wheels=True)
    assert row["position s"] < 5.0
    assert row["position m"] < 20.0


def test_positions_further_off_than_a_receiver_drifts_are_the_estimates_error():
    """Wheels measure how fast it goes, not where to; a heading that is wrong goes on otherwise for ten minutes."""
    row = figures("rally", "1 Hz positions", 0.0, 1301, error="multipath", wheels=True)
    assert row["position m"] < 60.0
