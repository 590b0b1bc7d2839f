"""Goldens of the navigation filter: aiding sources."""

from dataclasses import replace

import numpy as np
from golden_data import RATE, data, navigated, random, road, turned
from golden_external import external
from golden_run import golden
from navigation_simulation import received, sensed
from vehicle_simulation import vehicle

from imud.configuration.settings import Aiding, Navigation, Noise, Settings
from imud.drivers.sample import NO_RATE
from imud.estimators.records import (
    BAROMETER_SOURCE,
    HEADING_SOURCE,
    MAGNETOMETER_SOURCE,
    MEASUREMENT,
    ODOMETER_SOURCE,
)


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


@golden("navigation")
def compass():
    """From the start, at rest; a jump of 30 deg for 2 s, then single headings of unknown sigma ever farther off."""
    d = road(80.0, rest=30.0)
    rows = headings(d, seed=51)
    rows["value"][250:260, 0] += 0.5
    rows["value"][261:381:6, 0] += np.linspace(0.07, 0.12, 20)
    return replace(navigated(*data(d, seed=46)), measurements=rows)


@golden("navigation")
def compass_in_wrong_units():
    """Radians taken for degrees, from the start on; after a minute they are degrees."""
    d = road(140.0, rest=15.0)
    rows = headings(d, seed=55)
    early = rows["t_ns"] < 160e9
    rows["value"][early, 0] = np.radians(np.mod(rows["value"][early, 0], 2.0 * np.pi))
    rows["value"][520:530, 0] += 1.0
    return replace(navigated(*data(d, seed=56)), measurements=rows)


def mounted_wrong(boresight_sigma_deg="auto", from_s=0.0, **tuning):
    """A compass that is mounted wrong by 10 deg, and comes from that time on."""
    d = road(80.0, rest=15.0)
    rows = headings(d, seed=57)
    rows["value"][:, 0] += np.radians(10.0)
    aiding = Aiding(heading_boresight_sigma_deg=boresight_sigma_deg)
    recording = navigated(*data(d, seed=58), aiding=aiding, tuning=tuning)
    return replace(recording, measurements=rows[rows["t_ns"] > (100.0 + from_s) * 1e9])


@golden("navigation")
def compass_near_iron():
    """Of the vehicle: its deviation changes with the heading. Its headings pause twice, once on the way."""
    d = road(80.0, rest=15.0)
    rows = headings(d, seed=57)
    rows["value"][:, 0] += np.radians(20.0) * np.sin(rows["value"][:, 0] + 2.0)
    t = rows["t_ns"] * 1e-9 - 100.0
    return replace(navigated(*data(d, seed=58)), measurements=rows[(np.abs(t - 10.0) > 2.0) & (np.abs(t - 50.0) > 2.0)])


@golden("navigation")
def compass_that_stops():
    """It repeats its last heading for twenty seconds of a drive."""
    d = road(80.0, rest=15.0)
    rows = headings(d, seed=59)
    stopped = np.abs(rows["t_ns"] * 1e-9 - 150.0) < 10.0
    rows["value"][stopped, 0] = rows["value"][stopped, 0][0]
    return replace(navigated(*data(d, seed=60)), measurements=rows)


@golden("navigation")
def compass_mounted_wrong():
    """It is estimated as a boresight."""
    return mounted_wrong()


@golden("navigation")
def compass_mounted_wrong_though_known():
    """Motion contradicts the boresight that is stated: it is estimated as one of which nothing was known."""
    return mounted_wrong(boresight_sigma_deg=0.06)


@golden("navigation")
def compass_mounted_wrong_without_boresight():
    """No boresight explains it: what it has done to the estimate is removed, and it is left out."""
    return mounted_wrong(unknown_boresight_sigma=1e-3)


@golden("navigation")
def compass_that_comes_under_way():
    """Its first heading is outside the gate."""
    return mounted_wrong(boresight_sigma_deg=0.06, from_s=50.0)


@golden("navigation")
def compass_in_wrong_units_on_the_spot():
    """Radians taken for degrees: the headings do not turn with the vehicle."""
    d = turned(road(90.0, rest=1e3), 2.0 * np.sin(0.3 * np.maximum(np.arange(90 * RATE) / RATE - 20.0, 0.0)))
    rows = headings(d, seed=101)
    rows["value"][:, 0] = np.radians(np.mod(rows["value"][:, 0], 2.0 * np.pi))
    return replace(navigated(*data(d, seed=102)), measurements=rows)


