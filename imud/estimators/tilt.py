"""Roll and pitch from the accelerometer alone, for sensors without gyros: which way is the averaged force?

The specific force is averaged in body axes by a first-order low-pass of BANDWIDTH_HZ (a running mean until that has
filled), so the answer lags a steady turn by 1 / (2 pi BANDWIDTH_HZ) = 0.16 s. The tilt between the body's z and the
vertical is acos(acc_z / acc_xyz), with acc pointing up; roll and pitch are its full rotation. Their sigmas follow from
what the sensor's noise, bias and scale do to the average, and from the accelerations that there may be.

An acceleration tilts the answer by a / g. Its evidence is a change of the average, which may as well be a rotation, and
a magnitude that differs from gravity by more than the sensor's errors explain. While the body vibrates by more than the
sensor's noise, it may be a vehicle that goes on braking or turning as it has begun to: the evidence is remembered for
MOTION_S. An acceleration that begins more slowly than that, and is small, is not seen.

Yaw is unknown, 0 with the sigma of a uniform angle, unless a yaw gyro exists (a rate that is ever anything but exactly
0): from then on its rate is integrated, and yaw counts from there or from the heading that the user gave.

Source: Prasanna, Vehicle localisation using GPS and IMU (2009), "Calculating Tilt", where the quotient is printed
upside down, and section INS, where g sin(roll) stands for the full rotation.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from imud.drivers import elementary
from imud.drivers.sample import NO_FORCE, NO_RATE, SUSPECT
from imud.drivers.sample import SATURATED as BEYOND_RANGE

from ..compile.jit import interpreted, kernel
from ..configuration.settings import Initial, Settings
from ..math.arrays import Records
from ..math.earth import STANDARD_GRAVITY, gravity
from ..math.rotation import UNKNOWN_ANGLE, quat_of_euler, wrap_angle
from ..sensor_errors.profiles import profile_of
from . import Estimator
from .records import ATTITUDE_VALID, HEADING_VALID, SATURATED

if TYPE_CHECKING:
    from .types import Sample, Solution, TiltParameters, TiltState

BANDWIDTH_HZ = 1.0
TIME_CONSTANT_S = 1.0 / (2.0 * math.pi * BANDWIDTH_HZ)
SLOW_RATIO = 3.0  # times as slow: the second average, behind which the first one runs by twice its own lag
# largest difference of the two averages after a step of the force by 1
STEP_RESPONSE = SLOW_RATIO ** (-1.0 / (SLOW_RATIO - 1.0)) - SLOW_RATIO ** (-SLOW_RATIO / (SLOW_RATIO - 1.0))
MOTION_S = 10.0  # for which an acceleration may last; choice: a vehicle that brakes, or a bend
VIBRATION_RATIO = 2.0  # of the sensor's variance: more is vibration; choice, for profiles' noise that is typical
VIBRATION_S = 1.0  # over which that variance is averaged
GRAVITY_SPREAD = 0.0015  # of standard gravity over the earth's surface, 1 sigma
MAGNITUDE_GATE = 2.0  # sigma by which sensor errors may change the force's magnitude
GIVEN_ANGLE = math.radians(1.0)  # of a heading given by the user
VALID_TILT, VALID_HEADING = math.radians(10.0), math.radians(20.0)
FAULT_RATE = 0.3  # rad/s, error of the rate while the gyro fails
LONG_GAP_S = 1.0  # without a good sample the tilt is not claimed, and the heading is lost

PARAMETERS = np.dtype(
    [
        ("sample_var", "<f8"),  # (m/s^2)^2, white noise of one sample
        ("bias_var", "<f8"),  # (m/s^2)^2
        ("scale_var", "<f8"),
        ("gyro_psd", "<f8"),  # rad^2/s
        ("gyro_bias_var", "<f8"),  # (rad/s)^2
    ],
    align=True,
)

STATE = np.dtype(
    [
        ("gravity", "<f8"),  # m/s^2
        ("gravity_var", "<f8"),
        ("t_ns", "<i8"),  # of the newest sample
        ("last_good_ns", "<i8"),  # of the newest good one
        ("sample_count", "<i8"),  # good ones
        ("f_mean", "<f8", (3,)),  # m/s^2, averaged
        ("f_slow_mean", "<f8", (3,)),  # averaged for longer
        ("noise_var", "<f8"),  # (m/s^2)^2, white noise left in f
        ("vibration_var", "<f8"),  # (m/s^2)^2, of samples about the average, mean of the axes
        ("motion_var", "<f8"),  # (m/s^2)^2, of the accelerations that there may be, each axis
        ("has_gyro", "<i8", (3,)),  # 1: that axis has shown a rate
        ("w", "<f8", (3,)),  # rad/s, newest
        ("true_heading", "<i8"),  # 1 while yaw refers to true north
        ("yaw", "<f8"),
        ("yaw_var", "<f8"),  # rad^2, but for the gyro's bias
        ("yaw_per_bias", "<f8"),  # s, rad of yaw per rad/s of that bias
        ("tilt_var", "<f8"),
        ("roll_pitch", "<f8", (2,)),  # rad, roll and pitch
        ("roll_pitch_var", "<f8", (2,)),
    ],
    align=True,
)


def configure(settings: Settings, rate_hz: float) -> Records:
    """Parameters (PARAMETERS) from the sensor's noise profile; a sample's noise fills half of `rate_hz`."""
    profile = profile_of(settings)
    p = np.zeros(1, PARAMETERS)
    p["sample_var"] = profile.accel_noise**2 * rate_hz
    p["bias_var"] = profile.accel_bias_initial**2
    p["scale_var"] = profile.accel_scale**2
    p["gyro_psd"] = profile.gyro_noise**2
    p["gyro_bias_var"] = profile.gyro_bias_initial**2
    return p


def start(parameters: Records, initial: Initial) -> Records:
    """A state (STATE) that waits for its first sample. A latitude makes gravity known; a given yaw is the start's."""
    s = np.zeros(1, STATE)
    s["gravity"], s["gravity_var"] = STANDARD_GRAVITY, (GRAVITY_SPREAD * STANDARD_GRAVITY) ** 2
    if initial.lat_deg is not None:
        s["gravity"], s["gravity_var"] = (
            interpreted(gravity)(math.radians(initial.lat_deg), initial.height_m or 0.0),
            0.0,
        )
    if initial.yaw_deg is not None:
        s["yaw"], s["yaw_var"], s["true_heading"] = math.radians(initial.yaw_deg), GIVEN_ANGLE**2, 1
    s["tilt_var"] = s["roll_pitch_var"] = UNKNOWN_ANGLE**2
    return s


