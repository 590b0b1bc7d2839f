"""The reduced inertial estimator on the emulator's motions: errors, sigmas, NEES. `python tests/riss_runs.py 100`."""

from __future__ import annotations

import math
import sys

import numpy as np
from simulated import E2, A, estimated, motion, received, rpy, sensed

from imud.configuration.settings import Imu, Settings
from imud.estimators.records import HEADING_VALID, SOLUTION
from imud.firmware_sim.rga300 import RGA300

SETTINGS = Settings(imu=Imu(profile="crossbow-dmu"))
RATE_HZ = 100.0


def drive(
    seed, scenario="car", seconds=300.0, outage=None, settings=SETTINGS, vibration=0.0, begin=0.0, late=0.0, old=0.0
):
    """(motion, solutions, fixes, innovations) of one specimen; outage: from when to when no fix comes.

    begin: when imud is started, s; the solutions before it are empty. late: by how much more than usual a fix is, s.
    old: by how much it is older than its epoch says, s.
    """
    rng = np.random.default_rng(seed)
    m = motion(scenario, seconds, RATE_HZ)
    samples, _ = sensed(m, rng, RGA300)
    samples["w"][:, :2] = 0.0
    samples["f"] += vibration * rng.standard_normal(samples["f"].shape)
    fixes = received(m, rng)
    fixes["arrival_ns"] += round(late * 1e9)
    fixes["t_ns"] += round(old * 1e9)
    if outage:
        t = fixes["t_ns"] * 1e-9 - 1.0
        fixes = fixes[(t < outage[0]) | (t > outage[1])]
    out, first = np.zeros(len(samples), SOLUTION), int(begin * RATE_HZ)
    out["q_nb"][:first] = np.nan
    fixes = fixes[fixes["arrival_ns"] > samples["t_ns"][first]]
    out[first:], innovations = estimated("riss", samples[first:], fixes, settings)
    return m, out, fixes, innovations


def errors(m, out):
    """Errors over sigmas and errors: north, east, down m; velocity m/s; roll, pitch, yaw rad; (n, 9) each."""
    truth = m.truth
    down = truth.height - out["height"]
    curved = np.sqrt(1.0 - E2 * np.sin(truth.lat) ** 2)
    north = (out["lat"] - truth.lat) * (A * (1.0 - E2) / curved**3 + truth.height)
    east = (out["lon"] - truth.lon) * (A / curved + truth.height) * np.cos(truth.lat)
    angles = rpy(out["q_nb"]) - truth.rpy
    angles = (angles + math.pi) % (2.0 * math.pi) - math.pi
    e = np.column_stack([north, east, down, out["v"] - truth.v_n, angles])
    sigma = np.column_stack([out["sigma_p"], out["sigma_v"], out["sigma_rpy"]])
    return e, sigma


def normalised(run):
    """Mean square errors, and those over the variances, from 10 s after the heading is known: (9,) each."""
    m, out, _, _ = run
    e, sigma = errors(m, out)
    late = m.t > m.t[np.flatnonzero(out["status"] & HEADING_VALID)[0]] + 10.0
    return np.mean(e[late] ** 2, axis=0), np.mean((e[late] / sigma[late]) ** 2, axis=0)


def report(seeds, **options):
    """Print RMS errors and NEES per degree of freedom."""
    squares, nees = zip(*(normalised(drive(seed, **options)) for seed in seeds), strict=True)
    rms = np.sqrt(np.mean(squares, axis=0)) * ([1.0] * 6 + [math.degrees(1.0)] * 3)
    for name, error, ratio in zip(NAMES, rms, np.mean(nees, axis=0), strict=True):
        print(f"{name:6} RMS {error:7.3f}   NEES {ratio:5.2f}")
    means = np.mean(nees, axis=1)
    print(f"NEES per degree of freedom {np.mean(means):.2f}; of single runs {np.min(means):.2f} to {np.max(means):.2f}")


NAMES = ("north", "east", "down", "vn", "ve", "vd", "roll", "pitch", "yaw")

if __name__ == "__main__":
    report(range(int(sys.argv[1]) if len(sys.argv) > 1 else 5))
