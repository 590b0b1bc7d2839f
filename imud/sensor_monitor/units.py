"""Finds rates in degrees per second instead of radians: the measured gravity rotates more slowly than the rates say.

While a sensor rotates at w, the specific force f of gravity changes at the rate f x w. The regression coefficient k of
the measured change on this expected change is 1, and 1/57.3 if the rates are in deg/s. Accelerations change the force,
too, so k has a variance. Rates are in deg/s from when k is significantly near 1/57.3, over up to WINDOW_S of fast
rates, until it is significantly above: a unit does not change with the motion. Each time the number of fast rates has
doubled the decision is made, so that great rates show it within a tenth of a second.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..compile.jit import kernel

if TYPE_CHECKING:
    from .types import RateUnits

DEG = math.pi / 180.0
WINDOW_S, DECISIONS = 5.0, 4  # time of fast rates over which k is estimated, and how often in it k is tested at least
FIRST_DECISION = 16  # fast rates
MIN_RATE = 2.0  # rad/s of a fast rate; 2 deg/s if the rates are in deg/s
MAX_RATIO = 2.0  # factor by which k may differ from 1/57.3
SIGMAS, SIGMAS_OF_RADIANS = 4.0, 6.0  # by which k must differ from 0, and from 1/57.3 to withdraw the finding

RATE_UNITS = np.dtype(
    [
        ("period", "<f8"),  # s
        ("window", "<i8"),  # samples in WINDOW_S
        ("samples", "<i8"),  # with fast rates, in the present window
        ("force", "<f8", (3,)),  # m/s^2, specific force of the sample before
        ("covariance", "<f8"),  # (m/s^2)^2, sum of the products of measured and expected changes
        ("expected2", "<f8"),  # (m/s^2)^2, sums of their squares
        ("measured2", "<f8"),
        ("degrees", "<i8"),  # 1: the rates are in deg/s
    ],
    align=True,
)


def new_units(rate_hz: float) -> Any:
    """A record (array of one RATE_UNITS) for samples at this rate."""
    u = np.zeros(1, RATE_UNITS)
    u["period"], u["force"] = 1.0 / rate_hz, math.nan
    u["window"] = max(100, DECISIONS * round(WINDOW_S / DECISIONS * rate_hz))
    return u


@kernel
def rates_are_in_degrees(u: RateUnits, sample: Any) -> bool:
    """Whether the rates are in deg/s. Call once for each sample."""
    w, f = sample.w, sample.f
    change = (f[0] - u.force[0], f[1] - u.force[1], f[2] - u.force[2])
    u.force[0], u.force[1], u.force[2] = f[0], f[1], f[2]
    if w[0] * w[0] + w[1] * w[1] + w[2] * w[2] < MIN_RATE**2:
        return bool(u.degrees == 1)
    expected = (f[1] * w[2] - f[2] * w[1], f[2] * w[0] - f[0] * w[2], f[0] * w[1] - f[1] * w[0])
    covariance = expected2 = measured2 = 0.0
    for i in range(3):
        measured, expected_change = change[i], expected[i] * u.period
        covariance += measured * expected_change
        expected2 += expected_change * expected_change
        measured2 += measured * measured
    if not expected2 + measured2 < math.inf:
        return bool(u.degrees == 1)
    u.samples += 1
    u.covariance += covariance
    u.expected2 += expected2
    u.measured2 += measured2
    doubled = u.samples >= FIRST_DECISION and u.samples & (u.samples - 1) == 0
    if doubled or u.samples % (u.window // DECISIONS) == 0:
        decide(u)
    return bool(u.degrees == 1)


@kernel
def decide(u: RateUnits) -> None:
    """Decide by the sums of the window so far, if they are significant; at its end, begin a new window."""
    k = u.covariance / u.expected2
    variance = u.measured2 / (3.0 * u.samples * u.expected2)
    if DEG / MAX_RATIO < k < DEG * MAX_RATIO and k * k > SIGMAS**2 * variance:
        u.degrees = 1
    elif k > 1.0 / MAX_RATIO and (k - DEG) ** 2 > SIGMAS_OF_RADIANS**2 * variance:
        u.degrees = 0
    if u.samples >= u.window:
        u.samples = 0
        u.covariance = u.expected2 = u.measured2 = 0.0
