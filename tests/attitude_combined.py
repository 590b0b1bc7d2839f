"""Random combinations of errors on recordings with a reference: where is the attitude filter wrong and sure, or off?

    python tests/attitude_combined.py [--seeds 0-199] [--jobs 2] [--set KEY=VALUE]..

Each seed draws one of the recordings of `accuracy_attitude` (one in five a vehicle), a part of 40 to 150 s (half of
them begin in motion), the mean of 1, 2 or 5 samples for each, up to three errors of the sensor, and for two runs in
five another mounting. One line for each run: seconds wrong and sure of tilt and yaw (more than 5 deg and 4 sigma, the
tilt with ATTITUDE_VALID; yaw counts from its first, and anew from a slip), RMS of the tilt, 90 % of its stated sigmas,
NEES, the part of the time with ATTITUDE_VALID, the RMS of VQF where it is installed; what was drawn. The runs that are
worst come last.
"""

from __future__ import annotations

import argparse
import importlib.util
from concurrent.futures import ProcessPoolExecutor
from functools import cache

import accuracy_attitude
import numpy as np
from accuracy_attitude import WRONG_DEG, WRONG_SIGMAS, of_vehicle
from accuracy_combined import accelerometer_step, by_sign, clock_rate, counts, force_sensitivity, noise, time_tags
from accuracy_simulated import seeds_of
from attitude_runs import tilt_variance_deg2, yaw_sigma_deg
from attitude_simulation import G
from broad import HALF_TURN_ABOUT_X, samples_of
from navigation_runner import SHARED
from replay_in_process import new_filter, replay
from scipy.spatial.transform import Rotation

from imud.estimators.records import ATTITUDE_VALID
from imud.setup import config

VEHICLES = ("apm-quad106", "dtu-ugv4")


@cache
def recordings():
    """(names, files) that are drawn: optical reference, vehicles."""
    files = sorted(path for path in (SHARED / "attitude").glob("*.npz") if accuracy_attitude.LEFT_OUT not in path.name)
    return files, [SHARED / "navigation" / name for name in VEHICLES]


@cache
def loaded(path):
    """(t, gyr, acc, reference as body FRD to NED, quaternions with NaN where there is none, whether it moves)."""
    import score_attitude

    trial = score_attitude.load(str(path)) if path.suffix == ".npz" else of_vehicle(path)
    q = score_attitude.shifted_ref(trial, score_attitude.SHIFT.get(trial["dataset"], 0.0))
    q = q * accuracy_attitude.TO_Z_UP
    return trial["t"], trial["gyr"] * HALF_TURN_ABOUT_X, trial["acc"] * HALF_TURN_ABOUT_X, q, trial["move"]


# errors: change samples and their reference; `rng` is the run's own; they return what is left of both


def biases(samples, rng):
    samples["w"] += np.radians(rng.uniform(0.1, 3.0)) * rng.uniform(-1.0, 1.0, 3)
    samples["f"] += 0.008 * G * rng.standard_normal(3)


def scale(samples, rng):
    """Scale factors and misalignments of both."""
    for name in "wf":
        samples[name] = samples[name] @ (np.eye(3) + np.diag(0.007 * rng.standard_normal(3))).T
        samples[name] = samples[name] @ (np.eye(3) + 0.005 * rng.standard_normal((3, 3))).T


def middle(samples, rng):
    return int(len(samples) * rng.uniform(0.3, 0.9))


def spells(samples, rng, shortest_s, longest_s):
    """One to four random spells of that length, as slices."""
    period = np.median(np.diff(samples["t_ns"])) * 1e-9
    for _ in range(rng.integers(1, 5)):
        begin = rng.integers(len(samples))
        yield slice(begin, begin + max(1, round(rng.uniform(shortest_s, longest_s) / period)))


def gaps(samples, rng):
    """Without samples."""
    kept = np.ones(len(samples), bool)
    for spell in spells(samples, rng, 0.1, 3.0):
        kept[spell] = False
    return kept


def frozen(samples, rng):
    """All readings repeat."""
    for spell in spells(samples, rng, 0.1, 1.0):
        for name in "wf":
            samples[name][spell] = samples[name][spell.start]


def spikes(samples, rng):
    hit = rng.choice(len(samples), max(1, round(len(samples) * 10.0 ** rng.uniform(-4.0, -2.0))), replace=False)
    for name, most in (("w", np.radians(2000.0)), ("f", 16.0 * G)):
        some = hit[rng.random(len(hit)) < 0.7]
        axis = rng.integers(3, size=len(some))
        samples[name][some, axis] = rng.uniform(-most, most, len(some))


