"""Goldens of the navigation filter: aiding sources."""

from dataclasses import replace

import numpy as np
from golden_data import RATE, data, navigated, random, road

from imud.configuration.settings import Aiding, Settings
from imud.estimators.records import BAROMETER_SOURCE, HEADING_SOURCE, MEASUREMENT, ODOMETER_SOURCE


def headings(d, seed, every_s=0.2, late_s=0.05, spread_s=0.0):
    """MEASUREMENT rows of a compass of 0.3 deg, known `late_s` to `late_s` + `spread_s` after their epochs."""
    step, rng = round(every_s * RATE), random(seed)
    t, yaw = d.t[step::step], d.attitude.as_euler("ZYX")[step::step, 0]
    rows = np.zeros(len(t), MEASUREMENT)
    rows["t_ns"] = np.round(1e9 * (100.0 + t))
    rows["arrival_ns"] = rows["t_ns"] + np.round(1e9 * (late_s + spread_s * rng.rand(len(t)))).astype(np.int64)
    rows["kind"], rows["sigma"] = HEADING_SOURCE, np.nan
    rows["value"][:, 0], rows["sigma"][::2, 0] = yaw + 0.005 * rng.standard_normal(len(t)), 0.005
    return rows


def compass():
    """From the start, at rest; a jump of 30 deg for 2 s, then single headings of unknown sigma ever farther off."""
    d = road(80.0, rest=30.0)
    rows = headings(d, seed=51)
    rows["value"][250:260, 0] += 0.5
    rows["value"][261:381:6, 0] += np.linspace(0.07, 0.12, 20)
    return replace(navigated(*data(d, seed=46)), measurements=rows)


def compass_in_any_order():
    d = road(60.0)
    return replace(navigated(*data(d, seed=47)), measurements=headings(d, seed=52, spread_s=1.5))


def compass_too_late():
    """Some come after the horizon; others are so many that the oldest are forgotten within it."""
    d = road(40.0)
    rows = headings(d, seed=53, every_s=0.01)
    rows["arrival_ns"][::7] += 1_900_000_000
    rows["arrival_ns"][::501] += 8_000_000_000
    rows["value"][3::100] = np.nan
    return replace(navigated(*data(d, seed=48)), measurements=rows)


def compass_behind_many_fixes():
    """A measurement comes when the alignment's sums of its time are kept no longer."""
    d = road(40.0)
    rows = headings(d, seed=54, every_s=1.0, late_s=0.8)
    return replace(navigated(*data(d, seed=49, every=0.02)), measurements=rows)


def readings(d, seed, every_s=0.1, late_s=0.05, spread_s=0.0, arm=(0.0, 0.0, 0.0)):
    """MEASUREMENT rows of a wheel at `arm`, m, whose reading is 2 % too large; every other tells its sigma."""
    step, rng = round(every_s * RATE), random(seed)
    v = d.attitude.inv().apply(d.v) + np.cross(d.w, arm)
    t, forward = d.t[step::step], v[step::step, 0]
    rows = np.zeros(len(t), MEASUREMENT)
    rows["t_ns"] = np.round(1e9 * (100.0 + t))
    rows["arrival_ns"] = rows["t_ns"] + np.round(1e9 * (late_s + spread_s * rng.rand(len(t)))).astype(np.int64)
    rows["kind"], rows["sigma"] = ODOMETER_SOURCE, np.nan
    rows["value"][:, 0], rows["sigma"][::2, 0] = 1.02 * forward + 0.05 * rng.standard_normal(len(t)), 0.05
    return rows


def odometer():
    """A wheel off the middle; it slips, and in an outage the sensor is shaken."""
    arm = (-1.0, 0.7, 0.0)
    d = road(120.0, swing=1.3)
    samples, fixes = data(d, seed=61)
    rows = readings(d, seed=62, arm=arm)
    t = rows["t_ns"] * 1e-9 - 100.0
    rows["value"][(t > 50.0) & (t < 52.0), 0] *= 1.4
    rows["value"][(t > 60.0) & (t < 75.0), 0] *= 1.5
    samples["f"][(d.t > 90.0) & (d.t < 91.0), 0] += 1.5
    gone = (fixes["t_ns"] > 182e9) & (fixes["t_ns"] < 212e9)
    settings = Settings(aiding=Aiding(odometer_lever_arm_m=arm))
    return replace(navigated(samples, fixes[~gone]), settings=settings, measurements=rows)


def odometer_without_sign():
    """It reverses, and tells no sign; the readings come late and in any order."""
    d = road(90.0, swing=1.6)
    rows = readings(d, seed=63, spread_s=1.0)
    rows["value"][:, 0] = np.abs(rows["value"][:, 0])
    return replace(navigated(*data(d, seed=64)), measurements=rows)


def odometer_against_a_drift():
    """The receiver drifts, and says so in its velocity, too; then it is where it was."""
    d = road(150.0)
    samples, fixes = data(d, seed=65)
    dt = np.maximum(fixes["t_ns"] * 1e-9 - 160.0, 0.0) * (fixes["t_ns"] < 220e9)
    fixes["lat"] += dt / 6.37e6
    v = fixes["speed"] * np.exp(1j * fixes["course"]) + (dt > 0.0)
    fixes["speed"], fixes["course"] = np.abs(v), np.angle(v)
    return replace(navigated(samples, fixes), measurements=readings(d, seed=66))


def barometer():
    """A door is opened and closed, then a window stays open; every other reading tells its sigma."""
    d, rng = road(120.0), random(67)
    rows = np.zeros(1199, MEASUREMENT)
    t, height = d.t[10::10][:1199], d.height[10::10][:1199]
    rows["t_ns"] = np.round(1e9 * (100.0 + t))
    rows["arrival_ns"] = rows["t_ns"] + np.round(1e9 * (0.02 + 0.5 * rng.rand(len(t)))).astype(np.int64)
    rows["kind"], rows["sigma"] = BAROMETER_SOURCE, np.nan
    rows["value"][:, 0], rows["sigma"][::2, 0] = height - 37.0 + 0.2 * rng.standard_normal(len(t)), 0.25
    rows["value"][(t > 50.0) & (t < 52.0), 0] -= 8.0
    rows["value"][t > 80.0, 0] += 12.0
    return replace(navigated(*data(d, seed=68)), measurements=rows)
