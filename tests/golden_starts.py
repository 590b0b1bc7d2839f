"""Goldens of the navigation filter: alignment under way, given values, and their errors."""

import numpy as np
from golden_data import HEADED, data, moved, navigated, random, road, seconds, silent, turned
from golden_run import golden
from navigation_simulation import received, sensed
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Initial


@golden("navigation")
def wrong_heading():
    samples, fixes = data(seed=28)
    return navigated(samples, fixes, Initial(yaw_deg=-120.0))


@golden("navigation")
def wrong_initial_position():
    samples, fixes = data(seed=29)
    return navigated(samples, fixes, replace_initial(HEADED, lat_deg=47.0, lon_deg=10.0))


@golden("navigation")
def uncertain_initial_heading():
    """The gyro's bias is not known as it starts under way, and the fixes come late: the given heading has grown old."""
    samples, fixes = data(road(rest=0.0, fast_start=True), seed=46)
    return navigated(samples, fixes[seconds(fixes) > 7.0], Initial(yaw_deg=70.0))


@golden("navigation")
def jump_before_heading():
    """It is no speed, as it was not felt."""
    samples, fixes = data(road(100.0, rest=30.0), seed=47, hdop=0.2, sigma=0.3, white=0.1)
    return navigated(samples, silent(moved(fixes, 25.0, 1e9, 40.0)))


@golden("navigation")
def start_in_free_fall():
    samples, fixes = data(road(60.0), seed=48)
    samples["f"][:40] *= 0.01
    return navigated(samples, fixes)


@golden("navigation")
def all_initial_values():
    d = road(80.0, rest=0.0, fast_start=True)
    samples, fixes = data(d, seed=30)
    given = {"lat_deg": 48.0, "lon_deg": 11.0, "height_m": 500.0, "roll_deg": 0.0, "pitch_deg": 0.0}
    given |= dict(zip(("vn_mps", "ve_mps", "vd_mps"), map(float, d.v[0]), strict=True))
    return navigated(
        samples, fixes[seconds(fixes) > 30.0], replace_initial(HEADED, **given), lever_arm_m=(1.0, 0.5, -1.0)
    )


def replace_initial(initial, **given):
    return Initial(**({name: getattr(initial, name) for name in initial.__struct_fields__} | given))


@golden("navigation")
def under_way():
    """With a gyro bias of several degrees per second."""
    d, rng = road(rest=0.0, fast_start=True), random(31)
    samples = sensed(d, rng, bg=tuple(np.radians((2.0, -1.0, 4.0))), ba=(0.2, -0.1, 0.1))
    return navigated(samples, received(d, rng, late=0.2))


@golden("navigation")
def under_way_without_velocity():
    samples, fixes = data(road(200.0, rest=0.0, fast_start=True), seed=32, white=0.5)
    return navigated(samples, silent(fixes))


@golden("navigation")
def no_fixes():
    """Curves without a receiver: only roll and pitch are known."""
    samples, fixes = data(road(60.0), seed=33)
    return navigated(samples, fixes[:0])


@golden("navigation")
def reversing():
    """Turns about its axle, ahead of which the sensor stands; forwards and in reverse."""
    samples, fixes = data(road(swing=1.8, arm=1.5), seed=34)
    return navigated(samples, fixes, vehicle="land")


@golden("navigation")
def slipping_start():
    """A land vehicle by its settings, whose nose swings ever less about its way."""
    d = road(120.0)
    angle = 1.2 * np.exp(-np.maximum(d.t - 10.0, 0.0) / 25.0) * np.sin(1.1 * d.t)
    samples, fixes = data(turned(d, angle), seed=70)
    return navigated(samples, fixes, vehicle="land")


@golden("navigation")
def slip_before_the_heading():
    """The sensor slips by 40 degrees in its mount while the heading is sought: a level force of 6 m/s^2."""
    samples, fixes = data(road(90.0, speed=3.0), seed=94)
    slipped = Rotation.from_euler("x", 40.0, degrees=True)
    k = seconds(samples) > 12.5
    for name in ("w", "f"):
        samples[name][k] = slipped.inv().apply(samples[name][k])
    return navigated(samples, fixes)


@golden("navigation")
def large_biases():
    """A gyro of the worst kind, and an accelerometer that does not weigh gravity, at rest at first."""
    samples, fixes = data(road(60.0, rest=12.0), seed=51)
    samples["w"] += np.radians([15.0, -12.0, 9.0])
    samples["f"][:, 2] += 0.6
    return navigated(samples, fixes)


@golden("navigation")
def large_vertical_bias_under_way():
    """It is beyond all frame rates of the bank; at first nothing but it turns."""
    samples, fixes = data(road(100.0, rest=0.0), seed=52)
    samples["w"] += np.radians([0.0, 0.0, -7.0])
    return navigated(samples, fixes)
