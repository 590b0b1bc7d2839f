"""Goldens of the navigation filter: boats, flight, vibration, rest, and the ends of the map."""

import math
from dataclasses import replace

import numpy as np
from golden_data import (
    HEADED,
    RATE,
    between,
    data,
    navigated,
    random,
    road,
    seconds,
    silent,
    smooth,
    stop_and_go,
    turned,
)
from golden_run import golden
from navigation_simulation import Drive, curvature, drive, ideal_sensor, received, sensed
from scipy.spatial.transform import Rotation
from vehicle_simulation import vehicle

from imud.configuration.settings import Initial


@golden("navigation")
def ferry():
    """A car that a current sets off for some time, and that is a car again after."""
    d = road(330.0)
    angle = 0.5 * np.clip((d.t - 60.0) / 3.0, 0.0, 1.0) * np.clip((110.0 - d.t) / 3.0, 0.0, 1.0)
    samples, fixes = data(turned(d, angle * np.sin(0.15 * (d.t - 60.0))), seed=71)
    return navigated(samples, fixes)


@golden("navigation")
def boat():
    """It keeps to its axis for a minute, then a current sets it off."""
    d = road(180.0)
    angle = 0.5 * np.clip((d.t - 75.0) / 3.0, 0.0, 1.0) * np.sin(0.15 * (d.t - 75.0))
    samples, fixes = data(turned(d, angle), seed=35)
    return navigated(samples, fixes)


@golden("navigation")
def free_craft():
    """Its nose turns about freely."""
    d = road(120.0)
    samples, fixes = data(turned(d, 2.5 * np.sin(0.2 * d.t)), seed=36)
    return navigated(samples, fixes)


@golden("navigation")
def mounted_on_its_side():
    """The sensor stands on its side, and is told so by nobody; it is a free vehicle by its settings at first."""
    d, rng = road(), random(37)
    samples = sensed(d, rng, mount=Rotation.from_euler("ZYX", (130.0, -20.0, 80.0), degrees=True).inv())
    return navigated(samples, received(d, rng, late=0.2))


@golden("navigation")
def scale_factor():
    """The gyro shows 3 % too much of a turn, and has its axes out of line."""
    d, rng = road(), random(38)
    samples = sensed(d, rng)
    samples["w"] = samples["w"] @ np.array([[1.0, 0.01, 0.01], [0.0, 1.0, -0.01], [0.0, 0.0, 1.03]]).T
    return navigated(samples, received(d, rng, late=0.2))


@golden("navigation")
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


@golden("navigation")
def vibrating_gyro_at_rest():
    """The sensor of a car that stands: the heading grows old without a turn, as all that shakes is noise."""
    samples, fixes = data(stop_and_go(), seed=61)
    shaken = np.flatnonzero(between(samples, 62.0, 78.0))
    samples["w"][shaken] += 10.0 * np.where(shaken % 2, -1.0, 1.0)[:, None]
    return navigated(samples, fixes)


@golden("navigation")
def stops():
    """Stop and go; then the fixes end, and with them what tells that it stands."""
    d = stop_and_go()
    samples, fixes = data(d, seed=40)
    return navigated(samples, fixes[~between(fixes, 160.0, 1e9)])


@golden("navigation")
def parked():
    """With a heading given; the receiver's latency and its sigmas have nothing to be learned from."""
    samples, fixes = data(road(rest=1e3), seed=43)
    return navigated(samples, fixes, HEADED)


def idling(seed, **how):
    """(samples, fixes) of a parked vehicle with its engine running, which shakes the sensor more than a parked one."""
    samples, fixes = data(road(rest=1e3), seed=seed, **how)
    samples["f"] += 0.1 * random(51).standard_normal(samples["f"].shape)
    return samples, fixes


@golden("navigation")
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


@golden("navigation")
def turned_at_rest():
    """On a turntable: slowly, and as if the gyro's bias had changed."""
    samples, fixes = idling(52)
    samples["w"][between(samples, 50.0, 70.0), 2] += 0.02
    return navigated(samples, fixes, HEADED)


@golden("navigation")
def slow_change_of_force():
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


@golden("navigation")
def disturbed_rest():
    return graded_rest(72, False)


@golden("navigation")
def disturbed_rest_without_velocity():
    return graded_rest(74, True)


@golden("navigation")
def disturbed_rest_before_heading():
    recording = graded_rest(76, True)
    return replace(recording, initial=Initial())


