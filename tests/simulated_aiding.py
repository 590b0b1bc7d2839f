"""Aiding sources beside a receiver on the vehicles of `simulated_vehicles`, with errors: MEASUREMENT rows.

Each source and each of its errors is drawn by `rng`. A source has errors of its own, which its sensor has when it is
right (a scale factor, a boresight, slips); an error of `ERRORS` comes on top, from the first row on or later.
"""

import numpy as np
from vehicle_simulation import RATE, slips

from imud.estimators.records import (
    BAROMETER_SOURCE,
    BODY_VELOCITY_SOURCE,
    HEADING_SOURCE,
    MAGNETOMETER_SOURCE,
    MEASUREMENT,
    ODOMETER_SOURCE,
    POSE_SOURCE,
    VELOCITY_SOURCE,
)

EARTH_T = np.array([20.9e-6, 1.6e-6, 43.4e-6])  # NED, near Munich
METRES_OF_LATITUDE = 6.37e6


def rows_of(d, rng, kind, shortest_s=0.05, longest_s=1.0):
    """(samples of the measurements, their rows without values): evenly, known up to 0.1 s after their epochs."""
    step = max(1, round(RATE * np.exp(rng.uniform(np.log(shortest_s), np.log(longest_s)))))
    k = np.arange(step, len(d.t), step)
    rows = np.zeros(len(k), MEASUREMENT)
    rows["t_ns"] = np.round(1e9 * (100.0 + d.t[k]))
    rows["arrival_ns"] = rows["t_ns"] + round(1e9 * rng.uniform(0.0, 0.1))
    rows["kind"], rows["value"], rows["sigma"] = kind, np.nan, np.nan
    return k, rows


def wander(rng, n, every_s, sigma, time_s):
    """A first-order Gauss-Markov error (n,)."""
    x, decay = np.empty(n), np.exp(-every_s / time_s)
    x[0] = sigma * rng.standard_normal()
    for i in range(1, n):
        x[i] = decay * x[i - 1] + sigma * np.sqrt(1.0 - decay * decay) * rng.standard_normal()
    return x


def odometer(d, rng):
    """A wheel, 2 % off (1 sigma), with slips; half of them show no sign."""
    k, rows = rows_of(d, rng, ODOMETER_SOURCE, 0.02, 0.5)
    ahead = np.sum(d.attitude[k].apply([1.0, 0.0, 0.0]) * d.v[k], axis=1)
    noise = 0.05 * (np.abs(ahead) > 0.05) * rng.standard_normal(len(k))
    speed = (1.0 + 0.02 * rng.standard_normal()) * ahead * slips(rng, d.t[k]) + noise
    rows["value"][:, 0] = speed if rng.random() < 0.5 else np.abs(speed)
    return rows


def heading(d, rng):
    """A compass whose boresight is off by 2 deg (1 sigma)."""
    k, rows = rows_of(d, rng, HEADING_SOURCE, 0.1, 1.0)
    sigma = np.radians(np.exp(rng.uniform(np.log(0.2), np.log(3.0))))
    yaw = d.attitude.as_euler("ZYX")[k, 0] + np.radians(2.0) * rng.standard_normal()
    rows["value"][:, 0] = yaw + sigma * rng.standard_normal(len(k))
    rows["sigma"][:, 0] = sigma
    return rows


def barometer(d, rng):
    """With an offset, and the pressure of the own motion: some percent of that of the speed."""
    k, rows = rows_of(d, rng, BAROMETER_SOURCE, 0.05, 1.0)
    wind = rng.uniform(-0.3, 0.3) * np.sum(d.v[k] ** 2, axis=1) / (2.0 * 9.8)
    rows["value"][:, 0] = d.height[k] + rng.uniform(-60.0, 60.0) + 0.2 * rng.standard_normal(len(k)) + wind
    return rows


