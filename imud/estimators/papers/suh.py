"""Suh's three attitude filters: standard, simple adaptive and two-step extended Kalman filter.

Source: Suh, Park, Kang, Ro, Attitude Estimation Adaptively Compensating External Acceleration (2004); equation numbers
are theirs. State x = [pitch, roll, wx, wy, wz]; the rate is a random walk that the gyro measures, the accelerometer
measures pitch and roll (2)-(5). The filters differ in the accelerometer's covariance r1, r2: constant; 5 while
| |a|^2 - 1 | > delta (7); or by axis from how much the force differs from what the gyro leads to expect (9), (10).

What is built instead of the print:
- f = [sin(pitch), sin(roll) cos(pitch)] has the sign of another accelerometer: with specific force in FRD axes
  a_x = f_x / g and a_y = -f_y / g;
- (5) drops d a_y / d pitch = -sin(roll) sin(pitch);
- (8), (11) predict the measurement as C x; an extended filter predicts f(x);
- (9) adds alpha2 (z - C x), which is negative for pushes to one side, and trusts them; a covariance needs the square,
  element by element. His alpha2 = 10 belongs to the first power: divided by sqrt(delta), the horizontal acceleration
  that (7) just detects, it gives the same covariance there. With 10 e^2 itself a push below 0.55 g is trusted more than
  by the simple filter, and on simulated carts the two-step filter is the worse of the two; with 10 |e| it is not. So
  the rule, 141 e^2, is ours; `rule` in the parameters has the print's, with and without its sign;
- (5) has C at the prediction for (11), too; the two-step filter takes C and f where the gyro (8) has left the state;
- no initial rate is printed, only an attitude and P0 = 0: it is the gyro's first;
- (10) r <- alpha1 r + r_nom ends at r_nom / (1 - alpha1); alpha1 r + (1 - alpha1) r_nom ends at r_nom.
All three are well defined as printed too, (9) by its lower bound r_nom: `literal` in the parameters, and `rule` SIGNED.

His numbers belong to 20 samples per second: faster samples are averaged over STEP_S, and the answer holds until the
next step. Yaw is not in the paper; it is integrated aside from an arbitrary origin, only to have a quaternion, with
the sigma of an angle of which nothing is known. The covariances are in his numbers, whose ratios alone matter (his
section 5): r_nom = 0.05 stands for 0.22 g of external acceleration, so the sigmas are far above the errors of a sensor
at rest.
His delta needs a zeroed accelerometer: more than 2.5 mg of bias along gravity is external acceleration to it for good
(an M-G350 may start with 8 mg).
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from imud.drivers import elementary
from imud.drivers.sample import UNUSABLE

from ...compile.jit import interpreted, kernel
from ...configuration.settings import Initial, Settings
from ...math.arrays import Records
from ...math.earth import STANDARD_GRAVITY, gravity
from ...math.kalman import measure, scale, shear, update
from ...math.rotation import UNKNOWN_ANGLE, Vector, quat_of_euler, wrap_angle
from .. import Estimator
from ..blank_solution import blank
from ..records import ATTITUDE_VALID

if TYPE_CHECKING:
    from ..types import Sample, Solution
    from .types import SuhParameters, SuhState

STEP_S = 0.05
LONG_GAP_S = 1.0  # after it the filter begins anew
Q1, R_NOMINAL, R3 = 1.0, 0.05, 1.0
DELTA, ALPHA1, R_LARGE = 0.005, 0.4, 5.0
PRINTED_ALPHA2 = 10.0  # g, of the residual
ALPHA2 = PRINTED_ALPHA2 / math.sqrt(DELTA)  # of its square
VALID_TILT = math.radians(20.0)
MIN_COS_PITCH = 1e-3  # least |cos(pitch)|: at 90 deg roll and its rate are not defined
PITCH, ROLL, RATE, STATES = 0, 1, 2, 5
STANDARD, ADAPTIVE, TWO_STEP = range(3)
SQUARE, ABSOLUTE, SIGNED = range(3)  # what (9) takes of the residual

PARAMETERS = np.dtype(
    [("mode", "<i8"), ("literal", "<i8"), ("rule", "<i8"), ("half_ns", "<i8")],  # half_ns: of a sample period
    align=True,
)

STATE = np.dtype(
    [
        ("t_ns", "<i8"),  # of the newest sample
        ("step_ns", "<i8"),  # of the last step
        ("started", "<i8"),  # 1: there was a sample
        ("initialised", "<i8"),  # 1: there is an attitude
        ("steps", "<i8"),
        ("gravity", "<f8"),
        ("initial_rpy", "<f8", (3,)),  # rad, roll, pitch, yaw that the user knows; NaN: unknown
        ("count", "<i8"),  # samples since the last step, and their sums
        ("w_sum", "<f8", (3,)),
        ("f_sum", "<f8", (3,)),
        ("x", "<f8", (STATES,)),
        ("yaw", "<f8"),
        ("P", "<f8", (15,)),
        ("r", "<f8", (2,)),
        ("external_acceleration", "<i8"),  # 1: (7) holds
        ("innovation", "<f8", (2,)),  # of the accelerometer, g
        ("d", "<f8", (STATES,)),
        ("columns", "<i8", (2,)),
        ("jacobian", "<f8", (2,)),
    ],
    align=True,
)


def configure(mode: int, settings: Settings, rate_hz: float) -> Records:
    """Parameters (PARAMETERS) of one of the three filters."""
    p = np.zeros(1, PARAMETERS)
    p["mode"], p["half_ns"] = mode, round(0.5e9 / rate_hz)
    return p


def start(parameters: Records, initial: Initial) -> Records:
    """A state (STATE) that waits for its first step; P0 = 0, as he prints."""
    s = np.zeros(1, STATE)
    angles = (initial.roll_deg, initial.pitch_deg, initial.yaw_deg)
    s["initial_rpy"] = [math.nan if angle is None else math.radians(angle) for angle in angles]
    known = initial.lat_deg is not None
    s["gravity"] = (
        interpreted(gravity)(math.radians(initial.lat_deg or 0.0), initial.height_m or 0.0)
        if known
        else STANDARD_GRAVITY
    )
    s["r"] = R_NOMINAL
    return s


@kernel
def initialise(s: SuhState, w: Vector, a: Vector) -> None:
    """The first attitude, (1) made valid for all angles, or the user's."""
    given = s.initial_rpy
    s.x[PITCH] = given[1] if math.isfinite(given[1]) else elementary.atan2(a[0], math.sqrt(a[1] * a[1] + a[2] * a[2]))
    s.x[ROLL] = given[0] if math.isfinite(given[0]) else elementary.atan2(a[1], -a[2])
    if math.isfinite(given[2]):
        s.yaw = given[2]
    for i in range(3):
        s.x[RATE + i] = w[i]
        given[i] = math.nan
    for i in range(len(s.P)):
        s.P[i] = 0.0
    s.r[0] = s.r[1] = R_NOMINAL
    s.initialised = 1


