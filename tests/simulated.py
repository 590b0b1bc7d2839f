"""The emulator's motions and sensor errors, run through any estimator: for the golden traces and the consistency tests.

`firmware_sim` shares no code with the filters, so neither can hide the other's mistake.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Imu, Initial, Settings
from imud.drivers.sample import SAMPLE
from imud.estimators import registry
from imud.estimators.records import FIX, SOLUTION
from imud.firmware_sim.fixes import SimulatedFixes
from imud.firmware_sim.motion import Trajectory, Truth
from imud.firmware_sim.noise import M_G350, Grade, ImuErrors
from imud.firmware_sim.scenarios import SCENARIOS, Course
from imud.firmware_sim.timeline import Timeline
from imud.pipeline import Filter

G350 = Settings(imu=Imu(profile="m-g350"))
UTC = 1_700_000_000.0  # s, of the recordings' time 0
PLACE = (48.0, 11.0, 500.0)  # deg, deg, m
A, E2 = 6378137.0, 0.00669437999014  # WGS-84: m, first eccentricity squared


def circle(_roll, _pitch, _yaw):
    """For ever round 100 m at 10 m/s on level ground, after 5 s at rest."""
    return Course(
        {1: ((100.0, 0.0, 0.0), (0.0, 100.0, 0.0))}, Timeline([(5.0, 0.0), (8.0, 0.1)], [(60.0, 0.1)]), start=0.0
    )


PATHS = {**SCENARIOS, "circle": circle}


class Remembering:
    """A trajectory whose state at a time is computed once: each run's receiver asks for the same times."""

    def __init__(self, trajectory: Trajectory) -> None:
        self._at = cache(lambda t: trajectory.at(np.array([t])))

    def at(self, t: np.ndarray) -> Truth:
        """See `Trajectory.at`; of one time, array (1,)."""
        return self._at(t.item())


@dataclass(frozen=True)
class Motion:
    """A scenario at `rate_hz`, without errors. signal: (n, 6) rates rad/s and forces m/s^2; t in s."""

    t: np.ndarray
    trajectory: Remembering
    truth: Truth
    signal: np.ndarray


@cache
def motion(scenario, seconds, rate_hz, rpy=(0.0, 0.0, 0.0), place=PLACE):
    trajectory = Trajectory(PATHS[scenario](*rpy), *place)
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    # a sample is the mean over the period that ends with it: Simpson's rule
    before, middle, now = (trajectory.imu(t - part / rate_hz) for part in (1.0, 0.5, 0.0))
    return Motion(t, Remembering(trajectory), trajectory.at(t), (before + 4.0 * middle + now) / 6.0)


def sensed(m, rng, grade: Grade = M_G350):
    """(samples, errors) of one specimen on the motion."""
    rate_hz = 1.0 / (m.t[1] - m.t[0])
    errors = ImuErrors(grade, rng, rate_hz)
    second = round(rate_hz)
    values = np.vstack([errors.corrupt(m.signal[k : k + second]) for k in range(0, len(m.t), second)])
    return samples_of(m.t, values), errors


def samples_of(t, values):
    """SAMPLE rows of (n, 6) rates and forces at t s, from 1 s on."""
    rows = np.zeros(len(t), SAMPLE)
    rows["t_ns"] = 1_000_000_000 + np.rint(t * 1e9).astype(np.int64)
    rows["tick"] = np.arange(len(t))
    rows["w"], rows["f"], rows["temperature"] = values[:, :3], values[:, 3:], np.nan
    return rows


def received(m, rng, interval=1.0):
    """FIX rows of a receiver carried along."""
    source = SimulatedFixes(m.trajectory, rng, UTC)
    fixes, t = [], m.t[0]
    while (fix := source.after(t, interval)).arrival < m.t[-1]:
        fixes.append(fix)
        t = fix.t
    rows = unknown_fixes(len(fixes))
    for row, fix in zip(rows, fixes, strict=True):
        row["t_ns"], row["arrival_ns"] = (1_000_000_000 + round(x * 1e9) for x in (fix.t, fix.arrival))
        row["lat"], row["lon"], row["height"] = math.radians(fix.lat_deg), math.radians(fix.lon_deg), fix.height_m
        row["hdop"], row["speed"] = fix.hdop, fix.speed_mps
        row["course"], row["satellites"] = math.radians(fix.course_deg), fix.satellites
    return rows


def unknown_fixes(n):
    """FIX rows of which nothing is known but that they are fixes."""
    rows = np.zeros(n, FIX)
    for name in ("sigma", "v", "hdop", "speed", "course", "height"):
        rows[name] = math.nan
    rows["quality"], rows["satellites"] = 1, -1
    return rows


def estimated(name, samples, fixes=None, settings=G350, initial=None, every=1):
    """(solutions of every so many samples, innovations) of the estimator `name`; fixes go in when they arrive."""
    filter_ = Filter(registry.by_name(name), settings, initial or Initial(), 1e9 / np.median(np.diff(samples["t_ns"])))
    samples, innovations = samples.copy(), []
    out = np.zeros(len(samples), SOLUTION)
    fixes = unknown_fixes(0) if fixes is None else fixes
    start = 0
    for k, stop in enumerate(np.searchsorted(samples["t_ns"], fixes["arrival_ns"])):
        filter_.run(samples[start:stop], out[start:stop])
        innovations.append(filter_.update(fixes[k : k + 1]).copy())
        start = stop
    filter_.run(samples[start:], out[start:])
    kept = out[every - 1 :: every]
    return kept, np.concatenate(innovations) if innovations else filter_.update(unknown_fixes(1))[:0]


def rpy(q):
    """Roll, pitch, yaw in rad of quaternions (n, 4), scalar first; NaN of unknown ones."""
    angles, known = np.full((len(q), 3), np.nan), np.isfinite(q).all(axis=1)
    if known.any():
        angles[known] = Rotation.from_quat(np.roll(q[known], -1, axis=1)).as_euler("ZYX")[:, ::-1]
    return angles


def errors(out, truth, k):
    """(position NED in m, velocity in m/s, roll pitch yaw in rad), true minus estimate, of `out` at samples k."""
    lat = truth.lat[k]
    d = 1.0 - E2 * np.sin(lat) ** 2
    north, east = A * (1.0 - E2) / d**1.5, A / np.sqrt(d) * np.cos(lat)
    p = [(lat - out["lat"]) * north, _wrapped(truth.lon[k] - out["lon"]) * east, out["height"] - truth.height[k]]
    return np.column_stack(p), truth.v_n[k] - out["v"], _wrapped(truth.rpy[k] - rpy(out["q_nb"]))


def _wrapped(angle):
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
