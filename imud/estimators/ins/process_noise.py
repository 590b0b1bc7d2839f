"""The process noise of velocity and attitude, learned on each drive: vibration adds to what the data sheet states.

The size of the innovations, against the variance that the filter expects, depends on the process noise and on the
receiver's noise; the correlation of successive innovations separates the two. The likelihood of the innovations has
both. Its derivative by the logarithm of a process noise needs two more recursions, in the steps of the Kalman filter's
own: D = dC and e = d(estimate), of position, velocity and attitude,

    C <- T C T' + Q                          (T: the transition matrix, Q: the process noise)
    D <- T D T' + dQ                         e <- T e
    C <- C - K h C                           K = C h' / s'
    D <- (I - K h) D (I - K h)'              e <- e - K h e + (D h' - K h D h') z / s'

D and e for each of the two noises. Each innovation z of variance s adds to the derivatives, and to their Fisher
information,

    score = 1/2 (h D h' / s) (z^2 / s - 1) + z h e / s
    information = 1/2 (h D h' / s) (h D h' / s)' + (h e) (h e)' / s      of the vectors of both

C, the covariance of a filter of these nine states alone, is what makes D and e stable: with the nine rows of the gain
of all states they are not, where a position shares its error with the receiver's bias, the time offset or the lever
arm. To that filter all other errors are noise of the measurement: s' = max(s, h C h' + r), r the noise of it.

A noise of the attitude shows as an error of the velocity that grows, and returns after a fix; one of the velocity is
gone after it. The unknown is the logarithm of the noise plus a scale, because below some scale the derivative by a
logarithm vanishes with the noise. Both are random walks with a prior, estimated by a Kalman filter of two states. What
few or poor fixes cannot show stays at the prior. The first values are not those of a smooth car: on any other vehicle
biases and the time offset would be certain, and wrong, before the noise is learned. Where it turns out to be far larger
all the same, they are opened again.

Source: Ljung and Soderstrom, Theory and practice of recursive identification (1983), sec. 3.8: recursive maximum
likelihood; Gupta and Mehra, Computational aspects of maximum likelihood estimation (1974): the sensitivity equations.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from ...math.earth import STANDARD_GRAVITY
from ...math.kalman import packed_index
from ...math.lanes import measure, shear, shear3, subtract_update
from ..tuning import Tunable
from .ekf import add_variance, covariance, exponential
from .glr_tests.compass_offset import is_unconfirmed
from .state import (
    ACCEL_BIAS,
    ATTITUDE,
    LEARNING_STATES,
    POSITION,
    REPORTED_EPOCHS,
    TIME_OFFSET,
    VELOCITY,
    VELOCITY_NOISE,
)
from .time_evidence import forget_time_evidence

if TYPE_CHECKING:
    from ...math.arrays import Floats, Reals
    from .types import Core, Parameters, Transition


TUNABLES = (
    Tunable(
        "vibration_vrw",
        0.035,
        "(m/s)/sqrt(s)",
        "Velocity random walk that vibration adds to an accelerometer's under way; the first value, learned later.",
        "Between a smooth car and a multicopter.",
    ),
    Tunable(
        "vibration_arw",
        math.radians(0.04),
        "rad/sqrt(s)",
        "Angle random walk that vibration adds to a gyro's under way; the first value, learned later.",
        "Between a smooth car and a multicopter.",
    ),
    Tunable(
        "process_noise_prior",
        1.5,
        "",
        "Sigma of the logarithm of a vehicle's process noise before it is learned.",
        "A factor of 400 from a smooth car to a multicopter: four sigmas.",
    ),
    Tunable(
        "known_noise_sigma",
        0.55,
        "",
        "Sigma of the logarithm below which a process noise is known.",
        "Some ten fixes of centimetres.",
    ),
    Tunable(
        "max_first_noise_error",
        2.0,
        "",
        "Logarithm of a known process noise over the first value, above which earlier estimates are opened again.",
        "A factor of 7.",
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
        "unconfirmed_velocity_noise",
        0.3,
        "(m/s)/sqrt(s)",
        "Largest velocity process noise that is learned while motion has not confirmed a given heading.",
        "What a wrong heading does looks like noise; simulated helicopters have more than 0.15.",
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
def set_psd(p: Parameters, c: Core) -> None:
    """Bound the logarithms and store what they are of."""
    g, t = c.process_noise, p.tuning
    for k in range(2):
        least, most, scale = t.min_velocity_noise, t.max_velocity_noise, t.velocity_noise_scale
        if k == 1:
            least, most, scale = t.min_attitude_noise, t.max_attitude_noise, t.attitude_noise_scale
        elif is_unconfirmed(c):
            most = t.unconfirmed_velocity_noise
        q = min(max(elementary.exp(g.log_psd[k]) - scale * scale, least * least), most * most)
        g.log_psd[k] = elementary.log(q + scale * scale)
        g.psd[k] = q


@kernel
def reset_process_noise(p: Parameters, c: Core) -> None:
    """The noise was learned with an attitude that is wrong: as before the first sample."""
    g, t = c.process_noise, p.tuning
    g.log_psd[0] = elementary.log(t.vibration_vrw**2 + t.velocity_noise_scale**2)
    g.log_psd[1] = elementary.log(t.vibration_arw**2 + t.attitude_noise_scale**2)
    g.log_psd_covariance[0] = g.log_psd_covariance[2] = t.process_noise_prior**2
    g.log_psd_covariance[1] = 0.0
    set_psd(p, c)


@kernel
def clear_learning(c: Core) -> None:
    """The estimate is new: the filter of nine states begins with the covariance of it, and no sensitivity is known."""
    g, at = c.process_noise, 0
    g.first_log_psd = g.log_psd[0]
    g.estimate_sensitivity[:] = 0.0
    g.covariances[:] = 0.0
    for i in range(LEARNING_STATES):
        for k in range(i, LEARNING_STATES):
            g.covariances[at, 0] = covariance(c, i, k)
            at += 1


@kernel
def propagate_covariances(c: Core, transition: Transition) -> None:
    """S <- T S T' of C and of both D, with the transition T."""
    S, f, n = c.process_noise.covariances, transition.delta_v, LEARNING_STATES
    for i in range(3):
        shear(S, n, POSITION + i, VELOCITY + i, transition.interval)
    shear3(S, n, VELOCITY, ATTITUDE, 0.0, f[2], -f[1])
    shear3(S, n, VELOCITY + 1, ATTITUDE, -f[2], 0.0, f[0])
    shear3(S, n, VELOCITY + 2, ATTITUDE, f[1], -f[0], 0.0)


