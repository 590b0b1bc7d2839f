"""A simulated drive in plain numpy: a smooth path over the ellipsoid, what an ideal sensor would show, and fixes of it.

Independent of the kernels: positions and velocities are given in closed form, the sensor's values follow from their
derivatives (Titterton and Weston, ch. 3), and noise is added afterwards.
"""

import copy
import functools
import math
from dataclasses import dataclass

import numpy as np
from navigation_runner import fixes_of, samples_of
from scipy.spatial.transform import Rotation

A, F, RATE = 6378137.0, 1.0 / 298.257223563, 7.292115e-5
E2 = F * (2.0 - F)


def normal_gravity(lat, height):
    s2 = np.sin(lat) ** 2
    surface = 9.7803253359 * (1.0 + 0.00193185265241 * s2) / np.sqrt(1.0 - E2 * s2)
    h = height / A
    return surface * (1.0 - 2.0 * h * (1.0 + F + 0.00344978650684 - 2.0 * F * s2) + 3.0 * h * h)


def curvature(lat):
    d = 1.0 - E2 * np.sin(lat) ** 2
    return A * (1.0 - E2) / d**1.5, A / np.sqrt(d)


def curvature_at(lat):
    """As `curvature`, of one latitude: arrays of one number take five times as long."""
    sine = float(np.sin(lat))
    d = 1.0 - E2 * (sine * sine)
    return A * (1.0 - E2) / d**1.5, A / math.sqrt(d)


@dataclass
class Drive:
    t: np.ndarray  # s
    lat: np.ndarray  # rad
    lon: np.ndarray
    height: np.ndarray
    v: np.ndarray  # NED
    attitude: Rotation  # vehicle to NED
    w: np.ndarray  # ideal, vehicle axes
    f: np.ndarray


class Later:
    """The Drive that `make` returns for these arguments, made when it is first used.

    Each worker imports all files of tests and runs a few of them; pytest asks each name of theirs for attributes.
    """

    def __init__(self, make, *arguments, **options):
        self._make = functools.partial(make, *arguments, **options)

    @functools.cached_property
    def _made(self):
        return self._make()

    def __getattr__(self, name):
        if name not in Drive.__dataclass_fields__:
            raise AttributeError(name)
        return getattr(self._made, name)


def made_once(make):
    """For each choice of arguments; what is returned is a copy that the caller may change."""
    made = functools.lru_cache(maxsize=16)(make)  # the same drive is wanted by many tests

    @functools.wraps(make)
    def copied(*arguments, **options):
        return copy.deepcopy(made(*arguments, **options))

    return copied


@made_once
def drive(
    seconds, rate=100, rest=10.0, lat_deg=48.0, lon_deg=11.0, speed=8.0, fast_start=False, swing=0.6, arm=0.0,
    straight_s=math.inf,
):  # fmt: skip
    """A car that rests, then drives curves with changing speed; with `fast_start` it is under way at once.

    The speed changes by the share `swing`, beyond 1 it also reverses; the sensor is `arm` m ahead of the axle.
    It drives straight on after `straight_s` of its way.
    """
    t = np.arange(int(seconds * rate)) / rate
    u = np.maximum(t - rest, 0.0)
    ramp = 1.0 if fast_start else 1.0 - np.exp(-((u / 4.0) ** 3))
    along = ramp * speed * (1.0 - swing * np.sin(2 * np.pi * u / 23.0))
    bend = np.minimum(u, straight_s)
    yaw = 0.7 + 1.3 * ramp * np.sin(2 * np.pi * bend / 31.0) + 0.5 * ramp * np.sin(2 * np.pi * bend / 13.0)
    pitch = 0.02 * ramp * np.sin(0.4 * u)
    roll = 0.03 * ramp * np.sin(0.7 * u)
    v = np.column_stack(
        [along * np.cos(pitch) * np.cos(yaw), along * np.cos(pitch) * np.sin(yaw), -along * np.sin(pitch)]
    )
    attitude = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))
    v += np.gradient(attitude.apply([arm, 0.0, 0.0]), t, axis=0)
    return moved(t, v, attitude, lat_deg, lon_deg)


def walk(seconds, rng, rate=100, rest=10.0, sensor_yaw=1.0):
    """A pedestrian with the sensor in the hand, turned by `sensor_yaw` rad, after a rest.

    Steps of some 1.8 Hz nod and roll the hand by 3 deg and move it up and down, ahead and sideways.
    """
    t = np.arange(int(seconds * rate)) / rate
    u = np.maximum(t - rest, 0.0)
    ramp = 1.0 - np.exp(-((u / 4.0) ** 3))
    step = 2 * np.pi * 1.8 * t + 0.6 * np.sin(0.9 * t)
    course = rng.uniform(-3.0, 3.0) + 0.8 * np.sin(2 * np.pi * u / 23.0) + 0.4 * np.sin(2 * np.pi * u / 9.0)
    ahead, aside = ramp * (1.3 + 0.15 * np.cos(step + 1.0)), ramp * 0.5 * np.cos(0.5 * step)
    v = np.column_stack(
        [
            ahead * np.cos(course) - aside * np.sin(course),
            ahead * np.sin(course) + aside * np.cos(course),
            ramp * 0.28 * np.sin(step),
        ]
    )
    roll = 0.1 * np.sin(0.5 * u) + 0.06 * ramp * np.sin(0.5 * step)
    pitch = 0.3 + 0.1 * np.sin(0.4 * u) + 0.06 * ramp * np.sin(step)
    return moved(t, v, Rotation.from_euler("ZYX", np.column_stack([course + sensor_yaw, pitch, roll])))


