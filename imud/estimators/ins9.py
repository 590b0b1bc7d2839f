"""Prasanna's INS filter: position, velocity and acceleration per axis, on distances dead reckoned from the sensor.

Source: Prasanna, Vehicle Localisation Using GPS and IMU (2009), "INS Kalman Filter": acceleration free of gravity is
integrated to velocity and distance; the distances are the measurements of a nine-state filter, Q = 0.7, R = 0.2. The
filter smooths its own dead reckoning and cannot know better than that; the sigmas add what dead reckoning does not
know, from the sensor's noise. His integrated program, which ties the INS to GPS, is the `navigation` estimator.

What is built instead of the print:
- the gain lacks the inverse, and the predicted P is updated: as in `gps_track`;
- acc = macc + 9.8 sin(angle) holds for small angles: gravity is removed with the full rotation, which is the device's
  own tilt where it gives one, else the gyros' from the rest at the start;
- biases: his means at standstill, taken over the first REST_S, which must be at rest: the mean rate is the gyro's
  bias, the mean force is gravity in size and direction;
- G = columns of ones: a discrete Wiener process of the acceleration, [dt^2 / 2, dt, 1] per axis (Bar-Shalom, Li and
  Kirubarajan, sec. 6.3.3), its variance Q per second, so that it does not depend on the sample rate.
Q in (m/s^2)^2/s and R in m^2 are `ins9` in the settings. The axes share one covariance. Position needs an origin: the
user's, or the first fix; without a given yaw the track is turned by an unknown angle, which its sigma includes.
"""

import math
from typing import Any

import numpy as np

from drivers.sample import SUSPECT

from ..kernels.earth import radii
from ..kernels.jit import kernel
from ..kernels.kalman import measure, shear, update
from ..kernels.rotation import (
    euler_of_quat,
    quat_exp,
    quat_normalised,
    quat_of_euler,
    quat_of_gravity,
    quat_product,
    quat_rotate,
)
from ..profiles import PROFILES
from ..settings import Initial, Settings
from . import Estimator, Record
from .records import AT_REST, ATTITUDE_VALID, COASTING, HEADING_VALID, POSITION_VALID
from .unknown import blank

DEFAULT_PROFILE = "consumer-mems"
REST_S = 5.0
ORIGIN_SIGMA = 5.0  # m, of an origin whose source does not say
GIVEN_HEADING, UNIFORM = math.radians(5.0), math.pi / math.sqrt(3.0)
TRUSTED = math.radians(20.0)
DISTANCE, SPEED, ACCELERATION, STATES = 0, 1, 2, 3

PARAMETERS = np.dtype(
    [
        ("acceleration_walk", "<f8"),  # (m/s^2)^2/s, Q
        ("distance_var", "<f8"),  # m^2, R
        ("gyro_psd", "<f8"),  # rad^2/s
        ("accel_psd", "<f8"),  # (m/s)^2/s
        ("accel_bias_var", "<f8"),  # (m/s^2)^2
    ],
    align=True,
)

STATE = np.dtype(
    [
        ("t_ns", "<i8"),
        ("samples", "<i8"),
        ("begin_ns", "<i8"),  # of the first sample
        ("since_s", "<f8"),  # how long the rest at the start was
        ("moving_s", "<f8"),  # since the rest at the start
        ("w_sum", "<f8", (3,)),  # over that rest
        ("f_sum", "<f8", (3,)),
        ("given_yaw", "<f8"),  # rad, NaN: unknown
        ("q", "<f8", (4,)),
        ("bg", "<f8", (3,)),
        ("gravity", "<f8"),
        ("w", "<f8", (3,)),  # the newest good sample
        ("f", "<f8", (3,)),
        ("turned", "<f8"),  # rad, the largest turn since the rest
        ("q_rest", "<f8", (4,)),
        ("reckoned_v", "<f8", (3,)),  # m/s, NED: dead reckoning
        ("reckoned_p", "<f8", (3,)),
        ("p", "<f8", (3,)),  # the nine states, NED
        ("v", "<f8", (3,)),
        ("a", "<f8", (3,)),
        ("predicted", "<f8", (3,)),  # p before the update
        ("P", "<f8", (6,)),
        ("x", "<f8", (STATES,)),
        ("d", "<f8", (STATES,)),
        ("column", "<i8", (1,)),
        ("one", "<f8", (1,)),
        ("innovation", "<f8", (3,)),
        ("variance", "<f8"),
        ("origin", "<f8", (3,)),  # rad, rad, m; NaN: none
        ("origin_var", "<f8", (3,)),
    ],
    align=True,
)


