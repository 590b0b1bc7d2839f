"""Roll and pitch from the accelerometer alone, for sensors without gyros: which way is the averaged force?

The specific force is averaged in body axes by a first-order low-pass of BANDWIDTH_HZ (a running mean until that has
filled), so the answer lags a steady turn by 1 / (2 pi BANDWIDTH_HZ) = 0.16 s. The tilt between the body's z and the
vertical is acos(acc_z / acc_xyz), with acc pointing up; roll and pitch are its full rotation. Their sigmas follow from
what the sensor's noise, bias and scale do to the average, from how fast it changes, and from how much its magnitude
differs from gravity by more than these explain: then the force is not only weight. An acceleration too steady and
too small for that to show is not seen: it tilts the answer by a / g.

Yaw is unknown, 0 with the sigma of a uniform angle, unless a yaw gyro exists (a rate that is ever anything but exactly
0): from then on its rate is integrated, and yaw counts from there or from the heading that the user gave.

Source: Prasanna, Vehicle localisation using GPS and IMU (2009), "Calculating Tilt", where the quotient is printed
upside down, and section INS, where g sin(roll) stands for the full rotation.
"""

import math
from typing import Any

import numpy as np

from drivers.sample import NO_FORCE, NO_RATE, SUSPECT
from drivers.sample import SATURATED as BEYOND_RANGE

from ..compile.jit import kernel
from ..configuration.settings import Initial, Settings
from ..math.arrays import Records
from ..math.earth import STANDARD_GRAVITY, gravity
from ..math.rotation import quat_of_euler
from ..sensor_errors.profiles import profile_of
from . import Estimator
from .records import ATTITUDE_VALID, HEADING_VALID, SATURATED

BANDWIDTH_HZ = 1.0
TIME_S = 1.0 / (2.0 * math.pi * BANDWIDTH_HZ)
SLOW = 3.0  # times as slow: the second average, behind which the first one runs by twice its own lag
GRAVITY_SPREAD = 0.0015  # of standard gravity over the earth's surface, 1 sigma
EXPLAINED = 2.0  # sigma by which sensor errors may change the force's magnitude
UNIFORM = math.pi / math.sqrt(3.0)  # rad, sigma of an angle of which nothing is known
GIVEN_ANGLE = math.radians(1.0)  # of a heading given by the user
TRUSTED_TILT, TRUSTED_HEADING = math.radians(10.0), math.radians(20.0)
UNSEEN_RATE = 0.3  # rad/s, while the gyro tells nothing
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
        ("good_ns", "<i8"),  # of the newest good one
        ("samples", "<i8"),  # good ones
        ("f", "<f8", (3,)),  # m/s^2, averaged
        ("slow", "<f8", (3,)),  # averaged for longer
        ("noise_var", "<f8"),  # (m/s^2)^2, white noise left in f
        ("change", "<f8"),  # (m/s^2)^2, how far apart the averages were lately
        ("gyro", "<i8", (3,)),  # 1: that axis has shown a rate
        ("w", "<f8", (3,)),  # rad/s, newest
        ("heading", "<i8"),  # 1 while yaw refers to true north
        ("yaw", "<f8"),
        ("yaw_var", "<f8"),  # rad^2, but for the gyro's bias
        ("yaw_gain", "<f8"),  # s, rad of yaw per rad/s of that bias
        ("tilt_var", "<f8"),
        ("angles", "<f8", (2,)),  # rad, roll and pitch
        ("angle_var", "<f8", (2,)),
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
        s["gravity"], s["gravity_var"] = gravity(math.radians(initial.lat_deg), initial.height_m or 0.0), 0.0
    if initial.yaw_deg is not None:
        s["yaw"], s["yaw_var"], s["heading"] = math.radians(initial.yaw_deg), GIVEN_ANGLE**2, 1
    s["tilt_var"] = s["angle_var"] = UNIFORM**2
    return s


@kernel
def average(p: Any, s: Any, sample: Any, dt: float) -> None:
    """Take the force of a good sample, dt s after the last good one."""
    s.samples += 1
    fade = max(dt / (TIME_S + dt), 1.0 / s.samples)
    fade_slow = max(dt / (SLOW * TIME_S + dt), 1.0 / s.samples)
    apart = 0.0
    for i in range(3):
        s.f[i] += fade * (sample.f[i] - s.f[i])
        s.slow[i] += fade_slow * (sample.f[i] - s.slow[i])
        apart += (s.f[i] - s.slow[i]) ** 2
    s.noise_var += fade * (fade * p.sample_var - (2.0 - fade) * s.noise_var)
    s.change = max(apart, s.change + fade_slow * (apart - s.change))