@kernel
def propagate_vector(e: Floats, transition: Transition) -> None:
    """e <- T e with the transition T."""
    f = transition.delta_v
    for i in range(3):
        e[POSITION + i] += transition.interval * e[VELOCITY + i]
    north, east, down = e[ATTITUDE], e[ATTITUDE + 1], e[ATTITUDE + 2]
    e[VELOCITY] += f[2] * east - f[1] * down
    e[VELOCITY + 1] += f[0] * down - f[2] * north
    e[VELOCITY + 2] += f[1] * north - f[0] * east


@kernel
def add_noise(c: Core, lane: int, first: int, q: float) -> None:
    """S[i, i] += q of the three states from `first` on, in C or in a D."""
    for i in range(first, first + 3):
        c.process_noise.covariances[packed_index(LEARNING_STATES, i, i), lane] += q


@kernel
def propagate_learning(p: Parameters, c: Core, transition: Transition) -> None:
    """C <- T C T' + Q, D <- T D T' + dQ, e <- T e, and the random walk of the logarithms."""
    g, s, dt = c.process_noise, c.stationarity, transition.interval
    propagate_covariances(c, transition)
    add_noise(c, 0, VELOCITY, transition.velocity_psd * dt)
    add_noise(c, 0, ATTITUDE, transition.attitude_psd * dt)
    for k in range(2):
        level = s.vibration_level if k == VELOCITY_NOISE else s.attitude_noise_level
        psd_derivative = exponential(c, 2 + k, g.log_psd[k]) * level  # of q by log_psd
        propagate_vector(g.estimate_sensitivity[k], transition)
        add_noise(c, 1 + k, VELOCITY if k == 0 else ATTITUDE, psd_derivative * dt)
        if psd_derivative > 0.0 and g.log_psd_covariance[2 * k] < p.tuning.process_noise_prior**2:
            g.log_psd_covariance[2 * k] += p.tuning.process_noise_walk**2 * dt


@kernel
def restrict_jacobian(c: Core, length: int) -> int:
    """Store the elements of the Jacobian, of that length, that are of the nine states; returns how many they are."""
    scratch, n = c.scratch, 0
    for i in range(length):
        column = scratch.columns[i]
        if column < LEARNING_STATES:
            scratch.learning_columns[n], scratch.learning_values[n] = column, scratch.values[i]
            n += 1
    return n


@kernel
def predict_sensitivity(c: Core, k: int, n: int) -> float:
    """h e of noise k for the n elements of `restrict_jacobian`."""
    scratch, he = c.scratch, 0.0
    for i in range(n):
        he += scratch.learning_values[i] * c.process_noise.estimate_sensitivity[k, scratch.learning_columns[i]]
    return he