@golden("navigation")
def compass_turned_round_on_a_boat():
    """By 180 deg: the alignment contradicts it before motion has confirmed it."""
    d = vehicle("boat", 11)
    rows = headings(d, seed=103)
    rows["value"][:, 0] += np.pi
    return replace(navigated(*data(d, seed=104)), measurements=rows)


@golden("navigation")
def compass_turned_at_rest():
    """For good, before any motion: the heading that it gave is given up."""
    d = road(50.0, rest=40.0)
    rows = headings(d, seed=59)
    rows["value"][75:, 0] += 0.7
    return replace(navigated(*data(d, seed=60)), measurements=rows)


@golden("navigation")
def compass_in_any_order():
    d = road(60.0)
    return replace(navigated(*data(d, seed=47)), measurements=headings(d, seed=52, spread_s=1.5))


@golden("navigation")
def compass_too_late():
    """Some come after the horizon; others are so many that the oldest are forgotten within it."""
    d = road(40.0)
    rows = headings(d, seed=53, every_s=0.01)
    rows["arrival_ns"][::7] += 1_900_000_000
    rows["arrival_ns"][::501] += 8_000_000_000
    rows["value"][3::100] = np.nan
    return replace(navigated(*data(d, seed=48)), measurements=rows)


@golden("navigation")
def compass_behind_many_fixes():
    """A measurement comes when the alignment's sums of its time are kept no longer."""
    d = road(40.0)
    rows = headings(d, seed=56, every_s=1.0, late_s=0.8)
    return replace(navigated(*data(d, seed=49, every=0.02)), measurements=rows)


@golden("navigation")
def compass_before_the_first_fix():
    """The receiver finds its first fix ten seconds after the first heading."""
    d = road(40.0)
    samples, fixes = data(d, seed=49)
    fixes = fixes[fixes["t_ns"] > fixes["t_ns"][0] + 10_000_000_000]
    return replace(navigated(samples, fixes), measurements=headings(d, seed=54))


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


@golden("navigation")
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


@golden("navigation")
def odometer_and_compass():
    """Both from the start; the compass is mounted wrong by 5 deg."""
    d = road(80.0, rest=15.0)
    compass = headings(d, seed=57)
    compass["value"][:, 0] += np.radians(5.0)
    rows = np.concatenate([readings(d, seed=62), compass])
    return replace(navigated(*data(d, seed=61)), measurements=rows[np.argsort(rows["arrival_ns"], kind="stable")])


@golden("navigation")
def odometer_without_sign():
    """It reverses, and tells no sign; the readings come late and in any order."""
    d = road(90.0, swing=1.6)
    rows = readings(d, seed=63, spread_s=1.0)
    rows["value"][:, 0] = np.abs(rows["value"][:, 0])
    return replace(navigated(*data(d, seed=64)), measurements=rows)


@golden("navigation")
def odometer_late():
    """Of 0.7 s from the middle on, without a time of its own; the receiver is lost, and comes back."""
    d = road(120.0, swing=1.3)
    samples, fixes = data(d, seed=91)
    rows = readings(d, seed=92)
    late = rows["t_ns"] > 145e9
    rows["arrival_ns"][late] = rows["t_ns"][late] + 700_000_000
    rows["t_ns"][late] = rows["arrival_ns"][late]
    gone = (fixes["t_ns"] > 185e9) & (fixes["t_ns"] < 205e9)
    return replace(navigated(samples, fixes[~gone]), measurements=rows)


@golden("navigation")
def odometer_faulty():
    """It stands still for a while, then reads 3 m/s too much, and so it does without a receiver."""
    d = road(130.0, swing=1.3)
    samples, fixes = data(d, seed=93)
    rows = readings(d, seed=94)
    t = rows["t_ns"] * 1e-9 - 100.0
    frozen = (t > 50.0) & (t < 62.0)
    rows["value"][frozen] = rows["value"][np.argmax(frozen)]
    for begin in (75.0, 110.0):
        rows["value"][(t > begin) & (t < begin + 9.0), 0] += 3.0
    gone = (fixes["t_ns"] > 200e9) & (fixes["t_ns"] < 225e9)
    return replace(navigated(samples, fixes[~gone]), measurements=rows)


@golden("navigation")
def odometer_against_a_drift():
    """The receiver drifts, and says so in its velocity, too; then it is where it was."""
    d = road(150.0)
    samples, fixes = data(d, seed=65)
    dt = np.maximum(fixes["t_ns"] * 1e-9 - 160.0, 0.0) * (fixes["t_ns"] < 220e9)
    fixes["lat"] += dt / 6.37e6
    v = fixes["speed"] * np.exp(1j * fixes["course"]) + (dt > 0.0)
    fixes["speed"], fixes["course"] = np.abs(v), np.angle(v)
    return replace(navigated(samples, fixes), measurements=readings(d, seed=66))


