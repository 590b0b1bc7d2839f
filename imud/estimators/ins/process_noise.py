"""The process noise of velocity and attitude, learned on each drive: vibration adds to what the data sheet states.

The size of the innovations, against the variance that the filter expects, depends on the process noise and on the
receiver's noise; the correlation of successive innovations separates the two. The likelihood of the innovations has
both. Its derivative by the logarithm of a process noise needs two more recursions, in the steps of the Kalman filter's
own: D = dP and e = d(estimate), of position, velocity and attitude,

    D <- T D T' + dQ                         e <- T e         (T: the transition matrix)
    D <- (I - K h) D (I - K h)'              e <- e - K h e + (D h' - K h D h') z / s

for each of the two noises. Each innovation z of variance s adds to the derivatives, and to their Fisher information,

    score = 1/2 (h D h' / s) (z^2 / s - 1) + z h e / s
    information = 1/2 (h D h' / s) (h D h' / s)' + (h e) (h e)' / s      of the vectors of both

A noise of the attitude shows as an error of the velocity that grows, and returns after a fix; one of the velocity is
gone after it. The unknown is the logarithm of the noise plus a scale, because below some scale the derivative by a
logarithm vanishes with the noise. Both are random walks with a prior, estimated by a Kalman filter of two states. What
few or poor fixes cannot show stays at the prior.

Source: Ljung and Soderstrom, Theory and practice of recursive identification (1983), sec. 3.8: recursive maximum
likelihood; Gupta and Mehra, Computational aspects of maximum likelihood estimation (1974): the sensitivity equations.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from ...math.kalman import measure, packed_index, shear, shear33
from ..tuning import Tunable
from .ekf import exponential, variance
from .state import ATTITUDE, LEARNING_STATES, POSITION, VELOCITY

if TYPE_CHECKING:
    from ...math.arrays import Floats, Reals
    from .types import Core, Parameters, Transition


TUNABLES = (
    Tunable(
        "vibration_vrw",
        0.011,
        "(m/s)/sqrt(s)",
        "Velocity random walk that vibration adds to an accelerometer's under way; the first value, learned later.",
        "Recorded drives.",
    ),
    Tunable(
        "vibration_arw",
        math.radians(0.005),
        "rad/sqrt(s)",
        "Angle random walk that vibration adds to a gyro's under way; the first value, learned later.",
        "Recorded drives.",
    ),
    Tunable(
        "process_noise_prior",
        3.0,
        "",
        "Sigma of the logarithm of a vehicle's process noise before it is learned.",
        "From a smooth car to a multicopter: a factor of 400.",
    ),
    Tunable(
        "process_noise_walk",
        0.03,
        "per sqrt(s)",
        "Random walk of the logarithm of the process noise: road, speed and rotors change.",
        "A factor of 2.7 in 1000 s.",
    ),
    Tunable(
        "max_learned_nis", 9.0, "NIS", "Largest normalised innovation squared that is learned from.", "Three sigma."
    ),
    Tunable(
        "velocity_noise_scale",
        0.02,
        "(m/s)/sqrt(s)",
        "Velocity process noise from which it is learned as a logarithm.",
        "It adds 0.02 m/s in a second: less than a receiver shows.",
    ),
    Tunable(
        "attitude_noise_scale",
        math.radians(0.03),
        "rad/sqrt(s)",
        "Attitude process noise from which it is learned as a logarithm.",
        "A gyro of a phone.",
    ),
    Tunable(
        "max_velocity_noise", 1.0, "(m/s)/sqrt(s)", "Largest velocity process noise that is learned.", "A multicopter."
    ),
    Tunable(
        "min_velocity_noise", 5e-3, "(m/s)/sqrt(s)", "Least velocity process noise that is learned.", "A smooth car."
    ),
    Tunable(
        "max_attitude_noise",
        math.radians(1.0),
        "rad/sqrt(s)",
        "Largest attitude process noise that is learned.",
        "A multicopter.",
    ),
    Tunable(
        "min_attitude_noise",
        math.radians(1e-3),
        "rad/sqrt(s)",
        "Least attitude process noise that is learned.",
        "A smooth car.",
    ),
)


@kernel
def clear_learning(c: Core) -> None:
    """Clear the sensitivities: the estimate is new."""
    g = c.process_noise
    g.estimate_sensitivity[:] = 0.0
    g.covariance_sensitivity[:] = 0.0


@kernel
def propagate_one(D: Floats, e: Floats, transition: Transition) -> None:
    """D <- T D T' and e <- T e with the transition T, of one of the noises."""
    f, dt, n = transition.delta_v, transition.interval, LEARNING_STATES
    for i in range(3):
        shear(D, n, POSITION + i, VELOCITY + i, dt)
        e[POSITION + i] += dt * e[VELOCITY + i]
    shear33(D, n, VELOCITY, ATTITUDE, (0.0, f[2], -f[1], -f[2], 0.0, f[0], f[1], -f[0], 0.0))
    north, east, down = e[ATTITUDE], e[ATTITUDE + 1], e[ATTITUDE + 2]
    e[VELOCITY] += f[2] * east - f[1] * down
    e[VELOCITY + 1] += f[0] * down - f[2] * north
    e[VELOCITY + 2] += f[1] * north - f[0] * east


