"""Recordings for the golden traces of the navigation filter: one for each class of fault, of motion and of receiver."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
from golden_run import Recording
from navigation_simulation import Drive, curvature, drive, ideal_sensor, received, sensed
from scipy.spatial.transform import Rotation

from drivers.sample import POWER_ON, SUSPECT
from imud.configuration.settings import Imu, Initial, Navigation, Settings
from imud.estimators.records import HEADING_SOURCE, MEASUREMENT

RATE = 100
HEADED = Initial(yaw_deg=math.degrees(0.7))  # how a `drive` begins
LSB = math.radians(0.0125), 0.125e-3 * 9.80665  # of the M-G350
G350 = Imu(profile="m-g350")


@cache
def road(seconds=150.0, **how):
    """A drive; treat it as constant."""
    return drive(seconds, RATE, **how)


def random(seed):
    return np.random.RandomState(seed)  # its stream never changes (NEP 19)


def data(d=None, seed=1, late=0.2, **how):
    """(samples, fixes) of a consumer sensor and a receiver on a drive."""
    d, rng = d or road(), random(seed)
    return sensed(d, rng), received(d, rng, late=late, **how)


def seconds(rows):
    """Time in s since the start of a drive."""
    return rows["t_ns"] * 1e-9 - 100.0


def between(rows, begin, end):
    t = seconds(rows)
    return (t >= begin - 1e-6) & (t < end - 1e-6)


def silent(fixes):
    """From a receiver that does not measure velocity."""
    fixes = fixes.copy()
    fixes["speed"] = fixes["course"] = np.nan
    return fixes


def moved(fixes, begin, end, metres, per_second=0.0):
    """With a false position to the north from `begin` to `end`."""
    fixes, these = fixes.copy(), between(fixes, begin, end)
    fixes["lat"][these] += (metres + per_second * (seconds(fixes)[these] - begin)) / 6.37e6
    return fixes


def navigated(samples, fixes, initial=Initial(), imu=Imu(), **navigation):  # noqa: B008
    settings = Settings(imu=imu, navigation=Navigation(**navigation))
    return Recording("navigation", samples, fixes, settings, initial)


def no_velocity():
    samples, fixes = data(seed=2)
    return navigated(samples, silent(fixes))


def jump():
    """100 m that stay, against the velocity that the receiver measures."""
    samples, fixes = data()
    return navigated(samples, moved(fixes, 90.0, 1e9, 100.0))


def short_jump():
    samples, fixes = data(seed=3)
    return navigated(samples, moved(fixes, 90.0, 96.0, 300.0))


def jump_without_velocity():
    """After an outage, which leaves nothing to vouch for the velocity."""
    samples, fixes = data(seed=4)
    fixes = silent(moved(fixes, 95.0, 1e9, 500.0))
    return navigated(samples, fixes[~between(fixes, 80.0, 95.0)], HEADED)


def jump_of_height():
    samples, fixes = data(seed=5)
    fixes["height"][between(fixes, 90.0, 1e9)] += 60.0
    return navigated(samples, fixes)


def no_height():
    samples, fixes = data(seed=6)
    fixes["height"][~between(fixes, 60.0, 65.0)] = np.nan
    return navigated(samples, fixes)


def slow_drift():
    """Of the positions alone, at 1 m/s, which is found by what it does to the innovations."""
    samples, fixes = data(seed=1)
    return navigated(samples, silent(moved(fixes, 90.0, 125.0, 0.0, per_second=1.0)))


def slow_drift_against_velocity():
    samples, fixes = data(seed=7)
    return navigated(samples, moved(fixes, 80.0, 115.0, 0.0, per_second=2.0), HEADED)


def slow_drift_parked():
    samples, fixes = data(road(rest=1e3), seed=8)
    return navigated(samples, silent(moved(fixes, 70.0, 110.0, 0.0, per_second=1.0)), HEADED)


def drift_that_stays():
    """The drift ends, and the positions stay where it has brought them."""
    samples, fixes = data(road(rest=1e3), seed=9)
    fixes = moved(moved(fixes, 60.0, 80.0, 0.0, per_second=3.0), 80.0, 1e9, 60.0)
    return navigated(samples, silent(fixes), HEADED)


def frozen_receiver():
    samples, fixes = data(seed=10)
    frozen = np.flatnonzero(between(fixes, 90.0, 115.0))
    for name in ("lat", "lon", "height", "speed", "course"):
        fixes[name][frozen] = fixes[name][frozen[0]]
    return navigated(samples, fixes)


def frozen_slow_receiver():
    """Five fixes a second that stand still, of a vehicle about as slow as it may be for that to show."""
    d = road(100.0, speed=2.6, swing=0.5)
    samples, fixes = data(d, seed=62, every=0.2)
    for begin in (40.0, 52.0, 64.0, 76.0):
        frozen = np.flatnonzero(between(fixes, begin, begin + 4.0))
        fixes["lat"][frozen], fixes["lon"][frozen] = fixes["lat"][frozen[0]], fixes["lon"][frozen[0]]
    return navigated(samples, fixes)


def two_jumps_without_velocity():
    samples, fixes = data(seed=63)
    fixes = silent(moved(moved(fixes, 80.0, 1e9, 300.0), 91.0, 1e9, 400.0))
    return navigated(samples, fixes, HEADED)


def graded_jumps():
    """Each for three seconds, ever farther."""
    samples, fixes = data(road(200.0), seed=64)
    for k, metres in enumerate(np.geomspace(4.0, 40.0, 14)):
        fixes = moved(fixes, 50.0 + 10.0 * k, 53.0 + 10.0 * k, metres)
    return navigated(samples, fixes, HEADED)


def graded_drifts():
    """Of a parked vehicle's positions, ever faster, each until it is far enough; and back."""
    samples, fixes = data(road(320.0, rest=1e3), seed=65)
    for k, speed in enumerate((0.3, 0.6, 1.2, 2.4, 4.5, 6.0)):
        fixes = moved(fixes, 60.0 + 40.0 * k, 80.0 + 40.0 * k, 0.0, per_second=speed)
    return navigated(samples, silent(fixes), HEADED)


