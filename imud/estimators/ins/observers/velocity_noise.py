"""The velocity's process noise, learned on each drive: vibration and motion add more to the sensor's than a sheet says.

How far each innovation is from the variance that the filter expects tells whether its process noise is right, but so
it does for the receiver's noise; what tells the two apart is whether innovations resemble the ones before. Both are in
the likelihood of the innovations. Its derivative by the logarithm of the process noise needs two more recursions, in
the steps of the Kalman filter's own: D = dP and x = d(estimate), of position, velocity and attitude,

    D <- Phi D Phi' + dQ                     x <- Phi x
    D <- (I - K h) D (I - K h)'              x <- x - K h x + (D h' - K h D h') z / s

and each innovation z of variance s then adds to the derivative, and to its Fisher information,

    score = 1/2 (h D h' / s) (z^2 / s - 1) + z h x / s,     information = 1/2 (h D h' / s)^2 + (h x)^2 / s

The logarithm is a random walk with a prior; its estimate is a Kalman filter of one state with these. What few or poor
fixes cannot show stays at the prior.

Source: Ljung and Soderstrom, Theory and practice of recursive identification (1983), sec. 3.8: recursive maximum
likelihood; Gupta and Mehra, Computational aspects of maximum likelihood estimation (1974): the sensitivity equations.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ....math.kalman import measure, packed_index, shear, shear3
from ...tuning import Tunable
from ..error_model import learned_velocity_psd
from ..state import ATTITUDE, LEARNING_STATES, POSITION, VELOCITY

if TYPE_CHECKING:
    from ..types import Core, Parameters, Transition


TUNABLES = (
    Tunable(
        "velocity_noise_prior",
        3.0,
        "",
        "Sigma of the logarithm of a vehicle's process noise before it is learned.",
        "From a smooth car to a multicopter: a factor of 400.",
    ),
    Tunable(
        "velocity_noise_walk",
        0.1,
        "per sqrt(s)",
        "Random walk of this logarithm: road, speed and rotors change.",
        "A factor of 2.7 in 100 s.",
    ),
    Tunable(
        "max_learned_nis", 9.0, "NIS", "Largest normalised innovation squared that is learned from.", "Three sigma."
    ),
    Tunable("max_velocity_noise", 1.0, "(m/s)/sqrt(s)", "Largest process noise that is learned.", "A multicopter."),
    Tunable("min_velocity_noise", 5e-3, "(m/s)/sqrt(s)", "Least process noise that is learned.", "A sensor at rest."),
)


@kernel
def clear_learning(c: Core) -> None:
    """Clear the sensitivities: the estimate is new."""
    g = c.velocity_noise
    for i in range(LEARNING_STATES):
        g.estimate_sensitivity[i] = 0.0
    for i in range(LEARNING_STATES * (LEARNING_STATES + 1) // 2):
        g.covariance_sensitivity[i] = 0.0


@kernel
def propagate_learning(p: Parameters, c: Core, phi: Transition) -> None:
    """D <- Phi D Phi' + dQ, x <- Phi x, and the random walk of the logarithm."""
    g, f, dt = c.velocity_noise, phi.force, phi.interval
    n, D, x = LEARNING_STATES, g.covariance_sensitivity, g.estimate_sensitivity
    for i in range(3):
        shear(D, n, POSITION + i, VELOCITY + i, dt)
        x[POSITION + i] += dt * x[VELOCITY + i]
    shear3(D, n, VELOCITY, ATTITUDE, 0.0, f[2], -f[1])
    shear3(D, n, VELOCITY + 1, ATTITUDE, -f[2], 0.0, f[0])
    shear3(D, n, VELOCITY + 2, ATTITUDE, f[1], -f[0], 0.0)
    north, east, down = x[ATTITUDE], x[ATTITUDE + 1], x[ATTITUDE + 2]
    x[VELOCITY] += f[2] * east - f[1] * down
    x[VELOCITY + 1] += f[0] * down - f[2] * north
    x[VELOCITY + 2] += f[1] * north - f[0] * east
    q = learned_velocity_psd(c) * dt
    for i in range(3):
        D[packed_index(n, VELOCITY + i, VELOCITY + i)] += q
    if q > 0.0:
        g.log_psd_variance = min(
            g.log_psd_variance + p.tuning.velocity_noise_walk**2 * dt, p.tuning.velocity_noise_prior**2
        )


@kernel
def predict_sensitivity(c: Core, m: int) -> tuple[float, float]:
    """h D h' and h x for the Jacobian, of length m; stores D h in scratch.learning_d."""
    g, x, k, slope = c.velocity_noise, c.scratch, 0, 0.0
    for i in range(m):
        column, value = x.columns[i], x.values[i]
        if column < LEARNING_STATES:
            x.learning_columns[k], x.learning_values[k] = column, value
            slope += value * g.estimate_sensitivity[column]
            k += 1
    D = g.covariance_sensitivity
    return measure(D, LEARNING_STATES, x.learning_columns, x.learning_values, k, x.learning_d), slope


@kernel
def learn_velocity_psd(p: Parameters, c: Core, m: int, z: float, s: float) -> None:
    """Learn from an innovation z of variance s; the Jacobian has m elements. Call before its update, or without one."""
    g = c.velocity_noise
    hDh, slope = predict_sensitivity(c, m)
    share, most = hDh / s, math.sqrt(p.tuning.max_learned_nis * s)
    z = min(max(z, -most), most)
    score = 0.5 * share * (z * z / s - 1.0) + z * slope / s
    information = 0.5 * share * share + slope * slope / s
    g.log_psd_variance /= 1.0 + g.log_psd_variance * information
    least, largest = 2.0 * math.log(p.tuning.min_velocity_noise), 2.0 * math.log(p.tuning.max_velocity_noise)
    g.log_psd = min(max(g.log_psd + g.log_psd_variance * score, least), largest)
    g.psd = math.exp(g.log_psd)


@kernel
def update_learning(c: Core, m: int, z: float, s: float) -> None:
    """D and x after the scalar update that follows; arguments as those of `fuse`."""
    g, d, Dh, at = c.velocity_noise, c.scratch.d, c.scratch.learning_d, 0
    hDh, slope = predict_sensitivity(c, m)
    for i in range(LEARNING_STATES):
        gain = d[i] / s
        g.estimate_sensitivity[i] += (Dh[i] - gain * hDh) * z / s - gain * slope
        for j in range(i, LEARNING_STATES):
            other = d[j] / s
            g.covariance_sensitivity[at] += gain * other * hDh - gain * Dh[j] - Dh[i] * other
            at += 1