@kernel
def predict(s: SuhState, T: float) -> None:
    """Time update (4): x <- Phi x, P <- Phi P Phi' + Q with Phi = [[I, W T], [0, I]]."""
    x, P = s.x, s.P
    sr, cr = elementary.sin(x[ROLL]), elementary.cos(x[ROLL])
    cp = max(elementary.cos(x[PITCH]), MIN_COS_PITCH)
    tp = elementary.sin(x[PITCH]) / cp
    s.yaw += T * (sr * x[RATE + 1] + cr * x[RATE + 2]) / cp
    W = ((0.0, cr, -sr), (1.0, sr * tp, cr * tp))
    for i in range(2):
        for j in range(3):
            x[i] += T * W[i][j] * x[RATE + j]
            shear(P, STATES, i, RATE + j, T * W[i][j])
    cubic, square = Q1 * T * T * T / 3.0, Q1 * T * T / 2.0
    for j in range(3):
        P[0] += cubic * W[0][j] * W[0][j]
        P[1] += cubic * W[0][j] * W[1][j]
        P[5] += cubic * W[1][j] * W[1][j]
        P[2 + j] += square * W[0][j]
        P[6 + j] += square * W[1][j]
    for diagonal in (9, 12, 14):
        P[diagonal] += Q1 * T


@kernel
def fuse_scalar(s: SuhState, m: int, innovation: float, r: float) -> None:
    """One scalar measurement with the first m of the row's elements."""
    variance = measure(s.P, STATES, s.columns, s.jacobian, m, s.d) + r
    update(s.P, STATES, s.x, s.d, variance, innovation)


@kernel
def adapt_accel_noise(p: SuhParameters, s: SuhState, a: Vector) -> None:
    """r1 and r2 for this step: (7), (9), (10)."""
    s.external_acceleration = 1 if abs(a[0] * a[0] + a[1] * a[1] + a[2] * a[2] - 1.0) > DELTA else 0
    for i in range(2):
        if p.mode == ADAPTIVE:
            s.r[i] = R_LARGE if s.external_acceleration == 1 else R_NOMINAL
        elif p.mode == TWO_STEP and s.external_acceleration == 1:
            e = s.innovation[i]
            inflation = ALPHA2 * e * e
            if p.rule != SQUARE:
                inflation = PRINTED_ALPHA2 * (abs(e) if p.rule == ABSOLUTE else e)
            s.r[i] = max(ALPHA1 * s.r[i] + inflation, R_NOMINAL)
        elif p.mode == TWO_STEP:
            s.r[i] = ALPHA1 * s.r[i] + (1.0 if p.literal == 1 else 1.0 - ALPHA1) * R_NOMINAL


