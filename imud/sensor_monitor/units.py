"""Rates in degrees per second, where radians are expected: gravity in the sensor does not turn as they say.

While a sensor turns by w, gravity in it changes by f x w. The part k of the change that is seen in what the rates say
is 1, and 1/57.3 if they are in deg/s. Accelerations change the force, too: they make k uncertain. So rates are in
deg/s if, over up to `WINDOW_S` of fast rates, k is about 1/57.3, and certainly so; and from then on, until k is
certainly about 1: a unit does not change with the motion.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..compile.jit import kernel

if TYPE_CHECKING:
    from .types import RateUnits

DEG = math.pi / 180.0
WINDOW_S, LOOKS = 5.0, 4  # of rates that count; so often in it k is looked at
LEAST_RATE = 2.0  # rad/s, that counts; 2 deg/s if it is in deg/s
NEAR = 2.0  # by this factor k may differ from 1/57.3
SIGMAS = 6.0  # by so many k must differ from 0

RATE_UNITS = np.dtype(
    [
        ("period", "<f8"),  # s
        ("window", "<i8"),  # samples
        ("samples", "<i8"),
        ("force", "<f8", (3,)),  # m/s^2, of the sample before
        ("covariance", "<f8"),  # (m/s^2)^2, sum of the products of seen and expected changes
        ("expected2", "<f8"),  # sums of their squares
        ("seen2", "<f8"),
        ("degrees", "<i8"),  # 1: the rates are in deg/s
    ],
    align=True,
)


def new_units(rate_hz: float) -> Any:
    """A record (array of one RATE_UNITS) for samples at this rate."""
    u = np.zeros(1, RATE_UNITS)
    u["period"], u["window"], u["force"] = 1.0 / rate_hz, max(100, LOOKS * round(WINDOW_S / LOOKS * rate_hz)), math.nan
    return u


@kernel
def rates_are_in_degrees(u: RateUnits, sample: Any) -> bool:
    """Whether the rates are in deg/s. Once per sample."""
    w, f = sample.w, sample.f
    expected = (f[1] * w[2] - f[2] * w[1], f[2] * w[0] - f[0] * w[2], f[0] * w[1] - f[1] * w[0])
    covariance = expected2 = seen2 = 0.0
    for i in range(3):
        seen, turned = f[i] - u.force[i], expected[i] * u.period
        covariance += seen * turned
        expected2 += turned * turned
        seen2 += seen * seen
        u.force[i] = f[i]
    if w[0] * w[0] + w[1] * w[1] + w[2] * w[2] < LEAST_RATE**2 or not expected2 + seen2 < math.inf:
        return bool(u.degrees == 1)
    u.samples += 1
    u.covariance += covariance
    u.expected2 += expected2
    u.seen2 += seen2
    if u.samples % (u.window // LOOKS) == 0:
        look(u)
    return bool(u.degrees == 1)


@kernel
def look(u: RateUnits) -> None:
    """Decide by what the window has shown so far, if that is certain; at its end, begin another."""
    k = u.covariance / u.expected2
    variance = u.seen2 / (3.0 * u.samples * u.expected2)
    if DEG / NEAR < k < DEG * NEAR and k * k > SIGMAS**2 * variance:
        u.degrees = 1
    elif k > 1.0 / NEAR and (k - DEG) ** 2 > SIGMAS**2 * variance:
        u.degrees = 0
    if u.samples >= u.window:
        u.samples = 0
        u.covariance = u.expected2 = u.seen2 = 0.0
