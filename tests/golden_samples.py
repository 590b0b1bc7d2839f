"""Goldens of the navigation filter: samples missing, damaged or saturated, and sensors that were switched off."""

import math
from dataclasses import replace

import numpy as np
from golden_data import HEADED, RATE, between, counted, data, moved, navigated, random, road, stop_and_go
from golden_run import golden
from navigation_simulation import received, sensed
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Imu
from imud.drivers.sample import POWER_ON, RECONNECTED, SUSPECT

G350 = Imu(profile="m-g350")


@golden("navigation")
def gaps():
    samples, fixes = data(seed=20)
    keep = ~between(samples, 50.0, 50.05) & ~between(samples, 60.0, 60.4) & ~between(samples, 75.0, 77.0)
    return navigated(samples[keep & ~between(samples, 95.0, 125.0)], fixes)


@golden("navigation")
def short_gaps():
    """About the longest that are not bridged."""
    samples, fixes = data(seed=86)
    keep = np.ones(len(samples), bool)
    for begin in range(40, 140, 7):
        keep &= ~between(samples, begin, begin + 0.1)
    return navigated(samples[keep], fixes)


def another_sensor(samples, begin):
    """From `begin` on, with the biases of its power-on."""
    after = between(samples, begin, 1e9)
    samples["w"][after] += (0.01, -0.005, 0.008)
    samples["f"][after] += (0.1, 0.05, -0.1)
    samples["flags"][np.flatnonzero(after)[0]] |= POWER_ON


@golden("navigation")
def power_on():
    """Under way, for a moment and for longer."""
    samples, fixes = data(seed=87)
    another_sensor(samples, 70.0)
    another_sensor(samples, 105.0)
    return navigated(samples[~between(samples, 69.8, 70.0) & ~between(samples, 102.0, 105.0)], fixes)


@golden("navigation")
def power_on_moved():
    """At a stop, mounted again with a tilt that is too large for the same attitude."""
    samples, fixes = data(stop_and_go(), seed=88)
    another_sensor(samples, 110.0)
    tilt, after = Rotation.from_euler("Y", 40.0, degrees=True), between(samples, 110.0, 1e9)
    samples["w"][after], samples["f"][after] = tilt.apply(samples["w"][after]), tilt.apply(samples["f"][after])
    return navigated(samples[~between(samples, 106.0, 110.0)], fixes)


@golden("navigation")
def reconnected():
    """A car in a bend and at a walking pace, the sensor turned the second time: what the course shows, and what not."""
    samples, fixes = data(road(speed=6.0), seed=90, every=0.5)
    for begin in (58.0, 92.0, 128.0):
        samples["flags"][np.flatnonzero(between(samples, begin, 1e9))[0]] |= RECONNECTED
    turn, after = Rotation.from_euler("Z", -30.0, degrees=True), between(samples, 92.0, 1e9)
    samples["w"][after], samples["f"][after] = turn.apply(samples["w"][after]), turn.apply(samples["f"][after])
    away = between(samples, 50.0, 58.0) | between(samples, 87.0, 92.0) | between(samples, 122.0, 128.0)
    return navigated(samples[~away], fixes, vehicle="land")


@golden("navigation")
def rest_gaps():
    """At stops: left alone; switched off; driving off meanwhile; elsewhere afterwards; turned and tilted."""
    samples, fixes = data(stop_and_go(), seed=91)
    another_sensor(samples, 112.0)
    for end in (70.0, 163.0, 191.0, 229.0):
        samples["flags"][np.flatnonzero(between(samples, end, 1e9))[0]] |= RECONNECTED
    turn, after = Rotation.from_euler("ZX", (-60.0, 1.0), degrees=True), between(samples, 229.0, 1e9)
    samples["w"][after], samples["f"][after] = turn.apply(samples["w"][after]), turn.apply(samples["f"][after])
    away = between(samples, 64.0, 70.0) | between(samples, 104.0, 112.0) | between(samples, 150.0, 163.0)
    away |= between(samples, 188.0, 191.0) | between(samples, 225.0, 229.0)
    return navigated(samples[~away], moved(fixes, 190.5, 1e9, 40.0))


@golden("navigation")
def long_gap():
    """Longer than is bridged."""
    samples, fixes = data(seed=21)
    return navigated(samples[~between(samples, 70.0, 110.0)], fixes, HEADED)


@golden("navigation")
def saturation():
    """A spin faster than the gyro's range, forces beyond the accelerometer's, and later a short one of each."""
    d, rng = road(), random(22)
    spin = np.interp(d.t, [80.0, 80.5, 82.5, 83.0], [0.0, 8.0, 8.0, 0.0])
    turn = Rotation.from_rotvec(np.column_stack([0 * d.t, 0 * d.t, np.cumsum(spin) / RATE]))
    spun = replace(d, attitude=d.attitude * turn, f=turn.inv().apply(d.f))
    spun.w = turn.inv().apply(d.w) + np.column_stack([0 * d.t, 0 * d.t, spin])
    samples, fixes = sensed(spun, rng), received(d, rng, late=0.2)
    samples["f"][between(samples, 60.0, 60.3), 0] += 40.0
    samples["w"][between(samples, 120.0, 120.2), 1] += 8.0
    for name, most in (("w", math.radians(300.0)), ("f", 3.0 * 9.80665)):
        samples[name] = np.clip(samples[name], -most, most)
    return navigated(samples, fixes, imu=G350)


def spoilt(seed, begin, end, faults):
    samples, fixes = data(seed=seed)
    counted(samples)
    k = np.flatnonzero(between(samples, begin, end))
    for name, axes, value in faults:
        samples[name][k[0] : k[-1] + 1, axes] = samples[name][k[0], axes] if value is None else value
    return navigated(samples, fixes, imu=G350)


@golden("navigation")
def no_rates():
    return spoilt(23, 80.0, 86.0, [("w", slice(None), None)])


@golden("navigation")
def no_rate_for_a_moment():
    return spoilt(24, 80.0, 80.4, [("w", 2, np.nan)])


@golden("navigation")
def no_forces():
    return spoilt(25, 80.0, 86.0, [("f", slice(None), 0.0)])


@golden("navigation")
def no_samples():
    """All that the sensor shows is false for a while."""
    return spoilt(26, 80.0, 86.0, [("w", slice(None), np.nan), ("f", slice(None), np.nan)])


@golden("navigation")
def damaged_samples():
    samples, fixes = data(seed=27)
    samples["w"][between(samples, 50.0, 50.2)] = np.nan
    samples["f"][between(samples, 90.0, 90.3)] = 1e9
    samples["flags"][between(samples, 90.0, 90.3)] = SUSPECT
    samples["flags"][:30] = SUSPECT
    samples["t_ns"][between(samples, 95.0, 95.1)] -= 1_000_000_000
    return navigated(samples, fixes)
