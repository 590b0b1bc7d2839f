"""Goldens of the navigation filter: aiding sources."""

from dataclasses import replace

import numpy as np
from golden_data import RATE, data, navigated, random, road

from imud.estimators.records import HEADING_SOURCE, MEASUREMENT


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