@golden("navigation")
def odometer_of_a_slow_vehicle_against_a_drift():
    """At walking pace in bends; the receiver drifts, and says so in its velocity, too."""
    d = road(110.0, speed=1.4, swing=1.3)
    samples, fixes = data(d, seed=95)
    dt = np.maximum(fixes["t_ns"] * 1e-9 - 180.0, 0.0)
    fixes["lat"] += dt / 6.37e6
    v = fixes["speed"] * np.exp(1j * fixes["course"]) + (dt > 0.0)
    fixes["speed"], fixes["course"] = np.abs(v), np.angle(v)
    return replace(navigated(samples, fixes), measurements=readings(d, seed=96))


@golden("navigation")
def odometer_against_a_drift_across():
    """On a straight road, at walking pace, the receiver drifts across it, and says so in its velocity, too."""
    d = road(150.0, speed=2.0, swing=0.2, straight_s=75.0)
    samples, fixes = data(d, seed=67)
    dt = np.maximum(fixes["t_ns"] * 1e-9 - 200.0, 0.0) * (fixes["t_ns"] < 230e9)
    across = np.arctan2(d.v[-1, 1], d.v[-1, 0]) + 0.5 * np.pi
    fixes["lat"] += 0.6 * dt * np.cos(across) / 6.37e6
    fixes["lon"] += 0.6 * dt * np.sin(across) / 4.27e6
    v = fixes["speed"] * np.exp(1j * fixes["course"]) + 0.6 * (dt > 0.0) * np.exp(1j * across)
    fixes["speed"], fixes["course"] = np.abs(v), np.angle(v)
    return replace(navigated(samples, fixes), measurements=readings(d, seed=68))


@golden("navigation")
def two_wheels():
    """An axle whose left wheel is 0.4 % larger; each wheel slips in turn, then the track is another one."""
    d = road(110.0, swing=1.3)
    samples, fixes = data(d, seed=83)
    rows, rng = readings(d, seed=84), random(85)
    v, t = rows["value"], rows["t_ns"] * 1e-9 - 100.0
    v[:, 1] = 1.5 * np.interp(t, d.t, d.w[:, 2]) + 0.004 * v[:, 0] + 0.03 * rng.standard_normal(len(t))
    for spins, side in (((t > 50.0) & (t < 54.0), 1.0), ((t > 60.0) & (t < 63.0), -1.0)):
        v[spins, 0] += 1.0
        v[spins, 1] += side * 2.0
    v[t > 85.0, 1] *= 2.0
    gone = (fixes["t_ns"] > 170e9) & (fixes["t_ns"] < 200e9)
    settings = Settings(aiding=Aiding(track_width_m=1.5))
    return replace(navigated(samples, fixes[~gone]), settings=settings, measurements=rows)


@golden("navigation")
def speed_through_water():
    """A ship's log in a current, while the receiver is lost; one reading in ten is far off."""
    d = road(100.0)
    samples, fixes = data(d, seed=81)
    rows = readings(d, seed=82, every_s=0.5)
    rows["value"][:, 0] += 0.6
    rows["value"][::10, 0] += 5.0
    rows["sigma"][:, 1] = 0.5
    gone = (fixes["t_ns"] > 150e9) & (fixes["t_ns"] < 185e9)
    return replace(navigated(samples, fixes[~gone]), measurements=rows)


@golden("navigation")
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


@golden("navigation")
def barometer_in_an_outage():
    """A window is opened, and there are no fixes to show it."""
    still = barometer()
    return replace(still, fixes=still.fixes[still.fixes["t_ns"] < 175e9])


@golden("navigation")
def barometer_of_another_height():
    """Its readings climb by 1.5 m/s on a level road, as they would of another scale on a hill."""
    golden = barometer()
    rows = golden.measurements
    t = rows["t_ns"] * 1e-9 - 100.0
    rows["value"][:, 0] += 1.5 * np.clip(t - 20.0, 0.0, 25.0)
    rows["sigma"] = 3.0
    return golden


EARTH = np.array([20.9e-6, 1.6e-6, 43.4e-6])  # T, NED
POOR = Noise(gyro_bias_instability_deg_per_h=900.0)