def pose(d, rng):
    """A map's, of decimetres and a degree, which err together for seconds."""
    k, rows = rows_of(d, rng, POSE_SOURCE, 0.05, 0.5)
    every_s, n, sigma = (k[1] - k[0]) / RATE, len(k), rng.uniform(0.05, 0.4)
    e = np.column_stack([0.7 * wander(rng, n, every_s, sigma, 10.0) for _ in range(3)])
    e += 0.7 * sigma * rng.standard_normal((n, 3))
    yaw = d.attitude.as_euler("ZYX")[k, 0] + np.radians(1.0) * rng.standard_normal(n)
    north, east = e[:, 0] / METRES_OF_LATITUDE, e[:, 1] / (METRES_OF_LATITUDE * np.cos(d.lat[k]))
    rows["value"][:, :4] = np.column_stack([d.lat[k] + north, d.lon[k] + east, d.height[k] - e[:, 2], yaw])
    rows["sigma"] = sigma, sigma, sigma, np.radians(1.0)
    return rows


def _velocities(kind):
    def source(d, rng):
        """A velocity, 1 % off (1 sigma)."""
        k, rows = rows_of(d, rng, kind, 0.03, 0.5)
        v = d.attitude[k].inv().apply(d.v[k]) if kind == BODY_VELOCITY_SOURCE else d.v[k]
        sigma = rng.uniform(0.02, 0.2)
        rows["value"][:, :3] = v * (1.0 + 0.01 * rng.standard_normal()) + sigma * rng.standard_normal(v.shape)
        rows["sigma"][:, :3] = sigma
        return rows

    return source


def magnetometer(d, rng):
    """Iron of the vehicle and fields beside the way, of 1 uT each (1 sigma)."""
    k, rows = rows_of(d, rng, MAGNETOMETER_SOURCE, 0.05, 0.5)
    every_s = (k[1] - k[0]) / RATE
    outside = np.column_stack([wander(rng, len(k), every_s, 1e-6, 30.0) for _ in range(3)])
    body = d.attitude[k].inv().apply(EARTH_T + outside) + 1e-6 * rng.standard_normal(3)
    rows["value"][:, :3] = body + 0.5e-6 * rng.standard_normal(body.shape)
    rows["value"][:, 3:] = EARTH_T
    return rows


SOURCES = {
    "odometer": odometer,
    "heading": heading,
    "barometer": barometer,
    "pose": pose,
    "velocity": _velocities(VELOCITY_SOURCE),
    "body velocity": _velocities(BODY_VELOCITY_SOURCE),
    "magnetometer": magnetometer,
}
KMH, FEET = 3.6, 3.2808
UNITS = {
    "odometer": KMH,
    "velocity": KMH,
    "body velocity": KMH,
    "barometer": FEET,
    "heading": np.radians(1.0),
    "magnetometer": 0.1,
}
JUMPS = {
    "odometer": 2.0,
    "velocity": 2.0,
    "body velocity": 2.0,
    "barometer": 12.0,
    "heading": 0.5,
    "magnetometer": 8e-6,
}


def since(rows, rng):
    """Which rows are those from a random time on: all, or those after 20 to 70 % of them."""
    first = 0 if rng.random() < 0.3 else int(len(rows) * rng.uniform(0.2, 0.7))
    return slice(first, None)


def spells(rows, rng, shortest_s=3.0, longest_s=30.0):
    """Which rows are in one of some random spells."""
    t, inside = (rows["t_ns"] - rows["t_ns"][0]) * 1e-9, np.zeros(len(rows), bool)
    begin = rng.uniform(5.0, 60.0)
    while begin < t[-1]:
        end = begin + rng.uniform(shortest_s, longest_s)
        inside |= (t >= begin) & (t < end)
        begin = end + rng.uniform(10.0, 60.0)
    return inside


def offset(name, rows, where, size):
    """Add so many times the source's typical jump."""
    if name == "pose":
        rows["value"][where, :2] += (np.reshape(size, (-1, 1)) * np.array([6.0, 4.0])) / METRES_OF_LATITUDE
    elif name == "velocity":
        rows["value"][where, :2] += np.reshape(size, (-1, 1)) * np.array([1.5, -1.5])
    else:
        rows["value"][where, 0] += size * JUMPS[name]


def lost(name, rows, rng):
    """None for a while, again and again."""
    return rows[~spells(rows, rng)]