@kernel
def judge(p: Any, s: Any) -> None:
    """Roll and pitch of the averaged force, and what they are worth."""
    f = s.f
    force2 = max(f[0] * f[0] + f[1] * f[1] + f[2] * f[2], 1e-12)
    roll, pitch = math.atan2(-f[1], -f[2]), math.atan2(f[0], math.sqrt(f[1] * f[1] + f[2] * f[2]))
    s.angles[0], s.angles[1] = roll, pitch
    sensor_var = s.noise_var + p.bias_var
    excess = math.sqrt(force2) - s.gravity
    explained = EXPLAINED * math.sqrt(sensor_var + s.gravity_var + p.scale_var * force2)
    # a horizontal acceleration a lengthens the force by a^2 / (2 g); a vertical one is taken for as large sideways
    unexplained = max(abs(excess) - explained, 0.0)
    motion_var = unexplained * unexplained + 0.25 * s.change
    if excess > 0.0:
        motion_var += s.gravity * unexplained
    isotropic = sensor_var + motion_var
    cos_pitch = max(math.cos(pitch), 1e-6)
    sr, cr, sp = math.sin(roll), math.cos(roll), math.sin(pitch)
    across = p.scale_var * ((f[1] * cr) ** 2 + (f[2] * sr) ** 2)
    along = p.scale_var * ((f[0] * cos_pitch) ** 2 + (f[1] * sr * sp) ** 2 + (f[2] * cr * sp) ** 2)
    s.tilt_var = min((isotropic + max(across, along)) / force2, UNIFORM**2)
    s.angle_var[0] = min((isotropic + across) / (force2 * cos_pitch**2), UNIFORM**2)
    s.angle_var[1] = min((isotropic + along) / force2, UNIFORM**2)


@kernel
def turn(p: Any, s: Any, sample: Any, dt: float) -> None:
    """Integrate yaw over dt with the rates there are, between the last good sample and this one."""
    for i in range(3):
        if sample.w[i] != 0.0:
            s.gyro[i] = 1
    if s.gyro[2] == 1:
        cos_pitch = max(math.cos(s.angles[1]), 0.1)
        sr, cr = math.sin(s.angles[0]), math.cos(s.angles[0])
        middle_y, middle_z = 0.5 * (s.w[1] + sample.w[1]), 0.5 * (s.w[2] + sample.w[2])
        yaw = s.yaw + (middle_y * sr + middle_z * cr) / cos_pitch * dt
        s.yaw = yaw - 2.0 * math.pi * math.floor(yaw / (2.0 * math.pi) + 0.5)
        s.yaw_gain += cr / cos_pitch * dt
        s.yaw_var += p.gyro_psd / cos_pitch**2 * dt
        if sample.flags & NO_RATE != 0:
            unseen = sample.unseen_s
            s.yaw_var += UNSEEN_RATE**2 * (unseen * unseen - max(unseen - dt, 0.0) ** 2)
    for i in range(3):
        s.w[i] = sample.w[i]


@kernel
def tell(p: Any, s: Any, sample: Any, out: Any) -> None:
    """Write a row of SOLUTION; what this estimator does not know is NaN."""
    yaw_sigma = UNIFORM
    if s.gyro[2] == 1:
        yaw_sigma = min(math.sqrt(s.yaw_var + p.gyro_bias_var * s.yaw_gain**2), UNIFORM)
    status = 0
    if s.samples > 0 and math.sqrt(s.tilt_var) < TRUSTED_TILT and s.t_ns - s.good_ns < LONG_GAP_S * 1e9:
        status |= ATTITUDE_VALID
        if s.heading == 1 and yaw_sigma < TRUSTED_HEADING:
            status |= HEADING_VALID
    if sample.flags & BEYOND_RANGE != 0:
        status |= SATURATED
    out.t_ns, out.status = s.t_ns, status
    out.lat = out.lon = out.height = math.nan
    q = quat_of_euler(s.angles[0], s.angles[1], s.yaw)
    for i in range(4):
        out.q_nb[i] = q[i]
    for i in range(3):
        out.v[i] = out.sigma_p[i] = out.sigma_v[i] = math.nan
        out.w[i] = s.w[i] if s.gyro[i] == 1 else math.nan
        out.f[i] = sample.f[i]
        out.bg[i] = 0.0 if s.gyro[i] == 1 else math.nan
        out.ba[i] = 0.0
        out.sigma_bg[i] = math.sqrt(p.gyro_bias_var) if s.gyro[i] == 1 else math.nan
        out.sigma_ba[i] = math.sqrt(p.bias_var)
    out.sigma_rpy[0], out.sigma_rpy[1] = math.sqrt(s.angle_var[0]), math.sqrt(s.angle_var[1])
    out.sigma_rpy[2] = yaw_sigma


@kernel
def step(p: Any, s: Any, sample: Any, solution: Any) -> None:
    """Take one sample (SAMPLE), write one row (SOLUTION). A sample that is not newer than the last is ignored."""
    if s.t_ns == 0 or sample.t_ns > s.t_ns:
        f, w = sample.f, sample.w
        s.t_ns = sample.t_ns
        if sample.flags & (SUSPECT | NO_FORCE) == 0 and math.isfinite(f[0] + f[1] + f[2] + w[0] + w[1] + w[2]):
            dt = (s.t_ns - s.good_ns) * 1e-9 if s.samples > 0 else 0.0
            if dt > LONG_GAP_S:
                s.yaw_var, s.heading = UNIFORM**2, 0
            average(p, s, sample, dt)
            judge(p, s)
            turn(p, s, sample, min(dt, LONG_GAP_S))
            s.good_ns = s.t_ns
    tell(p, s, sample, solution)


ESTIMATOR = Estimator("tilt", configure, start, step, None, needs_gyros=False, survives_power_on=True)