def graded_drifts_under_way():
    """The same of a car; each stays for a while where it has come to."""
    samples, fixes = data(road(330.0), seed=66)
    for k, speed in enumerate((0.8, 1.6, 5.6)):
        begin = 60.0 + 90.0 * k
        fixes = moved(fixes, begin, begin + 20.0, 0.0, per_second=speed)
        fixes = moved(fixes, begin + 20.0, begin + 55.0, 20.0 * speed)
    return navigated(samples, silent(fixes), HEADED)


def survey_of_a_decimetre():
    """Whose fixes are just too uncertain for it to be one."""
    d, rng = road(80.0), random(67)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.5, sigma=0.08, white=0.05)
    fixes["arrival_ns"] = fixes["t_ns"]
    fixes["sigma"], fixes["hdop"] = (0.11, 0.11, 0.2), np.nan
    return navigated(samples, fixes)


def outage_before_heading():
    """After two fixes under way; what was matched until then is too old as they come back."""
    samples, fixes = data(road(100.0, rest=0.0, fast_start=True), seed=68)
    return navigated(samples, fixes[~between(fixes, 7.5, 29.5)])


def old_fixes():
    """About as old as may be used; none comes meanwhile."""
    samples, fixes = data(seed=69)
    fixes["arrival_ns"][between(fixes, 80.0, 81.0)] += 11_000_000_000
    fixes["arrival_ns"][between(fixes, 110.0, 111.0)] += 4_000_000_000
    fixes["t_ns"][between(fixes, 130.0, 131.0)] += 1_300_000_000
    return navigated(samples, fixes[~between(fixes, 81.0, 92.0) & ~between(fixes, 111.0, 115.0)], HEADED)


def drift_that_returns():
    """Slowly, of a parked vehicle's positions."""
    samples, fixes = data(road(200.0, rest=1e3), seed=82)
    fixes = moved(moved(fixes, 70.0, 110.0, 0.0, per_second=1.0), 110.0, 190.0, 40.0, per_second=-0.5)
    return navigated(samples, silent(fixes), HEADED)


