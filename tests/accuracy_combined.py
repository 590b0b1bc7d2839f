"""Random combinations of errors on the open recordings: where is the navigation filter wrong and sure, or far off?

    python tests/accuracy_combined.py [--simulated | --aiding] [--seeds 0-199] [--jobs 2] [--set KEY=VALUE,..]

Each seed draws a recording and its fixes, a part of 200 to 420 s (half of them begin in mid-drive), up to three errors
of the sensor, up to two of the receiver, and for two runs in five another mounting. One line for each run: seconds
wrong and sure of position, yaw and tilt, as in `accuracy`; RMS of the horizontal error and 90 % of the stated sigmas
from a minute on; what was drawn. The runs that are worst come last. Where the mounting is another one, the sigma of
every angle is the largest of the three; the yaw of cars, which have no reference of it, does not count then.
With `--simulated` each seed draws one of the vehicles and receivers of `accuracy_simulated` for 160 to 240 s instead.
With `--aiding` it draws one without further errors, in three of ten runs an outage of up to 60 s, and one or two aiding
sources (`simulated_aiding`), most of them with an error; each line has the same run without them, too, the ratios of
the RMS errors of position, velocity and yaw, and the seconds without a yaw within 5 degrees.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from accuracy import (
    FIXES,
    LIMIT_DEG,
    LIMIT_M,
    LIMIT_SIGMA,
    horizontal,
    recording,
    restamp,
    solutions,
    yaw_errors,
)
from accuracy_simulated import ON_WHEELS, RATE, RECEIVERS, judged, received, seeds_of, sensed, way
from msgspec.structs import replace
from navigation_runner import navigate, scorer, settings_of, table
from scipy.spatial.transform import Rotation
from simulated_aiding import drawn as aiding_drawn
from simulated_errors import part
from simulated_vehicles import VEHICLES

from imud.batch import NO_MEASUREMENT
from imud.configuration.settings import Aiding
from imud.estimators.records import ATTITUDE_VALID, HEADING_VALID, POSITION_VALID

G, EARTH_M = 9.80665, 6.37e6


def noise(samples, rng):
    samples["w"] += np.radians(0.3) * rng.standard_normal(samples["w"].shape)
    samples["f"] += 0.1 * rng.standard_normal(samples["f"].shape)


def biases(samples, rng):
    samples["w"] += np.radians(2.0) * rng.uniform(-1.0, 1.0, 3)
    samples["f"] += 0.02 * G * rng.standard_normal(3)


def scale(samples, rng):
    for name in "wf":
        samples[name] = samples[name] @ (np.eye(3) + 0.01 * rng.standard_normal((3, 3)))


def by_sign(samples, rng):
    """Scale factors that differ by the sign of what is measured."""
    for name in "wf":
        factor = 1.0 + 0.004 * rng.standard_normal(3)
        samples[name] = np.where(samples[name] > 0.0, samples[name] * factor, samples[name])


def counts(samples, rng):
    for name, count in (("w", np.radians(0.06)), ("f", 4e-3 * G)):
        samples[name] = np.round(samples[name] / count) * count


def time_tags(samples, rng):
    period = np.median(np.diff(samples["t_ns"]))
    off = np.clip(rng.normal(0.0, 0.2, len(samples)), -0.45, 0.45)
    samples["t_ns"] += (off * period).astype(np.int64)


def clock_rate(samples, rng):
    t = samples["t_ns"] - samples["t_ns"][0]
    samples["t_ns"] += np.round(t * 1e-4 * rng.uniform(-1.0, 1.0)).astype(np.int64)


def later(samples, rng):
    return slice(int(len(samples) * rng.uniform(0.4, 0.8)), None)


def gyro_step(samples, rng):
    samples["w"][later(samples, rng)] += np.radians(0.4) * rng.standard_normal(3)


def accelerometer_step(samples, rng):
    samples["f"][later(samples, rng)] += 0.03 * G * rng.standard_normal(3)


def warm_up(samples, rng):
    t = (samples["t_ns"] - samples["t_ns"][0])[:, None] * 1e-9
    samples["w"] += np.radians(0.3) * rng.standard_normal(3) * np.exp(-t / 100.0)


def force_sensitivity(samples, rng):
    samples["w"] += samples["f"] @ (np.radians(0.1) / G * rng.standard_normal((3, 3)))


def seconds(fixes):
    return (fixes["t_ns"] - fixes["t_ns"][0]) * 1e-9


def shift(fixes, ned):
    """Move the positions by so many metres, (n, 3)."""
    fixes["lat"] += ned[:, 0] / EARTH_M
    fixes["lon"] += ned[:, 1] / (EARTH_M * np.cos(fixes["lat"]))
    fixes["height"] -= ned[:, 2]
    return fixes


def spells(fixes, rng, shortest_s, longest_s):
    """Whether each fix is within one of some random spells of that length, by the number of the spell; 0: none."""
    t, number, begin, k = seconds(fixes), np.zeros(len(fixes), int), rng.uniform(5.0, 60.0), 0
    while begin < t[-1]:
        end, k = begin + rng.uniform(shortest_s, longest_s), k + 1
        number[(t >= begin) & (t < end)] = k
        begin = end + rng.uniform(10.0, 80.0)
    return number


def late(fixes, rng):
    fixes["arrival_ns"] += int(1e9 * rng.uniform(0.05, 0.6))
    return fixes


def stamps(fixes, rng):
    restamp(fixes, slice(None), rng.uniform(-0.2, 0.2))
    return fixes


def seldom(fixes, rng):
    period = max(float(np.median(np.diff(seconds(fixes)))), 1e-3)
    return fixes[:: max(1, round(rng.uniform(2.0, 5.0) / period))]


def outages(fixes, rng):
    return fixes[spells(fixes, rng, 5.0, 30.0) == 0]


def no_velocity(fixes, rng):
    for name in ("v", "speed", "course"):
        fixes[name] = np.nan
    return fixes


def digits(fixes, rng):
    """Four digits of a minute."""
    last = np.radians(1e-4 / 60.0)
    for name in ("lat", "lon"):
        fixes[name] = np.round(fixes[name] / last) * last
    return fixes


def slow_errors(fixes, rng):
    error, dt = np.zeros((len(fixes), 3)), np.diff(seconds(fixes))
    for i in range(1, len(fixes)):
        decay = np.exp(-dt[i - 1] / 40.0)
        error[i] = decay * error[i - 1] + 2.0 * np.sqrt(1.0 - decay * decay) * rng.standard_normal(3)
    fixes["sigma"] = np.hypot(fixes["sigma"], 2.0)
    return shift(fixes, error)


def multipath(fixes, rng):
    number = spells(fixes, rng, 4.0, 20.0)
    error = rng.normal(0.0, 10.0, (number.max() + 1, 3))
    error[0] = 0.0
    return shift(fixes, error[number])


def outliers(fixes, rng):
    return shift(fixes, (rng.random(len(fixes)) < 0.03)[:, None] * rng.normal(0.0, 20.0, (len(fixes), 3)))


def too_sure(fixes, rng):
    fixes["sigma"] *= 0.4
    fixes["hdop"] *= 0.6
    return fixes


SENSOR = (
    noise, biases, scale, by_sign, counts, time_tags, clock_rate, gyro_step, accelerometer_step, warm_up,
    force_sensitivity,
)  # fmt: skip
RECEIVER = (late, stamps, seldom, outages, no_velocity, digits, slow_errors, multipath, outliers, too_sure)


def changed(samples, fixes, rng, most):
    """FIX rows and the names of up to so many errors of the sensor and two of the receiver that both have now."""
    of_sensor = [SENSOR[i] for i in rng.choice(len(SENSOR), rng.integers(0, most + 1), replace=False)]
    of_receiver = [RECEIVER[i] for i in rng.choice(len(RECEIVER), rng.integers(0, 3), replace=False)]
    for change in of_sensor:
        change(samples, rng)
    for change in of_receiver:
        fixes = change(fixes, rng)
    return fixes, ", ".join(x.__name__ for x in of_sensor + of_receiver)


def drawn(rng):
    """(SAMPLE rows, FIX rows, truth, meta, what was drawn as text) of one run, before another mounting."""
    name = list(FIXES)[rng.integers(len(FIXES))]
    grade = FIXES[name][rng.integers(len(FIXES[name]))]
    samples, fixes, truth, meta, _ = recording(name, grade)
    first, last = samples["t_ns"][[0, -1]] * 1e-9
    length = min(rng.uniform(200.0, 420.0), last - first)
    begin = first if rng.random() < 0.5 else rng.uniform(first, last - length)
    samples, fixes = (
        rows[(rows["t_ns"] >= 1e9 * begin) & (rows["t_ns"] < 1e9 * (begin + length))].copy()
        for rows in (samples, fixes)
    )
    fixes, names = changed(samples, fixes, rng, 3)
    text = f"{name} {grade} {begin - first:.0f}+{length:.0f} s {names}"
    return samples, fixes, truth, meta, text


def remounted(samples, mount):
    """SAMPLE rows of the same sensor in another mounting."""
    for name in "wf":
        samples[name] = mount.inv().apply(samples[name])
    return samples


def in_axes_of_the_body(out, mount):
    """SOLUTION rows with the attitude of the body again, each of whose angles has the largest of the sigmas."""
    q = Rotation.from_quat(np.roll(np.nan_to_num(out["q_nb"], nan=0.5), -1, axis=1)) * mount.inv()
    out["q_nb"] = np.roll(q.as_quat(), 1, axis=1)
    out["sigma_rpy"] = out["sigma_rpy"].max(axis=1)[:, None]
    return out


def run(seed, tuning):
    """(seconds wrong and sure: position, yaw, tilt; RMS of the position, 90 % of its sigmas, m; what was drawn)."""
    rng = np.random.default_rng(seed)
    samples, fixes, truth, meta, text = drawn(rng)
    mount = Rotation.random(random_state=seed) if rng.random() < 0.4 else None
    arm = np.array(meta["lever_frd"], float)
    if mount is not None:
        text += ", mounted"
        arm, samples = mount.inv().apply(arm), remounted(samples, mount)
    out = solutions(samples, fixes, settings_of("auto", arm, "auto", tuning, "auto"), False)
    if mount is not None:
        out = in_axes_of_the_body(out, mount)
    est = table(out)
    if len(est) < 10:
        return np.zeros(3), np.nan, np.nan, text
    t, d, i = scorer().errors(est, truth, meta["lever_frd"] if meta["truth_point"] == "antenna" else None)
    sigma = np.column_stack([np.interp(t, est[:, 0], est[:, k]) for k in range(10, 19)])
    status = out["status"][np.searchsorted(out["t_ns"], (t * 1e9).astype(np.int64), "right") - 1]
    d[:, 8] = yaw_errors(truth, d, i, est, t, status & HEADING_VALID > 0)
    if mount is not None and not np.isfinite(truth[i, 9]).any():
        d[:, 8] = np.nan
    away, sigmas = horizontal(d[:, :2], sigma[:, :2])
    angle, angle_sigmas = np.abs(d[:, 6:9]), np.abs(d[:, 6:9]) / sigma[:, 6:9]
    flown = (t >= meta.get("score_from", -np.inf)) & (t <= meta.get("score_to", np.inf))
    sure = (angle > LIMIT_DEG) & (angle_sigmas > LIMIT_SIGMA) & flown[:, None]
    wrong = (
        (away > LIMIT_M) & (sigmas > LIMIT_SIGMA) & (status & POSITION_VALID > 0),
        sure[:, 2] & (status & HEADING_VALID > 0),
        (sure[:, 0] | sure[:, 1]) & (status & ATTITUDE_VALID > 0),
    )
    row_s, settled = np.minimum(np.diff(t, prepend=t[0]), 1.1), t > t[0] + 60.0
    rms = float(np.sqrt(np.mean(away[settled] ** 2))) if settled.any() else np.nan
    stated = float(np.quantile(np.hypot(sigma[:, 0], sigma[:, 1]), 0.9))
    return np.array([row_s[x].sum() for x in wrong]), rms, stated, text


def run_simulated(seed, tuning):
    """The same of a simulated vehicle; its way has a seed that no table of `accuracy_simulated` has."""
    rng = np.random.default_rng([seed, 1])
    vehicle, receiver = (list(of)[rng.integers(len(of))] for of in (VEHICLES, RECEIVERS))
    d = way(vehicle, 5000 + seed)
    vrw, arw = (np.exp(rng.uniform(*np.log(span))) for span in VEHICLES[vehicle][1:])
    begin_s = 0.0 if rng.random() < 0.5 else rng.uniform(20.0, 80.0)
    first = int(begin_s * RATE)
    samples, fixes = sensed(d, rng, vrw, arw)[first:].copy(), received(d, rng, receiver)
    fixes = fixes[fixes["t_ns"] >= samples["t_ns"][0]].copy()
    d = part(d, slice(first, None))
    d = dataclasses.replace(d, t=d.t - d.t[0])
    fixes, names = changed(samples, fixes, rng, 2)
    mount = Rotation.random(random_state=seed) if rng.random() < 0.2 else None
    if mount is not None:
        names, samples = names + ", mounted", remounted(samples, mount)
    out, _, _ = navigate(samples, fixes, settings_of(tuning=tuning))
    if mount is not None:
        out = in_axes_of_the_body(out, mount)
    row = judged(d, out, 0)
    stated = float(np.nanquantile(np.hypot(out["sigma_p"][:, 0], out["sigma_p"][:, 1]), 0.9))
    wrong = np.array([row[name] for name in ("position s", "yaw s", "tilt s")])
    return wrong, row["position m"], stated, f"{vehicle} {receiver} from {begin_s:.0f} s {names}"


def run_aided(seed, tuning):
    """The same of a simulated vehicle with one or two aiding sources; the text has also what it is without them."""
    rng = np.random.default_rng([seed, 2])
    vehicle, receiver = (list(of)[rng.integers(len(of))] for of in (VEHICLES, RECEIVERS))
    d = way(vehicle, 50_000 + seed)
    vrw, arw = (np.exp(rng.uniform(*np.log(span))) for span in VEHICLES[vehicle][1:])
    samples, fixes = sensed(d, rng, vrw, arw), received(d, rng, receiver)
    if rng.random() < 0.3:
        begin, end = np.sort(rng.uniform(100.0, 340.0, 2)) * 1e9
        fixes = fixes[(fixes["t_ns"] < begin) | (fixes["t_ns"] > min(end, begin + 60e9))]
    measurements, names = aiding_drawn(d, rng, vehicle in ON_WHEELS)
    settings = replace(settings_of(tuning=tuning), aiding=Aiding(magnetometer=True))
    out, alone = (navigate(samples, fixes, settings, aiding=rows)[0] for rows in (measurements, NO_MEASUREMENT))
    aided, alone = (judged(d, rows, 0) for rows in (out, alone))
    stated = float(np.nanquantile(np.hypot(out["sigma_p"][:, 0], out["sigma_p"][:, 1]), 0.9))
    wrong, without = (np.array([row[f"{name} s"] for name in ("position", "yaw", "tilt")]) for row in (aided, alone))
    harm = {name: aided[name] / alone[name] for name in ("position m", "velocity m/s", "yaw deg")}
    text = f"without {without.round(1)} s, ratios {' '.join(f'{x:.2f}' for x in harm.values())}"
    text += f", no yaw {aided['no yaw s']:.0f} and {alone['no yaw s']:.0f} s"
    return wrong, aided["position m"], stated, f"{vehicle} {receiver} {names} ({text})"


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--simulated", action="store_true", help="simulated vehicles instead of the recordings")
    parser.add_argument(
        "--aiding", action="store_true", help="simulated vehicles with aiding sources, and their errors"
    )
    parser.add_argument("--seeds", type=seeds_of, default=seeds_of("0-199"), metavar="FIRST-LAST")
    parser.add_argument("--set", type=lambda text: text.split(","), default=[], help="tunables: KEY=VALUE,..")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    a = parser.parse_args()
    tuning = {key: float(value) for key, value in (text.split("=") for text in a.set)}
    with ProcessPoolExecutor(a.jobs) as pool:
        rows = list(
            zip(
                a.seeds,
                pool.map(
                    run_aided if a.aiding else run_simulated if a.simulated else run, a.seeds, [tuning] * len(a.seeds)
                ),
                strict=True,
            )
        )
    for seed, (wrong, rms, stated, text) in sorted(rows, key=lambda row: (row[1][0].sum(), np.nan_to_num(row[1][1]))):
        print(f"{seed:5d}  wrong {wrong.round(1)} s  rms {rms:.2f} m  stated {stated:.1f} m  {text}")
    print(
        "all:",
        sum(row[1][0] for row in rows).round(1),
        "s; median of RMS",
        f"{np.nanmedian([r[1][1] for r in rows]):.2f} m",
    )


if __name__ == "__main__":
    main()
