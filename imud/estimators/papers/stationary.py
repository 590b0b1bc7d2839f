"""Farrell's Kalman filter of a stationary accelerometer: position, velocity and bias, one such filter per body axis.

Source: Farrell, Simple Kalman Filter: Design Example; equation numbers are his. His position is measured once per
second: at rest it is known, so the measurement is 0 with R = (1e-5 m)^2, the table's vibration. On a moving body the
filter is therefore wrong by design, and says so: REJECTING instead of AT_REST while a residual exceeds GATE sigma.

What is built instead of the print:
- (11), (14) integrate `u - b`; by the model (3), u = a - b - n, and Problem 1 the acceleration is `u + b`;
- (12), (15) hold b constant; the mean follows the same Phi as the covariance, b <- exp(-lambda T) b;
- (13), (14) are Euler's method with u_k after t_k; here a sample stands for the interval that ends with it, as of a
  sensor that filters; over that u is constant and the integral exact, so mean and Phi agree;
- lambda = 0.001 Hz is, in (4) and by the printed Phi, 0.001 1/s;
- sigma_b = 8 mg is 7.845e-2 m/s^2, not 7.2e-2; the data sheet's VRW is in (m/s)/sqrt(h), not (m/s)/sqrt(Hz);
- P = (I - KH) P is symmetric only on paper; here it is the packed triangle of `math.kalman`.

The three axes have the same parameters and therefore one covariance, which turning the axes does not change. `ba` of a
solution is -b. Position needs an origin: the user's, or the first fix; further fixes say nothing that the filter does
not claim to know.

Tilt is the user's, and then taken for exact, or that of the first sample, and then fixed. At rest nothing
distinguishes a level bias from a tilt: with states for the tilt, whose error is constant, what is estimated is their
sum b + g x tilt, which begins at the first sample's noise; the tilt keeps the variance (sigma_b^2 + sigma_n^2) / g^2,
and b that of the sum plus sigma_b^2 + sigma_n^2 in each direction across gravity. So these states need not be carried:
the filter's b is the sum, and the sigmas of `ba` have the tilt's part.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from imud.drivers import elementary
from imud.drivers.sample import NO_FORCE, SUSPECT

from ...compile.jit import interpreted, kernel
from ...configuration.settings import Initial, Settings
from ...math.arrays import Records
from ...math.earth import MIN_COS, STANDARD_GRAVITY, displaced, gravity
from ...math.kalman import measure, scale, shear, update
from ...math.rotation import UNKNOWN_ANGLE, euler_of_quat, quat_of_euler, quat_of_gravity, quat_rotate, quat_rotate_back
from ...sensor_errors.profiles import profile_of
from .. import Estimator
from ..blank_solution import blank
from ..pending_innovations import move_innovations, store_innovation
from ..records import (
    AT_REST,
    ATTITUDE_VALID,
    HEIGHT_VALID,
    PENDING_INNOVATIONS,
    POSITION_VALID,
    REJECTING,
    REST_POSITION_X,
    REST_POSITION_Y,
    REST_POSITION_Z,
)

if TYPE_CHECKING:
    from ...math.arrays import Floats, Reals
    from ..types import Fix, Innovation, Sample, Solution
    from .types import StationaryParameters, StationaryState

GATE = 5.0
ORIGIN_SIGMA = 5.0  # m, of an origin whose source does not say
TERMS = 12  # of the series below: the next one is under 1e-16 for lambda T < 1
NODES = ((-0.8611363115940526, 0.3478548451374538), (-0.3399810435848563, 0.6521451548625461))  # Gauss-Legendre, 4
POSITION, VELOCITY, BIAS, STATES = 0, 1, 2, 3

AXES = (REST_POSITION_X, REST_POSITION_Y, REST_POSITION_Z)

PARAMETERS = np.dtype(
    [
        ("bias_rate", "<f8"),  # 1/s, lambda
        ("accel_psd", "<f8"),  # (m/s)^2/s, Q_n
        ("bias_psd", "<f8"),  # (m/s^2)^2/s, Q_omega
        ("bias_var", "<f8"),  # (m/s^2)^2, in P0
        ("position_var", "<f8"),  # m^2, R
        ("interval_ns", "<i8"),
        ("sample_var", "<f8"),  # (m/s^2)^2, white noise of one sample
        ("P0", "<f8", (2,)),  # m^2, (m/s)^2, of position and velocity
        ("initial_bias", "<f8", (3,)),  # m/s^2, b(0)
    ],
    align=True,
)

STATE = np.dtype(
    [
        ("t_ns", "<i8"),
        ("samples", "<i8"),
        ("gravity", "<f8"),  # m/s^2
        ("initial_rpy", "<f8", (3,)),  # rad, roll, pitch, yaw that the user knows; NaN: unknown
        ("q", "<f8", (4,)),
        ("tilt_var", "<f8"),  # (m/s^2)^2, of gravity times the tilt's error
        ("u", "<f8", (3,)),  # m/s^2, newest measured acceleration, body
        ("p", "<f8", (3,)),  # m, body axes, from the origin
        ("v", "<f8", (3,)),
        ("b", "<f8", (3,)),  # m/s^2, his sign
        ("P", "<f8", (6,)),
        ("x", "<f8", (3,)),
        ("d", "<f8", (3,)),
        ("column", "<i8", (1,)),
        ("one", "<f8", (1,)),
        ("measurement_ns", "<i8"),  # when the position was last measured
        ("measurement_count", "<i8"),  # how often
        ("residual", "<f8", (3,)),  # m, the newest r_k
        ("variance", "<f8"),  # m^2, its S_k
        ("rejected", "<i8"),
        ("origin", "<f8", (3,)),  # rad, rad, m; NaN: none
        ("origin_var", "<f8", (3,)),  # m^2
        ("pending", PENDING_INNOVATIONS),
    ],
    align=True,
)


def configure(settings: Settings, rate_hz: float) -> Records:
    """Parameters (PARAMETERS): Q_n and sigma_b from the sensor's profile, the rest from `stationary`'s settings."""
    profile, design = profile_of(settings), settings.stationary
    p = np.zeros(1, PARAMETERS)
    p["bias_rate"], p["bias_psd"] = design.bias_rate, design.bias_psd
    p["accel_psd"], p["bias_var"] = profile.accel_noise**2, profile.accel_bias_initial**2
    p["position_var"], p["interval_ns"] = design.position_var, round(design.interval_s * 1e9)
    p["sample_var"] = profile.accel_noise**2 * rate_hz
    p["P0"] = design.initial_position_sigma_m**2, design.initial_velocity_sigma_mps**2
    p["initial_bias"] = design.initial_bias_mps2
    return p


def start(parameters: Records, initial: Initial) -> Records:
    """A state (STATE) that waits for its first sample: P0 is diagonal (Solution 7)."""
    s = np.zeros(1, STATE)
    angles = (initial.roll_deg, initial.pitch_deg, initial.yaw_deg)
    s["initial_rpy"] = [math.nan if angle is None else math.radians(angle) for angle in angles]
    s["gravity"], s["origin"], s["one"] = STANDARD_GRAVITY, math.nan, 1.0
    if initial.lat_deg is not None:
        s["gravity"] = interpreted(gravity)(math.radians(initial.lat_deg), initial.height_m or 0.0)
        if initial.lon_deg is not None:
            s["origin"] = math.radians(initial.lat_deg), math.radians(initial.lon_deg), initial.height_m or 0.0
            s["origin_var"][0, 2] = math.nan if initial.height_m is None else 0.0
    s["P"][0, [0, 3]], s["P"][0, 5] = parameters["P0"][0], parameters["bias_var"][0]
    s["b"] = parameters["initial_bias"]
    return s


@kernel
def transition(rate: float, T: float) -> tuple[float, float, float]:
    """Phi[0, 2], Phi[1, 2], Phi[2, 2] over T s for lambda = rate, of F in (16); Phi[0, 1] is T, the rest is I.

    They are T^2 phi_2(x), T phi_1(x), exp(-x) with x = lambda T and phi_k(x) = sum of (-x)^j / (j + k)!; the closed
    forms (exp(-x) - 1 + x) / lambda^2 lose all digits at 1 kHz, and are for long gaps.
    """
    x = rate * T
    if x > 1.0:
        return (elementary.exp(-x) - 1.0 + x) / (rate * rate), (1.0 - elementary.exp(-x)) / rate, elementary.exp(-x)
    phi1 = phi2 = 0.0
    term = 1.0
    for j in range(TERMS):
        phi1 += term / (j + 1)
        phi2 += term / ((j + 1) * (j + 2))
        term *= -x / (j + 1)
    return T * T * phi2, T * phi1, elementary.exp(-x)


@kernel
def add_process_noise(p: StationaryParameters, T: float, P: Floats) -> None:
    """P (packed triangle) += Q_d over T s: the integral of Phi(s) G Q G' Phi(s)' by Gauss and Legendre's rule.

    Four nodes are exact to s^7: Q_n's part exactly, Q_omega's to (lambda T)^4 1e-6.
    """
    for node in range(4):
        abscissa, weight = NODES[node % 2]
        s = 0.5 * T * (1.0 + (abscissa if node < 2 else -abscissa))
        w = 0.5 * T * weight
        to_p, to_v, to_b = transition(p.bias_rate, s)
        n, b = w * p.accel_psd, w * p.bias_psd
        P[0] += n * s * s + b * to_p * to_p
        P[1] += n * s + b * to_p * to_v
        P[2] += b * to_p * to_b
        P[3] += n + b * to_v * to_v
        P[4] += b * to_v * to_b
        P[5] += b * to_b * to_b


@kernel
def predict(p: StationaryParameters, s: StationaryState, T: float) -> None:
    """(9), (10)-(12) corrected: mean and covariance over T s with the acceleration u constant."""
    to_p, to_v, to_b = transition(p.bias_rate, T)
    for i in range(3):
        s.p[i] += T * s.v[i] + to_p * s.b[i] + 0.5 * T * T * s.u[i]
        s.v[i] += to_v * s.b[i] + T * s.u[i]
        s.b[i] *= to_b
    shear(s.P, STATES, POSITION, VELOCITY, T)
    shear(s.P, STATES, POSITION, BIAS, to_p)
    shear(s.P, STATES, VELOCITY, BIAS, to_v)
    scale(s.P, STATES, BIAS, to_b)
    add_process_noise(p, T, s.P)


@kernel
def fuse_zero_position(p: StationaryParameters, s: StationaryState) -> None:
    """Solution 7, step 3b: the position is 0. The gain is the same for all axes, and so is P. Nothing is rejected."""
    s.variance = measure(s.P, STATES, s.column, s.one, 1, s.d) + p.position_var
    s.rejected = 0
    for i in range(3):
        r = -s.p[i]
        s.residual[i] = r
        store_innovation(s.pending, s.t_ns, AXES[i], r, s.variance, 1)
        if r * r > GATE * GATE * s.variance:
            s.rejected = 1
        s.p[i] += s.d[POSITION] / s.variance * r
        s.v[i] += s.d[VELOCITY] / s.variance * r
        s.b[i] += s.d[BIAS] / s.variance * r
    update(s.P, STATES, s.x, s.d, s.variance, 0.0)
    s.measurement_count += 1


@kernel
def pending_innovations(s: StationaryState, innovations: list[Innovation]) -> int:
    """Move those of the zero position to `innovations`; returns how many."""
    return move_innovations(s.pending, innovations)


@kernel
def initialise_tilt(p: StationaryParameters, s: StationaryState, f: Reals) -> None:
    """Fix the tilt: the user's, or that of the first force."""
    x, y, z = f[0] + s.b[0], f[1] + s.b[1], f[2] + s.b[2]
    roll, pitch, _ = euler_of_quat(quat_of_gravity(x, y, z if z != 0.0 else -1e-12))
    s.tilt_var = p.bias_var + p.sample_var
    if math.isfinite(s.initial_rpy[0]) and math.isfinite(s.initial_rpy[1]):
        roll, pitch = s.initial_rpy[0], s.initial_rpy[1]
        s.tilt_var = 0.0
    yaw = s.initial_rpy[2] if math.isfinite(s.initial_rpy[2]) else 0.0
    s.q[0], s.q[1], s.q[2], s.q[3] = quat_of_euler(roll, pitch, yaw)