def fields(d, seed, every_s=0.1, iron=(0.8e-6, -0.6e-6, 0.5e-6)):
    """MEASUREMENT rows of a magnetometer with a little iron beside it; every other tells its sigma."""
    rng, k, rows = external(d, MAGNETOMETER_SOURCE, seed, every_s)
    noise = 0.3e-6 * rng.standard_normal((len(k), 3))
    rows["value"][:, :3] = d.attitude[k].inv().apply(EARTH) + np.array(iron) + noise
    rows["value"][:, 3:], rows["sigma"][::2, 0] = EARTH, 1.2e-6
    return rows


@golden("navigation")
def magnetometer():
    """It gives the heading at rest, and holds it without fixes; motors, steel and a bridge disturb it."""
    d = road(240.0, rest=15.0)
    samples, fixes = data(d, seed=81)
    samples["w"] += np.cumsum(4e-5 * random(82).standard_normal(samples["w"].shape), axis=0)
    rows = fields(d, 83)
    t = rows["t_ns"] * 1e-9 - 100.0
    rows["value"][(t > 1.0) & (t < 4.0), :3] *= 1.1
    rows["value"][(t > 100.0) & (t < 103.0), :3] *= np.linspace(1.0, 1.2, 30)[:, None][: ((t > 100) & (t < 103)).sum()]
    near = (t > 130.0) & (t < 150.0)
    rows["value"][near, :3] += np.repeat(random(84).standard_normal((near.sum(), 1)), 3, axis=1) * 1.5e-6
    rows["value"][(t > 170.0) & (t < 174.0), 2] += np.linspace(0.0, 1.2e-5, ((t > 170) & (t < 174)).sum())
    rows["value"][:, :3] *= 1.0 + 0.14 * np.interp(t, (180.0, 194.0, 208.0), (0.0, 1.0, 0.0))[:, None]
    rows["value"][:, :2] *= 1.0 - 0.38 * np.interp(t, (210.0, 222.0, 234.0), (0.0, 1.0, 0.0))[:, None]
    settings = Settings(aiding=Aiding(magnetometer=True), navigation=Navigation(vehicle="land"), noise=POOR)
    return replace(navigated(samples, fixes[fixes["t_ns"] < 150e9]), settings=settings, measurements=rows)


@golden("navigation")
def magnetometer_contradicted():
    """The field turns while the heading is known: it is not used until it has agreed for a while."""
    d = road(200.0, rest=15.0)
    samples, fixes = data(d, seed=85)
    samples["w"] += np.cumsum(4e-5 * random(86).standard_normal(samples["w"].shape), axis=0)
    rows = fields(d, 87)
    t = rows["t_ns"] * 1e-9 - 100.0
    turn = np.cos(0.6), np.sin(0.6)
    wrong = (t > 30.0) & (t < 34.0)
    x, y = rows["value"][wrong, 0].copy(), rows["value"][wrong, 1].copy()
    rows["value"][wrong, 0], rows["value"][wrong, 1] = turn[0] * x - turn[1] * y, turn[1] * x + turn[0] * y
    settings = Settings(
        aiding=Aiding(magnetometer=True),
        navigation=Navigation(vehicle="land", tuning={"mag_distrust_s": 60.0}),
        noise=POOR,
    )
    return replace(navigated(samples, fixes[fixes["t_ns"] < 160e9]), settings=settings, measurements=rows)


@golden("navigation")
def magnetometer_turned_from_the_start():
    """It starts with a field that is turned by 50 deg; the fixes contradict it, and the rates are lost for a while.

    Some readings are empty.
    """
    d = road(120.0, rest=15.0)
    rows = fields(d, 88)
    x, y = rows["value"][:, 0].copy(), rows["value"][:, 1].copy()
    rows["value"][:, 0], rows["value"][:, 1] = 0.64 * x - 0.77 * y, 0.77 * x + 0.64 * y
    rows["value"][::9, :3] = 0.0
    rows["sigma"][:40, 0] = 1e-5
    settings = Settings(aiding=Aiding(magnetometer=True))
    samples, fixes = data(d, seed=89)
    gone = (d.t >= 80.0) & (d.t < 82.5)
    samples["flags"][gone], samples["outage_s"][gone], samples["w"][gone] = NO_RATE, d.t[gone] - 80.0, np.nan
    return replace(navigated(samples, fixes), settings=settings, measurements=rows)


@golden("navigation")
def compass_and_a_wrong_lever_arm():
    """Of a survey, by a metre to the right."""
    d, rng = road(110.0, rest=15.0), random(89)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.2, sigma=0.01, white=0.01)
    fixes["sigma"], fixes["hdop"], fixes["quality"] = (0.02, 0.02, 0.04), np.nan, 4
    run = navigated(samples, fixes, lever_arm_m=(0.0, 1.0, 0.0))
    return replace(run, measurements=headings(d, seed=90))