def clip(samples, rng, name, least):
    largest = np.max(np.abs(samples[name]))
    limit = max(largest * rng.uniform(0.5, 0.95), least)
    samples[name] = np.clip(samples[name], -limit, limit)


def clipped_gyro(samples, rng):
    clip(samples, rng, "w", np.radians(125.0))


def clipped_accelerometer(samples, rng):
    clip(samples, rng, "f", 2.0 * G)


def gyro_step(samples, rng):
    samples["w"][middle(samples, rng) :] += np.radians(0.4) * rng.standard_normal(3)


def warm_up(samples, rng):
    t = (samples["t_ns"] - samples["t_ns"][0])[:, None] * 1e-9
    samples["w"] += np.radians(0.3) * rng.standard_normal(3) * np.exp(-t / 60.0)


def slip(samples, rng):
    """(first sample after it, the new axes to the old ones)."""
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(np.radians(rng.uniform(5.0, 20.0)) * axis / np.linalg.norm(axis))
    begin = middle(samples, rng)
    for name in "wf":
        samples[name][begin:] = turn.inv().apply(samples[name][begin:])
    return begin, turn


ERRORS = (  # in the order in which a sensor makes them
    slip, scale, by_sign, force_sensitivity, biases, gyro_step, accelerometer_step, warm_up, noise, clipped_gyro,
    clipped_accelerometer, counts, time_tags, clock_rate, frozen, spikes, gaps,
)  # fmt: skip


def means_of(n, *arrays):
    """Of n rows each; the newest where they are no numbers of a sensor."""
    length = len(arrays[0]) // n * n
    return [a[:length].reshape(-1, n, *a.shape[1:]) for a in arrays]


def drawn(seed):
    """(samples, reference, whether it counts, index of a slip, mounting in deg, what was drawn) of one run."""
    rng = np.random.default_rng(seed)
    optical, vehicles = recordings()
    files = vehicles if rng.random() < 0.2 else optical
    path = files[rng.integers(len(files))]
    t, gyr, acc, q, move = loaded(path)
    length = min(rng.uniform(40.0, 150.0), t[-1])
    moving = t[move & (t < t[-1] - 20.0)]
    begin = rng.choice(moving) if rng.random() < 0.5 else max(rng.uniform(0.0, moving[0]), moving[0] - 10.0)
    part = (t >= begin) & (t < begin + length)
    n = int(rng.choice([1, 2, 5]))
    t, gyr, acc, q, move = means_of(n, t[part], gyr[part], acc[part], q[part], move[part])
    samples = samples_of(t[:, -1], gyr.mean(axis=1), acc.mean(axis=1))
    q, move, slipped = q[:, -1].copy(), move[:, -1], len(samples)
    text = f"{path.stem} {begin:.0f}+{np.ptp(t):.0f} s /{n}"
    mount = (0.0, 0.0, 0.0)  # of the sensor in the body
    if rng.random() < 0.4:
        text += ", mounted"
        mount = tuple(rng.uniform((-180.0, -85.0, -180.0), (180.0, 85.0, 180.0)).tolist())
        q = product(q, Rotation.from_euler("ZYX", mount[::-1], degrees=True).inv())
    for i in sorted(rng.choice(len(ERRORS), rng.integers(0, 4), replace=False)):
        text += f", {ERRORS[i].__name__}"
        result = ERRORS[i](samples, rng)
        if ERRORS[i] is gaps:
            slipped = int(np.sum(result[:slipped]))
            samples, q, move = samples[result], q[result], move[result]
        elif ERRORS[i] is slip:
            slipped, turn = result
            turn_mounted = Rotation.from_euler("ZYX", mount[::-1], degrees=True)
            q[slipped:] = product(q[slipped:], turn_mounted * turn * turn_mounted.inv())
    return samples, q, move & np.isfinite(q).all(axis=1), slipped, mount, text


def product(q, turn):
    """q times a rotation, where q is known."""
    known = np.isfinite(q).all(axis=1)
    q = q.copy()
    q[known] = np.roll((Rotation.from_quat(np.roll(q[known], -1, axis=1)) * turn).as_quat(), 1, axis=1)
    return q


