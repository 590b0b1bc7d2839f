"""Whether the body rests, from the inertial sensor alone, and whether the rate it then shows may be the gyro's bias.

Rest is: for REST_S no sample far from the running means, the direction of gravity unchanged, and a mean rate that a
bias can explain. Steady slow rotation about the vertical looks just the same; it is told from a bias by what is known
already. A mean rate that contradicts the known bias is believed only after WAIT_S when it is the likelier bias by
what the sensor's maker promises (then the body turned before and rests now), else after a long PATIENCE_S.
"""

from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import reset
from ...kernels.rotation import Vector

from .covariance import variance
from .state import GYRO_BIAS, STATES

MEAN_S = 0.35
REST_S = 1.5
RATE_DEVIATION = 0.035  # rad/s, of a sample from the mean
FORCE_DEVIATION = 0.5  # m/s^2
TURNED = 0.1  # m/s^2, of the mean force since the quiet began
GATE = 5.0  # sigma, against what is known of the bias
PLAUSIBLE = 4.0  # sigma, against what the maker promises
BIAS_FLOOR = 5e-4  # rad/s, how well a bias is ever known (warming, counts, earth rate)
WAIT_S, PATIENCE_S = 3.0, 300.0


@kernel
def watch(p: Any, s: Any, w: Vector, f: Vector, dt: float) -> None:
    """Follow the means with this sample and count how long it has been quiet."""
    fade = dt / (MEAN_S + dt)
    rate2 = force2 = turned2 = mean2 = 0.0
    for i in range(3):
        s.w_mean[i] += fade * (w[i] - s.w_mean[i])
        s.f_mean[i] += fade * (f[i] - s.f_mean[i])
        rate2 += (w[i] - s.w_mean[i]) ** 2
        force2 += (f[i] - s.f_mean[i]) ** 2
        turned2 += (s.f_mean[i] - s.f_anchor[i]) ** 2
        mean2 = max(mean2, s.w_mean[i] ** 2)
    s.force2 += fade * (f[0] * f[0] + f[1] * f[1] + f[2] * f[2] - s.force2)
    quiet = rate2 < RATE_DEVIATION**2 and force2 < FORCE_DEVIATION**2 and turned2 < TURNED**2
    if quiet and mean2 < PLAUSIBLE**2 * p.gyro_bias_var:
        s.quiet_s += dt
        return
    s.quiet_s = 0.0
    for i in range(3):
        s.f_anchor[i] = s.f_mean[i]


@kernel
def judge(p: Any, s: Any) -> bool:
    """Is this rest, with a mean rate that may correct the gyro bias? To be asked once per covariance interval."""
    s.resting = 0
    if s.quiet_s < REST_S:
        s.contradicted_s = 0.0
        return False
    contradicts = False
    known2 = shown2 = 0.0
    for i in range(3):
        d = s.w_mean[i] - s.bg[i]
        known2 += s.bg[i] ** 2
        shown2 += s.w_mean[i] ** 2
        if d * d > GATE**2 * (variance(s, GYRO_BIAS + i) + BIAS_FLOOR**2):
            contradicts = True
    if not contradicts:
        s.contradicted_s = 0.0
        s.resting = 1
        return True
    s.contradicted_s += s.span
    if s.contradicted_s > (WAIT_S if shown2 < known2 else PATIENCE_S):
        for i in range(3):
            reset(s.P, STATES, GYRO_BIAS + i, p.gyro_bias_var)
    return False
