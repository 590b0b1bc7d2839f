"""Vehicles of other kinds than `navigation_simulation.drive`: their ways are drawn from a seed.

Levels of speed and yaw rate that change every few seconds, smoothed; attitude and velocity then give what an ideal
sensor shows, as there.
"""

import math

import numpy as np
from navigation_simulation import Drive, curvature_at, ideal_sensor
from scipy.spatial.transform import Rotation

RATE, SECONDS = 100, 130.0


def smooth(x, seconds):
    """x (n,), averaged over a Hann window."""
    n = round(seconds * RATE)
    weights = np.hanning(2 * n + 1)
    return np.convolve(np.pad(x, n, mode="edge"), weights / weights.sum(), "valid")


def levels(rng, t, low, high, every_s):
    """Values between low and high, each held for some `every_s`."""
    n = int(t[-1] / (0.6 * every_s)) + 2
    ends = np.cumsum(rng.uniform(0.6, 1.4, n) * every_s)
    return rng.uniform(low, high, n)[np.searchsorted(ends, t)]


def slips(rng, t):
    """Share of the true speed that a wheel shows at times t (n,), s: it slips for 1 to 4 s twice a minute."""
    share = np.ones(len(t))
    for begin in np.arange(t[0] + 20.0, t[-1], 30.0):
        slipping = (t > begin) & (t < begin + rng.uniform(1.0, 4.0))
        share[slipping] *= rng.choice([0.0, 0.6, 1.4])
    return share


def way(t, v, yaw, pitch, roll):
    """The Drive of velocities NED, m/s, and angles, rad."""
    attitude = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))
    places = [(math.radians(48.0), math.radians(11.0), 500.0)]
    for north, east, down in (0.5 * (v[1:] + v[:-1]) / RATE).tolist():
        lat, lon, height = places[-1]
        m, n = curvature_at(lat)
        lon += east / ((n + height) * math.cos(lat))
        places.append((lat + north / (m + height), lon, height - down))
    lat, lon, height = np.transpose(places).copy()
    return Drive(t, lat, lon, height, v, attitude, *ideal_sensor(t, lat, height, v, attitude))


def ahead(speed, yaw, pitch=0.0):
    """Velocity NED of a speed along the forward axis."""
    level = speed * np.cos(pitch)
    return np.column_stack([level * np.cos(yaw), level * np.sin(yaw), -speed * np.sin(pitch)])


def city(rng, t):
    """A car among others: it stops, turns off, brakes."""
    speed = levels(rng, t, 2.0, 14.0, 9.0)
    speed[levels(rng, t, 0.0, 1.0, 11.0) < 0.2] = 0.0
    speed[t < 8.0] = 0.0
    speed = smooth(speed, 2.5)
    turns = levels(rng, t, -0.35, 0.35, 5.0) * (levels(rng, t, 0.0, 1.0, 6.0) > 0.4)
    rate = smooth(turns, 1.0) * np.clip(speed / 5.0, 0.0, 1.0)
    yaw, pitch = 2.0 + np.cumsum(rate) / RATE, 0.01 * np.gradient(speed, t)
    return way(t, ahead(speed, yaw, pitch), yaw, pitch, 0.005 * speed * rate)


def motorway(rng, t):
    """Up to 30 m/s, in long bends."""
    speed = np.minimum(1.8 * np.maximum(t - 6.0, 0.0), 27.0) + smooth(levels(rng, t, -5.0, 3.0, 14.0), 3.0) * (t > 25.0)
    speed = smooth(speed, 2.0)
    speed[t < 4.0] = 0.0
    rate = smooth(levels(rng, t, -0.03, 0.03, 12.0), 2.0) * np.clip(speed / 10.0, 0.0, 1.0)
    yaw, pitch = 1.0 + np.cumsum(rate) / RATE, 0.005 * np.sin(0.2 * t)
    return way(t, ahead(speed, yaw, pitch), yaw, pitch, 0.3 * rate)


