"""How the errors grow between measurements: the covariance is propagated over what has gathered since the last time.

p' = v; v' = phi x f - C ba; phi' = -C (bg + s w_down); biases and mounting walk; the GNSS wander is Gauss-Markov.
Left out, being below a hundredth of what a MEMS sensor adds in minutes: Coriolis and frame rotation of the errors,
the change of gravity and of transport rate with them. Scale factors and misalignments have states (s) for turns about
the vertical only; else they act as noise that grows with the rate and with the force beyond gravity.

Source: Groves, Principles of GNSS, Inertial and Multisensor Integrated Navigation (2013), sec. 14.2.
"""

import math
from typing import Any

from ...kernels.earth import STANDARD_GRAVITY
from ...kernels.jit import kernel
from ...kernels.kalman import packed_index, reset, scale, shear, shear3
from ...kernels.rotation import dcm_of_quat, quat_rotate_back
from ..records import AT_REST
from .alignment.integrals import accumulate_integrals
from .integrity.gnss_drift import propagate_sensitivity
from .mechanization import rotate_attitude
from .state import (
    ACCEL_BIAS,
    ATTITUDE,
    COARSE_ALIGNMENT,
    GNSS_BIAS,
    GYRO_BIAS,
    MOUNT_PITCH,
    MOUNT_YAW,
    NHC_LEVER_ARM,
    POSITION,
    STATES,
    TURN_SCALE,
    VELOCITY,
)

COVARIANCE_INTERVAL_S = 0.0195  # the covariance follows at about 50 Hz
GNSS_BIAS_TIME_S = 40.0  # time constant of the GNSS position error (four real receivers: 20 to 60 s)
ACCEL_SCALE_TIME_S, GYRO_SCALE_TIME_S = 0.2, 0.05  # how long a scale-factor error acts in one direction
VIBRATION_VRW = 0.011  # (m/s)/sqrt(s), of an accelerometer on a vehicle under way, beyond its own
VIBRATION_BIAS_WALK = 2e-3  # (m/s^2)/sqrt(s), vibration rectified into bias
MOUNT_PSD = math.radians(0.02) ** 2  # rad^2/s, load and suspension
NHC_LEVER_ARM_PSD = 0.01**2  # m^2/s, where a vehicle turns about depends on load and ground
SECOND_ORDER_TIME_S = 1.0  # how long such an error of acceleration lasts
MIN_TURN_RAD = 1e-3  # rad
NONLINEAR_SCALE_SHARE = (
    0.5  # share of a gyro error in turns about the vertical that its states, constant factors, do not explain
)
MISALIGNMENT_OVER_SCALE = 0.35  # misalignment over scale factor (M-G350 sheet: 0.1 deg and 0.5 %)
TURN_SCALE_PSD = 5e-5**2  # 1/s, with temperature
ALIGNMENT_ACCEL, ALIGNMENT_ACCEL_TIME_S = (
    0.3,
    1.0,
)  # m/s^2, s: what is not felt of an acceleration in unknown direction; its time


@kernel
def variance(c: Any, i: int) -> float:
    """P[i, i]."""
    return float(c.cov.P[packed_index(STATES, i, i)])


@kernel
def standard_deviation(c: Any, i: int) -> float:
    """Square root of P[i, i]."""
    return math.sqrt(max(variance(c, i), 0.0))


@kernel
def add_variance(c: Any, i: int, q: float) -> None:
    """P[i, i] += q."""
    c.cov.P[packed_index(STATES, i, i)] += q


@kernel
def couple_velocity(c: Any, dt: float) -> None:
    """Velocity errors from attitude and accelerometer bias, over `dt`."""
    m = dcm_of_quat((c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3]))
    fx, fy, fz = c.imu.delta_v[0], c.imu.delta_v[1], c.imu.delta_v[2]
    if c.nav.flags & AT_REST:  # known better than felt: no false knowledge of the heading from noise in fx, fy
        fx, fy, fz = 0.0, 0.0, -STANDARD_GRAVITY * dt
    shear3(c.cov.P, STATES, VELOCITY, ATTITUDE, 0.0, fz, -fy)
    shear3(c.cov.P, STATES, VELOCITY + 1, ATTITUDE, -fz, 0.0, fx)
    shear3(c.cov.P, STATES, VELOCITY + 2, ATTITUDE, fy, -fx, 0.0)
    for i in range(3):
        k = 3 * i
        shear3(c.cov.P, STATES, VELOCITY + i, ACCEL_BIAS, -m[k] * dt, -m[k + 1] * dt, -m[k + 2] * dt)


@kernel
def second_order_psd(c: Any, accel2: float) -> float:
    """Velocity noise, m^2/s^3, for what a linear model of an uncertain heading leaves out of the acceleration.

    The acceleration itself is shortened by half the square of the heading's error, and that of a wrong tilt or bias
    points elsewhere by the heading's error.
    """
    heading2 = variance(c, ATTITUDE + 2)
    tilt2 = 0.5 * (variance(c, ATTITUDE) + variance(c, ATTITUDE + 1))
    return float((0.5 * heading2 * accel2 + STANDARD_GRAVITY**2 * tilt2) * heading2 * SECOND_ORDER_TIME_S)