def long_drift():
    """For longer than fixes are refused."""
    samples, fixes = data(road(200.0, rest=1e3), seed=83)
    return navigated(samples, silent(moved(fixes, 60.0, 1e9, 0.0, per_second=1.0)), HEADED)


def restless_receiver():
    """Its positions wander farther than it says, for minutes, and drift at last."""
    samples, fixes = data(road(330.0, rest=1e3), seed=84, sigma=5.0, tau=30.0)
    return navigated(samples, silent(moved(fixes, 280.0, 1e9, 0.0, per_second=1.5)), HEADED)


def restless_receiver_under_way():
    samples, fixes = data(road(330.0), seed=85, sigma=4.0, tau=20.0)
    return navigated(samples, silent(moved(fixes, 270.0, 1e9, 0.0, per_second=2.0)), HEADED)


def outage():
    samples, fixes = data(seed=11)
    return navigated(samples, fixes[~between(fixes, 90.0, 130.0)])


def latency():
    """0.4 s instead of the 0.15 s that are assumed, and a velocity that is 0.2 s older still."""
    d = road()
    rng = random(12)
    samples = sensed(d, rng)
    return navigated(samples, received(d, rng, late=0.4, stamp=0.25, lag=0.2), HEADED)


def late_fixes():
    """Some later than can be rewound, some out of order, some of the future, some that cannot be true."""
    samples, fixes = data(seed=13)
    t, odd = seconds(fixes), fixes["arrival_ns"]
    odd[between(fixes, 70.0, 80.0)] += 5_000_000_000
    odd[between(fixes, 100.0, 101.0)] += 1_500_000_000
    fixes["t_ns"][between(fixes, 110.0, 113.0)] += 3_000_000_000
    fixes["quality"][(t > 120.0) & (t < 123.0)] = 6
    fixes["lat"][(t > 125.0) & (t < 127.0)] = 2.0
    return navigated(samples, fixes, HEADED)


def rtk():
    """Centimetres whose epochs a survey's log states, ten a second, the antenna beside the sensor."""
    d, rng, lever = road(100.0), random(14), (0.5, -0.4, -1.0)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.2, sigma=0.01, white=0.01, stamp=0.02)
    k = np.searchsorted(100.0 + d.t, fixes["arrival_ns"] * 1e-9 - 1e-6)
    arm = d.attitude[k].apply(lever)
    fixes["lat"] += arm[:, 0] / 6.37e6
    fixes["lon"] += arm[:, 1] / (6.39e6 * np.cos(fixes["lat"]))
    fixes["height"] -= arm[:, 2]
    fixes["arrival_ns"] = fixes["t_ns"]
    fixes["sigma"], fixes["hdop"], fixes["quality"] = (0.02, 0.02, 0.04), np.nan, 4
    return navigated(samples, silent(fixes), lever_arm_m=lever)


def rtk_comes_and_goes():
    """By its quality alone: fixed, float, single, fixed."""
    d, rng = road(120.0), random(15)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.5, late=0.1, sigma=0.02, white=0.01)
    single = received(d, random(16), every=0.5, late=0.1)
    fixes["quality"] = 4
    fixes["quality"][between(fixes, 50.0, 65.0)] = 5
    fixes[between(fixes, 65.0, 85.0)] = single[between(single, 65.0, 85.0)]
    return navigated(samples, fixes)


def ned_velocity():
    """As modern receivers measure it, with sigmas of the position, five a second."""
    d, rng = road(100.0), random(17)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.2, late=0.08)
    k = np.searchsorted(100.0 + d.t, fixes["t_ns"] * 1e-9 - 1e-6)
    fixes["v"] = d.v[k] + 0.05 * rng.standard_normal((len(fixes), 3))
    fixes["sigma"], fixes["hdop"] = (1.2, 1.2, 2.0), np.nan
    return navigated(samples, fixes)


def sparse_fixes():
    """One every five seconds, without velocity or a word of their quality."""
    samples, fixes = data(seed=18, every=5.0)
    fixes["hdop"] = np.nan
    return navigated(samples, silent(fixes))