@kernel
def measure_learning(c: Core, length: int) -> int:
    """scratch.learning_d <- S h and h S h' of C and of both D; arguments and result as those of `restrict_jacobian`."""
    n, scratch = restrict_jacobian(c, length), c.scratch
    columns, values = scratch.learning_columns, scratch.learning_values
    measure(c.process_noise.covariances, LEARNING_STATES, columns, values, n, scratch.learning_d)
    return n


@kernel
def add_information(V: Reals, a: float, b: float) -> None:
    """V <- (V^-1 + u u')^-1 with u = (a, b); V: elements (0, 0), (0, 1), (1, 1)."""
    x, y = V[0] * a + V[1] * b, V[1] * a + V[2] * b
    s = 1.0 + a * x + b * y
    V[0] -= x * x / s
    V[1] -= x * y / s
    V[2] -= y * y / s


@kernel
def learn_process_noise(p: Parameters, c: Core, length: int, z: float, s: float) -> None:
    """Learn from an innovation z of variance s, before its update or without one; `length`: of the Jacobian."""
    V, most, root = c.process_noise.log_psd_covariance, math.sqrt(p.tuning.max_learned_nis * s), math.sqrt(s)
    n, hSh = measure_learning(c, length), c.scratch.learning_d[LEARNING_STATES]
    hDh_velocity, he_velocity = hSh[1], predict_sensitivity(c, 0, n)
    hDh_attitude, he_attitude = hSh[2], predict_sensitivity(c, 1, n)
    z = min(max(z, -most), most)
    excess = 0.5 * (z * z / s - 1.0) / s
    add_information(V, math.sqrt(0.5) * hDh_velocity / s, math.sqrt(0.5) * hDh_attitude / s)
    add_information(V, he_velocity / root, he_attitude / root)
    by_velocity, by_attitude = hDh_velocity * excess + z * he_velocity / s, hDh_attitude * excess + z * he_attitude / s
    c.process_noise.log_psd[0] += V[0] * by_velocity + V[1] * by_attitude
    c.process_noise.log_psd[1] += V[1] * by_velocity + V[2] * by_attitude
    set_psd(p, c)


@kernel
def was_too_small(p: Parameters, c: Core) -> bool:
    """Whether the velocity's noise has just become known, and is far larger than the first value."""
    g = c.process_noise
    if g.log_psd_covariance[0] > p.tuning.known_noise_sigma**2:
        return False
    first = g.first_log_psd
    g.first_log_psd = math.inf
    return bool(g.log_psd[0] > first + p.tuning.max_first_noise_error)


@kernel
def inflate_earlier_estimates(p: Parameters, c: Core) -> None:
    """After a fix: once the noise is known to be far larger than it was taken to be, open what was estimated meanwhile.

    With a noise that is too small innovations are taken for errors of the accelerometer and of the time offset, which
    are then certain and wrong, and do not change any more. Not so the gyros' biases, which a rest has measured: of 128
    simulated runs without a rest the attitude's noise turned out far larger in one.
    """
    if was_too_small(p, c):
        tilt = p.accel_bias_sigma / STANDARD_GRAVITY
        for i in range(3):
            add_variance(c, ACCEL_BIAS + i, p.accel_bias_sigma**2)
            add_variance(c, ATTITUDE + i, tilt * tilt)
        if c.integrity.epochs == REPORTED_EPOCHS:
            add_variance(c, TIME_OFFSET, p.tuning.reported_epoch_sigma**2)
        forget_time_evidence(c)


@kernel
def update_learning(c: Core, length: int, z: float, s: float) -> None:
    """C, D and e after the scalar update that follows; arguments as those of `fuse`."""
    g, scratch, n, r = c.process_noise, c.scratch, measure_learning(c, length), s
    if n == 0:
        return
    for i in range(length):
        r -= scratch.values[i] * scratch.d[scratch.columns[i]]
    gain, d, hSh = scratch.learning_gain, scratch.learning_d, scratch.learning_d[LEARNING_STATES]
    s = max(s, hSh[0] + r)
    share = z / s
    for i in range(LEARNING_STATES):
        gain[i, 0] = gain[i, 1] = gain[i, 2] = gain[i, 3] = d[i, 0] / s
    for k in range(2):
        e, he = g.estimate_sensitivity[k], predict_sensitivity(c, k, n)
        for i in range(LEARNING_STATES):
            e[i] += (d[i, 1 + k] - gain[i, 0] * hSh[1 + k]) * share - gain[i, 0] * he
    for i in range(LEARNING_STATES):
        d[i, 0] = 0.0
    hSh[0] = -s
    subtract_update(g.covariances, LEARNING_STATES, gain, d, hSh)
