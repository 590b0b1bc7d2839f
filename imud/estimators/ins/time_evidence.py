"""How well the time offset is known: what changes of the acceleration show of it.

If the fixes are later than assumed by d, the trajectory that they show is that of the IMU, shifted by d. The positions
differ by v d, the velocities by a d, and an error of the estimate explains the same. Only a change of the acceleration
shows d: in a time dt it adds a' d dt to the difference of the velocities, whose noise is q dt. So the information about
d grows by

    |a'|^2 dt / q     (1/s^2),

and no filter can know d better. A Kalman filter states more: its Jacobian has estimated velocities and accelerations,
whose noise it takes for changes. With positions of centimetres, on a vehicle that shakes its sensor, that is an error
of metres at a sigma of centimetres. Here a' is that of the means of the measured acceleration in windows one after the
other, less what their noise alone would be; where that is more, the windows that follow make up for it.

Of the information dI that P gains in a window, dR is shown by a', and the rest is noise that looks like information.
Then the error of the estimate shrinks by the share dR / I only, while both add the noise that P expects of them:

    S <- (1 - dR / I)^2 S + dI / I^2

is the variance of the error; with dR = dI it is that of P. What P has less than S, times v^2 and a^2, is added to the
stated variances of position and velocity; P does not have it, as its gains would then follow the noise.

S begins with the variance of P, or of the delay of a receiver that averages, which no epoch says, if that is more.
P begins with less, since nearly all receivers do not, and headings would be found later.

Source: Van Trees, Detection, estimation, and modulation theory I (1968), sec. 2.4: the bound by the information; Gelb,
Applied Optimal Estimation (1974), sec. 7.2: the error variance of a filter whose model is wrong.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ..tuning import Tunable
from .ekf import variance
from .state import COARSE_ALIGNMENT, EXACT_EPOCHS, REPORTED_EPOCHS, TIME_OFFSET, VELOCITY_NOISE

if TYPE_CHECKING:
    from .types import Core, Parameters, Transition


TUNABLES = (
    Tunable("jerk_window_s", 0.5, "s", "Time over which an acceleration is averaged.", "Choice."),
    Tunable(
        "averaging_delay_sigma",
        0.2,
        "s",
        "Sigma of the delay of a receiver's positions behind their epochs by averaging.",
        "Receivers that average over half a second or a second.",
    ),
)


@kernel
def compare_accelerations(c: Core, known: float, psd: float) -> None:
    """The window is complete: what its acceleration shows of the time offset, and what P has gained; begin a new one.

    known: 1/s^2, information about the time offset by P; psd: m^2/s^3, of the noise of the velocity.
    """
    g, change2 = c.time_evidence, 0.0
    noise = g.velocity_variance / (g.duration * g.duration)  # of each component of the mean
    for i in range(3):
        accel = g.velocity_change[i] / g.duration
        change2 += (accel - g.accel[i]) ** 2
        g.accel[i] = accel
        g.velocity_change[i] = 0.0
    if g.accel_noise > 0.0:
        g.shown = max(g.shown + (change2 - 3.0 * (g.accel_noise + noise)) / (g.duration * psd), -known)
    gained, shown = known - g.information, max(g.shown, 0.0)
    if gained > 0.0:
        g.error_variance = (1.0 - min(shown, gained) / known) ** 2 * g.error_variance + gained / known**2
    else:
        g.error_variance += 1.0 / known - 1.0 / g.information
        g.largest_variance = max(g.largest_variance, g.error_variance)
    g.shown -= shown
    g.information, g.accel_noise = known, noise
    g.velocity_variance = g.duration = 0.0


@kernel
def forget_time_evidence(c: Core) -> None:
    """The noise is known to be larger than it was taken to be: the variance is that of the beginning again."""
    g = c.time_evidence
    g.error_variance = max(g.error_variance, g.largest_variance)


@kernel
def measure_time_evidence(p: Parameters, c: Core, transition: Transition) -> None:
    """After an interval of the covariance: the time offset's variance by what the acceleration has shown until then."""
    g, known = c.time_evidence, 1.0 / max(variance(c, TIME_OFFSET), 1e-12)
    if g.information == 0.0 or c.alignment.mode == COARSE_ALIGNMENT:
        delay = p.tuning.averaging_delay_sigma if c.integrity.epochs == REPORTED_EPOCHS else 0.0
        g.information, g.largest_variance, g.shown = known, 1.0 / known, 0.0
        g.error_variance = max(1.0 / known, delay * delay)
    for i in range(3):
        g.velocity_change[i] += transition.delta_v[i]
    g.velocity_variance += transition.velocity_psd * transition.interval
    g.duration += transition.interval
    if g.duration >= p.tuning.jerk_window_s:
        compare_accelerations(c, known, p.accel_psd + c.process_noise.psd[VELOCITY_NOISE])
    g.missing_variance = max(0.0, g.error_variance - 1.0 / known) if c.integrity.epochs != EXACT_EPOCHS else 0.0
