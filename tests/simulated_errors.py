"""Errors that the sensors and receivers of `accuracy_simulated` do not have, and that others do: one each.

`ERRORS[name](d, samples, fixes, rng)` returns the Drive d with its SAMPLE and FIX rows as they are then.
"""

import dataclasses

import numpy as np
from navigation_simulation import curvature
from vehicle_simulation import RATE, smooth

G = 9.80665


def on_samples(change):
    return lambda d, samples, fixes, rng: (d, change(d, samples.copy(), rng), fixes)


def on_fixes(change):
    return lambda d, samples, fixes, rng: (d, samples, change(d, fixes.copy(), rng))


def part(d, rows):
    """The Drive of some of its samples."""
    return dataclasses.replace(d, **{field.name: getattr(d, field.name)[rows] for field in dataclasses.fields(d)})


def vibration_rectified(d, samples, rng):
    """A bias while the vehicle moves: sensors rectify vibration."""
    moves = smooth((np.linalg.norm(d.v, axis=1) > 0.2).astype(float), 1.0)[:, None]
    samples["w"] += moves * np.radians(0.1) * rng.standard_normal(3)
    samples["f"] += moves * 0.1 * rng.standard_normal(3)
    return samples


def large_gyro_bias(_, samples, rng):
    """Within the limits of the worst data sheet."""
    samples["w"] += np.radians(20.0) * rng.uniform(-1.0, 1.0, 3)
    return samples


def large_accel_bias(_, samples, rng):
    samples["f"] += 0.06 * G * rng.standard_normal(3)
    return samples


def temperature_cycle(_, samples, rng):
    """Biases that swing slowly: sun, rain, a fan."""
    t = np.arange(len(samples)) / RATE
    swing = np.sin(2.0 * np.pi * (t[:, None] / rng.uniform(80.0, 200.0, 3) + rng.random(3)))
    samples["w"] += np.radians(0.05) * swing
    samples["f"] += 0.02 * swing
    return samples


def clock_rate(_, samples, rng):
    """The sensor's clock is off by 500 ppm against the receiver's, and is not disciplined."""
    t = samples["t_ns"] - samples["t_ns"][0]
    samples["t_ns"] += np.round(t * 5e-4 * rng.choice([-1.0, 1.0])).astype(np.int64)
    return samples


def jitter(_, samples, rng):
    """Time tags that err by 3 ms (1 sigma), each by itself."""
    samples["t_ns"] += np.clip(rng.normal(0.0, 3e6, len(samples)), -4.9e6, 4.9e6).astype(np.int64)
    return samples


def lost(d, samples, fixes, rng):
    """0.3 s of samples are missing, once in some 15 s."""
    t = np.arange(len(samples)) / RATE
    starts = np.cumsum(rng.uniform(5.0, 25.0, int(t[-1] / 5.0)))
    kept = np.ones(len(t), bool)
    for start in starts[starts < t[-1]]:
        kept &= (t < start) | (t > start + 0.3)
    return part(d, kept), samples[kept], fixes


def clipped(_, samples, __):
    """A gyro that ends at 60 deg/s and accelerometers that end at 2 g."""
    samples["w"] = np.clip(samples["w"], -np.radians(60.0), np.radians(60.0))
    samples["f"] = np.clip(samples["f"], -2.0 * G, 2.0 * G)
    return samples


def coarse(_, samples, __):
    """Counts of 0.1 deg/s and of 4 mg."""
    for name, count in (("w", np.radians(0.1)), ("f", 4e-3 * G)):
        samples[name] = np.round(samples[name] / count) * count
    return samples


def averaged(d, fixes, time_s, velocities):
    """What a receiver's own filter makes of positions (and velocities): an average over the time constant before."""
    share = 1.0 - np.exp(-1.0 / RATE / time_s)
    m, n = curvature(d.lat)
    k = np.clip(np.round((fixes["t_ns"] * 1e-9 - 100.0) * RATE).astype(int), 0, len(d.t) - 1)
    v = np.empty_like(d.v)
    mean = d.v[0]
    for i, now in enumerate(d.v):
        mean = v[i] = mean + share * (now - mean)
    lag = np.cumsum(v - d.v, axis=0) / RATE
    north, east, down = lag[k].T
    fixes["lat"] += north / m[k]
    fixes["lon"] += east / (n[k] * np.cos(d.lat[k]))
    fixes["height"] -= down
    return with_velocity_error(fixes, (v - d.v)[k]) if velocities else fixes