@kernel
def write_solution(p: StationaryParameters, s: StationaryState, sample: Sample, out: Solution) -> None:
    """Write a row of SOLUTION."""
    blank(out, s.t_ns, sample)
    if s.samples == 0:
        return
    q = (s.q[0], s.q[1], s.q[2], s.q[3])
    out.status |= ATTITUDE_VALID | (REJECTING if s.rejected == 1 else AT_REST)
    for i in range(4):
        out.q_nb[i] = s.q[i]
    down = quat_rotate_back(q, (0.0, 0.0, 1.0))
    tilt_sigma = math.sqrt(p.bias_var + p.sample_var) / s.gravity  # also of a given tilt: it is not used for more
    cos_pitch = math.sqrt(down[1] * down[1] + down[2] * down[2])
    out.sigma_rpy[0] = min(tilt_sigma / max(cos_pitch, MIN_COS), UNKNOWN_ANGLE)
    out.sigma_rpy[1] = tilt_sigma
    out.sigma_rpy[2] = UNKNOWN_ANGLE
    for i in range(3):
        out.f[i] = sample.f[i] + s.b[i]
        out.ba[i] = -s.b[i]
        out.sigma_ba[i] = math.sqrt(s.P[5] + s.tilt_var * max(1.0 - down[i] * down[i], 0.0))
    if not math.isfinite(s.origin[0]):
        return
    out.status |= POSITION_VALID
    p_n = quat_rotate(q, (s.p[0], s.p[1], s.p[2]))
    v_n = quat_rotate(q, (s.v[0], s.v[1], s.v[2]))
    out.lat, out.lon = displaced(s.origin[0], s.origin[1], s.origin[2], p_n[0], p_n[1])
    if math.isfinite(s.origin_var[2]):
        out.status |= HEIGHT_VALID
        out.height = s.origin[2] - p_n[2]
    for i in range(3):
        out.v[i] = v_n[i]
        out.sigma_p[i] = math.sqrt(s.P[0] + s.origin_var[i])
        out.sigma_v[i] = math.sqrt(s.P[3])


