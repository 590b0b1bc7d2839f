"""What an inertial sensor on a moving body measures, and how far an estimate is from the truth. Independent of `imud`.

Rotation with scipy; a sample is the mean rate and force over the period that ends with it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]
Course = Callable[[Floats], Floats]  # times (N,) in s to vectors (N, 3)
G = 9.80665
DEG = np.pi / 180.0
MG = 1e-3 * G


@dataclass(frozen=True)
class Truth:
    """t: s (N,). attitude: body to NED at t. w: rad/s, f: m/s^2 (N, 3), body FRD, without errors."""

    t: Floats
    attitude: Rotation
    w: Floats
    f: Floats


def simulate(
    seconds: float,
    rate_hz: float,
    rates: Course | None = None,
    acceleration: Course | None = None,
    rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Truth:
    """A body that starts at rpy_deg, turns with body rates (rad/s) and accelerates in NED (m/s^2)."""
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    middle = t - 0.5 / rate_hz
    first = Rotation.from_euler("ZYX", rpy_deg[::-1], degrees=True)
    w = np.zeros((len(t), 3)) if rates is None else rates(middle)
    a = np.zeros((len(t), 3)) if acceleration is None else acceleration(middle)
    attitude = Rotation.from_quat(_accumulated(first.as_quat(), Rotation.from_rotvec(w / rate_hz).as_quat()))
    f = (attitude * Rotation.from_rotvec(-0.5 * w / rate_hz)).inv().apply(a - [0.0, 0.0, G])
    return Truth(t, attitude, w, f)


def _accumulated(first: Floats, steps: Floats) -> Floats:
    """Quaternions (scalar last) of `first` turned by steps 1, 1-2, 1-3, … (step 0 ends at the start)."""
    x, y, z, w = (float(c) for c in first)
    out = [(x, y, z, w)]
    for a, b, c, d in steps[1:].tolist():
        x, y, z, w = (
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
            w * d - x * a - y * b - z * c,
        )
        out.append((x, y, z, w))
    return np.array(out)


@dataclass(frozen=True)
class Flaws:
    """Errors of one sensor: noise densities per root Hz, biases rad/s and m/s^2, matrix and scales dimensionless."""

    gyro_noise: float = 0.2 * DEG / 60.0  # the M-G350's, as printed: 0.2 deg/sqrt(h), 0.04 (m/s)/sqrt(h)
    accel_noise: float = 0.04 / 60.0
    gyro_bias: tuple[float, ...] = (0.0, 0.0, 0.0)
    accel_bias: tuple[float, ...] = (0.0, 0.0, 0.0)
    gyro_matrix: Floats | None = None
    accel_scale: tuple[float, ...] = (0.0, 0.0, 0.0)
    accel_matrix: Floats | None = None  # misalignment


def measure(truth: Truth, flaws: Flaws, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Rates and forces as the sensor gives them."""
    root_rate = np.sqrt(1.0 / np.median(np.diff(truth.t)))
    matrix = np.zeros((3, 3)) if flaws.gyro_matrix is None else flaws.gyro_matrix
    w = truth.w + truth.w @ matrix.T + flaws.gyro_bias + flaws.gyro_noise * root_rate * rng.normal(size=truth.w.shape)
    f = truth.f * (1.0 + np.array(flaws.accel_scale)) + flaws.accel_bias
    f = f if flaws.accel_matrix is None else f + truth.f @ flaws.accel_matrix.T
    return w, f + flaws.accel_noise * root_rate * rng.normal(size=truth.f.shape)


def errors_deg(q_nb: Floats, attitude: Rotation) -> tuple[Floats, Floats]:
    """Tilt (unsigned) and yaw error in NED, deg, of quaternions (scalar first)."""
    error = (Rotation.from_quat(q_nb[:, [1, 2, 3, 0]]) * attitude.inv()).as_quat()
    error *= np.where(error[:, 3:] < 0.0, -1.0, 1.0)
    tilt = 2.0 * np.arcsin(np.clip(np.hypot(error[:, 0], error[:, 1]), 0.0, 1.0))
    return np.degrees(tilt), np.degrees(2.0 * np.arctan2(error[:, 2], error[:, 3]))


def wobble(seed: int, amplitude: float, slowest: float = 0.3, fastest: float = 2.5) -> Course:
    """Three smooth random components, sums of three sines, of the given RMS size and angular frequencies (rad/s)."""
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(slowest, fastest, (3, 3)), rng.uniform(0.0, 2.0 * np.pi, (3, 3))
    return lambda t: amplitude * np.sin(frequency * t[:, None, None] + phase).sum(2) / np.sqrt(1.5)


def after(start: float, course: Course) -> Course:
    """Nothing until `start` s, then the course."""
    return lambda t: course(t) * (t > start)[:, None]


def steady(vector: tuple[float, float, float], start: float, stop: float) -> Course:
    """A constant vector between two times."""
    return lambda t: np.array(vector) * ((t > start) & (t < stop))[:, None]


def car_that_stops(seconds):
    """A truth of 6 s of speeding up, 20 straight on at an even speed, 5 of braking, 3 of standing, and the phase."""
    leg, speed = 34.0, 12.0
    edges = ((10.0, 16.0, speed / 6.0), (36.0, 41.0, -speed / 5.0))

    def acceleration(t):
        phase = np.where(t > 10.0, (t - 10.0) % leg + 10.0, 0.0)
        ahead = sum(a * ((phase > begin) & (phase <= end)) for begin, end, a in edges)
        return np.column_stack([ahead, 0.0 * t, 0.0 * t])

    truth = simulate(seconds, 50.0, acceleration=acceleration)
    return truth, np.where(truth.t > 10.0, (truth.t - 10.0) % leg, np.nan)
