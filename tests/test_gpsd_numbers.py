"""Numbers in gpsd's messages: units, angles, bounds of 95 % and times, against independent computations."""

import datetime
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imud.estimators.records import HEIGHT_VALID, POSITION_VALID, SOLUTION
from imud.math.rotation import euler_of_quat
from imud.outputs.gpsd_json import _bound95, _motion, _turn_rate
from imud.outputs.gpsd_objects import iso
from imud.outputs.view import decode, euler


@given(st.binary(min_size=SOLUTION.itemsize, max_size=SOLUTION.itemsize))
def test_decoding_reads_every_column_in_its_unit(data):
    row = np.frombuffer(data, SOLUTION)[0]
    state = decode(data)
    with np.errstate(all="ignore"):
        for name in state._fields:
            value = np.degrees(row[name]) if name in ("lat", "lon", "w", "bg", "sigma_rpy", "sigma_bg") else row[name]
            hidden = name in ("lat", "lon", "height", "v", "sigma_p", "sigma_v") and not row["status"] & POSITION_VALID
            hidden |= name == "height" and not row["status"] & HEIGHT_VALID
            expected = np.full_like(value, math.nan) if hidden else value
            np.testing.assert_allclose(getattr(state, name), expected, rtol=1e-14, equal_nan=True)


unit_quaternions = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)


@given(unit_quaternions)
@example(np.array([8.42936970e-08, 7.07106781e-01, 8.42936970e-08, 7.07106781e-01]))  # all but straight down
@example(np.array([-0.0, 0.70710678, 0.0, 0.70710678]) / np.linalg.norm([0.70710678, 0.70710678]))
def test_euler_angles_are_those_of_the_kernel(q):
    apart = np.array(euler(tuple(q))) - np.degrees(euler_of_quat(tuple(q)))
    np.testing.assert_allclose((apart + 180.0) % 360.0 - 180.0, 0.0, atol=1e-9)  # 180 deg is -180 deg


@given(unit_quaternions, st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_rate_of_turn_is_the_derivative_of_the_heading(q, w):
    roll, pitch, yaw = euler(tuple(q))
    if abs(pitch) > 80.0:
        return
    dt = 1e-5
    turned = Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec(np.array(w) * dt)
    change = turned.as_euler("ZYX", degrees=True)[0] - yaw
    expected = (change + 180.0) % 360.0 - 180.0
    assert _turn_rate(roll, pitch, tuple(np.degrees(w))) * dt == pytest.approx(expected, abs=2e-6)


def test_rate_of_turn_is_unknown_when_the_nose_points_up():
    assert math.isnan(_turn_rate(0.0, 89.9, (0.0, 0.0, 1.0)))


@pytest.mark.parametrize("sigmas", [(1, 1), (1, 0.5), (1, 0.1), (3, 0), (2, 2, 2), (1, 1, 3), (1, 2, 4), (0.1, 0.1, 5)])
def test_radial_bound_holds_95_percent(sigmas):
    samples = np.random.default_rng(1).normal(size=(400_000, len(sigmas))) * sigmas
    inside = np.mean(np.linalg.norm(samples, axis=1) < _bound95(*sigmas))
    assert inside == pytest.approx(0.95, abs=0.004)


@pytest.mark.parametrize("scale", [1e-200, 1e200])
def test_radial_bound_scales_with_the_sigmas_however_small_or_large(scale):
    assert _bound95(scale, 2.0 * scale) == pytest.approx(_bound95(1.0, 2.0) * scale)


def test_radial_bound_of_nothing_and_of_the_unknown():
    assert _bound95(0.0, 0.0) == 0.0
    assert math.isnan(_bound95(math.nan, math.nan))


@pytest.mark.parametrize(("v", "sigma"), [((10, 0), (0.5, 0.2)), ((3, -4), (0.1, 0.3)), ((-6, 6), (0.2, 0.2))])
def test_bounds_of_track_speed_and_climb_hold_95_percent(v, sigma):
    row = np.zeros(1, SOLUTION)
    row["status"], row["q_nb"] = POSITION_VALID, (1.0, 0.0, 0.0, 0.0)
    row["v"], row["sigma_v"] = (*v, -0.5), (*sigma, 0.3)
    track, speed, climb, epd, eps, epc = _motion(decode(row.tobytes()))
    samples = np.random.default_rng(2).normal(size=(400_000, 3)) * (*sigma, 0.3) + (*v, -0.5)
    tracks = np.degrees(np.arctan2(samples[:, 1], samples[:, 0]))
    assert np.mean(np.abs((tracks - track + 180.0) % 360.0 - 180.0) < epd) == pytest.approx(0.95, abs=0.005)
    assert np.mean(np.abs(np.hypot(samples[:, 0], samples[:, 1]) - speed) < eps) == pytest.approx(0.95, abs=0.005)
    assert np.mean(np.abs(-samples[:, 2] - climb) < epc) == pytest.approx(0.95, abs=0.005)


@given(st.floats(0.0, 4e9))
def test_time_is_iso_8601_to_the_microsecond(utc_s):
    text = iso(utc_s)
    parsed = datetime.datetime.strptime(text, '"%Y-%m-%dT%H:%M:%S.%fZ"').replace(tzinfo=datetime.UTC)
    assert abs((parsed - datetime.datetime.fromtimestamp(utc_s, datetime.UTC)).total_seconds()) <= 1e-6


@pytest.mark.parametrize("utc_s", [None, math.nan, math.inf, -1.0, 1e18])
def test_impossible_times_are_unknown(utc_s):
    assert iso(utc_s) == ""


def test_time_carries_into_the_next_second():
    assert iso(1774267220.9999999) == '"2026-03-23T12:00:21.000000Z"'
