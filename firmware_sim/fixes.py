"""Simulated fixes of a satellite receiver: a true motion with the errors of a single-frequency receiver.

Position errors are first-order Gauss-Markov (atmosphere, multipath) plus a little white noise, as receivers filter.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .ellipsoid import Array
from .motion import Trajectory

COMPUTE_S = 0.1  # from the epoch to the first byte
_JITTER_S = 0.005  # 1 sigma of it
_CORRELATION_S = 30.0
_SLOW = np.array([1.5, 1.5, 2.5])  # m, 1 sigma north, east, down, at HDOP 1
_WHITE = np.array([0.2, 0.2, 0.4])  # m
_VELOCITY = np.array([0.05, 0.05, 0.1])  # m/s
_HEADING_CORRELATION_S = 10.0  # of reflections
_STANDSTILL = 0.2  # m/s; below it the receiver reports course 0.00


@dataclass(frozen=True)
class Fix:
    """One position. speed_mps and course_deg are None where they are not known."""

    t: float  # epoch, s since the start
    arrival: float  # when the first byte of its report leaves, s since the start
    lat_deg: float
    lon_deg: float
    height_m: float  # above the ellipsoid
    speed_mps: float | None
    course_deg: float | None
    hdop: float
    satellites: int = 8
    valid: bool = True  # else the receiver knows no position
    sigma_m: tuple[float, float, float] | None = None  # north, east, down; None: not known
    velocity_mps: tuple[float, float, float] | None = None  # NED
    velocity_sigma_mps: tuple[float, float, float] | None = None
    heading_deg: float | None = None  # true, of two antennas in line with the vehicle; None: it has one antenna


class FixSource(Protocol):
    def after(self, t: float, interval: float) -> Fix | None:
        """The first fix with its epoch after time `t`, or None; `interval` s apart where the receiver decides."""
        ...


class SimulatedFixes:
    """Fixes of a receiver carried along a trajectory, at whole multiples of the interval in UTC.

    utc: UTC of time 0 in s since 1970. ideal: without errors, and with constant latency. heading_sigma_deg: error of
    the heading of two antennas, which lasts some seconds; None: there is one antenna.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        rng: np.random.Generator,
        utc: float,
        ideal: bool = False,
        heading_sigma_deg: float | None = None,
    ) -> None:
        self._heading_sigma, self._heading_rng = heading_sigma_deg, np.random.default_rng(1)
        self._heading_error = self._heading_rng.standard_normal()
        self._trajectory, self._rng, self._utc = trajectory, rng, utc
        self._size = 0.0 if ideal else 1.0
        self._slow = _SLOW * rng.standard_normal(3)
        self._last = 0.0

    def after(self, t: float, interval: float) -> Fix:
        epoch = (math.floor((self._utc + t) / interval + 1e-6) + 1) * interval - self._utc
        truth = self._trajectory.at(np.array([epoch]))
        hdop = 1.0 + 0.1 * math.sin(2.0 * math.pi * epoch / 300.0)
        north, east, down = self._size * hdop * self._position_error(epoch)
        velocity = truth.v_n[0] + self._size * _VELOCITY * self._rng.standard_normal(3)
        speed = math.hypot(velocity[0], velocity[1])
        course = math.degrees(math.atan2(velocity[1], velocity[0])) % 360.0
        sigma = hdop * np.hypot(_SLOW, _WHITE)
        lat = truth.lat[0] + north / 6.36e6  # errors in metres need no ellipsoid
        return Fix(
            t=epoch,
            arrival=epoch + COMPUTE_S + self._size * abs(_JITTER_S * self._rng.standard_normal()),
            lat_deg=math.degrees(lat),
            lon_deg=math.degrees(truth.lon[0] + east / (6.38e6 * math.cos(lat))),
            height_m=float(truth.height[0]) - down,
            speed_mps=speed,
            course_deg=course if speed > _STANDSTILL else 0.0,
            hdop=hdop,
            sigma_m=(sigma[0], sigma[1], sigma[2]),
            velocity_mps=(velocity[0], velocity[1], velocity[2]),
            velocity_sigma_mps=(_VELOCITY[0], _VELOCITY[1], _VELOCITY[2]),
            heading_deg=self._heading(float(truth.rpy[0, 2]), interval),
        )

    def _heading(self, yaw: float, interval: float) -> float | None:
        if self._heading_sigma is None:
            return None
        decay = math.exp(-interval / _HEADING_CORRELATION_S)
        fresh = math.sqrt(1.0 - decay**2) * self._heading_rng.standard_normal()
        self._heading_error = decay * self._heading_error + fresh
        return (math.degrees(yaw) + self._size * self._heading_sigma * self._heading_error) % 360.0

    def _position_error(self, epoch: float) -> Array:
        decay = math.exp(-(epoch - self._last) / _CORRELATION_S)
        self._slow = decay * self._slow + math.sqrt(1.0 - decay**2) * _SLOW * self._rng.standard_normal(3)
        self._last = epoch
        return self._slow + _WHITE * self._rng.standard_normal(3)