@kernel
def propagate_learning(p: Parameters, c: Core, transition: Transition) -> None:
    """D <- T D T' + dQ, e <- T e, and the random walk of the logarithms."""
    g = c.process_noise
    for k in range(2):
        D = g.covariance_sensitivity[k]
        propagate_one(D, g.estimate_sensitivity[k], transition)
        first = VELOCITY if k == 0 else ATTITUDE
        psd_derivative = exponential(c, 2 + k, g.log_psd[k]) * c.stationarity.vibration_level  # of q by log_psd
        for i in range(3):
            D[packed_index(LEARNING_STATES, first + i, first + i)] += psd_derivative * transition.interval
        if psd_derivative > 0.0 and g.log_psd_covariance[2 * k] < p.tuning.process_noise_prior**2:
            g.log_psd_covariance[2 * k] += p.tuning.process_noise_walk**2 * transition.interval


@kernel
def bound_sensitivity(c: Core) -> None:
    """D <- at most P, abs(e) <- at most one sigma, of each state, by a congruence.

    P is a concave function of the noises, homogeneous of degree 1, so its derivative by the logarithm of one of them is
    at most P. The recursions leave the other states out, with whose gains alone they would not be stable.
    """
    n = LEARNING_STATES
    for k in range(2):
        D, e = c.process_noise.covariance_sensitivity[k], c.process_noise.estimate_sensitivity[k]
        for i in range(n):
            most, at = max(variance(c, i), 0.0), packed_index(n, i, i)
            e[i] = min(max(e[i], -math.sqrt(most)), math.sqrt(most))
            if D[at] > most:
                share = math.sqrt(most / D[at])
                for j in range(n):
                    D[packed_index(n, min(i, j), max(i, j))] *= share
                D[at] = most


@kernel
def predict_sensitivity(c: Core, k: int, length: int) -> tuple[float, float]:
    """h D h' and h e of noise k for the Jacobian, of that length; stores D h in scratch.learning_d."""
    scratch, n, he = c.scratch, 0, 0.0
    for i in range(length):
        column, value = scratch.columns[i], scratch.values[i]
        if column < LEARNING_STATES:
            scratch.learning_columns[n], scratch.learning_values[n] = column, value
            he += value * c.process_noise.estimate_sensitivity[k, column]
            n += 1
    D = c.process_noise.covariance_sensitivity[k]
    return measure(D, LEARNING_STATES, scratch.learning_columns, scratch.learning_values, n, scratch.learning_d), he


@kernel
def add_information(V: Reals, a: float, b: float) -> None:
    """V <- (V^-1 + u u')^-1 with u = (a, b); V: elements (0, 0), (0, 1), (1, 1)."""
    x, y = V[0] * a + V[1] * b, V[1] * a + V[2] * b
    s = 1.0 + a * x + b * y
    V[0] -= x * x / s
    V[1] -= x * y / s
    V[2] -= y * y / s


@kernel
def set_psd(p: Parameters, c: Core) -> None:
    """Bound the logarithms and store what they are of."""
    g, t = c.process_noise, p.tuning
    for k in range(2):
        least, most, scale = t.min_velocity_noise, t.max_velocity_noise, t.velocity_noise_scale
        if k == 1:
            least, most, scale = t.min_attitude_noise, t.max_attitude_noise, t.attitude_noise_scale
        q = min(max(elementary.exp(g.log_psd[k]) - scale * scale, least * least), most * most)
        g.psd[k] = q
        g.log_psd[k] = elementary.log(q + scale * scale)


@kernel
def learn_process_noise(p: Parameters, c: Core, length: int, z: float, s: float) -> None:
    """Learn from an innovation z of variance s, before its update or without one; `length`: of the Jacobian."""
    bound_sensitivity(c)
    V, most, root = c.process_noise.log_psd_covariance, math.sqrt(p.tuning.max_learned_nis * s), math.sqrt(s)
    hDh_velocity, he_velocity = predict_sensitivity(c, 0, length)
    hDh_attitude, he_attitude = predict_sensitivity(c, 1, length)
    z = min(max(z, -most), most)
    excess = 0.5 * (z * z / s - 1.0) / s
    add_information(V, math.sqrt(0.5) * hDh_velocity / s, math.sqrt(0.5) * hDh_attitude / s)
    add_information(V, he_velocity / root, he_attitude / root)
    by_velocity, by_attitude = hDh_velocity * excess + z * he_velocity / s, hDh_attitude * excess + z * he_attitude / s
    c.process_noise.log_psd[0] += V[0] * by_velocity + V[1] * by_attitude
    c.process_noise.log_psd[1] += V[1] * by_velocity + V[2] * by_attitude
    set_psd(p, c)


@kernel
def update_learning(c: Core, length: int, z: float, s: float) -> None:
    """D and e after the scalar update that follows; arguments as those of `fuse`."""
    gains, Dh = c.scratch.gain, c.scratch.learning_d
    for k in range(2):
        D, e, at = c.process_noise.covariance_sensitivity[k], c.process_noise.estimate_sensitivity[k], 0
        hDh, he = predict_sensitivity(c, k, length)
        for i in range(LEARNING_STATES):
            gain = gains[i]
            e[i] += (Dh[i] - gain * hDh) * z / s - gain * he
            for j in range(i, LEARNING_STATES):
                other = gains[j]
                D[at] += gain * other * hDh - gain * Dh[j] - Dh[i] * other
                at += 1
