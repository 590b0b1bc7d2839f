"""Goldens of the navigation filter: poses and velocities of other systems."""

from dataclasses import replace

import numpy as np
from golden_data import RATE, data, navigated, random, road
from golden_run import golden
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Aiding, Initial, Settings
from imud.estimators.records import BODY_VELOCITY_SOURCE, HEADING_SOURCE, MEASUREMENT, POSE_SOURCE, VELOCITY_SOURCE


def external(d, kind, seed, every_s=0.1):
    """(rng, indices of the samples, MEASUREMENT rows) of another system; every other has its sigma left out."""
    step, rng = round(every_s * RATE), random(seed)
    k = np.arange(step, len(d.t), step)
    rows = np.zeros(len(k), MEASUREMENT)
    rows["t_ns"] = np.round(1e9 * (100.0 + d.t[k]))
    rows["arrival_ns"] = rows["t_ns"] + np.round(1e9 * (0.02 + 0.3 * rng.rand(len(k)))).astype(np.int64)
    rows["kind"], rows["value"], rows["sigma"] = kind, np.nan, np.nan
    return rng, k, rows


def poses(d, seed, arm):
    """Poses of 0.1 m and 1 deg; some without height or yaw."""
    rng, k, rows = external(d, POSE_SOURCE, seed)
    p, e = d.attitude[k].apply(arm), 0.1 * rng.standard_normal((len(k), 3))
    rows["value"][:, 0] = d.lat[k] + (p[:, 0] + e[:, 0]) / 6.37e6
    rows["value"][:, 1] = d.lon[k] + (p[:, 1] + e[:, 1]) / (6.38e6 * np.cos(d.lat[k]))
    rows["value"][:, 2] = d.height[k] - p[:, 2] - e[:, 2]
    rows["value"][:, 3] = d.attitude.as_euler("ZYX")[k, 0] + 0.02 * rng.standard_normal(len(k))
    rows["sigma"][::2] = 0.15, 0.15, 0.15, 0.02
    rows["value"][::7, 2], rows["value"][::5, 3] = np.nan, np.nan
    return rows


@golden("navigation")
def pose():
    """Beside a receiver, which is lost; the poses jump for some seconds, then singly ever farther, then stand still."""
    d, arm = road(120.0), (0.5, 0.2, -1.0)
    samples, fixes = data(d, seed=71)
    rows = poses(d, 72, arm)
    t = rows["t_ns"] * 1e-9 - 100.0
    rows["value"][(t > 60.0) & (t < 70.0), 0] += 12.0 / 6.37e6
    near = (t > 74.0) & (t < 88.0) & (np.arange(len(t)) % 6 == 0)
    rows["value"][near, 0] += np.linspace(0.9, 1.5, near.sum()) / 6.37e6
    rows["value"][(t > 90.0) & (t < 92.0)] = rows["value"][np.searchsorted(t, 90.0)]
    rows["value"][(t > 100.0) & (t < 101.0), 1] = np.nan
    gone = (fixes["t_ns"] > 150e9) & (fixes["t_ns"] < 195e9)
    settings = Settings(aiding=Aiding(pose_lever_arm_m=arm))
    return replace(navigated(samples, fixes[~gone]), settings=settings, measurements=rows)


@golden("navigation")
def pose_of_a_map_that_is_turned():
    """The yaw gives the heading at rest; the map is put right under way, and trusted after half a minute."""
    d = road(100.0)
    samples, fixes = data(d, seed=91)
    rows = poses(d, 92, (0.0, 0.0, 0.0))
    rows["value"][rows["t_ns"] < 150e9, 3] += 0.5
    return replace(navigated(samples, fixes), measurements=rows)


@golden("navigation")
def pose_alone():
    """There is no receiver; at first longitude and yaw are not known."""
    d, arm = road(60.0), (0.5, 0.2, -1.0)
    samples, fixes = data(d, seed=73)
    rows = poses(d, 74, arm)
    rows["value"][:30, 3], rows["value"][:5, 1] = np.nan, np.nan
    rows["value"][100:104, 0] += 5.0 / 6.37e6
    settings = Settings(aiding=Aiding(pose_lever_arm_m=arm))
    return replace(navigated(samples, fixes[:0]), settings=settings, measurements=rows)