def robot(rng, t):
    """At walking pace, forward and in reverse; it turns on the spot."""
    speed, turns = levels(rng, t, -0.8, 1.6, 5.0), levels(rng, t, -0.7, 0.7, 4.0)
    turns *= levels(rng, t, 0.0, 1.0, 5.0) > 0.4
    speed[t < 6.0] = turns[t < 6.0] = 0.0
    speed, yaw = smooth(speed, 0.8), -1.0 + np.cumsum(smooth(turns, 0.6)) / RATE
    shaking = 0.01 * np.abs(speed)
    return way(t, ahead(speed, yaw), yaw, shaking * np.sin(3.0 * t), shaking * np.sin(2.3 * t + 1.0))


def boat(rng, t):
    """In a current and in waves."""
    phase = rng.uniform(0.0, 6.0, 8)
    speed = smooth(levels(rng, t, 1.5, 6.0, 20.0), 6.0) * np.clip((t - 5.0) / 8.0, 0.0, 1.0)
    yaw = 0.3 + np.cumsum(smooth(levels(rng, t, -0.12, 0.12, 11.0), 3.0)) / RATE + 0.04 * np.sin(0.7 * t + phase[0])
    roll = 0.10 * np.sin(0.9 * t + phase[1]) + 0.03 * np.sin(1.7 * t + phase[2])
    waves = [
        0.25 * np.sin(0.8 * t + phase[4]) + 0.4,
        0.25 * np.sin(0.75 * t + phase[5]) - 0.3,
        0.4 * np.sin(t + phase[6]),
    ]
    return way(t, ahead(speed, yaw) + np.column_stack(waves), yaw, 0.05 * np.sin(1.1 * t + phase[3]), roll)


def walk(rng, t):
    """Two steps a second, which bob and sway."""
    phase, go, steps = rng.uniform(0.0, 6.0, 8), np.clip((t - 5.0) / 2.0, 0.0, 1.0), 2.0 * np.pi * 0.9 * t
    speed = smooth(levels(rng, t, 0.9, 1.7, 8.0), 1.5) * go * (1.0 + 0.15 * np.sin(2.0 * steps))
    turns = levels(rng, t, -0.6, 0.6, 5.0) * (levels(rng, t, 0.0, 1.0, 6.0) > 0.4)
    course = np.cumsum(smooth(turns, 1.0) * (t > 6.0)) / RATE
    sway = 0.12 * go * np.sin(steps + phase[1])
    v = ahead(speed, course) + sway[:, None] * np.column_stack([-np.sin(course), np.cos(course), 0.0 * t])
    v[:, 2] += 0.25 * go * np.sin(2.0 * steps + phase[0])
    pitch, roll = 0.05 * go * np.sin(2.0 * steps + phase[2]), 0.04 * go * np.sin(steps + phase[3])
    return way(t, v, course + 0.05 * go * np.sin(steps), pitch, roll)


def drone(rng, t):
    """It flies in any direction, with the tilt that this needs."""
    v = np.column_stack(
        [levels(rng, t, -7.0, 7.0, 7.0), levels(rng, t, -7.0, 7.0, 7.0), levels(rng, t, -2.0, 2.0, 9.0)]
    )
    v[t < 6.0] = 0.0
    v = np.column_stack([smooth(smooth(column, 1.0), 1.0) for column in v.T])
    turns = levels(rng, t, -0.5, 0.5, 6.0) * (levels(rng, t, 0.0, 1.0, 6.0) > 0.5)
    yaw = 0.5 + np.cumsum(smooth(turns, 1.0) * (t > 5.0)) / RATE
    north, east, _ = np.gradient(v, t, axis=0).T
    along, right = north * np.cos(yaw) + east * np.sin(yaw), -north * np.sin(yaw) + east * np.cos(yaw)
    return way(t, v, yaw, -np.arctan(along / 9.8), np.arctan(right / 9.8))


LAND = {"city": city, "motorway": motorway, "robot": robot}
FREE = {"boat": boat, "walk": walk, "drone": drone}  # without wheels
VEHICLES = LAND | FREE


def vehicle(name, seed, seconds=SECONDS):
    """Drive of a vehicle by its name."""
    rng = np.random.default_rng([seed, list(VEHICLES).index(name)])
    return VEHICLES[name](rng, np.arange(int(seconds * RATE)) / RATE)