def configure(settings: Settings, rate_hz: float) -> Record:
    """Parameters (PARAMETERS): Q and R, and the sensor's noise for the sigmas of dead reckoning."""
    name = settings.imu.profile
    profile = PROFILES[DEFAULT_PROFILE if name == "auto" else name]
    p = np.zeros(1, PARAMETERS)
    p["acceleration_walk"] = settings.ins9.acceleration_walk
    p["distance_var"] = settings.ins9.distance_var
    p["gyro_psd"], p["accel_psd"] = profile.gyro_noise**2, profile.accel_noise**2
    p["accel_bias_var"] = profile.accel_bias_initial**2
    return p


def start(parameters: Record, initial: Initial) -> Record:
    """A state (STATE) at rest at its origin, P = 0."""
    s = np.zeros(1, STATE)
    s["origin"], s["one"] = math.nan, 1.0
    s["given_yaw"] = math.nan if initial.yaw_deg is None else math.radians(initial.yaw_deg)
    if initial.lat_deg is not None and initial.lon_deg is not None:
        s["origin"] = math.radians(initial.lat_deg), math.radians(initial.lon_deg), initial.height_m or 0.0
    return s


@kernel
def calibrate(s: Any, sample: Any) -> None:
    """Mean rate and force so far: gyro bias, gravity, tilt."""
    s.since_s = (sample.t_ns - s.begin_ns) * 1e-9
    for i in range(3):
        s.w_sum[i] += sample.w[i]
        s.f_sum[i] += sample.f[i]
        s.bg[i] = s.w_sum[i] / s.samples
        s.w[i], s.f[i] = sample.w[i], sample.f[i]
    fx, fy, fz = s.f_sum[0] / s.samples, s.f_sum[1] / s.samples, s.f_sum[2] / s.samples
    s.gravity = math.sqrt(fx * fx + fy * fy + fz * fz)
    roll, pitch, _ = euler_of_quat(quat_of_gravity(fx, fy, fz))
    q = quat_of_euler(roll, pitch, s.given_yaw if math.isfinite(s.given_yaw) else 0.0)
    for i in range(4):
        s.q[i] = s.q_rest[i] = q[i]


@kernel
def turn(s: Any, sample: Any, T: float) -> None:
    """The attitude after T s: the gyros' turn, then the device's own tilt if it computes one."""
    half = 0.5 * T
    q = (s.q[0], s.q[1], s.q[2], s.q[3])
    q = quat_product(
        q,
        quat_exp(
            half * (s.w[0] + sample.w[0]) - T * s.bg[0],
            half * (s.w[1] + sample.w[1]) - T * s.bg[1],
            half * (s.w[2] + sample.w[2]) - T * s.bg[2],
        ),
    )
    down = sample.down
    if down[0] * down[0] + down[1] * down[1] + down[2] * down[2] > 0.5:
        _, _, yaw = euler_of_quat(q)
        roll, pitch, _ = euler_of_quat(quat_of_gravity(-down[0], -down[1], -down[2]))
        q = quat_of_euler(roll, pitch, yaw)
    q = quat_normalised(q)
    same = 0.0
    for i in range(4):
        s.q[i] = q[i]
        same += q[i] * s.q_rest[i]
    s.turned = max(s.turned, 2.0 * math.acos(min(abs(same), 1.0)))