def smoothed(d, fixes, time_s):
    """What a receiver makes of positions and velocities that assumes a steady velocity: late by a change of it alone.

    A filter of second order with two equal poles, at 1 / time_s: at an acceleration a its velocity is off by
    2 a time_s, its position by a time_s^2.
    """
    rate, error, lag, of_v, of_p = 1.0 / time_s, np.zeros(3), np.zeros(3), np.zeros_like(d.v), np.zeros_like(d.v)
    for i in range(1, len(d.v)):
        error = error + (d.v[i - 1] - d.v[i]) - rate * rate * lag / RATE
        lag = lag + (error - 2.0 * rate * lag) / RATE
        of_v[i], of_p[i] = error, lag
    k = np.clip(np.round((fixes["t_ns"] * 1e-9 - 100.0) * RATE).astype(int), 0, len(d.t) - 1)
    return with_velocity_error(shifted(d, fixes, *(of_p[k] * [1.0, 1.0, -1.0]).T), of_v[k])


def with_velocity_error(fixes, error):
    """Fixes whose velocities err so."""
    fixes["v"] += error
    level = fixes["speed"][:, None] * np.column_stack([np.cos(fixes["course"]), np.sin(fixes["course"])])
    level += error[:, :2]
    fixes["speed"] = np.hypot(*level.T)
    fixes["course"] = np.arctan2(level[:, 1], level[:, 0])
    return fixes


def shifted(d, fixes, north, east, up):
    """Fixes moved by so many metres."""
    m, n = curvature(fixes["lat"])
    fixes["lat"] += north / m
    fixes["lon"] += east / (n * np.cos(fixes["lat"]))
    fixes["height"] += up
    return fixes


def multipath(d, fixes, rng):
    """12 m (1 sigma) beside the way for 4 to 20 s, once in some 40 s; the stated accuracy does not change."""
    t = (fixes["t_ns"] - fixes["t_ns"][0]) * 1e-9
    error, begin = np.zeros((len(t), 3)), rng.uniform(10.0, 60.0)
    while begin < t[-1]:
        end = begin + rng.uniform(4.0, 20.0)
        error[(t >= begin) & (t < end)] = rng.normal(0.0, 12.0, 3)
        begin = end + rng.uniform(10.0, 60.0)
    return shifted(d, fixes, *error.T)


def outliers(d, fixes, rng, sigma_m):
    """One position in twenty is off by so much (1 sigma) in each axis; the stated accuracy does not change."""
    return shifted(d, fixes, *((rng.random(len(fixes)) < 0.05)[:, None] * rng.normal(0.0, sigma_m, (len(fixes), 3))).T)


def creeping(d, fixes, rng):
    """Positions creep away by 0.5 m/s for 40 s, and come back at once."""
    t = (fixes["t_ns"] - fixes["t_ns"][0]) * 1e-9
    away = np.where((t > 120.0) & (t < 160.0), 0.5 * (t - 120.0), 0.0)
    course = rng.uniform(0.0, 2.0 * np.pi)
    return shifted(d, fixes, away * np.cos(course), away * np.sin(course), 0.0)


def held(_, fixes, rng):
    """One fix in three repeats the position of the one before."""
    repeats = np.flatnonzero(rng.random(len(fixes) - 1) < 1.0 / 3.0) + 1
    for name in ("lat", "lon", "height"):
        for i in repeats:
            fixes[name][i] = fixes[name][i - 1]
    return fixes


def static_hold(_, fixes, __):
    """Below 0.5 m/s, as it reports it, the position stands still and the velocity is zero."""
    speed = np.where(np.isfinite(fixes["speed"]), fixes["speed"], np.hypot(*fixes["v"][:, :2].T))
    for i in np.flatnonzero(speed[1:] < 0.5) + 1:
        for name in ("lat", "lon", "height"):
            fixes[name][i] = fixes[name][i - 1]
    slow = speed < 0.5
    fixes["v"][slow] *= 0.0
    fixes["speed"][slow] *= 0.0
    return fixes


def held_course(_, fixes, __):
    """Below 1 m/s the course of a receiver without a velocity vector stands still, while its speed goes on."""
    for i in np.flatnonzero(fixes["speed"][1:] < 1.0) + 1:
        fixes["course"][i] = fixes["course"][i - 1]
    return fixes


def twice(_, fixes, __):
    """Every fix comes again, 50 ms later: over a second line, or from two programs."""
    fixes = np.repeat(fixes, 2)
    fixes["arrival_ns"][1::2] += 50_000_000
    return fixes


