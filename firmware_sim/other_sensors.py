"""Sensors beside GNSS that speak NMEA: a wheel's speed over ground (VBW), air pressure (XDR), a compass (HDT).

Each sends one sentence at a fixed rate, of the true motion at that instant, with errors of its own and its faults.
Source of the atmosphere: ISO 2533, below 11 km.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .motion import Trajectory, Truth
from .sentences import with_checksum
from .uart import Uart

_KNOT = 1852.0 / 3600.0
_WHEEL_SCALE, _WHEEL_SIGMA = 1.015, 0.03  # radius; m/s
_WEATHER_PA, _BARO_SIGMA_PA = 350.0, 3.0  # against the standard atmosphere
_COMPASS_SIGMA_DEG, _COMPASS_S = 0.5, 10.0  # how long its error lasts


def _forward(truth: Truth) -> float:
    """Speed along the vehicle's forward axis, m/s."""
    _, pitch, yaw = truth.rpy[0]
    forward = [math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), -math.sin(pitch)]
    return float(truth.v_n[0] @ forward)


def pressure_pa(truth: Truth) -> float:
    """Of the standard atmosphere, Pa."""
    return float(101325.0 * (1.0 - truth.height[0] / 44330.77) ** (1.0 / 0.190263))


def _yaw(truth: Truth) -> float:
    return math.degrees(truth.rpy[0, 2])


@dataclass(frozen=True)
class Kind:
    """value: what an ideal one measures. slope, offset: its lasting errors. sigma: the other ones, which last `tau` s
    (0: white). sentence: of a value."""

    rate_hz: float
    value: Callable[[Truth], float]
    slope: float
    offset: float
    sigma: float
    tau: float
    sentence: Callable[[float], str]


KINDS = {
    "wheel": Kind(10.0, _forward, _WHEEL_SCALE, 0.0, _WHEEL_SIGMA, 0.0, lambda v: f"VDVBW,,,V,{v / _KNOT:.3f},0.0,A"),
    "baro": Kind(
        10.0, pressure_pa, 1.0, _WEATHER_PA, _BARO_SIGMA_PA, 0.0, lambda v: f"WIXDR,P,{v * 1e-5:.6f},B,Barometer"
    ),
    "compass": Kind(
        10.0,
        _yaw,
        1.0,
        0.0,
        _COMPASS_SIGMA_DEG,
        _COMPASS_S,
        lambda v: f"HEHDT,{v % 360.0:.2f},T".replace("360.00", "0.00"),
    ),
}


def _none(_t: float, value: float) -> float:
    return value


class OtherSensor:
    """One sensor, switched on at time 0. fault: from a time and a reading to what it says instead."""

    def __init__(
        self,
        kind: Kind,
        trajectory: Trajectory,
        rng: np.random.Generator,
        baud: int,
        ideal: bool = False,
        fault: Callable[[float, float], float] = _none,
    ) -> None:
        self.uart = Uart(baud)
        self._kind, self._trajectory, self._rng, self._fault = kind, trajectory, rng, fault
        self._size = 0.0 if ideal else 1.0
        self._error = rng.standard_normal()
        self.restart(0.0)

    def restart(self, t: float) -> None:
        """The next sentence is due at the next whole period."""
        self.uart.clear()
        self._count = math.floor(t * self._kind.rate_hz) + 1

    def receive(self, data: bytes, t: float) -> None:
        """It takes no commands."""

    def advance(self, t: float) -> None:
        """Send all sentences that were due until time `t`."""
        while (due := self._count / self._kind.rate_hz) <= t:
            self.uart.send(with_checksum(self._kind.sentence(self._reading(due))), due)
            self._count += 1

    def deadline(self) -> float:
        """When the next sentence is due."""
        return self._count / self._kind.rate_hz

    def prepare(self) -> None:
        """Nothing to compute ahead."""

    def _reading(self, t: float) -> float:
        """What it says at time `t`, in SI units; a heading in degrees."""
        kind = self._kind
        decay = math.exp(-1.0 / (kind.rate_hz * kind.tau)) if kind.tau else 0.0
        self._error = decay * self._error + math.sqrt(1.0 - decay**2) * self._rng.standard_normal()
        true = kind.value(self._trajectory.at(np.array([t])))
        errors = self._size * np.array([kind.slope - 1.0, kind.offset + kind.sigma * self._error])
        return self._fault(t, float((1.0 + errors[0]) * true + errors[1]))