@kernel
def step(p: StationaryParameters, s: StationaryState, sample: Sample, solution: Solution) -> None:
    """Take one sample (SAMPLE), write one row (SOLUTION). A bad sample repeats the last good one."""
    f = sample.f
    good = sample.flags & (SUSPECT | NO_FORCE) == 0 and math.isfinite(f[0] + f[1] + f[2])
    if s.samples == 0 and good:
        initialise_tilt(p, s, f)
        s.samples = 1
        s.t_ns = s.measurement_ns = sample.t_ns
    elif s.samples > 0 and sample.t_ns > s.t_ns:
        if good:
            weight = quat_rotate_back((s.q[0], s.q[1], s.q[2], s.q[3]), (0.0, 0.0, s.gravity))
            for i in range(3):
                s.u[i] = f[i] + weight[i]
        predict(p, s, (sample.t_ns - s.t_ns) * 1e-9)
        s.t_ns = sample.t_ns
        s.samples += 1
        if s.t_ns - s.measurement_ns >= p.interval_ns:
            s.measurement_ns = s.t_ns
            fuse_zero_position(p, s)
    write_solution(p, s, sample, solution)


@kernel
def set_origin(p: StationaryParameters, s: StationaryState, fix: Fix, innovations: list[Innovation]) -> int:
    """Take the first fix for the place where the sensor rests. No innovation: nothing was predicted."""
    usable = math.isfinite(fix.lat + fix.lon) and fix.quality != 0 and fix.quality != 6
    if usable and not math.isfinite(s.origin[0]):
        s.origin[0], s.origin[1] = fix.lat, fix.lon
        s.origin[2] = fix.height if math.isfinite(fix.height) else 0.0
        for i in range(3):
            s.origin_var[i] = (fix.sigma[i] if math.isfinite(fix.sigma[i]) else ORIGIN_SIGMA) ** 2
        if not math.isfinite(fix.height):
            s.origin_var[2] = math.nan
    return 0


ESTIMATOR = Estimator(
    "stationary", configure, start, step, set_origin, needs_gyros=False, pending_innovations=pending_innovations
)
