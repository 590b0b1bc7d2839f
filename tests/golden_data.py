"""Drives, fixes and samples for the goldens of the navigation filter."""

import math
from functools import cache

import numpy as np
from golden_run import Recording
from navigation_simulation import Drive, curvature, drive, ideal_sensor, received, sensed
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Aiding, Imu, Initial, Navigation, Settings

RATE = 100
LSB = math.radians(0.0125), 0.125e-3 * 9.80665  # of the M-G350
HEADED = Initial(yaw_deg=math.degrees(0.7))  # how a `drive` begins


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


def counted(samples):
    """As a sensor of whole counts shows it: one whose values stand still is then known to be frozen."""
    for name, lsb in zip("wf", LSB, strict=True):
        samples[name] = np.rint(samples[name] / lsb) * lsb
    return samples


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


def navigated(samples, fixes, initial=Initial(), imu=Imu(), aiding=Aiding(), **navigation):  # noqa: B008
    settings = Settings(imu=imu, navigation=Navigation(**navigation), aiding=aiding)
    return Recording("navigation", samples, fixes, settings, initial)


def turned(d, angle):
    """The same way with the nose turned from it by `angle` (rad, of each moment)."""
    attitude = d.attitude * Rotation.from_rotvec(np.outer(angle, (0.0, 0.0, 1.0)))
    return Drive(d.t, d.lat, d.lon, d.height, d.v, attitude, *ideal_sensor(d.t, d.lat, d.height, d.v, attitude))


def smooth(x, seconds, rate):
    kernel = np.hanning(round(2 * seconds * rate))
    return np.convolve(x, kernel / kernel.sum(), "same")


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
