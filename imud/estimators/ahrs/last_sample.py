"""The newest good sample, and for how long its rate has been held since."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.rotation import Vector

if TYPE_CHECKING:
    from .types import State


@kernel
def store_sample(s: State, w: Vector, f: Vector) -> None:
    """Make rate w and specific force f the newest sample."""
    for i in range(3):
        s.imu.w[i] = w[i]
        s.imu.f[i] = f[i]


@kernel
def forget_period(s: State) -> None:
    """After a gap there is no period to compare with."""
    s.imu.last_dt = s.imu.dt_change = 0.0


@kernel
def store_first_sample(s: State, w: Vector, f: Vector) -> None:
    """Make w and f the newest sample, without a sample before: at the start, or after a long gap."""
    store_sample(s, w, f)
    for i in range(3):
        s.imu.f_change[i] = 0.0
    s.imu.outage_s = 0.0
    forget_period(s)


@kernel
def subtract_biases(s: State) -> None:
    """Subtract the biases from the newest sample."""
    for i in range(3):
        s.imu.w[i] -= s.nav.bg[i]
        s.imu.f[i] -= s.nav.ba[i]


@kernel
def update_force_change(s: State, f: Vector) -> float:
    """Square of the change from the last force to f that the change before did not announce, (m/s^2)^2."""
    unannounced2 = 0.0
    for i in range(3):
        change = f[i] - s.imu.f[i]
        unannounced2 += (change - s.imu.f_change[i]) ** 2
        s.imu.f_change[i] = change
    return unannounced2


@kernel
def is_whole_multiple(period: float, shorter: float) -> bool:
    """Is it twice the shorter one, three times or more? By hundredths: stamps that are right are that good."""
    if not 0.0 < 1.5 * shorter < period:
        return False
    return bool(abs(period - math.floor(period / shorter + 0.5) * shorter) < 0.01 * shorter)


@kernel
def update_stamp_variance(s: State, dt: float, share: float) -> None:
    """The newest period, dt, is so much of the mean: minus the covariance of one period with the next.

    Of even samples whose stamps have errors, a period that is too long makes the next one too short. Where samples are
    uneven and their stamps right, it does not, unless long and short periods alternate: of them only those do not
    count that are whole multiples of each other, as where every third sample is lost.
    """
    imu = s.imu
    if is_whole_multiple(dt, imu.last_dt):
        dt = imu.last_dt
    elif is_whole_multiple(imu.last_dt, dt):
        imu.last_dt = dt
    change = dt - imu.last_dt if imu.last_dt > 0.0 else 0.0
    covariance = change * imu.dt_change + 0.5 * change * change  # whatever the mean period is
    imu.dt_covariance += share * (covariance - imu.dt_covariance)
    imu.last_dt, imu.dt_change = dt, change


@kernel
def stamp_variance(s: State) -> float:
    """Of the stamps about even ones, s^2."""
    return max(-s.imu.dt_covariance, 0.0)


@kernel
def turn_in_stamp_error(s: State) -> float:
    """By how much the body turns in the error of a stamp, rad: the attitude is that of another time than stated."""
    w = s.imu.w
    return math.sqrt(stamp_variance(s) * (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]))


@kernel
def update_mean_square_rate(s: State, w: Vector, share: float) -> None:
    """A good rate w is so much of the mean."""
    s.imu.rate2 += min(share, 1.0) * ((w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) / 3.0 - s.imu.rate2)


@kernel
def set_outage(s: State, seconds: float, fault_s: float) -> None:
    """The last rate has been held for so long. fault_s: the sensor's fault has lasted; 0: it has none."""
    s.imu.outage_s, s.imu.fault_s = seconds, fault_s