def positions_often():
    """Without velocity, more often than the velocity changes that they show can be told from noise."""
    samples, fixes = data(seed=49, every=0.7)
    return navigated(samples, silent(fixes))


def few_fixes():
    """Two; nobody asks for what rest told meanwhile, until there is more of it than is kept."""
    samples, fixes = data(road(rest=1e3), seed=50)
    return navigated(samples, fixes[[5, -5]], HEADED)


def contrary_velocity():
    """The receiver's course is false for a while: the filter gives its heading up, and finds it again."""
    samples, fixes = data(seed=19)
    fixes["course"][between(fixes, 70.0, 95.0)] += 1.6
    return navigated(samples, fixes, HEADED)


def gaps():
    samples, fixes = data(seed=20)
    keep = ~between(samples, 50.0, 50.05) & ~between(samples, 60.0, 60.4) & ~between(samples, 75.0, 77.0)
    return navigated(samples[keep & ~between(samples, 95.0, 125.0)], fixes)


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


def power_on():
    """Under way, for a moment and for longer."""
    samples, fixes = data(seed=87)
    another_sensor(samples, 70.0)
    another_sensor(samples, 105.0)
    return navigated(samples[~between(samples, 69.8, 70.0) & ~between(samples, 102.0, 105.0)], fixes)


def power_on_moved():
    """At a stop, mounted again with a tilt that is too large for the same attitude."""
    samples, fixes = data(stop_and_go(), seed=88)
    another_sensor(samples, 110.0)
    tilt, after = Rotation.from_euler("Y", 25.0, degrees=True), between(samples, 110.0, 1e9)
    samples["w"][after], samples["f"][after] = tilt.apply(samples["w"][after]), tilt.apply(samples["f"][after])
    return navigated(samples[~between(samples, 106.0, 110.0)], fixes)


def long_gap():
    """Longer than is bridged."""
    samples, fixes = data(seed=21)
    return navigated(samples[~between(samples, 70.0, 110.0)], fixes, HEADED)


def counted(samples):
    """As a sensor of whole counts shows it: one whose values stand still is then known to be frozen."""
    for name, lsb in zip("wf", LSB, strict=True):
        samples[name] = np.rint(samples[name] / lsb) * lsb
    return samples


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


def no_rates():
    return spoilt(23, 80.0, 86.0, [("w", slice(None), None)])


def no_rate_for_a_moment():
    return spoilt(24, 80.0, 80.4, [("w", 2, np.nan)])


def no_forces():
    return spoilt(25, 80.0, 86.0, [("f", slice(None), 0.0)])


def no_samples():
    """All that the sensor shows is false for a while."""
    return spoilt(26, 80.0, 86.0, [("w", slice(None), np.nan), ("f", slice(None), np.nan)])


def damaged_samples():
    samples, fixes = data(seed=27)
    samples["w"][between(samples, 50.0, 50.2)] = np.nan
    samples["f"][between(samples, 90.0, 90.3)] = 1e9
    samples["flags"][between(samples, 90.0, 90.3)] = SUSPECT
    samples["flags"][:30] = SUSPECT
    samples["t_ns"][between(samples, 95.0, 95.1)] -= 1_000_000_000
    return navigated(samples, fixes)


def wrong_heading():
    samples, fixes = data(seed=28)
    return navigated(samples, fixes, Initial(yaw_deg=-120.0))


def wrong_place():
    samples, fixes = data(seed=29)
    return navigated(samples, fixes, replace_initial(HEADED, lat_deg=47.0, lon_deg=10.0))


def vague_heading():
    """The gyro's bias is not known as it starts under way, and the fixes come late: the given heading has grown old."""
    samples, fixes = data(road(rest=0.0, fast_start=True), seed=46)
    return navigated(samples, fixes[seconds(fixes) > 7.0], Initial(yaw_deg=70.0))


def jump_before_heading():
    """It is no speed, as it was not felt."""
    samples, fixes = data(road(100.0, rest=30.0), seed=47, hdop=0.2, sigma=0.3, white=0.1)
    return navigated(samples, silent(moved(fixes, 25.0, 1e9, 40.0)))


