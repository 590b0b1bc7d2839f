"""How long the navigation filter is wrong and sure on simulated drives and flights, with and without a bias that steps.

    python tests/accuracy_simulated.py [--seeds 0-15] [--vehicles NAME,..] [--receivers NAME,..] [--step 0,0.5]
                                        [--warm-up 0.05] [--fault turn|outage|moving] [--errors none|all|NAME,..]
                                        [--wheels] [--lever-arm-sigma auto] [--set KEY=VALUE,..] [--jobs 2]

22 vehicles (`simulated_vehicles`), four receivers; each seed draws way, sensor and receiver. The sensor is worse than
the filter's noise profile: scale factors and misalignments, rates that depend on the force, a bias that warms up (by
so many deg/s, 1 sigma, within 100 s), vibration. The receiver errs slowly, its velocities are smoothed and late, its
stamps are off. With a step the bias of the gyro about the vertical jumps by so many deg/s, at 110 to 140 s. Each run
goes through what users run, at its full rate; of the settings it has only that the antenna is at the sensor, exactly
(auto: as sure as imud takes it to be). "Wrong and sure": seconds with an error of more than 4 sigma and 5 m or
5 degrees while the status says that position, attitude or heading are valid. "no yaw": seconds from the step on
without a yaw within 5 degrees. Seconds are sums over the seeds, the rest medians (NEES: means) from a minute after the
start on.

Faults, at the time of the step: the gyro turns by 150 deg too far in a second (turn); there are no fixes for 30 s, in
which the gyro is off by 0.3 deg/s (outage); the first 70 s are missing, so that most start moving (moving).
Errors: `simulated_errors`. Wheels: vehicles on wheels, only these, have an odometer, 2 % off (1 sigma), with slips.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import itertools
import os
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from navigation_runner import fixes_of, navigate, samples_of, settings_of
from navigation_simulation import curvature, errors, moved
from simulated_errors import ERRORS, part
from simulated_vehicles import VEHICLES
from vehicle_simulation import RATE, slips, smooth

from imud.batch import NO_MEASUREMENT
from imud.estimators.records import ATTITUDE_VALID, HEADING_VALID, MEASUREMENT, ODOMETER_SOURCE, POSITION_VALID

ON_WHEELS = ("city", "motorway", "motorcycle", "robot", "tram", "rally", "tractor", "bicycle", "forklift", "lorry")
SECONDS, SETTLED_S, LIMIT_M, LIMIT_DEG, LIMIT_SIGMA = 240.0, 60.0, 5.0, 5.0, 4.0


@functools.lru_cache(2)
def way(name, seed):
    """The Drive of a vehicle."""
    rng, t = np.random.default_rng([seed, list(VEHICLES).index(name)]), np.arange(int(SECONDS * RATE)) / RATE
    v, attitude = VEHICLES[name][0](rng, t)
    return moved(t, v, attitude)


def sensed(d, rng, vrw, arw, warm_up_dps=0.05):
    """SAMPLE rows of a sensor that is worse than its noise profile says, on a vehicle that shakes it so much."""
    sigma, n = rng.standard_normal, len(d.t)
    moves = smooth((np.linalg.norm(d.v, axis=1) > 0.2).astype(float), 1.0)[:, None]
    scale, accel_scale = (np.diag(0.012 * sigma(3)) + 0.006 * sigma((3, 3)) for _ in range(2))
    g_sensitivity = np.radians(0.05) / 9.8 * sigma((3, 3))
    bias = np.radians(0.4 * sigma(3) + warm_up_dps * sigma(3) * np.exp(-d.t / 100.0)[:, None])
    bias = bias + np.radians(0.001) * np.cumsum(sigma((n, 3)), axis=0) / RATE**0.5
    shaken_w = np.sqrt(np.radians(0.01) ** 2 + (moves * np.radians(arw)) ** 2) * RATE**0.5
    shaken_f = np.sqrt(2e-3**2 + (moves * vrw) ** 2) * RATE**0.5
    w = d.w + d.w @ scale.T + d.f @ g_sensitivity.T + bias + shaken_w * sigma((n, 3))
    f = d.f + d.f @ accel_scale.T + 0.1 * sigma(3) + shaken_f * sigma((n, 3))
    return samples_of(100.0 + d.t, w, f)


def wander(rng, n, every_s, sigma, time_s):
    """First-order Gauss-Markov errors (n, 3)."""
    x, decay = np.empty((n, 3)), np.exp(-every_s / time_s)
    x[0] = sigma * rng.standard_normal(3)
    for i in range(1, n):
        x[i] = decay * x[i - 1] + sigma * np.sqrt(1.0 - decay * decay) * rng.standard_normal(3)
    return x


RECEIVERS = {  # s between fixes; sigmas of positions, m: slow, white; of velocities, m/s: slow, of a second, white
    "1 Hz positions": (1.0, 1.5, 0.3, None),
    "1 Hz": (1.0, 1.5, 0.3, (0.04, 0.05, 0.05)),
    "5 Hz": (0.2, 1.2, 0.2, (0.03, 0.05, 0.05)),
    "RTK": (0.2, 0.01, 0.008, (0.01, 0.02, 0.02)),
}


def received(d, rng, name):
    """FIX rows."""
    every_s, slow, white, of_velocity = RECEIVERS[name]
    k = np.arange(round(every_s * RATE), len(d.t), round(every_s * RATE))
    n, down = len(k), np.array([1.0, 1.0, 1.8])
    error = (wander(rng, n, every_s, slow, rng.uniform(20.0, 100.0)) + white * rng.standard_normal((n, 3))) * down
    lag, stamp, late = rng.uniform(0.0, 0.15), rng.uniform(-0.04, 0.04), rng.uniform(0.05, 0.3)
    meridian, normal = curvature(d.lat[k])
    columns = {
        "t_s": 100.0 + d.t[k] + stamp,
        "arrival_s": 100.0 + d.t[k] + late,
        "lat_deg": np.degrees(d.lat[k] + error[:, 0] / meridian),
        "lon_deg": np.degrees(d.lon[k] + error[:, 1] / (normal * np.cos(d.lat[k]))),
        "height_m": d.height[k] - error[:, 2],
    }
    if every_s == 1.0:
        columns["hdop"] = np.full(n, 0.9)
    else:
        sigma = max(np.hypot(slow, white), 0.015)
        columns |= {"sn_m": np.full(n, sigma), "se_m": np.full(n, sigma), "sd_m": np.full(n, 1.8 * sigma)}
    if of_velocity:
        slow, second, white = of_velocity
        v = d.v[k - round(lag * RATE)] + white * rng.standard_normal((n, 3)) * down
        v += (wander(rng, n, every_s, slow, rng.uniform(30.0, 200.0)) + wander(rng, n, every_s, second, 1.0)) * down
        if every_s == 1.0:
            columns |= {"speed_mps": np.hypot(v[:, 0], v[:, 1]), "course_deg": np.degrees(np.arctan2(v[:, 1], v[:, 0]))}
        else:
            columns |= dict(zip(("vn_mps", "ve_mps", "vd_mps"), v.T, strict=True))
    return fixes_of(columns, n)


def wheel_speeds(d, rng, sigma=0.05, every_s=0.1, late_s=0.02):
    """MEASUREMENT rows of a wheel whose speed has a sign."""
    k = np.arange(round(every_s * RATE), len(d.t), round(every_s * RATE))
    ahead = np.sum(d.attitude[k].apply([1.0, 0.0, 0.0]) * d.v[k], axis=1)
    turning = np.abs(ahead) > sigma  # a wheel that stands has no noise
    rows = np.zeros(len(k), MEASUREMENT)
    rows["t_ns"] = np.round(1e9 * (100.0 + d.t[k]))
    rows["arrival_ns"] = rows["t_ns"] + round(1e9 * late_s)
    rows["kind"], rows["value"], rows["sigma"] = ODOMETER_SOURCE, np.nan, np.nan
    rows["value"][:, 0] = (1.0 + 0.02 * rng.standard_normal()) * ahead * slips(rng, d.t[k])
    rows["value"][:, 0] += sigma * turning * rng.standard_normal(len(k))
    return rows


def judged(d, out, begin):
    """The figures of one run, by name; begin: the sample of the step."""
    position, velocity, attitude = errors(d, out)
    position, attitude, sigma = position[:, :2], np.degrees(attitude), np.degrees(out["sigma_rpy"])
    yaw, tilt, away = np.abs(attitude[:, 2]), np.hypot(*attitude[:, :2].T), np.hypot(*position.T)
    valid = lambda bit: (out["status"] & bit) > 0  # noqa: E731
    known, late = valid(HEADING_VALID), d.t > SETTLED_S
    sigmas = {
        "yaw": yaw / sigma[:, 2],
        "tilt": tilt / sigma[:, :2].max(axis=1),
        "position": np.hypot(*(position / out["sigma_p"][:, :2]).T),
    }
    wrong = {
        "yaw": known & (yaw > LIMIT_DEG),
        "tilt": valid(ATTITUDE_VALID) & (tilt > LIMIT_DEG),
        "position": valid(POSITION_VALID) & (away > LIMIT_M),
    }
    rms = lambda x: float(np.sqrt(np.mean(x * x))) if len(x) else np.nan  # noqa: E731
    row = {f"{name} s": float((wrong[name] & (sigmas[name] > LIMIT_SIGMA)).sum()) / RATE for name in wrong}
    return row | {
        "yaw deg": rms(yaw[late & known]),
        "yaw NEES": rms(sigmas["yaw"][late & known]) ** 2,
        "no yaw s": float((~known | (yaw > LIMIT_DEG))[begin:].sum()) / RATE,
        "velocity m/s": rms(np.hypot(*velocity[late, :2].T)),
        "position m": rms(away[late]),
        "position NEES": 0.5 * rms(sigmas["position"][late & valid(POSITION_VALID)]) ** 2,
    }


def with_fault(fault, d, samples, fixes, begin, sign):
    """(Drive, SAMPLE rows, FIX rows, sample from which on the yaw counts)."""
    if fault == "turn":
        samples["w"][begin : begin + int(RATE), 2] += np.radians(150.0 * sign)
    elif fault == "outage":
        missing = slice(begin, begin + int(30.0 * RATE))
        samples["w"][missing, 2] += np.radians(0.3 * sign)
        t_ns = samples["t_ns"][missing]
        fixes = fixes[(fixes["t_ns"] < t_ns[0]) | (fixes["t_ns"] > t_ns[-1])]
    elif fault == "moving":
        first = int(70.0 * RATE)
        samples = samples[first:]
        fixes, begin = fixes[fixes["t_ns"] >= samples["t_ns"][0]], 0
        d = part(d, slice(first, None))
        d = dataclasses.replace(d, t=d.t - d.t[0])
    return d, samples, fixes, begin


def figures(
    vehicle,
    receiver,
    step_dps,
    seed,
    tuning=None,
    warm_up_dps=0.05,
    fault=None,
    error="none",
    lever_arm_sigma_m=0.0,
    wheels=False,
):
    """The figures of one run, by name."""
    d, sources = way(vehicle, seed), (list(VEHICLES).index(vehicle), list(RECEIVERS).index(receiver))
    rng = np.random.default_rng([seed, *sources, 1])
    vrw, arw = (np.exp(rng.uniform(*np.log(span))) for span in VEHICLES[vehicle][1:])
    samples, fixes = sensed(d, rng, vrw, arw, warm_up_dps), received(d, rng, receiver)
    begin, sign = int(rng.uniform(110.0, 140.0) * RATE), rng.choice([-1.0, 1.0])
    samples["w"][begin:, 2] += np.radians(sign * step_dps)
    begin_s = d.t[begin]
    aiding = wheel_speeds(d, np.random.default_rng([seed, *sources, 3])) if wheels else NO_MEASUREMENT
    d, samples, fixes = ERRORS[error](d, samples, fixes, np.random.default_rng([seed, *sources, 2]))
    d, samples, fixes, begin = with_fault(fault, d, samples, fixes, int(np.searchsorted(d.t, begin_s)), sign)
    aiding = aiding[aiding["t_ns"] >= samples["t_ns"][0]]
    settings = settings_of(tuning=tuning, lever_arm_sigma_m=lever_arm_sigma_m)
    out, _, _ = navigate(samples, fixes, settings, aiding=aiding)
    return judged(d, out, begin)


def line(head, rows):
    """A row of the table: sums of seconds, means of NEES, medians of the rest."""
    cells = []
    for name in rows[0]:
        of = np.sum if name.endswith(" s") else np.nanmean if name.endswith("NEES") else np.nanmedian
        cells.append(f"{of([row[name] for row in rows]):.3g}")
    return "| " + " | ".join([*head, *cells]) + " |"


def seeds_of(text):
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def arguments():
    names = lambda text: text.split(",")  # noqa: E731
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=seeds_of, default=seeds_of("0-15"), metavar="FIRST-LAST")
    parser.add_argument("--vehicles", type=names, default=list(VEHICLES))
    parser.add_argument("--receivers", type=names, default=list(RECEIVERS))
    parser.add_argument("--step", type=names, default=["0", "0.5"], help="deg/s")
    parser.add_argument("--warm-up", type=float, default=0.05, help="deg/s, 1 sigma")
    parser.add_argument("--fault", choices=["turn", "outage", "moving"])
    sigma = lambda text: text if text == "auto" else float(text)  # noqa: E731
    parser.add_argument("--lever-arm-sigma", type=sigma, default=0.0, help="m, of the set lever arm; auto: not given")
    parser.add_argument("--errors", type=names, default=["none"], help="all: each of them")
    parser.add_argument("--wheels", action="store_true", help="with an odometer")
    parser.add_argument("--set", type=names, default=[], help="tunables of the filter: KEY=VALUE,..")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    return parser.parse_args()


def main():
    a = arguments()
    tuning = {key: float(value) for key, value in (text.split("=") for text in a.set)}
    kinds = list(ERRORS) if a.errors == ["all"] else a.errors
    vehicles = [name for name in a.vehicles if name in ON_WHEELS] if a.wheels else a.vehicles
    runs = itertools.product(vehicles, a.seeds, a.receivers, kinds, map(float, a.step))
    jobs = [
        (vehicle, receiver, step, seed, tuning, a.warm_up, a.fault, error, a.lever_arm_sigma, a.wheels)
        for vehicle, seed, receiver, error, step in runs
    ]
    found = {}
    with ProcessPoolExecutor(a.jobs) as pool:
        for job, row in zip(jobs, pool.map(figures, *zip(*jobs, strict=True), chunksize=8), strict=True):
            vehicle, receiver, step, *_, error, _, _ = job
            for of in ((vehicle, receiver), ("all", "all")):
                found.setdefault((error, f"{step:g}", *of), []).append(row)
    print("| error | step deg/s | vehicle | receiver |", " | ".join(row), "|")
    print("|---" * (4 + len(row)) + "|")
    for head, rows in sorted(found.items(), key=lambda item: (item[0][:2], item[0][2] == "all")):
        print(line(head, rows))


if __name__ == "__main__":
    main()