@kernel
def reset_turn_scale(p: Any, c: Any) -> None:
    """Nothing is known of what turns show: along the vertical a scale factor, across it axes out of line."""
    down = quat_rotate_back((c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3]), (0.0, 0.0, 1.0))
    along, across = p.gyro_scale**2, (MISALIGNMENT_OVER_SCALE * p.gyro_scale) ** 2
    for i in range(3):
        reset(c.cov.P, STATES, TURN_SCALE + i, across)
    for i in range(3):
        for k in range(i, 3):
            c.cov.P[packed_index(STATES, TURN_SCALE + i, TURN_SCALE + k)] += (along - across) * down[i] * down[k]


@kernel
def apply_turn_scale(c: Any, m: Any) -> float:
    """Turn back by what the gyro has shown too much of a turn, once that is notable; returns the angle of the turn.

    What the body turned through, not a smoothed rate times the time: a wrong axis shows as a tilt and an accelerometer
    bias, both fixed in the body, and nothing tells the three apart unless the turn lags behind the body.
    """
    angle: float = c.imu.deferred_rotation
    if abs(angle) < MIN_TURN_RAD:
        return 0.0
    a, b, d = c.nav.turn_scale[0] * angle, c.nav.turn_scale[1] * angle, c.nav.turn_scale[2] * angle
    rotate_attitude(
        c, -m[0] * a - m[1] * b - m[2] * d, -m[3] * a - m[4] * b - m[5] * d, -m[6] * a - m[7] * b - m[8] * d
    )
    for i in range(3):
        k = 3 * i
        shear3(c.cov.P, STATES, ATTITUDE + i, TURN_SCALE, -m[k] * angle, -m[k + 1] * angle, -m[k + 2] * angle)
    c.imu.deferred_rotation = 0.0
    return angle


@kernel
def propagate_covariance(p: Any, c: Any) -> None:
    """Propagate P over the gathered interval and start a new one."""
    dt = c.imu.integration_time
    if dt <= 0.0:
        return
    for i in range(3):
        shear(c.cov.P, STATES, POSITION + i, VELOCITY + i, dt)
    accel2 = c.imu.accel_n[0] ** 2 + c.imu.accel_n[1] ** 2 + c.imu.accel_n[2] ** 2
    qv = (
        p.accel_psd
        + VIBRATION_VRW**2 * c.stationarity.vibration_level
        + c.stationarity.vibration_accel_psd
        + p.accel_scale**2 * accel2 * ACCEL_SCALE_TIME_S
    )
    if c.alignment.mode == COARSE_ALIGNMENT:
        qv = (ALIGNMENT_ACCEL**2 + accel2) * ALIGNMENT_ACCEL_TIME_S if not c.nav.flags & AT_REST else 0.0
    else:
        qv += second_order_psd(c, accel2)
        couple_velocity(c, dt)
    m = dcm_of_quat((c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3]))
    for i in range(3):
        k = 3 * i
        shear3(c.cov.P, STATES, ATTITUDE + i, GYRO_BIAS, -m[k] * dt, -m[k + 1] * dt, -m[k + 2] * dt)
    angle = m[6] * c.imu.delta_theta[0] + m[7] * c.imu.delta_theta[1] + m[8] * c.imu.delta_theta[2]
    accumulate_integrals(c, angle, dt)
    c.imu.deferred_rotation += angle
    angle = apply_turn_scale(c, m)
    turn = m[6] * c.imu.rate_b[0] + m[7] * c.imu.rate_b[1] + m[8] * c.imu.rate_b[2]
    rate2 = (
        c.imu.rate_b[0] ** 2 + c.imu.rate_b[1] ** 2 + c.imu.rate_b[2] ** 2 - (1.0 - NONLINEAR_SCALE_SHARE) * turn * turn
    )
    gyro_psd = max(
        p.gyro_psd, c.stationarity.gyro_noise_floor * c.stationarity.gyro_noise_floor * p.period / 3.0
    )  # its quietest is all noise
    qa = gyro_psd + c.stationarity.vibration_gyro_psd + p.gyro_scale**2 * rate2 * GYRO_SCALE_TIME_S
    decay = math.exp(-dt / GNSS_BIAS_TIME_S)
    propagate_sensitivity(c, m, angle, dt, decay)
    for i in range(3):
        scale(c.cov.P, STATES, GNSS_BIAS + i, decay)
        c.gnss.bias[i] *= decay
        c.integrity.position_inflation[i] *= decay * decay
        sigma = c.gnss.bias_sigma[0] if i < 2 else c.gnss.bias_sigma[1]
        add_variance(c, GNSS_BIAS + i, sigma * sigma * (1.0 - decay * decay))
        add_variance(c, VELOCITY + i, qv * dt)
        add_variance(c, ATTITUDE + i, qa * dt)
        add_variance(c, GYRO_BIAS + i, p.gyro_bias_psd * dt)
        add_variance(
            c, ACCEL_BIAS + i, (p.accel_bias_psd + VIBRATION_BIAS_WALK**2 * c.stationarity.vibration_level) * dt
        )
        add_variance(c, TURN_SCALE + i, TURN_SCALE_PSD * dt)
        c.imu.scale_error_rate[i] = c.nav.turn_scale[i] * turn
        c.imu.delta_v[i] = c.imu.delta_theta[i] = 0.0
    add_variance(c, MOUNT_PITCH, MOUNT_PSD * dt)
    add_variance(c, MOUNT_YAW, MOUNT_PSD * dt)
    add_variance(c, NHC_LEVER_ARM, NHC_LEVER_ARM_PSD * dt)
    c.imu.integration_time = 0.0
