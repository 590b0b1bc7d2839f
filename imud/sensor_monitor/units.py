"""Finds rates in degrees per second instead of radians: the measured gravity rotates more slowly than the rates say.

Two tests, of which either is enough; both look at fast rates only. The first is sooner where the body moves much:

- While a sensor rotates at w, the specific force f of gravity changes at the rate f x w. The regression coefficient k
  of the measured change on this expected change is 1, and 1/57.3 if the rates are in deg/s. Accelerations change the
  force, too, so k has a variance. It must be significantly near 1/57.3, over up to WINDOW_S of fast rates.
- The force is rotated into axes that do not turn if the rates are k times too large. Where k is right only
  accelerations spread it about its mean; gravity stays. The log likelihood ratio of 1/57.3 over both 0 and 2/57.3 must
  exceed EVIDENCE, and 1 must be worse by SPREAD_RATIO: the force of a centrifuge or at the end of an arm, which turns
  with the body, is spread by 1, and least by 0; nothing but degrees is spread least by 1/57.3. This test is sooner
  where the body moves little.

Until one of them says so, wrong rates have turned the attitude for seconds. So when rates become fast for the first
time they are unconfirmed while the force is spread SPREAD_RATIO times less in axes that they do not turn than in those
that they do, after CONFIRMING_TURN already. The thrust of a multicopter, and the force on an aircraft in a curve, do
not turn with the rates, either; but such a body has turned more slowly before, whereas a rate of 1 deg/s is soon
exceeded by whatever turns at all: after BRISK_S at BRISK_RATE they are confirmed. So they are once the rates have
explained the force (TRUST), or after CONFIRMING_WINDOWS without a finding: a unit does not change.

Each time the number of samples has doubled since a window began a decision is made, so that great rates show it within
a tenth of a second. A unit does not change with the motion: the finding is withdrawn only when gravity stays in the
axes that the rates as they are make, and in no others.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from imud.drivers import elementary

from ..compile.jit import kernel
from ..math.earth import STANDARD_GRAVITY
from ..math.rotation import quat_exp, quat_normalised, quat_product, quat_rotate

if TYPE_CHECKING:
    from .types import RateUnits

DEG = math.pi / 180.0
WINDOW_S, DECISIONS = 5.0, 16  # of either test, and how many decisions are made in it at least
FIRST_DECISION = 16  # samples
MAX_FORCE = 2.0 * STANDARD_GRAVITY  # m/s^2, RMS in the second test: gravity is too small a part of a greater one
MIN_RATE = 2.0  # rad/s of a fast rate; 2 deg/s if the rates are in deg/s
MAX_RATIO = 2.0  # factor by which k may differ from 1/57.3
SIGMAS = 4.0  # by which k must differ from 0
FACTORS = (0.0, DEG, 2.0 * DEG, 1.0)  # k of the second test
NONE, DEGREES, DOUBLE, RADIANS = 0, 1, 2, 3  # their indices
INDEPENDENT = 3.0  # 1/s, independent components of an acceleration
EVIDENCE = 6.0  # log likelihood ratio
SPREAD_RATIO = 3.0  # of sums of squares
BRISK_RATE, BRISK_S = 1.0, 1.0  # rad/s; s in all, of rates beyond it
CONFIRMING_TURN = 0.5  # rad, that rates must claim before they are unconfirmed
TRUST = 3.0  # log likelihood ratio of rad/s over a sensor that hardly turns, from which they never are again
CONFIRMING_WINDOWS = 2  # of the second test, after which they are not, either
TURN = 2.0 * math.pi  # rad, that rates must claim before gravity can show where it stays

RATE_UNITS = np.dtype(
    [
        ("period", "<f8"),  # s
        ("window", "<i8"),  # samples in WINDOW_S
        ("samples", "<i8"),  # with fast rates, in the present window of the first test
        ("force", "<f8", (3,)),  # m/s^2, specific force of the sample before
        ("covariance", "<f8"),  # (m/s^2)^2, sum of the products of measured and expected changes
        ("expected2", "<f8"),  # (m/s^2)^2, sums of their squares
        ("measured2", "<f8"),
        ("axes", "<f8", (16,)),  # for each of FACTORS the quaternion from the body to axes that do not turn
        ("sums", "<f8", (12,)),  # m/s^2, and the sum of the force in them
        ("force2", "<f8"),  # (m/s^2)^2, sum of its squares
        ("turn", "<f8"),  # rad, that the rates claim in the present window of the second test
        ("count", "<i8"),  # samples in it; 0: it has not begun
        ("evidence", "<f8"),  # of the windows before, at least 0
        ("degrees", "<i8"),  # 1: the rates are in deg/s
        ("unconfirmed", "<i8"),  # 1: the force does not turn as the rates say
        ("trust", "<f8"),  # log likelihood ratio of the rates as they are, of the windows before
        ("confirming_windows", "<i8"),  # that have ended; CONFIRMING_WINDOWS: they are confirmed
        ("brisk_s", "<f8"),  # s with rates beyond BRISK_RATE before the first window
    ],
    align=True,
)


def new_units(rate_hz: float) -> Any:
    """A record (array of one RATE_UNITS) for samples at this rate."""
    u = np.zeros(1, RATE_UNITS)
    u["period"], u["force"] = 1.0 / rate_hz, math.nan
    u["window"] = max(100, DECISIONS * round(WINDOW_S / DECISIONS * rate_hz))
    return u


@kernel
def is_due(u: RateUnits, samples: int) -> bool:
    """Is it time for a decision?"""
    doubled = samples >= FIRST_DECISION and samples & (samples - 1) == 0
    return bool(doubled or samples % (u.window // DECISIONS) == 0)


@kernel
def rates_are_in_degrees(u: RateUnits, sample: Any) -> bool:
    """Whether the rates are in deg/s. Call once for each sample."""
    w, f = sample.w, sample.f
    change = (f[0] - u.force[0], f[1] - u.force[1], f[2] - u.force[2])
    u.force[0], u.force[1], u.force[2] = f[0], f[1], f[2]
    rate2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    force2 = f[0] * f[0] + f[1] * f[1] + f[2] * f[2]
    is_fast = rate2 >= MIN_RATE**2
    if rate2 >= BRISK_RATE**2 and u.count == 0 and u.confirming_windows == 0:
        u.brisk_s += u.period
        u.confirming_windows = CONFIRMING_WINDOWS if u.brisk_s > BRISK_S else 0
    if (is_fast or u.count > 0) and rate2 + force2 < math.inf:
        compare_axes(u, w, f, math.sqrt(rate2), force2)
    if not is_fast or force2 > MAX_FORCE**2:
        return bool(u.degrees == 1)
    expected = (f[1] * w[2] - f[2] * w[1], f[2] * w[0] - f[0] * w[2], f[0] * w[1] - f[1] * w[0])
    covariance = expected2 = measured2 = 0.0
    for i in range(3):
        measured, expected_change = change[i], expected[i] * u.period
        covariance += measured * expected_change
        expected2 += expected_change * expected_change
        measured2 += measured * measured
    if not expected2 + measured2 < math.inf:
        return bool(u.degrees == 1)
    u.samples += 1
    u.covariance += covariance
    u.expected2 += expected2
    u.measured2 += measured2
    if is_due(u, u.samples):
        decide_by_changes(u)
    return bool(u.degrees == 1)


@kernel
def decide_by_changes(u: RateUnits) -> None:
    """The first test, with the sums of the window so far; at its end, begin a new window."""
    k = u.covariance / u.expected2
    variance = u.measured2 / (3.0 * u.samples * u.expected2)
    if DEG / MAX_RATIO < k < DEG * MAX_RATIO and k * k > SIGMAS**2 * variance:
        u.degrees = 1
    if u.samples >= u.window:
        u.samples = 0
        u.covariance = u.expected2 = u.measured2 = 0.0


@kernel
def compare_axes(u: RateUnits, w: Any, f: Any, rate: float, force2: float) -> None:
    """The second test, one sample."""
    if u.count == 0:
        u.turn = u.force2 = 0.0
        for i in range(16):
            u.axes[i] = 1.0 if i % 4 == 0 else 0.0
        for i in range(12):
            u.sums[i] = 0.0
    for k in range(4):
        time = FACTORS[k] * u.period
        q = (u.axes[4 * k], u.axes[4 * k + 1], u.axes[4 * k + 2], u.axes[4 * k + 3])
        if k != NONE:
            q = quat_normalised(quat_product(q, quat_exp(w[0] * time, w[1] * time, w[2] * time)))
            for i in range(4):
                u.axes[4 * k + i] = q[i]
        turned = quat_rotate(q, (f[0], f[1], f[2]))
        for i in range(3):
            u.sums[3 * k + i] += turned[i]
    u.force2 += force2
    u.turn += rate * u.period
    u.count += 1
    if u.confirming_windows < CONFIRMING_WINDOWS:
        confirm_rates(u)
    if is_due(u, u.count) and u.turn > TURN and u.force2 < MAX_FORCE**2 * u.count:
        decide_by_axes(u)
    if u.count >= u.window:
        u.count = 0


@kernel
def confirm_rates(u: RateUnits) -> None:
    """Does the force turn as the rates say, in the present window? At its end, and if they surely do, this is kept."""
    present = 0.0
    if u.turn > CONFIRMING_TURN and u.force2 < MAX_FORCE**2 * u.count:
        by_rates, unturned = spread(u, RADIANS), min(spread(u, NONE), spread(u, DEGREES))
        present = 0.5 * INDEPENDENT * u.count * u.period * elementary.log(unturned / by_rates)
        u.unconfirmed = 1 if by_rates > SPREAD_RATIO * unturned else 0
    if u.count >= u.window:
        u.trust += present
        u.confirming_windows += 1
        u.unconfirmed = 0
    if u.trust + present > TRUST:
        u.confirming_windows = CONFIRMING_WINDOWS
    if u.confirming_windows >= CONFIRMING_WINDOWS:
        u.unconfirmed = 0


@kernel
def spread(u: RateUnits, k: int) -> float:
    """The sum of the squared deviations of the force from its mean in the axes of factor k, (m/s^2)^2."""
    x, y, z = u.sums[3 * k], u.sums[3 * k + 1], u.sums[3 * k + 2]
    return max(u.force2 - (x * x + y * y + z * z) / u.count, 1e-12 * u.force2)


@kernel
def decide_by_axes(u: RateUnits) -> None:
    """The second test, with the evidence of the windows before and of the present one so far."""
    by_none, by_degrees, by_double, by_radians = (
        spread(u, NONE),
        spread(u, DEGREES),
        spread(u, DOUBLE),
        spread(u, RADIANS),
    )
    present = 0.0
    if by_radians > SPREAD_RATIO * by_degrees:
        components = INDEPENDENT * u.count * u.period
        present = 0.5 * components * elementary.log(min(by_none, by_double) / by_degrees)
        if u.evidence + present > EVIDENCE:
            u.degrees = 1
    elif SPREAD_RATIO * by_radians < min(by_none, by_degrees):
        u.degrees = 0
        u.evidence = 0.0
    if u.count >= u.window:
        u.evidence = max(u.evidence + present, 0.0)