@golden("navigation")
def pose_jump_that_stays():
    """There is no receiver; the poses jump by 3 m for good, are rejected, and return when the estimate is less sure."""
    d = road(100.0)
    samples, fixes = data(d, seed=81)
    rows = poses(d, 82, (0.0, 0.0, 0.0))
    rows["value"][rows["t_ns"] > 150e9, 0] += 3.0 / 6.37e6
    return replace(navigated(samples, fixes[:0]), measurements=rows)


@golden("navigation")
def pose_without_yaw():
    """There is no receiver; the heading is given, and the poses have none."""
    d = road(60.0)
    samples, fixes = data(d, seed=79)
    rows = poses(d, 80, (0.0, 0.0, 0.0))
    rows["value"][:, 3] = np.nan
    yaw = float(np.degrees(d.attitude.as_euler("ZYX")[0, 0])) + 3.0
    return replace(navigated(samples, fixes[:0], Initial(yaw_deg=yaw)), measurements=rows)


@golden("navigation")
def pose_of_which_no_yaw_is_known():
    """Its sigma is 180 deg, as of programs that write a large variance for what they do not measure."""
    d = road(40.0)
    samples, fixes = data(d, seed=97)
    rows = poses(d, 98, (0.0, 0.0, 0.0))
    rows["sigma"] = 10.0, 10.0, 10.0, np.pi
    return replace(navigated(samples, fixes), measurements=rows)


def external_velocities(kind, seed):
    """2 % too large, with jumps and repetitions, while the receiver is lost."""
    d, arm = road(120.0), (0.5, -0.4, 0.3)
    samples, fixes = data(d, seed=seed)
    rng, k, rows = external(d, kind, seed + 1)
    v = d.v[k] + d.attitude[k].apply(np.cross(d.w[k], arm))
    v = d.attitude[k].inv().apply(v) if kind == BODY_VELOCITY_SOURCE else v
    rows["value"][:, :3] = 1.02 * v + 0.1 * rng.standard_normal(v.shape)
    rows["sigma"][::2, :3], rows["value"][::5, 2] = 0.1, np.nan
    rows["value"][300:340, 0] += 3.0
    rows["value"][500:520] = rows["value"][500]
    rows["value"][600::9, 1] += np.linspace(0.0, 2.0, len(rows[600::9]))
    gone = (fixes["t_ns"] > 140e9) & (fixes["t_ns"] < 200e9)
    settings = Settings(aiding=Aiding(velocity_lever_arm_m=arm))
    return replace(navigated(samples, fixes[~gone]), settings=settings, measurements=rows)


@golden("navigation")
def external_velocity():
    """In north, east and down."""
    return external_velocities(VELOCITY_SOURCE, 75)


@golden("navigation")
def body_velocity():
    """In body axes."""
    return external_velocities(BODY_VELOCITY_SOURCE, 77)


@golden("navigation")
def body_velocity_of_a_sensor_that_is_turned():
    """By 25 deg, beside a compass that is off; for a while by 100 deg, when it is not used."""
    d = road(120.0)
    samples, fixes = data(d, seed=95)
    rng, k, rows = external(d, BODY_VELOCITY_SOURCE, 96)
    t = rows["t_ns"] * 1e-9 - 100.0
    for yaw_deg, use in ((25.0, (t < 50.0) | (t > 65.0)), (100.0, (t >= 50.0) & (t <= 65.0))):
        axes = Rotation.from_euler("ZYX", (yaw_deg, -4.0, 3.0), degrees=True)
        rows["value"][use, :3] = axes.inv().apply(d.attitude[k].inv().apply(d.v[k]))[use]
    rows["value"][:, :3] += 0.1 * rng.standard_normal((len(k), 3))
    _, k, compass = external(d, HEADING_SOURCE, 97, 0.5)
    compass["value"][:, 0] = d.attitude.as_euler("ZYX")[k, 0] + 0.1 + 0.02 * rng.standard_normal(len(k))
    gone = fixes["t_ns"] > 190e9
    return replace(
        navigated(samples, fixes[~gone]), measurements=np.sort(np.concatenate([rows, compass]), order="arrival_ns")
    )
