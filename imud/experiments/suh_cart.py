"""The recordings of Suh's two experiments, simulated: a sensor at rest, and one on a cart, of two makes.

`his`: the ADXL202 and Gyrostar as he measured them, white with the sample variances that he prints at 20 Hz, zeroed,
with what his gyros drift ("less than 1 degree after 10 seconds"). He does not print a_z's variance: a_x's is taken.
`m-g350`: a sensor with a 185th of that variance of the force, whose biases have been zeroed at rest but for a fifth:
that leaves the same drift.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..estimators.papers.suh import STEP_S
from ..math.arrays import Floats
from ..math.earth import STANDARD_GRAVITY
from .simulate import PROFILE, level_at_rest, m_g350, samples_of

RATE_HZ, SECONDS = 200.0, 60.0
VIBRATION = 0.01 * STANDARD_GRAVITY  # m/s^2, 1 sigma per axis of rails and rollers
ZEROED = 0.2  # of the switch-on bias is left
HIS_VARIANCES = (1.68e-5, 1.67e-5, 1.68e-5), (0.0032, 0.0040, 0.0031)  # g^2, (deg/s)^2, of a sample of his
HIS_DRIFT = np.radians(0.05)  # rad/s, 1 sigma: 1 deg after 10 s is two
Sensor = Callable[[np.random.Generator, Floats, Floats, Floats], Any]


def his(rng: np.random.Generator, t: Floats, w: Floats, f: Floats) -> Any:
    """SAMPLE rows of his sensors on the ideal motion; means over STEP_S have his variances."""
    faster = np.sqrt(STEP_S / (t[1] - t[0]))
    accel, gyro = (faster * np.sqrt(variances) for variances in HIS_VARIANCES)
    drift = HIS_DRIFT * rng.standard_normal(3)
    sensed_w = w + drift + np.radians(gyro) * rng.standard_normal(w.shape)
    return samples_of(t, sensed_w, f + STANDARD_GRAVITY * accel * rng.standard_normal(f.shape))


def zeroed(switch_on: float = ZEROED) -> Sensor:
    """An M-G350 of whose biases that part is left."""
    return lambda rng, t, w, f: m_g350(rng, t, w, f, switch_on)


_SHEET = (  # g, deg/s: noise of a mean over STEP_S
    PROFILE.accel_noise / np.sqrt(STEP_S) / STANDARD_GRAVITY,
    np.degrees(PROFILE.gyro_noise) / np.sqrt(STEP_S),
)
SIGMAS = {
    "his sensors": tuple(np.sqrt(variances) for variances in HIS_VARIANCES),
    "M-G350": tuple(np.full(3, sigma) for sigma in _SHEET),
}
SENSORS: dict[str, Sensor] = {"his sensors": his, "M-G350": zeroed()}


def still(rng: np.random.Generator, sensor: Sensor) -> Any:
    """Experiment 1: samples of the sensor at rest."""
    t = np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    return sensor(rng, t, *level_at_rest(len(t)))


def pushes(rng: np.random.Generator, t: Floats) -> Floats:
    """Acceleration along the rails in m/s^2: strokes to and fro by hand, each from rest to rest, with pauses."""
    a = np.zeros(len(t))
    start = 5.0
    direction = 1.0
    while start < t[-1] - 3.0:
        lasts, length = rng.uniform(0.5, 1.0), rng.uniform(0.2, 0.5)
        inside = (t >= start) & (t < start + lasts)
        phase = 2.0 * np.pi * (t[inside] - start) / lasts
        # a stroke: length (u - sin(2 pi u) / 2 pi), u from 0 to 1
        a[inside] = direction * 2.0 * np.pi * length / lasts**2 * np.sin(phase)
        direction = -direction
        start += lasts + (rng.uniform(0.0, 0.2) if rng.random() < 0.7 else rng.uniform(1.0, 3.0))
    return a


def cart(rng: np.random.Generator, sensor: Sensor) -> tuple[Any, Floats]:
    """Experiment 2: samples on the cart, and its acceleration along y in m/s^2."""
    t = np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    w, f = level_at_rest(len(t))
    push = pushes(rng, t)
    f[:, 1] += push
    moving = np.convolve(np.abs(push) > 0.0, np.ones(3), mode="same") > 0.0
    f += VIBRATION * moving[:, None] * rng.standard_normal(f.shape)
    return sensor(rng, t, w, f), push


def averaged(samples: Any, rate_hz: float = RATE_HZ) -> tuple[Floats, Floats]:
    """Force in standard gravities and rate in deg/s, (n, 3) each, as the filters take them: means over STEP_S."""
    size = max(round(STEP_S * rate_hz), 1)
    n = len(samples) // size * size
    force, rate = (samples[name][:n].reshape(-1, size, 3).mean(axis=1) for name in "fw")
    return force / STANDARD_GRAVITY, np.degrees(rate)
