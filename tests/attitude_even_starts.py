"""How sure and how wrong the attitude filter is where it starts on a body that moves evenly, as a table.

    python tests/attitude_even_starts.py [-n RUNS] [-j JOBS] [--profile NAME] [--set KEY=VALUE]..

RUNS runs of two minutes of each body; all is drawn: speeds, curves, vibration, the mounting, the errors of the sensor
(`attitude_monte_carlo.sensor`). `standing` and `table` rest at first, for what honesty costs. Over all runs:

- tilt: RMS error of the vertical, deg, from 2 s on
- NEES: squared error of the vertical over its claimed variance, for each of its two components; 1 is honest
- 1 deg, 5 deg: seconds for each run with a tilt beyond that and beyond 4 sigma, with ATTITUDE_VALID
- yaw: seconds for each run with a change of the yaw beyond 5 deg and 4 sigma
- bias: deg/s, RMS error of the gyro bias at the end
"""

from __future__ import annotations

import argparse
import multiprocessing

import numpy as np
from attitude_monte_carlo import log_uniform, seed_of, sensor
from attitude_runs import tilt_variance_deg2, yaw_sigma_deg
from attitude_simulation import DEG, after, errors_deg, measure, simulate, wobble
from broad import samples_of
from replay_in_process import new_filter, replay
from scipy.spatial.transform import Rotation

from imud.estimators.records import ATTITUDE_VALID
from imud.setup import config

SECONDS, RATE_HZ, SETTLED_S = 120.0, 100.0, 2.0
FINE_S = 0.01


def at(values):
    """A course through values at multiples of FINE_S."""
    grid = np.arange(len(values)) * FINE_S
    return lambda t: np.interp(t, grid, values)


