"""An M-G350 on a given motion: ideal rate and specific force, plus the data sheet's noise and bias, from a seed."""

import numpy as np

from imud.drivers.sample import SAMPLE

from ..math.arrays import Floats, Records
from ..math.earth import STANDARD_GRAVITY
from ..sensor_errors.profiles import PROFILES

PROFILE = PROFILES["m-g350"]
IN_RUN_S = 300.0  # time in which a bias changes by its in-run stability


def samples_of(t: Floats, w: Floats, f: Floats) -> Records:
    """SAMPLE rows at t s from rates (n, 3) rad/s and specific forces (n, 3) m/s^2."""
    samples = np.zeros(len(t), SAMPLE)
    samples["t_ns"] = np.rint(t * 1e9).astype(np.int64)
    samples["tick"] = np.arange(len(t))
    samples["w"], samples["f"], samples["temperature"] = w, f, np.nan
    return samples


def _random_walk(rng: np.random.Generator, count: int, rate_hz: float, sigma: float) -> Floats:
    """A random walk of three axes that reaches `sigma` in IN_RUN_S."""
    return np.cumsum(sigma / np.sqrt(IN_RUN_S * rate_hz) * rng.standard_normal((count, 3)), axis=0)


def m_g350(rng: np.random.Generator, t: Floats, w: Floats, f: Floats, switch_on: float = 1.0) -> Records:
    """SAMPLE rows of an M-G350 on the ideal motion w, f. switch_on scales the bias at the start, 8 mg and 0.5 deg/s."""
    n, rate_hz = len(t), 1.0 / (t[1] - t[0])
    sensed = []
    for ideal, noise, initial, in_run in (
        (w, PROFILE.gyro_noise, PROFILE.gyro_bias_initial, PROFILE.gyro_bias_instability),
        (f, PROFILE.accel_noise, PROFILE.accel_bias_initial, PROFILE.accel_bias_instability),
    ):
        bias = switch_on * initial * rng.standard_normal(3) + _random_walk(rng, n, rate_hz, in_run)
        sensed.append(ideal + bias + noise * np.sqrt(rate_hz) * rng.standard_normal((n, 3)))
    return samples_of(t, sensed[0], sensed[1])


def level_at_rest(count: int) -> tuple[Floats, Floats]:
    """Ideal rate and specific force of a level body at rest."""
    return np.zeros((count, 3)), np.tile([0.0, 0.0, -STANDARD_GRAVITY], (count, 1))