def late(name, rows, rng):
    """Known later, and stamped when it comes."""
    where = since(rows, rng)
    rows["arrival_ns"][where] += round(1e9 * rng.uniform(0.1, 1.2))
    rows["t_ns"][where] = rows["arrival_ns"][where]
    return rows


def own_clock(name, rows, rng):
    """Its epochs are off."""
    rows["t_ns"][since(rows, rng)] += round(1e9 * rng.uniform(-0.5, 0.1))
    return rows


def frozen(name, rows, rng):
    """It repeats its last value, again and again for a while."""
    inside = spells(rows, rng)
    for i in np.flatnonzero(inside[1:]) + 1:
        rows["value"][i] = rows["value"][i - 1]
    return rows


def jumping(name, rows, rng):
    """Off by a constant for a while, again and again."""
    inside = spells(rows, rng)
    offset(name, rows, inside, rng.normal())
    return rows


def creeping(name, rows, rng):
    """Off by what grows with the time."""
    where = since(rows, rng)
    n = len(rows["t_ns"][where])
    offset(name, rows, where, 2.0 * rng.normal() * np.linspace(0.0, 1.0, n))
    return rows


def outliers(name, rows, rng):
    """One in thirty is off."""
    where = np.flatnonzero(rng.random(len(rows)) < 0.03)
    offset(name, rows, where, 3.0 * rng.standard_normal(len(where)))
    return rows


def scaled(name, rows, rng):
    """A scale factor that is off by 15 % (1 sigma); for what has none an offset."""
    where = since(rows, rng)
    if name in ("pose", "heading"):
        offset(name, rows, where, rng.normal())
    else:
        rows["value"][where, :3] *= np.exp(0.15 * rng.standard_normal())
    return rows


def wrong_units(name, rows, rng):
    """km/h, feet, radians; the height of poses in feet."""
    if name == "pose":
        rows["value"][:, 2] *= FEET
    else:
        rows["value"][:, :3] *= UNITS[name]
    return rows


def negative(name, rows, rng):
    """The opposite sign; of poses the yaw."""
    column = 3 if name == "pose" else 0
    rows["value"][:, column] *= -1.0
    return rows


def noisy(name, rows, rng):
    """Four times the noise that it states."""
    offset(name, rows, slice(None), 0.3 * rng.standard_normal(len(rows)))
    return rows


def too_sure(name, rows, rng):
    """It states a fifth of its error."""
    rows["sigma"] /= 5.0
    return rows


def turned(name, rows, rng):
    """Its axes are turned about the vertical."""
    angle = np.radians(rng.choice([5.0, 15.0, 40.0, 90.0, 180.0])) * rng.choice([-1.0, 1.0])
    if name in ("heading", "pose"):
        rows["value"][:, 3 if name == "pose" else 0] += angle
    elif name in ("velocity", "body velocity", "magnetometer"):
        x, y = rows["value"][:, 0].copy(), rows["value"][:, 1].copy()
        rows["value"][:, 0] = np.cos(angle) * x - np.sin(angle) * y
        rows["value"][:, 1] = np.sin(angle) * x + np.cos(angle) * y
    return rows


ERRORS = (
    lost, late, own_clock, frozen, jumping, creeping, outliers, scaled, wrong_units, negative, noisy, too_sure, turned,
)  # fmt: skip


def drawn(d, rng, on_wheels):
    """(MEASUREMENT rows in the order of their arrival, text) of one or two sources, half of them with an error."""
    names = [name for name in SOURCES if on_wheels or name != "odometer"]
    parts, texts = [], []
    for i in rng.choice(len(names), rng.integers(1, 3), replace=False):
        rows, text = SOURCES[names[i]](d, rng), names[i]
        if rng.random() < 0.6:
            error = ERRORS[rng.integers(len(ERRORS))]
            rows, text = error(names[i], rows, rng), f"{text} {error.__name__}"
        parts.append(rows)
        texts.append(text)
    rows = np.concatenate(parts)
    return rows[np.argsort(rows["arrival_ns"], kind="stable")], " + ".join(texts)