@kernel
def update_measurements(p: SuhParameters, s: SuhState, w: Vector, a: Vector) -> None:
    """Measurement updates: gyro (8), covariances, accelerometer (11).

    The standard filter takes both at once: its C and f are those of the predicted state, and what the gyro has moved
    since is removed by C; the two-step filter takes C and f where the gyro has left the state. As printed both take C
    at the predicted state, times the present one.
    """
    x = s.x
    pitch, roll = x[PITCH], x[ROLL]
    s.jacobian[0] = 1.0
    for i in range(3):
        s.columns[0] = RATE + i
        fuse_scalar(s, 1, w[i] - x[RATE + i], R3)
    if p.mode == TWO_STEP and p.literal == 0:
        pitch, roll = x[PITCH], x[ROLL]
    sp, cp, sr, cr = elementary.sin(pitch), elementary.cos(pitch), elementary.sin(roll), elementary.cos(roll)
    by_pitch, expected = -sr * sp, (sp, sr * cp)
    if p.literal == 1:
        pitch, roll = x[PITCH], x[ROLL]
        by_pitch, expected = 0.0, (cp * pitch, cr * cp * roll)
    s.innovation[0], s.innovation[1] = a[0] - expected[0], a[1] - expected[1]
    adapt_accel_noise(p, s, a)
    s.columns[0], s.columns[1] = PITCH, ROLL
    s.jacobian[0], s.jacobian[1] = cp, 0.0
    fuse_scalar(s, 2, s.innovation[0] - cp * (x[PITCH] - pitch), s.r[0])
    s.jacobian[0], s.jacobian[1] = by_pitch, cr * cp
    fuse_scalar(s, 2, s.innovation[1] - by_pitch * (x[PITCH] - pitch) - cr * cp * (x[ROLL] - roll), s.r[1])


@kernel
def wrap_angles(s: SuhState) -> None:
    """Keep pitch within +-90 deg, roll and yaw within +-180 deg."""
    x = s.x
    if abs(x[PITCH]) > 0.5 * math.pi:
        x[PITCH] = math.copysign(math.pi, x[PITCH]) - x[PITCH]
        x[ROLL] += math.pi
        s.yaw += math.pi
        scale(s.P, STATES, PITCH, -1.0)
    x[ROLL], s.yaw = wrap_angle(x[ROLL]), wrap_angle(s.yaw)


@kernel
def advance_filter(p: SuhParameters, s: SuhState) -> None:
    """One step of the filter with the mean of the samples since the last one."""
    n, T = s.count, (s.t_ns - s.step_ns) * 1e-9
    w = (s.w_sum[0] / n, s.w_sum[1] / n, s.w_sum[2] / n)
    g = n * s.gravity
    a = (s.f_sum[0] / g, -s.f_sum[1] / g, s.f_sum[2] / g)
    if s.initialised == 0 or T > LONG_GAP_S:
        initialise(s, w, a)
    else:
        predict(s, T)
        update_measurements(p, s, w, a)
        wrap_angles(s)
        s.steps += 1
    s.step_ns = s.t_ns
    s.count = 0
    for i in range(3):
        s.w_sum[i] = s.f_sum[i] = 0.0


@kernel
def step(p: SuhParameters, s: SuhState, sample: Sample, solution: Solution) -> None:
    """Take one sample (SAMPLE), write one row (SOLUTION). Bad samples are left out."""
    w, f = sample.w, sample.f
    good = sample.flags & UNUSABLE == 0 and math.isfinite(f[0] + f[1] + f[2] + w[0] + w[1] + w[2])
    if good and (s.started == 0 or sample.t_ns > s.t_ns):
        s.t_ns = sample.t_ns
        if s.started == 0:
            s.started = 1
            s.step_ns = s.t_ns - 2 * p.half_ns
        s.count += 1
        for i in range(3):
            s.w_sum[i] += w[i]
            s.f_sum[i] += f[i]
        if s.t_ns - s.step_ns >= STEP_S * 1e9 - p.half_ns:
            advance_filter(p, s)
    blank(solution, sample.t_ns, sample)
    if s.initialised == 1:
        q = quat_of_euler(s.x[ROLL], s.x[PITCH], s.yaw)
        for i in range(4):
            solution.q_nb[i] = q[i]
        solution.sigma_rpy[0] = min(math.sqrt(s.P[5]), UNKNOWN_ANGLE)
        solution.sigma_rpy[1] = min(math.sqrt(s.P[0]), UNKNOWN_ANGLE)
        solution.sigma_rpy[2] = UNKNOWN_ANGLE
        if max(solution.sigma_rpy[0], solution.sigma_rpy[1]) < VALID_TILT:
            solution.status |= ATTITUDE_VALID


SUH_STANDARD = Estimator("suh-standard", partial(configure, STANDARD), start, step, None)
SUH_ADAPTIVE = Estimator("suh-adaptive", partial(configure, ADAPTIVE), start, step, None)
SUH_TWO_STEP = Estimator("suh-two-step", partial(configure, TWO_STEP), start, step, None)