@kernel
def reckon(s: Any, sample: Any, T: float) -> None:
    """His integration, vel = vel' + accl dt, dist = dist' + vel dt, by the trapezoid rule."""
    before = quat_rotate((s.q[0], s.q[1], s.q[2], s.q[3]), (s.f[0], s.f[1], s.f[2]))
    turn(s, sample, T)
    after = quat_rotate((s.q[0], s.q[1], s.q[2], s.q[3]), (sample.f[0], sample.f[1], sample.f[2]))
    for i in range(3):
        a = 0.5 * (before[i] + after[i]) + (s.gravity if i == 2 else 0.0)
        s.reckoned_p[i] += T * s.reckoned_v[i] + 0.5 * T * T * a
        s.reckoned_v[i] += T * a
        s.w[i], s.f[i] = sample.w[i], sample.f[i]


@kernel
def smooth(p: Any, s: Any, T: float) -> None:
    """The nine-state filter over T s with the reckoned distances as its measurements."""
    shear(s.P, STATES, DISTANCE, SPEED, T)
    shear(s.P, STATES, DISTANCE, ACCELERATION, 0.5 * T * T)
    shear(s.P, STATES, SPEED, ACCELERATION, T)
    G = (0.5 * T * T, T, 1.0)
    at = 0
    for i in range(STATES):
        for j in range(i, STATES):
            s.P[at] += p.acceleration_walk * T * G[i] * G[j]
            at += 1
    s.variance = measure(s.P, STATES, s.column, s.one, 1, s.d) + p.distance_var
    for i in range(3):
        s.p[i] += T * s.v[i] + 0.5 * T * T * s.a[i]
        s.v[i] += T * s.a[i]
        s.predicted[i] = s.p[i]
        z = s.reckoned_p[i] - s.p[i]
        s.innovation[i] = z
        s.p[i] += s.d[DISTANCE] / s.variance * z
        s.v[i] += s.d[SPEED] / s.variance * z
        s.a[i] += s.d[ACCELERATION] / s.variance * z
    update(s.P, STATES, s.x, s.d, s.variance, 0.0, STATES)


@kernel
def reckoning_variance(p: Any, s: Any) -> tuple[float, float, float]:
    """What dead reckoning does not know after `moving_s` s: variances of distance, velocity and tilt, per axis.

    Errors of the two means at rest, white noise, and the accelerometer's bias, which levelling has hidden in the
    tilt and a turn brings out.
    """
    t, rest = s.moving_s, max(s.since_s, 1e-3)
    gyro = p.gyro_psd / rest  # of the mean rate
    force = p.accel_psd / rest + p.accel_bias_var * (2.0 * math.sin(0.5 * s.turned)) ** 2
    g2 = s.gravity * s.gravity
    distance = force * t**4 / 4 + p.accel_psd * t**3 / 3 + g2 * (gyro * t**6 / 36 + p.gyro_psd * t**5 / 20)
    velocity = force * t**2 + p.accel_psd * t + g2 * (gyro * t**4 / 4 + p.gyro_psd * t**3 / 3)
    tilt = (p.accel_bias_var + p.accel_psd / rest) / g2 + gyro * t**2 + p.gyro_psd * t
    return distance, velocity, tilt


@kernel
def tell_position(s: Any, heading_var: float, distance_var: float, velocity_var: float, out: Any) -> None:
    """Position and velocity relative to the origin; an unknown heading turns the way that was gone."""
    meridian, prime_vertical = radii(s.origin[0])
    out.lat = s.origin[0] + s.p[0] / (meridian + s.origin[2])
    out.lon = s.origin[1] + s.p[1] / ((prime_vertical + s.origin[2]) * max(math.cos(s.origin[0]), 1e-9))
    out.height = s.origin[2] - s.p[2]
    turned = min(heading_var, 2.0)  # mean square chord of an unknown turn, per square of the way
    way2, speed2 = s.p[0] ** 2 + s.p[1] ** 2, s.v[0] ** 2 + s.v[1] ** 2
    for i in range(3):
        level = 1.0 if i < 2 else 0.0
        out.v[i] = s.v[i]
        out.sigma_p[i] = math.sqrt(s.P[0] + distance_var + s.origin_var[i] + level * turned * way2)
        out.sigma_v[i] = math.sqrt(s.P[3] + velocity_var + level * turned * speed2)