def errors_deg(q, reference):
    """(tilt, yaw) of the error as a rotation in NED: about the vertical, then about a level axis."""
    import score_attitude

    error = score_attitude.qmul(q, reference * [1.0, -1.0, -1.0, -1.0])
    tilt = np.degrees(2.0 * np.arccos(np.clip(np.hypot(error[:, 0], error[:, 3]), 0.0, 1.0)))
    return tilt, np.degrees(2.0 * np.arctan2(error[:, 3], error[:, 0]))


def yaw_since(yaw, known, slipped):
    """Errors of the yaw less the first one that is known, and after a slip the first one then."""
    yaw = np.where(known, yaw, np.nan)
    for part in (slice(0, slipped), slice(slipped, None)):
        first = np.flatnonzero(known[part])
        yaw[part] -= yaw[part][first[0]] if len(first) else 0.0
    return np.abs((yaw + 180.0) % 360.0 - 180.0)


def vqf_rms(samples, reference, known, mount):
    if importlib.util.find_spec("vqf") is None:
        return np.nan
    from vqf import VQF

    turn = Rotation.from_euler("ZYX", mount[::-1], degrees=True)
    gyr, acc = (np.ascontiguousarray(turn.apply(samples[name]) * HALF_TURN_ABOUT_X) for name in "wf")
    q = VQF(np.median(np.diff(samples["t_ns"])) * 1e-9).updateBatch(gyr, acc)["quat6D"] * accuracy_attitude.TO_Z_UP
    return float(np.sqrt(np.mean(errors_deg(q, reference)[0][known] ** 2)))


def run(seed, changes):
    """(seconds wrong and sure: tilt, yaw; RMS tilt, 90 % of its sigmas, deg; NEES, part valid, RMS of VQF; text).

    None where no sample has a reference: of some means of five that of a vehicle is between two.
    """
    samples, reference, known, slipped, mount, text = drawn(seed)
    if not known.any():
        return None
    out = replay(
        new_filter("attitude", samples, config.loads("", (f"imu.mount_rpy_deg={list(mount)}", *changes))), samples
    )[0]
    valid, variance = out["status"] & ATTITUDE_VALID != 0, tilt_variance_deg2(out)
    tilt, yaw = errors_deg(out["q_nb"], reference)
    yaw = yaw_since(yaw, known & (np.cumsum(valid) > 0), slipped)
    period = np.minimum(np.diff(samples["t_ns"], prepend=samples["t_ns"][0]) * 1e-9, 0.1)
    wrong = (
        known & valid & (tilt > WRONG_DEG) & (tilt**2 > 0.5 * WRONG_SIGMAS**2 * variance),
        known & (yaw > WRONG_DEG) & (yaw > WRONG_SIGMAS * yaw_sigma_deg(out)),
    )
    rms = float(np.sqrt(np.mean(tilt[known] ** 2)))
    stated = float(np.quantile(np.sqrt(0.5 * variance[known]), 0.9))
    figures = rms, stated, np.mean((tilt**2 / variance)[known]), np.mean(valid[known])
    return np.array([period[x].sum() for x in wrong]), *figures, vqf_rms(samples, reference, known, mount), text


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=seeds_of, default=seeds_of("0-199"), metavar="FIRST-LAST")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--jobs", type=int, default=2)
    a = parser.parse_args()
    with ProcessPoolExecutor(a.jobs) as pool:
        found = pool.map(run, a.seeds, [tuple(a.set)] * len(a.seeds), chunksize=4)
        rows = [(seed, figures) for seed, figures in zip(a.seeds, found, strict=True) if figures is not None]
    for seed, (wrong, rms, stated, nees, valid, vqf, text) in sorted(
        rows, key=lambda row: (row[1][0].sum(), row[1][1])
    ):
        print(
            f"{seed:5d}  wrong {wrong.round(1)} s  rms {rms:.2f} stated {stated:.2f} NEES {nees:.2f} "
            f"valid {valid:.2f} VQF {vqf:.2f}  {text}"
        )
    wrong, rms, vqf = (np.array([row[1][k] for row in rows]) for k in (0, 1, 5))
    print(
        f"all: wrong {wrong.sum(axis=0).round(1)} s in {np.sum(wrong > 0.0, axis=0)} runs; "
        f"RMS mean {rms.mean():.3f}, median {np.median(rms):.3f} (VQF {vqf.mean():.3f}, {np.median(vqf):.3f}) deg; "
        f"median NEES {np.median([row[1][3] for row in rows]):.2f}; valid {np.mean([row[1][4] for row in rows]):.3f}"
    )


if __name__ == "__main__":
    main()