def start_in_free_fall():
    samples, fixes = data(road(60.0), seed=48)
    samples["f"][:40] *= 0.01
    return navigated(samples, fixes)


def everything_given():
    d = road(80.0, rest=0.0, fast_start=True)
    samples, fixes = data(d, seed=30)
    given = {"lat_deg": 48.0, "lon_deg": 11.0, "height_m": 500.0, "roll_deg": 0.0, "pitch_deg": 0.0}
    given |= dict(zip(("vn_mps", "ve_mps", "vd_mps"), map(float, d.v[0]), strict=True))
    return navigated(
        samples, fixes[seconds(fixes) > 30.0], replace_initial(HEADED, **given), lever_arm_m=(1.0, 0.5, -1.0)
    )


def replace_initial(initial, **given):
    return Initial(**({name: getattr(initial, name) for name in initial.__struct_fields__} | given))


def under_way():
    """With a gyro bias of several degrees per second."""
    d, rng = road(rest=0.0, fast_start=True), random(31)
    samples = sensed(d, rng, bg=tuple(np.radians((2.0, -1.0, 4.0))), ba=(0.2, -0.1, 0.1))
    return navigated(samples, received(d, rng, late=0.2))


def under_way_without_velocity():
    samples, fixes = data(road(200.0, rest=0.0, fast_start=True), seed=32, white=0.5)
    return navigated(samples, silent(fixes))


def no_fixes():
    """Curves without a receiver: only roll and pitch are known."""
    samples, fixes = data(road(60.0), seed=33)
    return navigated(samples, fixes[:0])


def reversing():
    """Turns about its axle, ahead of which the sensor stands; forwards and in reverse."""
    samples, fixes = data(road(swing=1.8, arm=1.5), seed=34)
    return navigated(samples, fixes, vehicle="land")


def slipping_start():
    """A land vehicle by its settings, whose nose swings ever less about its way."""
    d = road(120.0)
    angle = 1.2 * np.exp(-np.maximum(d.t - 10.0, 0.0) / 25.0) * np.sin(1.1 * d.t)
    samples, fixes = data(turned(d, angle), seed=70)
    return navigated(samples, fixes, vehicle="land")


def ferry():
    """A car that a current sets off for some time, and that is a car again after."""
    d = road(330.0)
    angle = 0.5 * np.clip((d.t - 60.0) / 3.0, 0.0, 1.0) * np.clip((110.0 - d.t) / 3.0, 0.0, 1.0)
    samples, fixes = data(turned(d, angle * np.sin(0.15 * (d.t - 60.0))), seed=71)
    return navigated(samples, fixes)


def turned(d, angle):
    """The same way with the nose turned from it by `angle` (rad, of each moment)."""
    attitude = d.attitude * Rotation.from_rotvec(np.outer(angle, (0.0, 0.0, 1.0)))
    return Drive(d.t, d.lat, d.lon, d.height, d.v, attitude, *ideal_sensor(d.t, d.lat, d.height, d.v, attitude))


def boat():
    """It keeps to its axis for a minute, then a current sets it off."""
    d = road(180.0)
    angle = 0.5 * np.clip((d.t - 75.0) / 3.0, 0.0, 1.0) * np.sin(0.15 * (d.t - 75.0))
    samples, fixes = data(turned(d, angle), seed=35)
    return navigated(samples, fixes)


def free_craft():
    """Its nose turns about freely."""
    d = road(120.0)
    samples, fixes = data(turned(d, 2.5 * np.sin(0.2 * d.t)), seed=36)
    return navigated(samples, fixes)


def mounted_askew():
    """The sensor stands on its side, and is told so by nobody; it is a free vehicle by its settings at first."""
    d, rng = road(), random(37)
    samples = sensed(d, rng, mount=Rotation.from_euler("ZYX", (130.0, -20.0, 80.0), degrees=True).inv())
    return navigated(samples, received(d, rng, late=0.2))


