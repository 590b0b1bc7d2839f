"""The error model: how the errors of the nominal state propagate (F), and how P follows, with process noise (Q).

Errors are true minus estimated values (Groves' are the other way round). phi is the attitude error, a small rotation in
navigation axes; f is the specific force in body axes, C turns it into navigation axes.

    p' = v
    v' = phi x C f - C ba
    phi' = -C (bg + gyro_scale w)
    bg', ba', gyro_scale', mount_yaw', mount_pitch', nhc_lever_arm', odometer_scale', baro_offset' = noise
    gnss_bias' = -gnss_bias / T + noise, gnss_velocity_bias' likewise
    time_offset' = noise, where positions are of centimetres, else 0
    velocity_time_offset' = 0; the variances of both have a floor (`gnss_noise`)

Omitted, being below a hundredth of the errors that a MEMS sensor causes in minutes: Coriolis and frame rotation of the
errors, and the change of gravity and of transport rate with them. Scale factors and misalignments of the gyros are
gyro_scale; what changes with the rate beyond them, and those of the accelerometers, are noise that grows with it.

`linearize` evaluates the blocks of the transition matrix, I + F over the interval; `propagate_covariance` applies it to
P and adds Q (`noise_density`; the odometer's and the barometer's are in their files); `apply_transition` applies it to
error states.

Source: Groves (2013), sec. 14.2.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ...compile.jit import kernel, unrolled
from ...math.earth import STANDARD_GRAVITY
from ...math.kalman import scale3, shear, shear33
from ...math.rotation import Vector
from ..tuning import Tunable
from .ekf import add_variance, decorrelate, exponential
from .mechanization import rotate_attitude, rotation_matrix
from .noise_density import accelerometer_psd, attitude_psd, velocity_psd
from .state import (
    ACCEL_BIAS,
    ATTITUDE,
    COARSE_ALIGNMENT,
    GNSS_BIAS,
    GNSS_VELOCITY_BIAS,
    GYRO_BIAS,
    GYRO_SCALE,
    HORIZONTAL,
    MOUNT_PITCH,
    MOUNT_YAW,
    NHC_LEVER_ARM,
    POSITION,
    REPORTED_EPOCHS,
    STATES,
    TIME_OFFSET,
    VELOCITY,
    VERTICAL,
)

if TYPE_CHECKING:
    from ...math.arrays import Reals, Tensor
    from .types import Core, Parameters, Transition


TUNABLES = (
    Tunable("covariance_interval_s", 0.0195, "s", "Interval in which the covariance is propagated.", "About 50 Hz."),
    Tunable(
        "gnss_bias_time_s", 40.0, "s", "Time constant of the GNSS position error.", "Four real receivers: 20 to 60 s."
    ),
    Tunable(
        "gnss_velocity_bias_sigma",
        0.05,
        "m/s",
        "Sigma of the correlated error of a GNSS velocity, north and east.",
        "Two real receivers in flight: means over a minute.",
    ),
    Tunable(
        "gnss_velocity_bias_time_s",
        100.0,
        "s",
        "Time constant of the correlated error of a GNSS velocity.",
        "The same receivers.",
    ),
    Tunable(
        "vibration_bias_walk",
        2e-3,
        "(m/s^2)/sqrt(s)",
        "Random walk of the accelerometer bias by rectified vibration.",
        "Recorded drives.",
    ),
    Tunable(
        "mount_psd",
        math.radians(0.02) ** 2,
        "rad^2/s",
        "Random walk of the forward axis by load and suspension.",
        "0.02 deg in a second, 1.2 deg in an hour.",
    ),
    Tunable(
        "nhc_lever_arm_psd",
        0.01**2,
        "m^2/s",
        "Random walk of the point about which a vehicle turns.",
        "1 cm in a second, 0.6 m in an hour.",
    ),
    Tunable(
        "min_scaled_turn",
        1e-3,
        "rad",
        "Least rotation that is corrected for scale factors and misalignments.",
        "Numerics.",
    ),
    Tunable(
        "time_offset_psd",
        0.001**2,
        "s",
        "Random walk of the time offset, with positions of centimetres; the floor of coarser ones is above it.",
        "1 ms in a second: simulated clocks that run apart by up to 5 ms/s.",
    ),
    Tunable(
        "level_force_time_s",
        1.0,
        "s",
        "Time constant of the average by which a level force is distinguished from noise.",
        "A manoeuvre of a multicopter.",
    ),
    Tunable(
        "level_force_gate",
        2.0,
        "",
        "Mean squares of noise that are no force.",
        "Noise alone exceeds two in a seventh of the time, by little.",
    ),
    Tunable("gyro_scale_psd", 5e-5**2, "1/s", "Random walk of gyro_scale, with temperature.", "0.3 % in an hour."),
)


@kernel
def known_force_share(p: Parameters, c: Core) -> float:
    """Share of the level specific force that is no noise: 1 less the noise's square over that of the averaged force.

    A heading shows in the direction in which a level force changes the velocity. Noise changes the estimated velocity,
    too, in the direction of the estimated heading: taken for a force, it confirms any heading, and makes it falsely
    observable (errors in variables). That is most of what a multicopter measures while it hovers.
    """
    dt, mean = c.imu.integration_time, c.imu.level_force
    gain = min(dt / p.tuning.level_force_time_s, 1.0)
    for i in range(2):
        mean[i] += gain * (c.imu.delta_v[i] / dt - mean[i])
    mean_square = accelerometer_psd(p, c) / p.tuning.level_force_time_s  # of the noise, both axes
    square, noise = mean[0] ** 2 + mean[1] ** 2, p.tuning.level_force_gate * mean_square
    return 1.0 - noise / square if square > noise else 0.0


@kernel
def linearize(p: Parameters, c: Core, transition: Transition) -> None:
    """transition <- F over the interval since P was propagated, at the attitude now; see core.TRANSITION."""
    C_nb, dt = rotation_matrix(c), c.imu.integration_time
    share = known_force_share(p, c)
    fx, fy, fz = share * c.imu.delta_v[0], share * c.imu.delta_v[1], c.imu.delta_v[2]
    if c.stationarity.at_rest:  # gravity is known exactly
        fx, fy, fz = 0.0, 0.0, -STANDARD_GRAVITY * dt
    transition.interval = dt
    transition.delta_v[0], transition.delta_v[1], transition.delta_v[2] = fx, fy, fz
    for k in range(9):
        transition.C_nb[k] = C_nb[k]
    transition.turn_angle = (
        C_nb[6] * c.imu.delta_theta[0] + C_nb[7] * c.imu.delta_theta[1] + C_nb[8] * c.imu.delta_theta[2]
    )
    transition.gnss_bias_decay = exponential(c, 0, -dt / p.tuning.gnss_bias_time_s)
    transition.gnss_velocity_bias_decay = exponential(c, 1, -dt / p.tuning.gnss_velocity_bias_time_s)


@unrolled
def apply_transition(u: Tensor, columns: int, transition: Transition) -> None:
    """u <- transition u, for `columns` columns of error states (STATES x columns)."""
    C_nb, f, dt = transition.C_nb, transition.delta_v, transition.interval
    for j in range(columns):
        for i in range(3):
            u[POSITION + i, j] += dt * u[VELOCITY + i, j]
        x, y, z = u[ATTITUDE, j], u[ATTITUDE + 1, j], u[ATTITUDE + 2, j]
        u[VELOCITY, j] += f[2] * y - f[1] * z
        u[VELOCITY + 1, j] += f[0] * z - f[2] * x
        u[VELOCITY + 2, j] += f[1] * x - f[0] * y
        for k in range(3):
            turn_error = dt * u[GYRO_BIAS + k, j]
            for n in range(3):
                turn_error += transition.scaled_angle[n] * u[GYRO_SCALE + 3 * n + k, j]
            for i in range(3):
                u[VELOCITY + i, j] -= C_nb[3 * i + k] * dt * u[ACCEL_BIAS + k, j]
                u[ATTITUDE + i, j] -= C_nb[3 * i + k] * turn_error
        for i in range(3):
            u[GNSS_BIAS + i, j] *= transition.gnss_bias_decay
            u[GNSS_VELOCITY_BIAS + i, j] *= transition.gnss_velocity_bias_decay


@kernel
def reset_gyro_scale(p: Parameters, c: Core) -> None:
    """Make gyro_scale independent of the other error states, with the sigmas of the profile."""
    for k in range(9):
        sigma = p.gyro_scale if k % 4 == 0 else p.gyro_misalignment
        decorrelate(c, GYRO_SCALE + k, sigma**2)


@kernel
def gyro_scale_error(c: Core, rotation: Vector) -> Vector:
    """What the estimated scale factors and misalignments make of a rotation, or a rate, in body axes."""
    x, y, z = rotation
    k = c.nav.gyro_scale
    return (
        k[0] * x + k[3] * y + k[6] * z,
        k[1] * x + k[4] * y + k[7] * z,
        k[2] * x + k[5] * y + k[8] * z,
    )


@unrolled
def subtract_rotated(c: Core, i: int, j: int, C_nb: Reals, factor: float) -> None:
    """Error states i to i + 2, in navigation axes, lose `factor` times the states j to j + 2, in body axes."""
    a, b, d = -C_nb[0] * factor, -C_nb[1] * factor, -C_nb[2] * factor
    e, f, g = -C_nb[3] * factor, -C_nb[4] * factor, -C_nb[5] * factor
    h, k, m = -C_nb[6] * factor, -C_nb[7] * factor, -C_nb[8] * factor
    shear33(c.cov.P, STATES, i, j, (a, b, d, e, f, g, h, k, m))


@kernel
def apply_gyro_scale(p: Parameters, c: Core, transition: Transition) -> None:
    """Correct the attitude by the gyros' scale factors and misalignments, once the rotation is large enough.

    The rotation is the integral of the rate itself, not of a smoothed one: a wrong axis has the effect of a tilt and of
    an accelerometer bias, all fixed in the body, and a delayed turn would make them falsely distinguishable.
    """
    angle, C_nb = c.imu.deferred_rotation, transition.C_nb
    for j in range(3):
        angle[j] += c.imu.delta_theta[j]
        transition.scaled_angle[j] = 0.0
    if angle[0] ** 2 + angle[1] ** 2 + angle[2] ** 2 < p.tuning.min_scaled_turn**2:
        return
    x, y, z = gyro_scale_error(c, (angle[0], angle[1], angle[2]))
    rotate_attitude(
        c,
        -C_nb[0] * x - C_nb[1] * y - C_nb[2] * z,
        -C_nb[3] * x - C_nb[4] * y - C_nb[5] * z,
        -C_nb[6] * x - C_nb[7] * y - C_nb[8] * z,
    )
    subtract_rotated(c, ATTITUDE, GYRO_SCALE, C_nb, angle[0])
    subtract_rotated(c, ATTITUDE, GYRO_SCALE + 3, C_nb, angle[1])
    subtract_rotated(c, ATTITUDE, GYRO_SCALE + 6, C_nb, angle[2])
    for j in range(3):
        transition.scaled_angle[j] = angle[j]
        angle[j] = 0.0


@kernel
def velocity_bias_sigma(p: Parameters, axis: int) -> float:
    """Sigma, m/s, of the correlated error of a GNSS velocity along an axis."""
    return p.tuning.gnss_velocity_bias_sigma * (p.tuning.vertical_ratio if axis == 2 else 1.0)


@kernel
def propagate_covariance(p: Parameters, c: Core, transition: Transition) -> None:
    """P <- transition P transition' + Q, and the decay of the nominal GNSS biases; transition: from `linearize`.

    Before the heading is known the velocity is the receiver's, to which neither tilt nor accelerometer bias adds.
    """
    P, C_nb, f, dt = c.cov.P, transition.C_nb, transition.delta_v, transition.interval
    for i in range(3):
        shear(P, STATES, POSITION + i, VELOCITY + i, dt)
    qv = velocity_psd(p, c)
    if c.alignment.mode != COARSE_ALIGNMENT:
        shear33(P, STATES, VELOCITY, ATTITUDE, (0.0, f[2], -f[1], -f[2], 0.0, f[0], f[1], -f[0], 0.0))
        subtract_rotated(c, VELOCITY, ACCEL_BIAS, C_nb, dt)
    subtract_rotated(c, ATTITUDE, GYRO_BIAS, C_nb, dt)
    apply_gyro_scale(p, c, transition)
    turn_rate = C_nb[6] * c.imu.rate_b[0] + C_nb[7] * c.imu.rate_b[1] + C_nb[8] * c.imu.rate_b[2]
    qa, decay = attitude_psd(p, c, turn_rate), transition.gnss_bias_decay
    transition.velocity_psd, transition.attitude_psd = qv, qa
    velocity_decay = transition.gnss_velocity_bias_decay
    scale3(P, STATES, GNSS_BIAS, decay)
    scale3(P, STATES, GNSS_VELOCITY_BIAS, velocity_decay)
    for i in range(3):
        c.nav.gnss_bias[i] *= decay
        c.nav.gnss_velocity_bias[i] *= velocity_decay
        sigma, velocity_sigma = c.gnss.bias_sigma[HORIZONTAL if i < 2 else VERTICAL], velocity_bias_sigma(p, i)
        add_variance(c, GNSS_BIAS + i, sigma * sigma * (1.0 - decay * decay))
        add_variance(
            c, GNSS_VELOCITY_BIAS + i, velocity_sigma * velocity_sigma * (1.0 - velocity_decay * velocity_decay)
        )
        add_variance(c, VELOCITY + i, qv * dt)
        add_variance(c, ATTITUDE + i, qa * dt)
        add_variance(c, GYRO_BIAS + i, p.gyro_bias_psd * dt)
        add_variance(
            c,
            ACCEL_BIAS + i,
            (p.accel_bias_psd + p.tuning.vibration_bias_walk**2 * c.stationarity.vibration_level) * dt,
        )
    rate, scale_error = c.imu.rate_b, c.imu.scale_error_rate
    scale_error[0], scale_error[1], scale_error[2] = gyro_scale_error(c, (rate[0], rate[1], rate[2]))
    for k in range(9):
        add_variance(c, GYRO_SCALE + k, p.tuning.gyro_scale_psd * dt)
    if c.integrity.epochs == REPORTED_EPOCHS and 0.0 < c.gnss.reported_sigma[HORIZONTAL] < p.tuning.survey_sigma:
        add_variance(c, TIME_OFFSET, p.tuning.time_offset_psd * dt)
    add_variance(c, MOUNT_PITCH, p.tuning.mount_psd * dt)
    add_variance(c, MOUNT_YAW, p.tuning.mount_psd * dt)
    add_variance(c, NHC_LEVER_ARM, p.tuning.nhc_lever_arm_psd * dt)