def moved(t, v, attitude, lat_deg=48.0, lon_deg=11.0):
    """The motion with velocity v (NED) and attitude at the times t, with what an ideal sensor shows."""
    way = 0.5 * (v[1:] + v[:-1]) * np.diff(t)[:, None]
    places = [(math.radians(lat_deg), math.radians(lon_deg), 500.0)]
    for north, east, down in way.tolist():
        lat, lon, height = places[-1]
        m, n = curvature_at(lat)
        then = lat + north / (m + height)
        lon += east / ((n + height) * float(np.cos(0.5 * (then + lat))))
        places.append((then, lon, height - down))
    lat, lon, height = np.transpose(places).copy()
    return Drive(t, lat, lon, height, v, attitude, *ideal_sensor(t, lat, height, v, attitude))


def ideal_sensor(t, lat, height, v, attitude):
    m, n = curvature(lat)
    earth = RATE * np.column_stack([np.cos(lat), 0 * lat, -np.sin(lat)])
    transport = np.column_stack(
        [v[:, 1] / (n + height), -v[:, 0] / (m + height), -v[:, 1] * np.tan(lat) / (n + height)]
    )
    acceleration = np.gradient(v, t, axis=0)
    gravity = np.column_stack([0 * lat, 0 * lat, normal_gravity(lat, height)])
    f = attitude.inv().apply(acceleration + np.cross(2 * earth + transport, v) - gravity)
    step = t[1] - t[0]
    turn = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / step  # mean over each interval
    mean = np.vstack([turn[:1], 0.5 * (turn[1:] + turn[:-1]), turn[-1:]])
    return mean + attitude.inv().apply(earth + transport), f


def sensed(d, rng, gyro_psd=1.7e-4, accel_psd=2e-3, bg=(0, 0, 0), ba=(0, 0, 0), mount=None):
    """SAMPLE rows: noise densities in rad/sqrt(s), m/s/sqrt(s); `mount` turns vehicle axes into the sensor's."""
    rate = 1.0 / (d.t[1] - d.t[0])
    w, f = (d.w, d.f) if mount is None else (mount.apply(d.w), mount.apply(d.f))
    w = w + bg + gyro_psd * np.sqrt(rate) * rng.standard_normal(w.shape)
    f = f + ba + accel_psd * np.sqrt(rate) * rng.standard_normal(f.shape)
    return samples_of(100.0 + d.t, w, f)


def received(d, rng, every=1.0, late=0.0, sigma=1.0, tau=40.0, white=0.3, speed_sigma=0.05, hdop=0.9, stamp=0.0, lag=0):
    """FIX rows: Gauss-Markov plus white error, `late` s from epoch to arrival, the epoch misstated by `stamp` s.

    The velocity is that of `lag` s before.
    """
    k = np.arange(int(every / (d.t[1] - d.t[0])), len(d.t), int(every / (d.t[1] - d.t[0])))
    wander = np.zeros((len(k), 3))
    wander[0] = sigma * rng.standard_normal(3)
    decay = np.exp(-every / tau)
    for i in range(1, len(k)):
        wander[i] = decay * wander[i - 1] + sigma * np.sqrt(1 - decay**2) * rng.standard_normal(3)
    error = (wander + white * rng.standard_normal(wander.shape)) * (1.0, 1.0, 1.8)
    m, n = curvature(d.lat[k])
    v = d.v[k - round(lag / (d.t[1] - d.t[0])), :2] + speed_sigma * rng.standard_normal((len(k), 2))
    columns = {
        "t_s": 100.0 + d.t[k] + stamp,
        "arrival_s": 100.0 + d.t[k] + late,
        "lat_deg": np.degrees(d.lat[k] + error[:, 0] / m),
        "lon_deg": np.degrees(d.lon[k] + error[:, 1] / (n * np.cos(d.lat[k]))),
        "height_m": d.height[k] - error[:, 2],
        "hdop": np.full(len(k), hdop),
        "speed_mps": np.hypot(*v.T),
        "course_deg": np.degrees(np.arctan2(v[:, 1], v[:, 0])),
    }
    return fixes_of(columns, len(k))


def at_antenna(d, fixes, arm, speed_error=0.0):
    """The fixes of an antenna that is `arm` m (body) from the sensor, at which they were simulated; m/s, NED."""
    k = np.searchsorted(100.0 + d.t, fixes["t_ns"] * 1e-9 - 1e-6)
    north, east, down = d.attitude[k].apply(arm).T
    m, n = curvature(d.lat[k])
    fixes["lat"] += north / m
    fixes["lon"] += east / (n * np.cos(fixes["lat"]))
    fixes["height"] -= down
    v = d.v[k] + d.attitude[k].apply(np.cross(d.w[k], arm)) + speed_error
    fixes["course"] = np.arctan2(v[:, 1], v[:, 0])
    fixes["speed"] = np.hypot(v[:, 0], v[:, 1])
    return fixes


def errors(d, out, mount=None):
    """(position NED m, velocity m/s, attitude rotation vector NED rad), true minus estimate, per sample."""
    m, n = curvature(d.lat)
    dlon = (d.lon - out["lon"] + np.pi) % (2 * np.pi) - np.pi
    p = np.column_stack([(d.lat - out["lat"]) * m, dlon * n * np.cos(d.lat), out["height"] - d.height])
    estimate = Rotation.from_quat(np.roll(out["q_nb"], -1, axis=1))
    truth = d.attitude if mount is None else d.attitude * mount.inv()
    return p, d.v - out["v"], (truth * estimate.inv()).as_rotvec()