def scale_factor():
    """The gyro shows 3 % too much of a turn, and has its axes out of line."""
    d, rng = road(), random(38)
    samples = sensed(d, rng)
    samples["w"] = samples["w"] @ np.array([[1.0, 0.01, 0.01], [0.0, 1.0, -0.01], [0.0, 0.0, 1.03]]).T
    return navigated(samples, received(d, rng, late=0.2))


def smooth(x, seconds, rate):
    kernel = np.hanning(round(2 * seconds * rate))
    return np.convolve(x, kernel / kernel.sum(), "same")


def flight():
    """A multicopter: idle motors, take-off, moves, hovering and an outage meanwhile."""
    rate, duration, aloft_s = 200, 100, 10.0
    rng = random(39)
    t = np.arange(duration * rate) / rate
    n, block = len(t), 3 * rate
    aloft = np.clip((t - aloft_s) / 2.0, 0.0, 1.0)
    free = aloft * (1.0 - np.clip((t - 45.0) / 2.0, 0.0, 1.0) * np.clip((65.0 - t) / 2.0, 0.0, 1.0))
    v = np.column_stack(
        [free * smooth(np.repeat(s * rng.standard_normal(n // block + 1), block)[:n], 0.8, rate) for s in (3, 3, 1)]
    )
    v[:, 2] -= smooth(((t > aloft_s) & (t < aloft_s + 3.0)).astype(float), 0.5, rate)
    yaw = 1.0 + aloft * smooth(np.repeat(rng.standard_normal(n // block + 1), block)[:n], 1.6, rate)
    level = Rotation.from_euler("Z", yaw[:, None]).inv().apply(np.gradient(v, t, axis=0))
    attitude = Rotation.from_euler("ZYX", np.column_stack([yaw, 0.01 - level[:, 0] / 9.8, level[:, 1] / 9.8 - 0.015]))
    way = np.cumsum(v, axis=0) / rate
    north, east = curvature(np.radians(48.0))
    lat, height = np.radians(48.0) + way[:, 0] / north, 500.0 - way[:, 2]
    lon = np.radians(11.0) + way[:, 1] / (east * np.cos(lat))
    d = Drive(t, lat, lon, height, v, attitude, *ideal_sensor(t, lat, height, v, attitude))
    motors = np.where(t < 3.0, 0.0, np.where(t < aloft_s, 0.25, 1.0))[:, None]
    tone = np.sin(2 * np.pi * 70.0 * t[:, None] + np.arange(3))
    rough = [np.diff(rng.standard_normal((n + 1, 3)), axis=0) for _ in range(2)]
    d.w, d.f = d.w + motors * (0.04 * tone + 0.02 * rough[0]), d.f + motors * (0.8 * tone + 0.5 * rough[1])
    samples, fixes = sensed(d, rng, bg=(0.01, -0.02, 0.01), ba=(0.2, 0.1, -0.2)), received(d, rng, late=0.2)
    return navigated(samples, fixes[~between(fixes, 75.0, 90.0)])


def hammered():
    """The sensor of a car that stands: the heading grows old without a turn, as all that shakes is noise."""
    samples, fixes = data(stop_and_go(), seed=61)
    shaken = np.flatnonzero(between(samples, 62.0, 78.0))
    samples["w"][shaken] += 10.0 * np.where(shaken % 2, -1.0, 1.0)[:, None]
    return navigated(samples, fixes)


def stops():
    """Stop and go; then the fixes end, and with them what tells that it stands."""
    d = stop_and_go()
    samples, fixes = data(d, seed=40)
    return navigated(samples, fixes[~between(fixes, 160.0, 1e9)])


@cache
def stop_and_go():
    """40 s each of driving and standing, its engine running."""
    t = np.arange(240 * RATE) / RATE
    go = smooth((((t + 20.0) % 40.0) > 20.0).astype(float), 2.0, RATE)
    heading = 0.7 + 0.9 * np.sin(0.05 * np.cumsum(go) / RATE)
    speed = 6.0 * go
    v = np.column_stack([speed * np.cos(heading), speed * np.sin(heading), 0 * t])
    m, n = curvature(np.radians(48.0))
    way = np.cumsum(v, axis=0) / RATE
    lat, height = np.radians(48.0) + way[:, 0] / m, np.full(len(t), 500.0)
    lon = np.radians(11.0) + way[:, 1] / (n * np.cos(lat))
    attitude = Rotation.from_euler("ZYX", np.column_stack([heading, 0 * t, 0 * t]))
    d = Drive(t, lat, lon, height, v, attitude, *ideal_sensor(t, lat, height, v, attitude))
    d.f += (0.05 + 0.3 * go)[:, None] * random(41).standard_normal(d.f.shape)
    d.w += (0.002 + 0.01 * go)[:, None] * random(42).standard_normal(d.w.shape)
    return d


def parked():
    """With a heading given; the receiver's latency and its sigmas have nothing to be learned from."""
    samples, fixes = data(road(rest=1e3), seed=43)
    return navigated(samples, fixes, HEADED)


def idling(seed, **how):
    """(samples, fixes) of a parked vehicle with its engine running, which shakes the sensor more than a parked one."""
    samples, fixes = data(road(rest=1e3), seed=seed, **how)
    samples["f"] += 0.1 * random(51).standard_normal(samples["f"].shape)
    return samples, fixes


def moored():
    """A boat that rocks and goes nowhere: there is no heading to be found in what a receiver's noise shows."""
    t = np.arange(100 * RATE) / RATE
    way = np.zeros((len(t), 3))
    place = np.full(len(t), np.radians(48.0)), np.full(len(t), np.radians(11.0)), np.full(len(t), 500.0)
    rocking = np.column_stack([0.7 + 0.05 * np.sin(0.3 * t), 0.03 * np.sin(0.9 * t), 0.08 * np.sin(1.1 * t)])
    attitude = Rotation.from_euler("ZYX", rocking)
    d = Drive(t, *place, way, attitude, *ideal_sensor(t, place[0], place[2], way, attitude))
    samples, fixes = data(d, seed=57, speed_sigma=0.4)
    return navigated(samples, fixes)


def turned_at_rest():
    """On a turntable: slowly, and as if the gyro's bias had changed."""
    samples, fixes = idling(52)
    samples["w"][between(samples, 50.0, 70.0), 2] += 0.02
    return navigated(samples, fixes, HEADED)


def force_that_creeps():
    """Slower than acceleration comes and goes: what the accelerometer shows at rest is no rest."""
    samples, fixes = idling(53)
    samples["f"][:, 0] += np.interp(seconds(samples), [50.0, 80.0, 90.0, 110.0], [0.0, 3.0, 3.0, 0.0])
    return navigated(samples, fixes, HEADED)


def graded_rest(seed, silent_receiver):
    """Steps of the gyro's bias, then noise of the forces, then of the rates, all about as large as at a rest."""
    samples, fixes = data(road(240.0, rest=1e3), seed=seed)
    rng, t = random(seed + 1), seconds(samples)
    level = np.interp(t, [20.0, 90.0], [0.0, 14.0]).astype(int)
    samples["w"][:, 2] += np.concatenate([[0.0], np.geomspace(1e-3, 5e-3, 14)])[level] * (level % 2) * (t < 90.0)
    samples["f"] += (
        rng.standard_normal(samples["f"].shape) * np.interp(t, [90, 91, 150, 151], [0, 0.01, 0.25, 0])[:, None]
    )
    samples["w"] += (
        rng.standard_normal(samples["w"].shape) * np.interp(t, [160, 161, 220, 221], [0, 1e-3, 8e-3, 0])[:, None]
    )
    return navigated(samples, silent(fixes) if silent_receiver else fixes, HEADED)


def disturbed_rest():
    return graded_rest(72, False)


def disturbed_rest_without_velocity():
    return graded_rest(74, True)


def disturbed_rest_before_heading():
    recording = graded_rest(76, True)
    return replace(recording, initial=Initial())


def rest_in_an_outage():
    """Of what may move anywhere, so that its velocity drifts: what was learned of rest and of slow motion tells."""
    samples, fixes = data(stop_and_go(), seed=78)
    return navigated(samples, fixes[~between(fixes, 165.0, 1e9)], vehicle="free")


def wrong_heading_by(degrees, seed):
    samples, fixes = data(seed=seed)
    return navigated(samples, fixes, Initial(yaw_deg=math.degrees(0.7) + degrees))


def heading_a_little_wrong():
    return wrong_heading_by(35.0, 79)


def heading_just_wrong():
    return wrong_heading_by(24.0, 80)


def step_of_the_bias_at_rest():
    """So still that it can be nothing else."""
    samples, fixes = data(road(rest=1e3), seed=54)
    samples["w"][between(samples, 60.0, 1e9), 2] += 0.03
    samples["w"][between(samples, 110.0, 1e9), 0] -= 0.03
    return navigated(samples, fixes, HEADED)


def lift():
    """Straight up and down, with the settings of a land vehicle."""
    t = np.arange(80 * RATE) / RATE
    climb = 3.0 * smooth(((t % 40.0) > 20.0) * np.sign(40.0 - t), 1.0, RATE)
    v = np.column_stack([0 * t, 0 * t, -climb])
    lat, lon = np.full(len(t), np.radians(48.0)), np.full(len(t), np.radians(11.0))
    attitude = Rotation.from_euler("ZYX", np.column_stack([0 * t + 0.7, 0 * t, 0 * t]))
    height = 500.0 + np.cumsum(climb) / RATE
    samples, fixes = data(Drive(t, lat, lon, height, v, attitude, *ideal_sensor(t, lat, height, v, attitude)), seed=55)
    k = np.searchsorted(100.0 + t, fixes["t_ns"] * 1e-9 - 1e-6)
    fixes["v"] = v[k] + 0.02 * random(56).standard_normal((len(fixes), 3))
    return navigated(samples, fixes, HEADED, vehicle="land")


def pole():
    d = drive(60.0, lat_deg=89.9999)
    samples, fixes = data(d, seed=44)
    fixes["lat"] = np.minimum(fixes["lat"], 0.5 * np.pi)
    return navigated(samples, fixes, HEADED)


def date_line():
    d = drive(80.0, lat_deg=10.0, lon_deg=179.9999)
    samples, fixes = data(d, seed=45)
    fixes["lon"] = (fixes["lon"] + np.pi) % (2 * np.pi) - np.pi
    return navigated(samples, fixes)


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
    """From the start, at rest; a jump of 30 deg for 2 s."""
    d = road(80.0, rest=30.0)
    rows = headings(d, seed=51)
    rows["value"][250:260, 0] += 0.5
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


CLASSES = (
    compass, compass_in_any_order, compass_too_late, compass_behind_many_fixes,
    drift_that_returns, long_drift, restless_receiver, restless_receiver_under_way, short_gaps, power_on,
    power_on_moved, no_velocity, jump, short_jump, jump_without_velocity, jump_of_height, no_height, slow_drift,
    slow_drift_against_velocity, slow_drift_parked, drift_that_stays, frozen_receiver, outage, latency, late_fixes,
    rtk, rtk_comes_and_goes, ned_velocity, sparse_fixes, positions_often, few_fixes, contrary_velocity, gaps,
    long_gap, saturation, no_rates, no_rate_for_a_moment, no_forces, no_samples, damaged_samples, wrong_heading,
    wrong_place, vague_heading, jump_before_heading, start_in_free_fall, everything_given, under_way,
    under_way_without_velocity, no_fixes, reversing, boat, free_craft, mounted_askew, scale_factor, flight,
    hammered, stops, parked, turned_at_rest, frozen_slow_receiver, two_jumps_without_velocity, graded_jumps,
    graded_drifts, graded_drifts_under_way, survey_of_a_decimetre, outage_before_heading, old_fixes, slipping_start,
    ferry, disturbed_rest, disturbed_rest_without_velocity, disturbed_rest_before_heading, rest_in_an_outage,
    heading_a_little_wrong, heading_just_wrong, force_that_creeps, moored, step_of_the_bias_at_rest, lift, pole,
    date_line,
)  # fmt: skip
