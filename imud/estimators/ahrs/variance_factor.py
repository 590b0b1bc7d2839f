"""How large the tilt's errors are, over what the covariance says: from the sums of the corrections that tilt has had.

The noises of the error model are those of the worst of many motions and sensors: with them a correction is weighted
well, but in most motions the covariance is several times the errors' own. The corrections show it. Their sum over a
time is as large as its variance if the model is right; where errors neither grow nor scatter so much, it is smaller.
Geodesy takes the same ratio, the a posteriori variance of unit weight, for the stated variances; so does this, and
leaves the gain as it is.

The sum is that of `correction_time_s`, fading. What it is expected to be is the variance of the corrections, but no
more than that of the tilt, as errors that come from accelerations do not add up. Squares and expectations are summed
over `correction_memory_s`, together with one square that agrees with the variance of now: a variance that becomes
larger is believed until it has been compared. A sum that is large just now counts at once.

An accelerometer bias is a tilt that no correction shows: what it explains of the tilt's variance is left out. A vehicle
accelerates for longer than any sum, so all of this is only for bodies that move as no vehicle does, after a first rest.

A sum that is far larger than expected has another cause: the gyro bias has changed. What turns the tilt by the sum in
that time is added to the variance of the bias, of all axes, as the yaw shows nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.kalman import packed_index
from .error_model import add_variance, variance
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, STATES

if TYPE_CHECKING:
    from .types import Parameters, State


@kernel
def expect_correction(s: State, innovation_variance: float) -> None:
    """A measurement corrects the tilt; s.scratch.ph holds P h'."""
    for i in range(2):
        gain_covariance = s.scratch.ph[ATTITUDE + i] * s.scratch.ph[ATTITUDE + i] / innovation_variance
        s.variance_factor.expected2[i] += gain_covariance


@kernel
def tilt_variance_by_bias(s: State, i: int) -> float:
    """What the accelerometer's bias explains of the variance of tilt i: gravity is as wrong across the axis."""
    total, explained = s.integrals, 0.0
    row = 3 * (1 - i)
    for j in range(3):
        for k in range(3):
            at = packed_index(STATES, ACCEL_BIAS + min(j, k), ACCEL_BIAS + max(j, k))
            explained += total.c[row + j] * total.c[row + k] * s.cov.P[at]
    return float(explained / (total.time * s.nav.gravity) ** 2)


@kernel
def update_variance_factor(p: Parameters, s: State) -> None:
    """After the measurements of an interval, before the error is injected: s.scratch.x holds the correction."""
    c, factor, time = p.tuning, s.variance_factor, s.integrals.time
    if s.stationarity.gravity_checked == 0 or s.attitude_step.hand_held_s <= 0.0:
        restart_variance_factor(s)
        return
    forgotten = time / (c.correction_time_s + time)
    correctable0 = max(variance(s, ATTITUDE) - tilt_variance_by_bias(s, 0), 0.0)
    correctable1 = max(variance(s, ATTITUDE + 1) - tilt_variance_by_bias(s, 1), 0.0)
    sum2 = expected2 = 0.0
    for i in range(2):
        factor.correction[i] += s.scratch.x[ATTITUDE + i] - forgotten * factor.correction[i]
        factor.expected2[i] *= (1.0 - forgotten) ** 2
        sum2 += factor.correction[i] * factor.correction[i]
        expected2 += factor.expected2[i]
    others = correctable0 + correctable1
    if sum2 > c.correction_gate * expected2 and s.stationarity.stationary == 0:
        add_bias_step(p, s, max(sum2 - expected2, 0.0))
    weight, faded = time / c.correction_time_s, time / (c.correction_memory_s + time)
    factor.squares += weight * sum2 - faded * factor.squares
    factor.expectations += weight * min(expected2, others) - faded * factor.expectations
    factor.tilt_scale[0] = factor.tilt_scale[1] = 1.0
    if s.attitude_step.hand_held_s < c.hand_time_s or others <= 0.0:
        return
    ratio = (others + factor.squares) / (others + factor.expectations)
    ratio = min(max(ratio, sum2 / (c.correction_gate * others)), 1.0)
    factor.tilt_scale[0] = (1.0 - (1.0 - ratio) * correctable0 / variance(s, ATTITUDE)) ** 0.5
    factor.tilt_scale[1] = (1.0 - (1.0 - ratio) * correctable1 / variance(s, ATTITUDE + 1)) ** 0.5


@kernel
def add_bias_step(p: Parameters, s: State, angle2: float) -> None:
    """The gyro bias may have changed by what has turned the tilt by this angle squared, rad^2, lately."""
    time = p.tuning.correction_time_s
    for i in range(3):
        add_variance(s, GYRO_BIAS + i, angle2 / time**3 * s.integrals.time)


@kernel
def restart_variance_factor(s: State) -> None:
    """Nothing is known of the corrections."""
    factor = s.variance_factor
    factor.squares = factor.expectations = 0.0
    for i in range(2):
        factor.correction[i] = factor.expected2[i] = 0.0
        factor.tilt_scale[i] = 1.0