def mixed_epochs(_, fixes, __):
    """Its velocity is that of the fix before: NMEA's RMC or VTG ahead of the GGA of its epoch."""
    for name in ("v", "speed", "course"):
        fixes[name][1:] = fixes[name][:-1].copy()
    return fixes


def rounded(_, fixes, __):
    """Three digits of a minute (1.9 m), and velocities of 0.1 m/s."""
    step = np.radians(1e-3 / 60.0)
    for name in ("lat", "lon"):
        fixes[name] = np.round(fixes[name] / step) * step
    fixes["height"] = np.round(fixes["height"])
    fixes["v"], fixes["speed"] = np.round(fixes["v"], 1), np.round(fixes["speed"], 1)
    return fixes


def stamped_at_arrival(_, fixes, rng):
    """No epoch: the receiver's line counts when it arrives, 0.1 to 0.4 s later, by 20 ms more or less."""
    late = rng.uniform(0.1, 0.4) + rng.normal(0.0, 0.02, len(fixes))
    fixes["t_ns"] = fixes["arrival_ns"] = fixes["t_ns"] + np.round(late * 1e9).astype(np.int64)
    return fixes


def outages(_, fixes, rng):
    """None for 5 to 20 s, once in some 40 s."""
    t, kept, begin = (fixes["t_ns"] - fixes["t_ns"][0]) * 1e-9, np.ones(len(fixes), bool), rng.uniform(20.0, 60.0)
    while begin < t[-1]:
        end = begin + rng.uniform(5.0, 20.0)
        kept &= (t < begin) | (t > end)
        begin = end + rng.uniform(10.0, 60.0)
    return fixes[kept]


def reacquired(d, fixes, rng):
    """As `outages`, and then the position is off by 20 m (1 sigma) in each axis, and comes back within some 8 s."""
    t = (fixes["t_ns"] - fixes["t_ns"][0]) * 1e-9
    error, kept, begin = np.zeros((len(t), 3)), np.ones(len(t), bool), rng.uniform(20.0, 60.0)
    while begin < t[-1]:
        end = begin + rng.uniform(5.0, 20.0)
        kept &= (t < begin) | (t > end)
        error += (np.exp(-np.maximum(t - end, 0.0) / 8.0) * (t > end))[:, None] * rng.normal(0.0, 20.0, 3)
        begin = end + rng.uniform(10.0, 60.0)
    return shifted(d, fixes, *error.T)[kept]


def too_sure(_, fixes, __):
    """The receiver states a third of its error."""
    fixes["sigma"] /= 3.0
    fixes["hdop"] /= 3.0
    return fixes


def seldom(_, fixes, __):
    """One fix in 5 s."""
    every = max(1, round(5e9 / (fixes["t_ns"][1] - fixes["t_ns"][0])))
    return fixes[::every]


ERRORS = {
    "none": lambda d, samples, fixes, _: (d, samples, fixes),
    "vibration": on_samples(vibration_rectified),
    "large gyro bias": on_samples(large_gyro_bias),
    "large accel bias": on_samples(large_accel_bias),
    "temperature": on_samples(temperature_cycle),
    "clock": on_samples(clock_rate),
    "jitter": on_samples(jitter),
    "lost": lost,
    "clipped": on_samples(clipped),
    "coarse": on_samples(coarse),
    "averaged": on_fixes(lambda d, fixes, _: averaged(d, fixes, 1.0, velocities=False)),
    "averaged both": on_fixes(lambda d, fixes, _: averaged(d, fixes, 0.5, velocities=True)),
    "smoothed 0.5 s": on_fixes(lambda d, fixes, _: smoothed(d, fixes, 0.5)),
    "smoothed 0.2 s": on_fixes(lambda d, fixes, _: smoothed(d, fixes, 0.2)),
    "multipath": on_fixes(multipath),
    "outliers 20 m": on_fixes(lambda d, fixes, rng: outliers(d, fixes, rng, 20.0)),
    "outliers 100 m": on_fixes(lambda d, fixes, rng: outliers(d, fixes, rng, 100.0)),
    "creeping": on_fixes(creeping),
    "static hold": on_fixes(static_hold),
    "held course": on_fixes(held_course),
    "twice": on_fixes(twice),
    "mixed epochs": on_fixes(mixed_epochs),
    "held": on_fixes(held),
    "rounded": on_fixes(rounded),
    "arrival": on_fixes(stamped_at_arrival),
    "outages": on_fixes(outages),
    "reacquired": on_fixes(reacquired),
    "too sure": on_fixes(too_sure),
    "seldom": on_fixes(seldom),
}
