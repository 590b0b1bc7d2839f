"""Faults of the sensor through the pipeline into the navigation filter, on a drive: honest, and back soon."""

from dataclasses import replace

import numpy as np
import pytest
from navigation_runner import navigate
from navigation_simulation import Drive, Later, curvature, drive, errors, ideal_sensor, received, sensed
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Imu, Initial, Navigation, Settings
from imud.drivers.sample import LIMITED_RATE, SATURATED
from imud.estimators.records import ATTITUDE_VALID, COASTING, HEADING_VALID, POSITION_VALID, REJECTING

RATE = 100
D = Later(drive, 160.0)
LSB = np.radians(0.0125), 0.125e-3 * 9.80665
ALL = slice(None)
BEGIN, END = 90.0, 95.0


def at(seconds):
    return round(seconds * RATE)


def spoilt(faults):
    """Solutions of a drive in which `faults` (name of the column, axes, value or None for the last one) last 5 s."""
    rng = np.random.default_rng(1)
    samples, fixes = sensed(D, rng), received(D, rng, late=0.2)
    for name, lsb in zip("wf", LSB, strict=True):
        samples[name] = np.rint(samples[name] / lsb) * lsb
    for name, axes, value in faults:
        values = samples[name]
        values[at(BEGIN) : at(END), axes] = values[at(BEGIN), axes] if value is None else value
    return navigate(samples, fixes, Settings(imu=Imu(profile="m-g350")))[0]


@pytest.mark.parametrize("faults", [[("w", 2, None)], [("w", ALL, None), ("f", ALL, None)], [("w", 0, np.nan)]])
def test_without_rates_fixes_continue_and_the_attitude_is_aligned_again(faults):
    out = spoilt(faults)
    p, v, a = errors(D, out)
    status, since = out["status"], at(BEGIN)
    assert (np.abs(p[since:]) < 5.0 * out["sigma_p"][since:]).all()
    assert (np.abs(v[since:]) < 6.0 * out["sigma_v"][since:]).all()
    assert not (status[at(BEGIN + 1.2) : at(END)] & (ATTITUDE_VALID | HEADING_VALID)).any()
    assert (status[since:] & (POSITION_VALID | COASTING) == POSITION_VALID).all()
    assert (status[at(END + 3.0) :] & ATTITUDE_VALID).all()
    assert np.abs(a[at(END + 20.0) :, 2]).max() < np.radians(4.0)
    assert np.abs(p[at(END + 10.0) :]).max() < 6.0


@pytest.mark.parametrize("axes", [ALL, 1])
@pytest.mark.parametrize("value", [None, 0.0])
def test_without_forces_gyro_and_receiver_go_on(axes, value):
    out = spoilt([("f", axes, value)])
    p, v, a = errors(D, out)
    since = at(BEGIN)
    valid = ATTITUDE_VALID | HEADING_VALID | POSITION_VALID
    assert (out["status"][since:] & valid == valid).all()
    assert (np.abs(p[since:]) < 5.0 * out["sigma_p"][since:]).all()
    assert (np.abs(v[since:]) < 5.0 * out["sigma_v"][since:]).all()
    assert np.abs(a[since:]).max() < np.radians(1.0)


@pytest.mark.parametrize("vehicle", ["land", "free"])
def test_a_spin_beyond_the_range_of_the_gyro_leaves_no_false_heading(vehicle):
    """430 deg/s for 0.6 s, of which it shows 300: what it hides turns the sensor out of the direction of travel."""
    rng = np.random.default_rng(1)
    samples, fixes = sensed(D, rng), received(D, rng, late=0.2)
    rate, most = np.radians(430.0), np.radians(300.0)
    turned = np.clip(D.t - BEGIN, 0.0, 0.6) * rate
    spin = Rotation.from_rotvec(np.outer(turned, (0.0, 0.0, 1.0)))
    samples["w"], samples["f"] = spin.inv().apply(samples["w"]), spin.inv().apply(samples["f"])
    spinning = slice(at(BEGIN), at(BEGIN + 0.6))
    samples["w"][spinning, 2] = np.minimum(samples["w"][spinning, 2] + rate, most)
    beyond = samples["w"][:, 2] == most
    samples["flags"][beyond] |= LIMITED_RATE | SATURATED
    out, _, _ = navigate(samples, fixes, Settings(navigation=Navigation(vehicle=vehicle)))
    p, v, a = errors(replace(drive(160.0), attitude=D.attitude * spin), out)
    since = at(BEGIN)
    trusted = (out["status"][since:] & HEADING_VALID) > 0
    assert not trusted[at(0.6)]
    assert trusted[at(15.0) :].all()
    assert (np.abs(a[since:, 2]) < 5.0 * out["sigma_rpy"][since:, 2])[trusted].all()
    assert (np.abs(p[since:, :2]) < 5.0 * out["sigma_p"][since:, :2]).all()
    assert (np.abs(v[since:, :2]) < 5.0 * out["sigma_v"][since:, :2]).all()


def steep_turn(bank_deg=65.0, speed=70.0, begin=60.0, end=85.0, seconds=100.0):
    """An aircraft that flies gentle curves and then, in a steep level turn, pulls 2.4 g."""
    t = np.arange(round(seconds * RATE)) / RATE
    steep = np.clip((t - begin) / 3.0, 0.0, 1.0) * np.clip((end - t) / 3.0, 0.0, 1.0)
    gentle = 0.35 * np.sin(2.0 * np.pi * t / 25.0) * np.clip((begin - t) / 3.0, 0.0, 1.0)
    roll = gentle + np.radians(bank_deg) * steep**2 * (3.0 - 2.0 * steep)
    yaw = np.cumsum(9.8 * np.tan(roll) / speed) / RATE
    attitude = Rotation.from_euler("ZYX", np.column_stack([yaw, 0.0 * t, roll]))
    v = speed * np.column_stack([np.cos(yaw), np.sin(yaw), 0.0 * t])
    way, (north, east) = np.cumsum(v, axis=0) / RATE, curvature(np.radians(48.0))
    lat, lon = np.radians(48.0) + way[:, 0] / north, np.radians(11.0) + way[:, 1] / (east * np.cos(np.radians(48.0)))
    height = 1000.0 + 0.0 * t
    return Drive(t, lat, lon, height, v, attitude, *ideal_sensor(t, lat, height, v, attitude))


def test_a_steep_turn_is_no_fault_of_the_accelerometer():
    flight, rng = steep_turn(), np.random.default_rng(1)
    steep = slice(at(60.0), at(90.0))
    assert np.linalg.norm(flight.f[at(65.0) : at(80.0)], axis=1).min() > 2.2 * 9.8
    out, _, _ = navigate(sensed(flight, rng), received(flight, rng, every=0.2, late=0.1), initial=Initial(yaw_deg=0.0))
    p, v, a = errors(flight, out)
    valid = ATTITUDE_VALID | HEADING_VALID | POSITION_VALID
    assert (out["status"][steep] & valid == valid).all()
    assert (out["status"][steep] & REJECTING > 0).mean() < 0.05
    assert np.abs(p[steep, :2]).max() < 10.0
    assert np.abs(v[steep, :2]).max() < 2.0
    assert np.degrees(np.abs(a[steep])).max() < 5.0