@kernel
def update_means(p: TiltParameters, s: TiltState, sample: Sample, dt: float) -> None:
    """Take the force of a good sample, dt s after the last good one."""
    if s.sample_count > 0:
        fast2 = 0.0
        for i in range(3):
            lag = (s.f_mean[i] - s.f_slow_mean[i]) / (SLOW_RATIO - 1.0)  # of the average behind a steady change
            fast2 += (sample.f[i] - s.f_mean[i] - lag) ** 2
        s.vibration_var += max(dt / (VIBRATION_S + dt), 1.0 / s.sample_count) * (fast2 / 3.0 - s.vibration_var)
    s.sample_count += 1
    gain = max(dt / (TIME_CONSTANT_S + dt), 1.0 / s.sample_count)
    slow_gain = max(dt / (SLOW_RATIO * TIME_CONSTANT_S + dt), 1.0 / s.sample_count)
    for i in range(3):
        s.f_mean[i] += gain * (sample.f[i] - s.f_mean[i])
        s.f_slow_mean[i] += slow_gain * (sample.f[i] - s.f_slow_mean[i])
    s.noise_var += gain * (gain * p.sample_var - (2.0 - gain) * s.noise_var)


@kernel
def update_motion(p: TiltParameters, s: TiltState, dt: float) -> None:
    """The accelerations that there may be: those for which the averages are evidence, and those of lately."""
    f, change2, force2 = s.f_mean, 0.0, 1e-12
    for i in range(3):
        change2 += (f[i] - s.f_slow_mean[i]) ** 2
        force2 += f[i] ** 2
    excess = math.sqrt(force2) - s.gravity
    explained = MAGNITUDE_GATE * math.sqrt(s.noise_var + p.bias_var + s.gravity_var + p.scale_var * force2)
    # a horizontal acceleration a lengthens the force by a^2 / (2 g); a vertical one is taken for as large sideways
    unexplained = max(abs(excess) - explained, 0.0)
    evidence = unexplained**2 + 0.5 * change2 / STEP_RESPONSE**2
    if excess > 0.0:
        evidence += s.gravity * unexplained
    vibrates = s.vibration_var > VIBRATION_RATIO * p.sample_var
    memory = MOTION_S if vibrates else SLOW_RATIO * TIME_CONSTANT_S
    s.motion_var = max(evidence, s.motion_var * memory / (memory + dt))


@kernel
def update_tilt(p: TiltParameters, s: TiltState) -> None:
    """Roll and pitch of the averaged force, and what they are worth."""
    f = s.f_mean
    force2 = max(f[0] * f[0] + f[1] * f[1] + f[2] * f[2], 1e-12)
    roll, pitch = elementary.atan2(-f[1], -f[2]), elementary.atan2(f[0], math.sqrt(f[1] * f[1] + f[2] * f[2]))
    s.roll_pitch[0], s.roll_pitch[1] = roll, pitch
    isotropic = s.noise_var + p.bias_var + s.motion_var
    cos_pitch = max(elementary.cos(pitch), 1e-6)
    sr, cr, sp = elementary.sin(roll), elementary.cos(roll), elementary.sin(pitch)
    across = p.scale_var * ((f[1] * cr) ** 2 + (f[2] * sr) ** 2)
    along = p.scale_var * ((f[0] * cos_pitch) ** 2 + (f[1] * sr * sp) ** 2 + (f[2] * cr * sp) ** 2)
    s.tilt_var = min((isotropic + max(across, along)) / force2, UNKNOWN_ANGLE**2)
    s.roll_pitch_var[0] = min((isotropic + across) / (force2 * cos_pitch**2), UNKNOWN_ANGLE**2)
    s.roll_pitch_var[1] = min((isotropic + along) / force2, UNKNOWN_ANGLE**2)


