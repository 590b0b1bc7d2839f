"""How good the attitude filter is beside VQF, on recordings with an optical reference and with faults added, as tables.

    python tests/accuracy_attitude.py [recordings|faults] [-j JOBS] [--set KEY=VALUE].. [--trials] [--only FILTER..]

Recordings: those of ../shared/data/attitude but one whose gyro is beyond its range throughout, and two of
../shared/data/navigation whose attitude is known from another filter with GNSS. Everything runs as in `imud replay`:
sensor monitor, calibration, filter, at full rate; `auto` and `consumer-mems`, causal and smoothed. Means of the trials:

- tilt: RMS error of the vertical, deg
- drift: slope of a straight line through the error of yaw, deg/min
- NEES: squared error of the vertical over its claimed variance, for each of its two components; 1 is honest
- wrong: seconds, in all trials together, with more than 5 deg and 4 sigma although ATTITUDE_VALID is set

`--set` changes a setting of imud, as of `imud replay`; `--trials` adds a line for each trial.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import zlib
from pathlib import Path

import numpy as np
from attitude_runs import tilt_variance_deg2
from broad import HALF_TURN_ABOUT_X, samples_of
from navigation_runner import SHARED, read
from replay_in_process import new_filter, replay, smoothed_solutions
from scipy.spatial.transform import Rotation, Slerp

from imud.estimators.records import ATTITUDE_VALID
from imud.setup import config

sys.path.append(str(SHARED))

PROFILES = ("auto", "consumer-mems")
LEFT_OUT = "TStick_Test05"
TO_Z_UP = np.concatenate([[1.0], HALF_TURN_ABOUT_X])  # quaternions body FRD to NED -> z-up sensor to z-up earth
GROUPS = ("rotation", "translation", "combined", "slow", "fast", "undisturbed", "disturbed")
WRONG_DEG, WRONG_SIGMAS = 5.0, 4.0


def trials():
    """Trials as score_attitude.py loads them."""
    import score_attitude

    files = sorted((SHARED / "attitude").glob("*.npz"))
    optical = [score_attitude.load(str(file)) for file in files if LEFT_OUT not in file.name]
    return optical + [of_vehicle(SHARED / "navigation" / name) for name in ("apm-quad106", "dtu-ugv4")]


def of_vehicle(folder: Path):
    """A trial from a recorded drive or flight; the reference is known at the samples next to its own epochs."""
    imu, truth = read(folder / "imu.csv"), read(folder / "truth.csv")
    t, t_ref = imu["t_s"], truth["t_s"]
    angles = np.column_stack([truth[f"{axis}_deg"] for axis in ("yaw", "pitch", "roll")])
    known = (t >= t_ref[0]) & (t <= t_ref[-1])
    nearest = t_ref[np.clip(np.searchsorted(t_ref, t), 1, len(t_ref) - 1) + np.array([[-1], [0]])]
    known &= np.min(np.abs(nearest - t), axis=0) < 0.5 * np.median(np.diff(t))
    q = np.full((len(t), 4), np.nan)
    at = Slerp(t_ref, Rotation.from_euler("ZYX", angles, degrees=True))(t[known]).as_quat()
    q[known] = at[:, [3, 0, 1, 2]] * TO_Z_UP
    vectors = (np.column_stack([imu[name] for name in names]) for names in IMU_COLUMNS)
    gyr, acc = (vector * HALF_TURN_ABOUT_X for vector in vectors)
    trial = {"t": t - t[0], "gyr": gyr, "acc": acc, "q_ref": q, "move": known, "fs": 1.0 / np.median(np.diff(t))}
    return trial | {"dataset": folder.name, "name": folder.name, "groups": []}


IMU_COLUMNS = ("gx_radps", "gy_radps", "gz_radps"), ("ax_mps2", "ay_mps2", "az_mps2")


# faults: a trial that has them; `rng` is the trial's own


def middle(trial, rng):
    """A moment in the middle third of the motion at which the sensor turns."""
    moving = np.flatnonzero(trial["move"])
    third = moving[len(moving) // 3 : 2 * len(moving) // 3]
    turning = third[np.linalg.norm(trial["gyr"][third], axis=1) > np.radians(30.0)]
    return rng.choice(turning if len(turning) else third)


def started_in_motion(trial, rng):
    import score_attitude

    return score_attitude.perturb(trial, start="moving")


def biased(trial, rng):
    import score_attitude

    return score_attitude.perturb(trial, gyr_bias=0.5, acc_bias=8.0)


def clipped(trial, rng):
    """Rates end at 0.7 of the fastest, which nobody declared."""
    limit = 0.7 * np.max(np.abs(trial["gyr"]))
    return trial | {"gyr": np.clip(trial["gyr"], -limit, limit)}


def held(trial, rng, seconds, columns):
    """These (reading, axes) keep their values."""
    begin = middle(trial, rng)
    part = slice(begin, begin + round(seconds * trial["fs"]))
    changed = {name: trial[name].copy() for name, _ in columns}
    for name, axes in columns:
        changed[name][part, axes] = changed[name][begin, axes]
    return trial | changed


def frozen_second(trial, rng):
    return held(trial, rng, 1.0, (("gyr", slice(3)), ("acc", slice(3))))


def frozen_axis(trial, rng):
    return held(trial, rng, 5.0, (("gyr", int(rng.integers(3))),))


def slipped(trial, rng):
    """From one sample to the next the sensor is turned by 10 deg in its mount, about a random axis."""
    begin, axis = middle(trial, rng), rng.normal(size=3)
    turn = Rotation.from_rotvec(np.radians(10.0) * axis / np.linalg.norm(axis))
    changed = {name: trial[name].copy() for name in ("gyr", "acc", "q_ref")}
    for name in ("gyr", "acc"):
        changed[name][begin:] = turn.inv().apply(changed[name][begin:])
    q = changed["q_ref"][begin:]
    known = np.isfinite(q).all(axis=1)
    q[known] = (Rotation.from_quat(q[known][:, [1, 2, 3, 0]]) * turn).as_quat()[:, [3, 0, 1, 2]]
    return trial | changed


def spiked(trial, rng):
    """One sample of 275 is anything within 2000 deg/s and 16 g."""
    n = len(trial["t"])
    hit = rng.choice(n, n // 275, replace=False)
    changed = {name: trial[name].copy() for name in ("gyr", "acc")}
    for name, most in (("gyr", np.radians(2000.0)), ("acc", 160.0)):
        changed[name][hit] = rng.uniform(-most, most, (len(hit), 3))
    return trial | changed


def in_degrees(trial, rng):
    return trial | {"gyr": np.degrees(trial["gyr"])}


FAULTS = (started_in_motion, biased, clipped, frozen_second, frozen_axis, slipped, spiked, in_degrees)


# filters: trial -> (quaternions z-up, sigma^2 of the vertical in deg^2 or None, whether it is valid)


def vqf(trial):
    from vqf import VQF

    return (
        VQF(1.0 / trial["fs"]).updateBatch(*(np.ascontiguousarray(trial[name]) for name in ("gyr", "acc")))["quat6D"],
        None,
        None,
    )


def offline_vqf(trial):
    from vqf import offlineVQF

    return offlineVQF(trial["gyr"], trial["acc"], None, 1.0 / trial["fs"])["quat6D"], None, None


def imud(trial, profile, smoothed, changes):
    samples = samples_of(trial["t"], trial["gyr"] * HALF_TURN_ABOUT_X, trial["acc"] * HALF_TURN_ABOUT_X)
    filter_ = new_filter("attitude", samples, config.loads("", (f"imu.profile={profile}", *changes)))
    if smoothed:
        out = smoothed_solutions(filter_, samples)
    else:
        out, _ = replay(filter_, samples)
    return out["q_nb"] * TO_Z_UP, tilt_variance_deg2(out), out["status"] & ATTITUDE_VALID != 0


FILTERS = ("VQF", "offlineVQF", *(f"{profile}{kind}" for kind in ("", ", smoothed") for profile in PROFILES))


def estimate(name, trial, changes):
    if name in ("VQF", "offlineVQF"):
        return (vqf if name == "VQF" else offline_vqf)(trial)
    profile, _, kind = name.partition(", ")
    return imud(trial, profile, kind == "smoothed", changes)


def score(job):
    """(tilt, drift, NEES, seconds wrong) of one filter on one trial."""
    trial, fault, name, changes = job
    import score_attitude

    if fault is not None:
        trial = fault(trial, np.random.default_rng(zlib.crc32(trial["name"].encode())))
    q, variance, valid = estimate(name, trial, changes)
    found = score_attitude.errors(q, trial)
    if variance is None:
        return found["incl"], found["drift"], np.nan, np.nan
    reference = score_attitude.shifted_ref(trial, score_attitude.SHIFT.get(trial["dataset"], 0.0))
    error = score_attitude.qmul(q, reference * [1.0, -1.0, -1.0, -1.0])
    tilt2 = np.degrees(2.0 * np.arccos(np.clip(np.hypot(error[:, 0], error[:, 3]), 0.0, 1.0))) ** 2
    known = np.isfinite(tilt2) & trial["move"]
    nees = tilt2 / variance
    wrong = known & valid & (tilt2 > WRONG_DEG**2) & (nees > 0.5 * WRONG_SIGMAS**2)
    seconds = np.sum(wrong) * np.ptp(trial["t"]) / len(known)
    return found["incl"], found["drift"], np.mean(nees[known]), seconds


def rows_of(trials_):
    """(name, indices of its trials) of each row of the table."""
    which = lambda wanted: [i for i, trial in enumerate(trials_) if wanted(trial)]  # noqa: E731
    sets = list(dict.fromkeys(trial["dataset"] for trial in trials_))
    rows = [(name, which(lambda trial, name=name: trial["dataset"] == name)) for name in sets]
    rows[1:1] = [(f"  {group}", which(lambda trial, group=group: group in trial["groups"])) for group in GROUPS]
    return rows


def table(title, names, scores, rows):
    """scores: of each filter, of each trial."""
    print(f"\n| {title} | {' | '.join(names)} |\n|{'---|' * (1 + len(names))}")
    for name, indices in rows:
        print(f"| {name} | {' | '.join(cell(scores[filter_, indices]) for filter_ in range(len(names)))} |", flush=True)


def cell(scores):
    """Of some trials; the sigmas of VQF are not known."""
    tilt, drift, nees, _ = scores.mean(axis=0)
    known = f", {nees:.2f}, {scores[:, 3].sum():.0f}" if np.isfinite(nees) else ""
    return f"{tilt:.2f}, {drift:.2f}{known}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("recordings", "faults", "all"), default="all")
    parser.add_argument("-j", "--jobs", type=int, default=1)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--trials", action="store_true", help="also each trial")
    parser.add_argument("--only", nargs="*", default=FILTERS, help="these filters")
    args = parser.parse_args()
    all_, changes = trials(), tuple(args.set)
    optical = [trial for trial in all_ if trial["dataset"] in ("BROAD", "RepoIMU")]
    tables = [("tilt, drift, NEES, wrong", None, all_, args.only)] if args.what != "faults" else []
    if args.what != "recordings":
        causal = [name for name in args.only if name in ("VQF", *PROFILES)]
        tables += [(fault.__name__.replace("_", " "), fault, optical, causal) for fault in FAULTS]
    with multiprocessing.Pool(args.jobs) as pool:
        for title, fault, trials_, names in tables:
            jobs = [(trial, fault, name, changes) for name in names for trial in trials_]
            scores = np.array(pool.map(score, jobs, chunksize=1)).reshape(len(names), len(trials_), 4)
            rows = rows_of(trials_)
            if args.trials:
                rows += [(trial["name"], [i]) for i, trial in enumerate(trials_)]
            table(title, names, scores, rows if fault is None or args.trials else [r for r in rows if r[0][0] != " "])


if __name__ == "__main__":
    main()
