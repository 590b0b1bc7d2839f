"""Accuracy and honesty of the navigation filter on the open recordings, as a table in Markdown, also with faults.

    python tests/accuracy.py [RECORDING..] [--faults] [--outages] [--vehicle auto,land] [--profile auto,consumer-mems]
                             [--fault NAME,..] [--fixes NAME,..] [--smooth] [--jobs 2]

Each row is one replay at the full rate, through what users run. Horizontal errors are RMS from a minute after the first
solution on (flights: within the times that their `meta.json` says are to be scored), in rows without a fault only while
fixes are fresh. NEES: mean squared error over variance, per axis. "Wrong and sure": seconds with an error of more than
4 sigma and 5 m, or 5 degrees, while the status says that position, heading or attitude are valid; `max` is the largest
horizontal error of these runs. A car's recording has no reference of the attitude: there the yaw is compared with the
course at more than 5 m/s, less the median of the difference, which is the mounting. A flight's reference of the
attitude is another filter, which does not know its yaw before it flies: it counts within the times to be scored only.

An outage has four figures: median, RMS and NEES of the horizontal errors at its end, RMS of the largest within it.

The profile `auto` is `consumer-mems` here, as these tables name no sensor: the rows of the two are equal.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from navigation_runner import (
    SHARED,
    load,
    outage_ends,
    scorer,
    settings_of,
    table,
    truth_of,
    without,
)
from replay_in_process import new_filter, replay, smoothed_solutions

from imud.estimators.records import ATTITUDE_VALID, HEADING_VALID, POSITION_VALID

FIXES = {  # recording: its fixes
    "ixr-0412": ("rtk1", "rtk1_live", "receiver_like", "nmea_grade"),
    "rtkx-drive": ("rtk1", "rtk1_live", "receiver_like", "nmea_grade"),
    "dtu-ugv4": ("rtk1", "rtk1_live", "receiver_like", "nmea_grade"),
    "umn-thor75": ("ned", "nmea"),
    "apm-quad106": ("ned", "nmea", "nmea_1hz"),
}
LIVE, LIVE_S = "_live", 0.1  # fixes as of a receiver at work: they arrive after their epoch, a survey's do not
FAULT_S = 30.0  # how long a passing fault lasts
RAMP_S = 60.0
LIMIT_M, LIMIT_DEG, LIMIT_SIGMA = 5.0, 5.0, 4.0
COURSE_MPS = 5.0  # slowest speed at which the course of a car is its heading


def during(rows, begin, seconds):
    t = rows["t_ns"] * 1e-9
    return (t >= begin) & (t < begin + seconds)


def frozen(samples, fixes, begin, names=("lat", "lon", "height", "speed", "course", "v")):
    """A receiver that repeats what it said, under new stamps."""
    k = np.flatnonzero(during(fixes, begin, FAULT_S))
    for name in names if len(k) else ():
        fixes[name][k] = fixes[name][k[0]]


def frozen_position(samples, fixes, begin):
    frozen(samples, fixes, begin, ("lat", "lon", "height"))


def restamp(fixes, k, seconds):
    fixes["t_ns"][k] += np.int64(1e9 * seconds) if np.isscalar(seconds) else (1e9 * seconds).astype(np.int64)
    fixes["arrival_ns"] = np.maximum(fixes["arrival_ns"], fixes["t_ns"])


def late(samples, fixes, begin):
    restamp(fixes, slice(None), 1.0)


def late_step(samples, fixes, begin):
    restamp(fixes, fixes["t_ns"] * 1e-9 >= begin, 1.0)


def early_step(samples, fixes, begin):
    """The stamps fall back by a second; the arrivals stay."""
    restamp(fixes, fixes["t_ns"] * 1e-9 >= begin, -1.0)


def jitter(samples, fixes, begin):
    restamp(fixes, slice(None), np.random.default_rng(1).uniform(-0.05, 0.05, len(fixes)))


def shift(fixes, seconds):
    """Another clock stamped the fixes: epochs and arrivals move by `seconds`, which depend on the time."""
    for name in ("t_ns", "arrival_ns"):
        fixes[name] += (1e9 * seconds).astype(np.int64)


def clock_rate(samples, fixes, begin):
    """The clocks of IMU and receiver agree at the first fix and run apart by 200 parts in a million."""
    shift(fixes, 2e-4 * 1e-9 * (fixes["t_ns"] - fixes["t_ns"][0]))


def clock_wander(samples, fixes, begin):
    """The clocks differ by 0.15 s to and fro within 200 s, at most 4.7 ms/s."""
    shift(fixes, 0.15 * np.sin(2e-9 * np.pi / 200.0 * (fixes["t_ns"] - fixes["t_ns"][0])))


def ramp(samples, fixes, begin):
    k = during(fixes, begin, RAMP_S)
    fixes["lat"][k] += (fixes["t_ns"][k] * 1e-9 - begin) / 6.37e6


def gyro_step(samples, fixes, begin):
    samples["w"][samples["t_ns"] * 1e-9 >= begin, 2] += np.radians(0.5)


def level_gyro_step(samples, fixes, begin):
    samples["w"][samples["t_ns"] * 1e-9 >= begin, 0] += np.radians(1.0)


def lever_arm(samples, fixes, begin):
    """The lever arm is given wrong, without or with a sigma: see `figures`."""


FAULTS = {
    "frozen": frozen,
    "frozen position": frozen_position,
    "stamps +1 s": late,
    "stamps step +1 s": late_step,
    "stamps step -1 s": early_step,
    "epochs +-50 ms": jitter,
    "clock +200 ppm": clock_rate,
    "clock +-0.15 s": clock_wander,
    "ramp 1 m/s": ramp,
    "lever arm +1 m": lever_arm,
    "lever arm +1 m as sigma": lever_arm,
    "gyro +0.5 deg/s": gyro_step,
    "level gyro +1 deg/s": level_gyro_step,
}


@functools.cache
def recording(name, grade):
    """(samples, fixes, reference, meta, when a fault begins: in motion, about the middle)."""
    folder = SHARED / "navigation" / name
    meta = json.loads((folder / "meta.json").read_text())
    samples, fixes = load(folder, grade.removesuffix(LIVE))
    if grade.endswith(LIVE):
        fixes["arrival_ns"] += int(1e9 * LIVE_S)
    truth = truth_of(folder)
    t, speed = truth[:, 0], np.hypot(truth[:, 4], truth[:, 5])
    start = meta.get("score_from", t[0] + 60.0)
    end = meta.get("score_to", t[-1])
    times = np.arange(start + 0.3 * (end - start), start + 0.6 * (end - start), 2.0)
    slowest = [
        np.percentile(speed[(t >= x) & (t < x + FAULT_S)], 10) if (np.abs(t - x) < 1).any() else 0 for x in times
    ]
    return samples, fixes, truth, meta, float(times[int(np.argmax(slowest))])


def horizontal(d, s):
    """Distance and the same in sigmas."""
    return np.hypot(d[:, 0], d[:, 1]), np.hypot(d[:, 0] / s[:, 0], d[:, 1] / s[:, 1])


def yaw_errors(truth, d, i, est, t, valid):
    """Errors of the yaw, deg, NaN where there is no reference; cars without one: against the course, but for what the
    yaws that are valid have in common."""
    if np.isfinite(truth[i, 9]).any():
        return d[:, 8]
    vn, ve = truth[i, 4], truth[i, 5]
    yaw = np.degrees(np.interp(t, est[:, 0], np.unwrap(np.radians(est[:, 9]))))
    away = (yaw - np.degrees(np.arctan2(ve, vn)) + 180.0) % 360.0 - 180.0
    away[np.hypot(vn, ve) < COURSE_MPS] = np.nan
    known = np.radians(away[valid & np.isfinite(away)])
    middle = np.angle(np.median(np.cos(known)) + 1j * np.median(np.sin(known))) if known.size else 0.0
    return (away - np.degrees(middle) + 180.0) % 360.0 - 180.0


def solutions(samples, fixes, settings, smooth):
    """Of one pass, causal or smoothed."""
    filter_ = new_filter("navigation", samples, settings)
    return smoothed_solutions(filter_, samples, fixes) if smooth else replay(filter_, samples, fixes)[0]


def figures(name, grade, fault, vehicle, profile, tuning, lengths, smooth):
    """The figures of one row, by name."""
    samples, fixes, truth, meta, begin = recording(name, grade)
    samples, fixes = samples.copy(), fixes.copy()
    if fault:
        FAULTS[fault](samples, fixes, begin)
    given = np.array(meta["lever_frd"], float) + np.array([0.0, float(fault.startswith("lever arm")), 0.0])
    settings, score = (
        settings_of(vehicle, given, profile, tuning, (1.0 if fault.endswith("sigma") else "auto")),
        scorer(),
    )
    out = solutions(samples, fixes, settings, smooth)
    est, arm = table(out), meta["lever_frd"] if meta["truth_point"] == "antenna" else None
    t, d, i = score.errors(est, truth, arm)
    sigma = np.column_stack([np.interp(t, est[:, 0], est[:, k]) for k in range(10, 19)])
    status = out["status"][np.searchsorted(out["t_ns"], (t * 1e9).astype(np.int64), "right") - 1]
    d[:, 8] = yaw_errors(truth, d, i, est, t, status & HEADING_VALID > 0)
    flown = (t >= meta.get("score_from", t[0] + 60.0 + 100.0 * (name[:3] == "ixr"))) & (
        t <= meta.get("score_to", t[-1])
    )
    fresh = (
        flown
        if fault
        else flown & score.steady(t, str(SHARED / "navigation" / name / f"gnss_{grade.removesuffix(LIVE)}.csv"))
    )
    away, sigmas = horizontal(d[:, :2], sigma[:, :2])
    row_s = np.minimum(np.diff(t, prepend=t[0]), 1.1)
    angle, angle_sigmas = np.abs(d[:, 6:9]), np.abs(d[:, 6:9]) / sigma[:, 6:9]
    sure = (angle > LIMIT_DEG) & (angle_sigmas > LIMIT_SIGMA)
    sure &= np.column_stack([status & ATTITUDE_VALID, status & ATTITUDE_VALID, status & HEADING_VALID]) > 0
    referenced = flown if "score_from" in meta else np.ones(len(t), bool)
    rms = lambda x: float(np.sqrt(np.nanmean(x * x))) if np.isfinite(x).any() else np.nan  # noqa: E731
    nees = [np.nanmean((d[fresh, k : k + 3] / sigma[fresh, k : k + 3]) ** 2) for k in (0, 3, 6)]
    found = np.flatnonzero(out["status"] & HEADING_VALID)
    row = {
        "position m": rms(away[fresh]),
        "velocity m/s": rms(np.hypot(d[fresh, 3], d[fresh, 4])),
        "yaw deg": rms(d[fresh, 8]),
        "NEES p, v, a": nees,
        "wrong: position s": float(
            row_s[(away > LIMIT_M) & (sigmas > LIMIT_SIGMA) & (status & POSITION_VALID > 0)].sum()
        ),
        "yaw s": float(row_s[sure[:, 2] & referenced].sum()),
        "tilt s": float(row_s[(sure[:, 0] | sure[:, 1]) & referenced].sum()),
        "max m": float(away[flown].max()),
        "heading after s": 1e-9 * float(out["t_ns"][found[0]] - out["t_ns"][0]) if len(found) else np.nan,
        "heading valid %": 100.0 * float(np.mean(status[flown] & HEADING_VALID > 0)),
    }
    for length in lengths:
        row[f"outage {length} s m"] = outages(name, grade, settings, truth, arm, length, smooth)
    return row


def outages(name, grade, settings, truth, arm, length, smooth):
    """[median, RMS, mean NEES] of the horizontal errors at the ends of outages of one length, and RMS of the largest
    within each; [] without any.
    """
    samples, fixes = recording(name, grade)[:2]
    ends, largest = [], []
    for windows in json.loads((SHARED / "navigation" / name / "outages.json").read_text()).get(length, []):
        cut = table(solutions(samples, without(fixes, windows), settings, smooth))
        ends += outage_ends(scorer(), cut, truth, arm, windows)
        t, d, _ = scorer().errors(cut, truth, arm)
        within = [(t >= begin) & (t <= end) for begin, end, _ in windows]
        largest += [np.hypot(d[k, 0], d[k, 1]).max() for k in within if k.any()]
    if not ends:
        return []
    e, rms = np.array(ends), lambda x: float(np.sqrt(np.mean(np.square(x))))
    return [float(np.median(e[:, 0])), rms(e[:, 0]), float(e[:, 1].mean()), rms(largest)]


def text_of(value):
    if isinstance(value, list):
        return ", ".join(text_of(x) for x in value)
    if not np.isfinite(value):
        return ""
    if value == 0.0:
        return "0"
    return f"{value:.3f}" if abs(value) < 0.2 else f"{value:.2f}" if abs(value) < 10.0 else f"{value:.0f}"


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    names = lambda text: text.split(",")  # noqa: E731
    parser.add_argument("recordings", nargs="*", default=list(FIXES))
    parser.add_argument("--faults", action="store_true", help="one row for each fault as well")
    parser.add_argument("--fault", type=names, help="these faults only: " + ", ".join(FAULTS))
    parser.add_argument("--fixes", type=names, help="these fixes only")
    parser.add_argument("--outages", action="store_true", help="withhold fixes as well, for 30 s, 60 s (flights: 15 s)")
    parser.add_argument("--smooth", action="store_true", help="as `imud replay --smooth`")
    parser.add_argument("--vehicle", type=names, default=["auto"])
    parser.add_argument("--profile", type=names, default=["auto"])
    parser.add_argument("--set", type=names, default=[], help="tunables of the filter: KEY=VALUE,..")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    return parser.parse_args()


def main():
    a = arguments()
    faults = a.fault or [""] + (list(FAULTS) if a.faults else [])
    tuning = {key: float(value) for key, value in (text.split("=") for text in a.set)}
    lengths = ("15", "30", "60") if a.outages else ()
    jobs = [
        (name, grade, fault, vehicle, profile, tuning, () if fault else lengths, a.smooth)
        for name in a.recordings
        for grade in FIXES[name]
        if not a.fixes or grade in a.fixes
        for vehicle in a.vehicle
        for profile in a.profile
        for fault in faults
    ]
    with ProcessPoolExecutor(a.jobs) as pool:
        for n, (job, row) in enumerate(zip(jobs, pool.map(figures, *zip(*jobs, strict=True)), strict=True)):
            if n == 0:
                print("| recording | fixes | fault | vehicle, profile |", *(f"{name} |" for name in row))
                print("|---" * (4 + len(row)) + "|")
            print("|", " | ".join([*job[:3], ", ".join(job[3:5]), *map(text_of, row.values())]), "|", flush=True)


if __name__ == "__main__":
    main()
