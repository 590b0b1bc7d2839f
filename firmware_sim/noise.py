"""The errors of an inertial sensor, drawn once from a seed and repeatable sample by sample.

Turn-on bias, in-run bias (first-order Gauss-Markov), scale factor, misalignment, white noise, range. The sensor's own
low-pass (133 Hz) is not modelled: noise is white at the internal sampling rate, with the random walk of the data sheet.
"""

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from .ellipsoid import Array

STANDARD_GRAVITY = 9.80665  # m/s^2, the unit G
DEG = math.pi / 180.0
MILLI_G = 1e-3 * STANDARD_GRAVITY
_ROOT_HOUR = 60.0  # sqrt(3600 s)


@dataclass(frozen=True)
class Grade:
    """Errors of a model of sensor; each pair is (gyro in rad/s, accelerometer in m/s^2)."""

    random_walk: tuple[float, float]  # per sqrt(Hz)
    turn_on: tuple[float, float]  # 1 sigma
    in_run: tuple[float, float]  # 1 sigma of the Gauss-Markov process
    scale: tuple[float, float]  # limit, as a ratio
    misalignment: tuple[float, float]  # 1 sigma, rad
    limit: tuple[float, float]  # range
    correlation_s: float = 300.0  # of the in-run bias
    warm_up_degc: float = 0.0  # rise of temperature above 25 degC after switch-on


# M-G350-PD11 data sheet, table "Sensor section specification"
M_G350 = Grade(
    random_walk=(0.2 * DEG / _ROOT_HOUR, 0.04 / _ROOT_HOUR),
    turn_on=(0.5 * DEG, 8.0 * MILLI_G),
    in_run=(6.0 * DEG / 3600.0, 0.1 * MILLI_G),
    scale=(0.005, 0.005),
    misalignment=(0.1 * DEG, 0.03 * DEG),
    limit=(300.0 * DEG, 3.0 * STANDARD_GRAVITY),
    warm_up_degc=6.0,
)
IDEAL = Grade((0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), M_G350.limit)


class Signal(Protocol):
    """A source of true rates and forces."""

    @property
    def end(self) -> float:
        """Time in s at which the signal ends, or infinity."""
        ...

    def imu(self, t: Array) -> Array:
        """w_ib_b in rad/s and f_b in m/s^2, (n, 6), at times `t` (n,) in s."""
        ...


@runtime_checkable
class SampledSignal(Signal, Protocol):
    """One that is known at certain times only: a sensor gives what it was then, at none of its own times."""

    def after(self, t: float) -> float:
        """The first of these times after time `t`; infinite: there is none."""
        ...


def _six(pair: tuple[float, float]) -> Array:
    return np.repeat(pair, 3)


class ImuErrors:
    """The errors of one specimen. Successive calls of `corrupt` continue its noise."""

    def __init__(
        self,
        grade: Grade,
        rng: np.random.Generator,
        tick_hz: float,
        gyro_bias: tuple[float, float, float] | None = None,
        accel_bias: tuple[float, float, float] | None = None,
        gyro_slope: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        """gyro_bias, accel_bias: turn-on biases in rad/s and m/s^2 instead of drawn ones.

        gyro_slope: change of the gyros' biases with the temperature above 25 degC, rad/s/K.
        """
        self._grade, self._rng, self._tick_hz = grade, rng, tick_hz
        self.bias = _six(grade.turn_on) * rng.standard_normal(6)
        self.gain = np.eye(6) + np.diag(_six(grade.scale) * rng.uniform(-1.0, 1.0, 6))
        for sensor, sigma in enumerate(grade.misalignment):
            axes = slice(3 * sensor, 3 * sensor + 3)
            self.gain[axes, axes] += sigma * rng.standard_normal((3, 3)) * (1.0 - np.eye(3))
        if gyro_bias is not None:
            self.bias[:3] = gyro_bias
        if accel_bias is not None:
            self.bias[3:] = accel_bias
        self._slope = np.array([*gyro_slope, 0.0, 0.0, 0.0])
        self._in_run = _six(grade.in_run)
        self._drift = np.zeros(6)
        self._white = _six(grade.random_walk) * math.sqrt(tick_hz)
        self.limit = _six(grade.limit)

    def measure(self, signal: Signal, t: Array) -> Array:
        """Measured values at times `t` (n,) in s, successive at its rate: (n, 6), rad/s and m/s^2."""
        rise = self._temperature_rise(t)
        return np.clip(self.corrupt(signal.imu(t)) + np.outer(rise, self._slope), -self.limit, self.limit)

    def corrupt(self, signal: Array) -> Array:
        """Measured from ideal values, (n, 6), one row per tick: gyro in rad/s, accelerometer in m/s^2."""
        n = len(signal)
        before = self._drift
        decay = math.exp(-n / (self._tick_hz * self._grade.correlation_s))
        increment = math.sqrt(1.0 - decay**2) * self._in_run
        self._drift = decay * before + increment * self._rng.standard_normal(6)
        drift = before + np.outer(np.arange(1, n + 1) / n, self._drift - before)
        white = self._white * self._rng.standard_normal((n, 6))
        return np.clip(signal @ self.gain.T + self.bias + drift + white, -self.limit, self.limit)

    def temperature(self, t: float) -> float:
        """Inside the sensor, degC, `t` s after switch-on."""
        return 25.0 + float(self._temperature_rise(np.array([t]))[0])

    def _temperature_rise(self, t: Array) -> Array:
        """Above 25 degC, at times `t` (n,) after switch-on."""
        return np.asarray(-self._grade.warm_up_degc * np.expm1(-np.maximum(t, 0.0) / 200.0))