@kernel
def integrate_yaw(p: TiltParameters, s: TiltState, sample: Sample, dt: float) -> None:
    """Integrate yaw over dt with the rates there are, between the last good sample and this one."""
    for i in range(3):
        if sample.w[i] != 0.0:
            s.has_gyro[i] = 1
    if s.has_gyro[2] == 1:
        cos_pitch = max(elementary.cos(s.roll_pitch[1]), 0.1)
        sr, cr = elementary.sin(s.roll_pitch[0]), elementary.cos(s.roll_pitch[0])
        middle_y, middle_z = 0.5 * (s.w[1] + sample.w[1]), 0.5 * (s.w[2] + sample.w[2])
        s.yaw = wrap_angle(s.yaw + (middle_y * sr + middle_z * cr) / cos_pitch * dt)
        s.yaw_per_bias += cr / cos_pitch * dt
        s.yaw_var += p.gyro_psd / cos_pitch**2 * dt
        if sample.flags & NO_RATE != 0:
            outage_s = sample.outage_s
            s.yaw_var += FAULT_RATE**2 * (outage_s * outage_s - max(outage_s - dt, 0.0) ** 2)
    for i in range(3):
        s.w[i] = sample.w[i]


@kernel
def write_solution(p: TiltParameters, s: TiltState, sample: Sample, out: Solution) -> None:
    """Write a row of SOLUTION; what this estimator does not know is NaN."""
    yaw_sigma = UNKNOWN_ANGLE
    if s.has_gyro[2] == 1:
        yaw_sigma = min(math.sqrt(s.yaw_var + p.gyro_bias_var * s.yaw_per_bias**2), UNKNOWN_ANGLE)
    status = 0
    if s.sample_count > 0 and math.sqrt(s.tilt_var) < VALID_TILT and s.t_ns - s.last_good_ns < LONG_GAP_S * 1e9:
        status |= ATTITUDE_VALID
        if s.true_heading == 1 and yaw_sigma < VALID_HEADING:
            status |= HEADING_VALID
    if sample.flags & BEYOND_RANGE != 0:
        status |= SATURATED
    out.t_ns, out.status = s.t_ns, status
    out.lat = out.lon = out.height = math.nan
    q = quat_of_euler(s.roll_pitch[0], s.roll_pitch[1], s.yaw)
    for i in range(4):
        out.q_nb[i] = q[i]
    for i in range(3):
        out.v[i] = out.sigma_p[i] = out.sigma_v[i] = math.nan
        out.w[i] = s.w[i] if s.has_gyro[i] == 1 else math.nan
        out.f[i] = sample.f[i]
        out.bg[i] = 0.0 if s.has_gyro[i] == 1 else math.nan
        out.ba[i] = 0.0
        out.sigma_bg[i] = math.sqrt(p.gyro_bias_var) if s.has_gyro[i] == 1 else math.nan
        out.sigma_ba[i] = math.sqrt(p.bias_var)
    out.sigma_rpy[0], out.sigma_rpy[1] = math.sqrt(s.roll_pitch_var[0]), math.sqrt(s.roll_pitch_var[1])
    out.sigma_rpy[2] = yaw_sigma


@kernel
def step(p: TiltParameters, s: TiltState, sample: Sample, solution: Solution) -> None:
    """Take one sample (SAMPLE), write one row (SOLUTION). A sample that is not newer than the last is ignored."""
    if s.t_ns == 0 or sample.t_ns > s.t_ns:
        f, w = sample.f, sample.w
        s.t_ns = sample.t_ns
        if sample.flags & (SUSPECT | NO_FORCE) == 0 and math.isfinite(f[0] + f[1] + f[2] + w[0] + w[1] + w[2]):
            dt = (s.t_ns - s.last_good_ns) * 1e-9 if s.sample_count > 0 else 0.0
            if dt > LONG_GAP_S:
                s.yaw_var, s.true_heading = UNKNOWN_ANGLE**2, 0
            update_means(p, s, sample, dt)
            update_motion(p, s, dt)
            update_tilt(p, s)
            integrate_yaw(p, s, sample, min(dt, LONG_GAP_S))
            s.last_good_ns = s.t_ns
    write_solution(p, s, sample, solution)


ESTIMATOR = Estimator("tilt", configure, start, step, None, needs_gyros=False, survives_power_on=True)
