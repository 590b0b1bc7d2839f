"""How well the time offset can be known at all: what changes of the acceleration show of it.

If the fixes are later than assumed by d, the trajectory that they show is that of the IMU, shifted by d. The positions
differ by v d, the velocities by a d, and an error of the estimate explains the same. Only a change of the acceleration
shows d: in a time dt it adds a' d dt to the difference of the velocities, whose noise is q dt. So the information about
d grows by

    |a'|^2 dt / q     (1/s^2),

and no filter can know d better. A Kalman filter states less: its Jacobian has estimated velocities and accelerations,
whose noise it takes for changes. With positions of centimetres, on a vehicle that shakes its sensor, that is an error
of metres at a sigma of centimetres. Here a' is that of the means of the measured acceleration in windows one after the
other, less what their noise alone would be. What the variance of the time offset is below the bound, times v^2 and a^2,
is added to the stated variances of position and velocity; P does not have it, as its gains would then follow the noise.

Source: Van Trees, Detection, estimation, and modulation theory I (1968), sec. 2.4: the bound by the information.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ..tuning import Tunable
from .ekf import variance
from .state import COARSE_ALIGNMENT, EXACT_EPOCHS, TIME_OFFSET, VELOCITY_NOISE

if TYPE_CHECKING:
    from .types import Core, Parameters, Transition


TUNABLES = (Tunable("jerk_window_s", 1.0, "s", "Time over which an acceleration is averaged.", "Choice."),)


@kernel
def compare_accelerations(p: Parameters, c: Core) -> None:
    """The window is complete: compare its mean acceleration with that of the window before, and begin a new one."""
    g, change2 = c.time_evidence, 0.0
    noise = g.velocity_variance / (g.duration * g.duration)  # of each component of the mean
    for i in range(3):
        accel = g.velocity_change[i] / g.duration
        change2 += (accel - g.accel[i]) ** 2
        g.accel[i] = accel
        g.velocity_change[i] = 0.0
    if g.accel_noise > 0.0:
        g.jerk2 = max(0.0, g.jerk2 + (change2 - 3.0 * (g.accel_noise + noise)) / g.duration)
    g.accel_noise = noise
    g.velocity_variance = g.duration = 0.0


@kernel
def bound_time_information(p: Parameters, c: Core, transition: Transition) -> None:
    """After an interval of the covariance: what the acceleration has shown of the time offset until then."""
    g, known = c.time_evidence, 1.0 / max(variance(c, TIME_OFFSET), 1e-12)
    for i in range(3):
        g.velocity_change[i] += transition.delta_v[i]
    g.velocity_variance += transition.velocity_psd * transition.interval
    g.duration += transition.interval
    if g.duration >= p.tuning.jerk_window_s:
        compare_accelerations(p, c)
    psd = p.accel_psd + c.process_noise.psd[VELOCITY_NOISE]
    first = g.prior_information == 0.0  # with a heading that the user gives there is no alignment
    if first or c.alignment.mode == COARSE_ALIGNMENT or known < g.prior_information:
        g.prior_information, g.jerk2 = known, 0.0
    g.jerk2 = min(g.jerk2, (known - g.prior_information) * psd)  # the variance may have been increased
    bound = 1.0 / (g.prior_information + g.jerk2 / psd)
    g.missing_variance = max(0.0, bound - 1.0 / known) if c.integrity.epochs != EXACT_EPOCHS else 0.0
