"""How honest the attitude filter is on simulated sensors and motions drawn at random, as a table.

    python tests/attitude_monte_carlo.py [-n RUNS] [-j JOBS] [--smooth] [--set KEY=VALUE]..

For each kind of motion RUNS runs of 60 s, half of which begin in motion, the others with up to 8 s of rest. Everything
is drawn: 50 to 400 Hz, mounting, how fast and how hard it moves; of the sensor: noise, biases, scale factors,
misalignment of both triads. Sensors of the profile `auto` are calibrated boards (accelerometer biases of 4 mG), those
of `consumer-mems` bare parts (20 mG). From 5 s on, over all runs:

- tilt: RMS error of the vertical, deg
- NEES: squared error of the vertical over its claimed variance, for each of its two components; 1 is honest
- bias: NEES of the gyro bias, rad/s
- wrong: part of the time, %, with more than 5 deg and 4 sigma although ATTITUDE_VALID is set
"""

from __future__ import annotations

import argparse
import multiprocessing

import numpy as np
from attitude_runs import tilt_variance_deg2
from attitude_simulation import DEG, MG, Flaws, G, after, errors_deg, measure, simulate, wobble
from broad import samples_of
from replay_in_process import new_filter, replay, smoothed_solutions
from scipy.spatial.transform import Rotation

from imud.estimators.records import ATTITUDE_VALID
from imud.setup import config

SECONDS, SETTLED_S = 60.0, 5.0
ACCEL_BIAS = {"auto": 4.0 * MG, "consumer-mems": 20.0 * MG}


def log_uniform(rng, low, high):
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def seed_of(rng):
    return int(rng.integers(2**31))


# motions: rng -> (body rates or None, acceleration in NED or None)


def rest(rng):
    return None, None


def slow_and_quiet(rng):
    rates = wobble(seed_of(rng), log_uniform(rng, 0.03, 0.3), 0.1, 1.0)
    return rates, wobble(seed_of(rng), log_uniform(rng, 0.02, 0.2), 0.5, 3.0)


def rotation(rng):
    return wobble(seed_of(rng), log_uniform(rng, 0.5, 5.0), 0.5, 4.0), wobble(seed_of(rng), 0.3, 1.0, 5.0)


def shaking(rng):
    rates = wobble(seed_of(rng), log_uniform(rng, 0.5, 4.0), 2.0, 20.0)
    return rates, wobble(seed_of(rng), log_uniform(rng, 2.0, 15.0), 4.0, 30.0)


def walking(rng):
    """In a hand or a pocket: steps at 1.4 m/s along a way that winds, and the swing of an arm."""
    step, hard = 2.0 * np.pi * rng.uniform(1.6, 2.2), rng.uniform(1.0, 4.0)
    winding = wobble(seed_of(rng), 1.0, 0.1, 0.5)

    def acceleration(t, half=1e-3):
        course, ahead, behind = (winding(at)[:, 0] for at in (t, t + half, t - half))
        across = 1.4 * (ahead - behind) / (2.0 * half)
        turning = np.column_stack([-across * np.sin(course), across * np.cos(course), 0.0 * t])
        beats = np.column_stack([np.cos(step * t), 0.6 * np.cos(0.5 * step * t), 1.5 * np.cos(step * t)])
        return hard * beats + turning

    swing = wobble(seed_of(rng), log_uniform(rng, 0.2, 1.5), 0.9 * step, 1.1 * step)
    turns = wobble(seed_of(rng), 0.3, 0.2, 0.8)
    return lambda t: swing(t) + turns(t), acceleration


