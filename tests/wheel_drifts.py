"""Receivers that drift on the open drives, with wheels and without: found when, how far off, wrong and sure how long.

    python tests/wheel_drifts.py [RECORDING..] [--fixes receiver_like] [--speed 1.0] [--without] [--runs 20] [--list]

The wheel's speed is that of the reference, 2 % too large, with noise of 0.05 m/s at 10 Hz and a slip of 1 to 4 s twice
a minute. From each of `runs` times on, spread over the drive, the receiver drifts for a minute: along the way of that
time, across it, and in two other directions; its velocity has the drift, too ("in velocity"), or has not ("positions
alone"). Each row of the table is the sum over the times of one kind of driving: creeping (mean speed of that minute
below 2 m/s, but not at rest), straight (the course stays within 15 degrees), others. "Found": share in which fixes are
rejected within 30 s; "sure": seconds beyond 4 sigma and 5 m with POSITION_VALID until a minute after the drift has
ended.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from navigation_runner import SHARED, load, navigate, scorer, settings_of, table, truth_of
from test_navigation_aiding import played
from vehicle_simulation import slips

from imud.estimators.records import MEASUREMENT, ODOMETER_SOURCE, POSITION_VALID, REJECTING

DRIFT_S, FOUND_S = 60.0, 30.0
DIRECTIONS = {"along": 0.0, "left": -90.0, "right": 90.0, "behind": 180.0, "oblique": 35.0}
CREEPING_MPS, STRAIGHT_DEG = 2.0, 15.0
COLUMNS = ("found_s", "sure_s", "most_sigmas", "end_m")


@functools.cache
def recording(name, grade):
    """(samples, fixes, reference, meta, wheel readings)."""
    folder = SHARED / "navigation" / name
    samples, fixes = load(folder, grade)
    truth = truth_of(folder)
    truth = truth[np.isfinite(truth[:, 4])]
    meta = json.loads((folder / "meta.json").read_text())
    surveyed = navigate(*load(folder, "rtk1"), settings_of("land", meta["lever_frd"], "auto"))[0]
    return samples, fixes, truth, meta, wheel_readings(truth, surveyed)


def wheel_readings(truth, solution, scale=0.02, sigma=0.05, every_s=0.1):
    """MEASUREMENT rows; where the reference has gaps, the speed is that of `solution`, made with the surveyed fixes."""
    rng = np.random.default_rng(1)
    t = np.arange(truth[0, 0], truth[-1, 0], every_s)
    speed = np.interp(t, truth[:, 0], np.hypot(truth[:, 4], truth[:, 5]))
    own = np.interp(t, solution["t_ns"] * 1e-9, np.hypot(solution["v"][:, 0], solution["v"][:, 1]))
    speed = np.where(known(truth, t), speed, own)
    reading = (1.0 + scale) * speed + sigma * rng.standard_normal(len(t)) * (speed > 0.05)
    reading *= slips(rng, t)
    rows = np.zeros(len(t), MEASUREMENT)
    rows["t_ns"] = np.round(1e9 * t)
    rows["arrival_ns"] = rows["t_ns"] + 20_000_000
    rows["kind"], rows["sigma"] = ODOMETER_SOURCE, np.nan
    rows["value"] = np.nan
    rows["value"][:, 0] = reading
    return rows[np.isfinite(reading)]


def known(truth, t):
    """Whether the reference is known at t: its points before and after are at most a second apart."""
    k = np.clip(np.searchsorted(truth[:, 0], t), 1, len(truth) - 1)
    return truth[k, 0] - truth[k - 1, 0] <= 1.0


def drifting(fixes, begin, velocity, in_velocity):
    """The fixes of a receiver that drifts with `velocity` (north, east, m/s) for DRIFT_S from `begin` on."""
    fixes = fixes.copy()
    t = fixes["t_ns"] * 1e-9
    k = (t >= begin) & (t < begin + DRIFT_S)
    fixes["lat"][k] += velocity[0] * (t[k] - begin) / 6.37e6
    fixes["lon"][k] += velocity[1] * (t[k] - begin) / (6.38e6 * np.cos(fixes["lat"][k]))
    if in_velocity:
        v = fixes["speed"][k] * np.exp(1j * fixes["course"][k]) + complex(*velocity)
        fixes["speed"][k], fixes["course"][k] = np.abs(v), np.angle(v)
        fixes["v"][k, :2] += velocity
    return fixes


def driving(truth, begin):
    """What kind of driving the minute from `begin` on is, and its course at the beginning, rad."""
    k = (truth[:, 0] >= begin) & (truth[:, 0] < begin + DRIFT_S)
    vn, ve = truth[k, 4], truth[k, 5]
    speed = np.hypot(vn, ve)
    course = np.unwrap(np.arctan2(ve, vn)[speed > 1.0])
    if not len(course):
        return "rest", 0.0
    if speed.mean() < CREEPING_MPS:
        return "creeping", float(course[0])
    away = np.degrees(course - np.median(course))
    return ("straight" if np.percentile(np.abs(away), 95) < STRAIGHT_DEG else "other"), float(course[0])


@functools.cache
def run(name, grade, begin, direction, in_velocity, speed, wheels, tuning, vehicle):
    samples, fixes, truth, meta, rows = recording(name, grade)
    kind, course = driving(truth, begin)
    angle = course + np.radians(DIRECTIONS.get(direction, 0.0))
    velocity = (speed * np.cos(angle), speed * np.sin(angle)) if direction else (0.0, 0.0)
    fixes = drifting(fixes, begin, velocity, in_velocity)
    end = begin + DRIFT_S + 60.0
    samples = samples[(samples["t_ns"] * 1e-9 < end) & (samples["t_ns"] * 1e-9 > begin - 300.0)]
    fixes = fixes[(fixes["arrival_ns"] * 1e-9 < end) & (fixes["t_ns"] * 1e-9 > begin - 300.0)]
    rows = rows[(rows["t_ns"] * 1e-9 < end) & (rows["t_ns"] * 1e-9 > begin - 300.0)] if wheels else rows[:0]
    out = played(samples, fixes, rows, settings_of(vehicle, meta["lever_frd"], "auto", dict(tuning)))[0]
    est = table(out)
    t, d, _ = scorer().errors(est, truth, meta["lever_frd"] if meta["truth_point"] == "antenna" else None)
    d = d[:, :2]
    status = out["status"][np.searchsorted(out["t_ns"], (t * 1e9).astype(np.int64), "right") - 1]
    sigma = np.column_stack([np.interp(t, est[:, 0], est[:, k]) for k in (10, 11)])
    away, sigmas = np.hypot(d[:, 0], d[:, 1]), np.hypot(*(d / sigma).T)
    row_s = np.minimum(np.diff(t, prepend=t[0]), 1.1)
    valid = (status & POSITION_VALID != 0) & (t >= begin) & known(truth, t)
    sure = (away > 5.0) & (sigmas > 4.0) & valid
    rejecting = (status & REJECTING != 0) & (t > begin) & (t < begin + DRIFT_S)
    wrong_reject = float(row_s[(status & REJECTING != 0) & (t >= begin + DRIFT_S + 20.0)].sum())
    fault = (t >= begin) & (t < begin + DRIFT_S)
    found = np.flatnonzero(rejecting)
    at_end = away[fault][-1] if fault.any() else np.nan
    return {
        "kind": kind,
        "found_s": float(t[found[0]] - begin) if len(found) else np.inf,
        "sure_s": float(row_s[sure].sum()),
        "most_sigmas": float(np.max(sigmas[valid & (away > 5.0)], initial=0.0)),
        "max_m": float(np.max(away[valid], initial=0.0)),
        "end_m": float(at_end),
        "late_reject_s": wrong_reject,
        "rms_m": float(np.sqrt(np.mean(away[valid] ** 2))) if valid.any() else np.nan,
        "nees": float(np.mean(0.5 * sigmas[valid] ** 2)) if valid.any() else np.nan,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("recordings", nargs="*", default=["rtkx-drive", "ixr-0412"])
    parser.add_argument("--fixes", default="receiver_like")
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--vehicle", default="auto")
    parser.add_argument("--without", action="store_true", help="without wheels")
    parser.add_argument("--list", action="store_true", help="each run, too")
    parser.add_argument("--direction", type=lambda s: s.split(","), default=["", *DIRECTIONS])
    parser.add_argument("--set", type=lambda s: s.split(","), default=[], help="tunables of the filter: KEY=VALUE,..")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    a = parser.parse_args()
    tuning = tuple((key, float(value)) for key, value in (text.split("=") for text in a.set))
    jobs = []
    for name in a.recordings:
        truth = recording(name, a.fixes)[2]
        first = truth[0, 0] + (200.0 if name[:3] == "ixr" else 120.0)
        begins = np.arange(first, truth[-1, 0] - DRIFT_S - 30.0, 2.0)
        begins = begins[[known(truth, np.arange(begin, begin + DRIFT_S, 0.5)).mean() > 0.7 for begin in begins]]
        for begin in begins[np.linspace(0, len(begins) - 1, a.runs).astype(int)]:
            for direction in a.direction:
                for in_velocity in (True, False) if direction else (False,):
                    jobs.append(
                        (name, a.fixes, float(begin), direction, in_velocity, a.speed, not a.without, tuning, a.vehicle)
                    )
    sums = {}
    with ProcessPoolExecutor(a.jobs) as pool:
        for job, row in zip(jobs, pool.map(run, *zip(*jobs, strict=True), chunksize=4), strict=True):
            name, _, begin, direction, in_velocity = job[:5]
            across = "across" if direction in ("left", "right") else "other"
            drift = f"{'in velocity,' if in_velocity else 'positions alone,'} {across}" if direction else "no drift"
            sums.setdefault((name, row["kind"], drift), []).append(row)
            if a.list:
                print(name, f"{begin:.0f}", direction, drift, row, flush=True)
    print("| recording | driving | drift | runs | found in 30 s | sure s | most sigma | median end m | most end m |")
    print("|---" * 9 + "|")
    for (name, kind, drift), rows in sorted(sums.items()):
        found, sure, sigmas, end = (np.array([row[key] for row in rows]) for key in COLUMNS)
        print(
            f"| {name} | {kind} | {drift} | {len(rows)} | {int(np.sum(found <= FOUND_S))} | {sure.sum():.0f} "
            f"| {sigmas.max():.0f} | {np.median(end):.1f} | {end.max():.1f} |"
        )


if __name__ == "__main__":
    main()