@golden("navigation")
def rest_in_an_outage():
    """Of what may move anywhere, so that its velocity drifts: what was learned of rest and of slow motion tells."""
    samples, fixes = data(stop_and_go(), seed=78)
    return navigated(samples, fixes[~between(fixes, 165.0, 1e9)], vehicle="free")


def wrong_heading_by(degrees, seed):
    samples, fixes = data(seed=seed)
    return navigated(samples, fixes, Initial(yaw_deg=math.degrees(0.7) + degrees))


@golden("navigation")
def heading_a_little_wrong():
    return wrong_heading_by(35.0, 79)


@golden("navigation")
def heading_just_wrong():
    return wrong_heading_by(24.0, 80)


@golden("navigation")
def boat_with_a_wrong_heading():
    """Its slow changes of speed let the filter explain much of what contradicts the heading."""
    d = vehicle("boat", 1)
    samples, fixes = data(d, seed=79)
    return navigated(samples, fixes, Initial(yaw_deg=float(np.degrees(d.attitude[0].as_euler("ZYX")[0])) + 180.0))


@golden("navigation")
def sensor_knocked():
    """It turns in its mount while nothing is measured: the heading is wrong from one sample to the next."""
    samples, fixes = data(seed=79)
    later, turn = between(samples, 60.0, math.inf), Rotation.from_euler("z", 40.0, degrees=True)
    for name in ("w", "f"):
        samples[name][later] = turn.inv().apply(samples[name][later])
    return navigated(samples, fixes)


@golden("navigation")
def sensor_tilted_with_positions_alone():
    """It slips by 30 degrees about its lateral axis: the estimate flies away from the positions."""
    samples, fixes = data(road(speed=12.0), seed=79, sigma=1.5, white=0.1)
    later, turn = between(samples, 80.0, math.inf), Rotation.from_euler("y", 30.0, degrees=True)
    for name in ("w", "f"):
        samples[name][later] = turn.inv().apply(samples[name][later])
    return navigated(samples, silent(fixes), vehicle="free")


@golden("navigation")
def step_of_the_biases_in_positions_alone():
    """Of the gyro about the longitudinal axis, then of the accelerometers: seen late, and by either sensor."""
    samples, fixes = data(road(speed=12.0), seed=56)
    samples["w"][between(samples, 80.0, 1e9), 0] += 0.015
    samples["f"][between(samples, 120.0, 1e9), 1] += 0.6
    return navigated(samples, silent(fixes), vehicle="free")


@golden("navigation")
def step_of_the_bias_at_rest():
    """So still that it can be nothing else."""
    samples, fixes = data(road(rest=1e3), seed=54)
    samples["w"][between(samples, 60.0, 1e9), 2] += 0.03
    samples["w"][between(samples, 110.0, 1e9), 0] -= 0.03
    return navigated(samples, fixes, HEADED)


@golden("navigation")
def step_of_the_bias_in_an_outage():
    """The tilt is lost, and the fixes begin the estimate anew."""
    samples, fixes = data(road(speed=12.0), seed=55)
    samples["w"][between(samples, 60.0, 1e9), 0] += 0.03
    return navigated(samples, fixes[~between(fixes, 60.0, 110.0)], HEADED, vehicle="free")


@golden("navigation")
def step_of_the_bias_before_the_heading():
    """As above, but no heading is known that it would have turned."""
    samples, fixes = data(road(rest=1e3), seed=54)
    samples["w"][between(samples, 60.0, 1e9), 2] += 0.03
    return navigated(samples, fixes)


@golden("navigation")
def step_of_the_bias_under_way():
    """Of a free craft: its heading turns away."""
    samples, fixes = data(road(speed=12.0), seed=55, every=0.5)
    samples["w"][between(samples, 80.0, 1e9), 2] += 0.015
    samples["w"][between(samples, 110.0, 1e9), 2] -= 0.02
    return navigated(samples, fixes, vehicle="free")


@golden("navigation")
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


@golden("navigation")
def pole():
    d = drive(60.0, lat_deg=89.9999)
    samples, fixes = data(d, seed=44)
    fixes["lat"] = np.minimum(fixes["lat"], 0.5 * np.pi)
    return navigated(samples, fixes, HEADED)


@golden("navigation")
def date_line():
    d = drive(80.0, lat_deg=10.0, lon_deg=179.9999)
    samples, fixes = data(d, seed=45)
    fixes["lon"] = (fixes["lon"] + np.pi) % (2 * np.pi) - np.pi
    return navigated(samples, fixes)