def steps(rng, first, first_s, others, every_s):
    """`first` for first_s, then values of `others(rng)` for about every_s each; with transitions of a second."""
    values = np.full(round((SECONDS + 1.0) / FINE_S), float(first))
    begin = first_s
    while begin < SECONDS:
        end = begin + every_s * rng.uniform(0.5, 1.5)
        values[round(begin / FINE_S) : round(end / FINE_S)] = others(rng)
        begin = end
    weights = np.hanning(round(1.0 / FINE_S) + 2)
    return np.convolve(np.pad(values, len(weights) // 2, mode="edge"), weights / weights.sum(), "valid")[: len(values)]


def level_way(rng, speed, turn, upright):
    """(body rates, acceleration in NED) of a vehicle with a speed, m/s, and a turn rate, rad/s, at FINE_S."""
    course = rng.uniform(0.0, 2.0 * np.pi) + np.cumsum(turn) * FINE_S
    along, across = np.gradient(speed, FINE_S), speed * turn
    north, east = along * np.cos(course) - across * np.sin(course), along * np.sin(course) + across * np.cos(course)
    axis = upright.inv().apply([0.0, 0.0, 1.0])
    rates = lambda t: at(turn)(t)[:, None] * axis  # noqa: E731
    return rates, lambda t: np.column_stack([at(north)(t), at(east)(t), 0.0 * t])


# bodies: rng, attitude at the start -> body rates, acceleration in NED, vibration in m/s^2


def in_curve(rng, upright, speeds, first, later, share, first_s, later_s, vibration):
    """At one of these speeds: a curve of `first` m/s^2 for `first_s`, then others of `later`, a `share` of the time."""
    speed = rng.uniform(*speeds)

    def rate(rng, across):
        return rng.choice([-1.0, 1.0]) * rng.uniform(*across) / speed

    begin = rate(rng, first)
    turn = steps(rng, begin, rng.uniform(*first_s), lambda rng: rate(rng, later) * (rng.random() < share), later_s)
    return (*level_way(rng, np.full(len(turn), speed), turn, upright), log_uniform(rng, *vibration))


def train_in_curve(rng, upright):
    return in_curve(rng, upright, (12.0, 40.0), (0.1, 0.9), (0.1, 0.9), 0.6, (8.0, 60.0), 20.0, (0.03, 0.3))


def train_accelerating(rng, upright):
    change = steps(rng, rng.choice([-0.7, 1.0]) * rng.uniform(0.2, 1.0), rng.uniform(8.0, 40.0), lambda rng: 0.0, 60.0)
    speed = np.maximum(rng.uniform(25.0, 35.0) * (change[0] < 0.0) + np.cumsum(change) * FINE_S, 0.0)
    return (*level_way(rng, speed, 0.0 * speed, upright), log_uniform(rng, 0.03, 0.3))


def car_in_curve(rng, upright):
    return in_curve(rng, upright, (5.0, 18.0), (0.2, 2.0), (0.2, 3.0), 0.5, (3.0, 20.0), 6.0, (0.05, 0.5))


def ship(rng, upright):
    """It rolls about an axis 5 m below the sensor, and turns slowly."""
    angle, pulse, phase = rng.uniform(0.5, 8.0) * DEG, 2.0 * np.pi / rng.uniform(8.0, 25.0), rng.uniform(0.0, 6.3)
    axis = upright.inv().apply([1.0, 0.0, 0.0])
    rates = lambda t: (angle * pulse * np.cos(pulse * t + phase))[:, None] * axis  # noqa: E731
    sway = lambda t: (5.0 * angle * pulse**2 * np.sin(pulse * t + phase))[:, None] * [0.0, -1.0, 0.0]  # noqa: E731
    return rates, sway, log_uniform(rng, 0.01, 0.1)


def picked_up(rng, rates, begin):
    """Then a hand takes it."""
    hand = wobble(seed_of(rng), log_uniform(rng, 0.2, 2.0))
    return lambda t: rates(t) + after(begin, hand)(t), after(begin, wobble(seed_of(rng), 0.5, 2.0, 6.0))


def turntable(rng, upright):
    """It stops; later a hand takes what is on it."""
    rate, stop = rng.choice([-1.0, 1.0]) * log_uniform(rng, 0.1, 5.0) * DEG, rng.uniform(10.0, 70.0)
    axis = upright.inv().apply([0.0, 0.0, 1.0])
    return (*picked_up(rng, lambda t: (rate * (t < stop))[:, None] * axis, stop + rng.uniform(0.0, 15.0)), 0.0)


def lift(rng, upright):
    change = steps(rng, rng.uniform(-1.2, 1.2), rng.uniform(1.0, 3.0), lambda rng: rng.uniform(-1.2, 1.2), 3.0)
    change = np.where(np.arange(len(change)) * FINE_S % 20.0 < 6.0, change, 0.0)
    up = lambda t: at(change)(t)[:, None] * [0.0, 0.0, 1.0]  # noqa: E731
    return (
        *picked_up(rng, lambda t: np.zeros((len(t), 3)), rng.uniform(60.0, 90.0))[:1],
        up,
        log_uniform(rng, 0.01, 0.1),
    )


def standing(rng, upright):
    """A car whose engine idles drives off."""
    begin = rng.uniform(3.0, 60.0)
    some = lambda rng: rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 3.0) / 12.0 * (rng.random() < 0.5)  # noqa: E731
    turn = steps(rng, 0.0, begin + 8.0, some, 6.0)
    speed = np.clip((np.arange(len(turn)) * FINE_S - begin) * 1.5, 0.0, 12.0)
    return (*level_way(rng, speed, turn, upright), log_uniform(rng, 0.01, 0.2))


def table(rng, upright):
    return (*picked_up(rng, lambda t: np.zeros((len(t), 3)), rng.uniform(3.0, 30.0)), 0.0)


BODIES = (train_in_curve, train_accelerating, car_in_curve, ship, turntable, lift, standing, table)


def run(job):
    """(squared tilt, NEES, seconds beyond 1 and 5 deg, of yaw beyond 5 deg, squared error of the bias)."""
    body, profile, number, changes = job
    rng = np.random.default_rng([number, BODIES.index(body), 21])
    rpy_deg = tuple(rng.uniform((-180, -80, 0), (180, 80, 0)))
    rates, acceleration, vibration = body(rng, Rotation.from_euler("ZYX", rpy_deg[::-1], degrees=True))
    truth = simulate(SECONDS, RATE_HZ, rates, acceleration, rpy_deg)
    flaws = sensor(rng, profile)
    w, f = measure(truth, flaws, rng)
    w += rng.normal(0.0, 0.02 * vibration, w.shape)
    f += rng.normal(0.0, vibration, f.shape)
    samples = samples_of(truth.t, w, f)
    out = replay(new_filter("attitude", samples, config.loads("", (f"imu.profile={profile}", *changes))), samples)[0]
    begin = round(SETTLED_S * RATE_HZ)
    tilt, yaw = errors_deg(out["q_nb"], truth.attitude)
    tilt, nees = tilt[begin:], (tilt**2 / tilt_variance_deg2(out))[begin:]
    turned = np.abs(np.unwrap(yaw, period=360.0) - yaw[0])[begin:]
    sure = (nees > 8.0) & (out["status"] & ATTITUDE_VALID != 0)[begin:]
    wrong = [np.sum(sure & (tilt > limit)) / RATE_HZ for limit in (1.0, 5.0)]
    yaw_wrong = np.sum((turned > 5.0) & (turned > 4.0 * yaw_sigma_deg(out)[begin:])) / RATE_HZ
    bias2 = np.mean(np.degrees(out["bg"][-1] - flaws.gyro_bias) ** 2)
    return np.mean(tilt**2), np.mean(nees), *wrong, yaw_wrong, bias2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", "--runs", type=int, default=40)
    parser.add_argument("-j", "--jobs", type=int, default=1)
    parser.add_argument("--profile", default="auto")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    args = parser.parse_args()
    print("| body | tilt | NEES | 1 deg | 5 deg | yaw | bias |\n|---|---|---|---|---|---|---|")
    with multiprocessing.Pool(args.jobs) as pool:
        for body in BODIES:
            jobs = [(body, args.profile, number, tuple(args.set)) for number in range(args.runs)]
            tilt2, nees, one, five, yaw, bias2 = np.mean(pool.map(run, jobs, chunksize=1), axis=0)
            cells = " | ".join(f"{value:.2f}" for value in (np.sqrt(tilt2), nees, one, five, yaw, np.sqrt(bias2)))
            print(f"| {body.__name__.replace('_', ' ')} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