@kernel
def tell(p: Any, s: Any, sample: Any, out: Any) -> None:
    """Write a row of SOLUTION."""
    blank(out, s.t_ns, sample)
    if s.samples == 0:
        return
    distance_var, velocity_var, tilt_var = reckoning_variance(p, s)
    known = math.isfinite(s.given_yaw)
    yaw_drift = (p.gyro_psd / max(s.since_s, 1e-3) * s.moving_s + p.gyro_psd) * s.moving_s
    heading_var = min((GIVEN_HEADING**2 if known else UNIFORM**2) + yaw_drift, UNIFORM**2)
    out.sigma_rpy[0] = out.sigma_rpy[1] = math.sqrt(tilt_var)
    out.sigma_rpy[2] = math.sqrt(heading_var)
    out.status |= AT_REST if s.moving_s == 0.0 else COASTING
    if out.sigma_rpy[0] < TRUSTED:
        out.status |= ATTITUDE_VALID
    if known and out.sigma_rpy[2] < TRUSTED:
        out.status |= HEADING_VALID
    for i in range(4):
        out.q_nb[i] = s.q[i]
    for i in range(3):
        out.w[i] = sample.w[i] - s.bg[i]
        out.bg[i] = s.bg[i]
        out.sigma_bg[i] = math.sqrt(p.gyro_psd / max(s.since_s, 1e-3))
    if math.isfinite(s.origin[0]):
        out.status |= POSITION_VALID
        tell_position(s, heading_var, distance_var, velocity_var, out)


@kernel
def step(p: Any, s: Any, sample: Any, solution: Any) -> None:
    """Take one sample (SAMPLE), write one row (SOLUTION). Bad samples are left out."""
    w, f = sample.w, sample.f
    good = sample.flags & SUSPECT == 0 and math.isfinite(f[0] + f[1] + f[2] + w[0] + w[1] + w[2])
    if good and (s.samples == 0 or sample.t_ns > s.t_ns):
        T = (sample.t_ns - s.t_ns) * 1e-9 if s.samples > 0 else 0.0
        s.t_ns = sample.t_ns
        if s.samples == 0:
            s.begin_ns = s.t_ns
        s.samples += 1
        if s.t_ns - s.begin_ns <= REST_S * 1e9:
            calibrate(s, sample)
        else:
            s.moving_s += T
            reckon(s, sample, T)
            smooth(p, s, T)
    tell(p, s, sample, solution)


@kernel
def set_origin(p: Any, s: Any, fix: Any, innovations: Any) -> int:
    """Take the first fix for the origin, less the way gone since. No innovation: nothing was predicted."""
    usable = math.isfinite(fix.lat + fix.lon) and fix.quality != 0 and fix.quality != 6
    if usable and not math.isfinite(s.origin[0]):
        meridian, prime_vertical = radii(fix.lat)
        s.origin[0] = fix.lat - s.p[0] / meridian
        s.origin[1] = fix.lon - s.p[1] / (prime_vertical * max(math.cos(fix.lat), 1e-9))
        s.origin[2] = (fix.height if math.isfinite(fix.height) else 0.0) + s.p[2]
        for i in range(3):
            s.origin_var[i] = (fix.sigma[i] if math.isfinite(fix.sigma[i]) else ORIGIN_SIGMA) ** 2
    return 0


ESTIMATOR = Estimator("ins9", configure, start, step, set_origin, needs_gyros=False)