def flight(rng):
    """A multicopter: it leans into what it accelerates, and yaws."""
    push = wobble(seed_of(rng), log_uniform(rng, 0.5, 3.0), 0.3, 1.5)
    turn = wobble(seed_of(rng), 1.0, 0.1, 0.5)

    def attitude(t):
        thrust = push(t) * [1.0, 1.0, 0.3] - [0.0, 0.0, G]
        down = -thrust / np.linalg.norm(thrust, axis=1)[:, None]
        yaw = turn(t)[:, 0]
        pitch, roll = np.arcsin(np.clip(down @ [1.0, 0.0, 0.0], -1.0, 1.0)), -np.arcsin(down @ [0.0, 1.0, 0.0])
        return Rotation.from_euler("yx", np.column_stack([pitch, roll])) * Rotation.from_euler("z", yaw[:, None])

    def rates(t, half=1e-3):
        return (attitude(t - half).inv() * attitude(t + half)).as_rotvec() / (2.0 * half)

    return rates, lambda t: push(t) * [1.0, 1.0, 0.3]


MOTIONS = (rest, slow_and_quiet, rotation, walking, shaking, flight)


def sensor(rng, profile):
    shear = rng.normal(0.0, 0.2 * DEG, (3, 3))
    return Flaws(
        log_uniform(rng, 0.002, 0.02) * DEG,
        log_uniform(rng, 5e-4, 4e-3),
        tuple(rng.normal(0.0, log_uniform(rng, 0.1, 2.0) * DEG, 3)),
        tuple(rng.normal(0.0, ACCEL_BIAS[profile], 3)),
        rng.normal(0.0, 0.005, (3, 3)),
        tuple(rng.normal(0.0, 0.004, 3)),
        accel_matrix=0.5 * (shear + shear.T) * (1.0 - np.eye(3)),
    )


def run(job):
    """(squared tilt, NEES of tilt, of the gyro bias, part of the time wrong) of one run."""
    motion, profile, number, smoothed, changes = job
    rng = np.random.default_rng([number, MOTIONS.index(motion), list(ACCEL_BIAS).index(profile)])
    rate_hz = float(rng.choice([50.0, 100.0, 200.0, 400.0]))
    still = rng.uniform(1.0, 8.0) if number % 2 else 0.0
    rates, acceleration = (None if course is None else after(still, course) for course in motion(rng))
    truth = simulate(SECONDS, rate_hz, rates, acceleration, tuple(rng.uniform((-180, -80, 0), (180, 80, 0))))
    flaws = sensor(rng, profile)
    samples = samples_of(truth.t, *measure(truth, flaws, rng))
    settings = config.loads("", (f"imu.profile={profile}", *changes))
    filter_ = new_filter("attitude", samples, settings)
    out = smoothed_solutions(filter_, samples) if smoothed else replay(filter_, samples)[0]
    begin = round(SETTLED_S * rate_hz)
    out, attitude = out[begin:], truth.attitude[begin:]
    tilt, _ = errors_deg(out["q_nb"], attitude)
    nees = tilt**2 / tilt_variance_deg2(out)
    bias = np.mean(((out["bg"] - flaws.gyro_bias) / out["sigma_bg"]) ** 2)
    wrong = (nees > 8.0) & (tilt > 5.0) & (out["status"] & ATTITUDE_VALID != 0)
    return np.mean(tilt**2), np.mean(nees), bias, 100.0 * np.mean(wrong)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", "--runs", type=int, default=100)
    parser.add_argument("-j", "--jobs", type=int, default=1)
    parser.add_argument("--smooth", action="store_true", help="estimates from the data before and after")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    args = parser.parse_args()
    print("| motion | profile | tilt | NEES | bias | wrong |\n|---|---|---|---|---|---|")
    with multiprocessing.Pool(args.jobs) as pool:
        for motion in MOTIONS:
            for profile in ACCEL_BIAS:
                jobs = [(motion, profile, number, args.smooth, tuple(args.set)) for number in range(args.runs)]
                tilt2, *others = np.mean(pool.map(run, jobs, chunksize=1), axis=0)
                cells = " | ".join(f"{value:.2f}" for value in (np.sqrt(tilt2), *others))
                print(f"| {motion.__name__.replace('_', ' ')} | {profile} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
