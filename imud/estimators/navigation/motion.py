"""Windows of half a second over the inertial data: is the sensor quiet, how strongly does it vibrate, is it at rest?

Quiet alone is not rest: at constant speed a smooth car is nearly as quiet as a parked one. Rest needs the quiet of
the quietest time seen, a mean rate that is the bias, and a speed, from a fresh fix or from the filter, near zero.
Where no speed is known, as in the first seconds of a start under way, the quietest time seen may itself be motion:
there only a stillness will do that no vehicle under way has. In an outage the speed is known less and less: there
the quiet is compared with what this vehicle has shown at rest and in slow motion while its speed was known.
"""

import math
from typing import Any

from ...kernels.earth import STANDARD_GRAVITY
from ...kernels.jit import kernel
from ...kernels.rotation import dcm_of_quat
from .correction import predicted, row
from .covariance import variance
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, NAVIGATING, VELOCITY

WINDOW_S = 0.5
QUIET = 3.0  # times the quietest gyro deviation seen
QUIET_ACCEL = 0.35  # m/s^2, an idling engine
STILL_ACCEL = 0.05  # m/s^2, parked; a smooth car that creeps has 0.06 to 0.1
CALMING = 0.95  # per window: the most fitful motion is forgotten within some ten seconds
FLOOR_GROWTH = 1.001  # per window: the quietest is forgotten within some ten minutes
VIBRATION = 0.005  # share of the vibration's power that acts as white noise
JOLT = 0.05  # m/s^2, sample to sample, of a vehicle under way
FRESH_S = 2.0
REST_SPEED = 0.3  # m/s, three sigma of a receiver's speed at rest
LONG_QUIET = 10  # windows, enough when no speed is known
REST_VARIANCE, LONG_REST_VARIANCE = 0.5, 10.0  # m^2/s^2, a velocity less certain than that cannot tell rest
REST_RATE = 0.003  # rad/s beyond the uncertainty of the bias
REST_ACCEL = 0.15  # m/s^2 beyond what tilt and bias may be wrong: less is no braking
UNDER_WAY = (0.5, 5.0)  # m/s, slow motion: what rest could be mistaken for
MANNER_MEMORY, MANNER_LEAST = 0.01, 20.0  # per window; windows before a manner is known
MANNER_SPREAD = 0.25  # least standard deviation of the logarithm
WEIGHT, SURE = 0.25, 3.0  # neighbouring windows are not independent; log likelihood ratio


@kernel
def gather(c: Any, w: Any, f: Any) -> None:
    """Add one sample (body axes), before it replaces c.w and c.f; time and force in NED are the strapdown's to add."""
    for i in range(3):
        c.sum_w[i] += w[i]
        c.sum_f[i] += f[i]
        c.sum_w2 += w[i] * w[i]
        c.sum_f2 += f[i] * f[i]
        c.sum_jump2[0] += (w[i] - c.w[i]) ** 2
        c.sum_jump2[1] += (f[i] - c.f[i]) ** 2
    c.n += 1


@kernel
def clear(c: Any) -> None:
    """Begin a new window."""
    c.n = 0
    c.elapsed = 0.0
    c.sum_w2 = 0.0
    c.sum_f2 = 0.0
    for i in range(3):
        c.sum_w[i] = 0.0
        c.sum_f[i] = 0.0
        c.sum_n[i] = 0.0
    for i in range(2):
        c.sum_jump2[i] = 0.0


@kernel
def judge(p: Any, c: Any) -> None:
    """At the end of a window: vibration densities, and how many windows in a row were quiet."""
    w2 = c.sum_w2 / c.n
    f2 = c.sum_f2 / c.n
    turned, pushed = 0.0, 0.0
    for i in range(3):
        mean_w, mean_f = c.sum_w[i] / c.n, c.sum_f[i] / c.n
        w2 -= mean_w * mean_w
        f2 -= mean_f * mean_f
        turned = max(turned, abs(mean_w - c.mean_w[i]))
        pushed = max(pushed, abs(mean_f - c.mean_f[i]))
        c.mean_w[i], c.mean_f[i] = mean_w, mean_f
    if c.floor > 0.0:  # not the first window
        c.fitful[0] = max(CALMING * c.fitful[0], turned**2 / c.elapsed)
        c.fitful[1] = max(CALMING * c.fitful[1], pushed**2 / c.elapsed)
    deviation = math.sqrt(max(w2, 0.0))
    dt = c.elapsed / c.n
    c.vibration_gyro = VIBRATION * c.sum_jump2[0] / (6.0 * c.n) * dt
    jolt2 = max(c.sum_jump2[1] / (6.0 * c.n) - 2.0 * p.accel_psd / dt, 0.0)
    c.vibration_accel = VIBRATION * jolt2 * dt
    c.shaking = jolt2 / (jolt2 + JOLT**2)
    least = math.sqrt(3.0 * p.gyro_psd / dt)
    if c.floor <= 0.0:
        c.floor = deviation
    c.floor = max(min(c.floor * FLOOR_GROWTH, deviation), least)
    even = turned < REST_RATE + c.floor and pushed < REST_ACCEL
    quiet = deviation < QUIET * c.floor and f2 < QUIET_ACCEL**2 and even
    c.quiet = c.quiet + 1 if quiet else 0
    c.still = c.still + 1 if quiet and f2 < STILL_ACCEL**2 else 0
    weigh(c, math.log(max(deviation, least)))


@kernel
def weigh(c: Any, x: float) -> None:
    """Learn the log deviation x of this window where the speed is known, and gather evidence of rest elsewhere."""
    known = c.fixes > 0 and 1e-9 * (c.t_ns - c.fix_ns) < FRESH_S
    speed = math.hypot(c.v[0], c.v[1]) if c.phase == NAVIGATING and not c.fix_speed >= 0.0 else c.fix_speed
    if known and speed < UNDER_WAY[1]:
        if speed < REST_SPEED and c.quiet > 1:
            learn(c.manner[0], x)
        elif speed > UNDER_WAY[0]:
            learn(c.manner[1], x)
    ratio = 0.0
    if min(c.manner[0, 0], c.manner[1, 0]) >= MANNER_LEAST:
        ratio = likelihood(c.manner[0], x) - likelihood(c.manner[1], x)
    c.evidence = c.evidence + WEIGHT * min(max(ratio, -2.0), 2.0) if c.quiet > 1 else 0.0


@kernel
def learn(manner: Any, x: float) -> None:
    """Count, mean and variance of x, of which the past is slowly forgotten."""
    manner[0] += 1.0
    share = max(1.0 / manner[0], MANNER_MEMORY)
    left = x - manner[1]
    manner[1] += share * left
    manner[2] += share * ((1.0 - share) * left * left - manner[2])


@kernel
def likelihood(manner: Any, x: float) -> float:
    """Logarithm of the normal density, but for its constant."""
    variance = max(manner[2], MANNER_SPREAD**2)
    return float(-0.5 * ((x - manner[1]) ** 2 / variance + math.log(variance)))


@kernel
def slow(c: Any) -> bool:
    """Whether nothing known of the speed speaks against rest."""
    fresh = c.fixes > 0 and 1e-9 * (c.t_ns - c.fix_ns) < FRESH_S
    known = fresh and c.fix_speed >= 0.0
    if known and c.fix_speed > REST_SPEED:
        return False
    if c.phase != NAVIGATING:
        return bool(known or c.still > LONG_QUIET)
    speed2 = c.v[0] ** 2 + c.v[1] ** 2 + c.v[2] ** 2
    s2 = max(variance(c, VELOCITY), variance(c, VELOCITY + 1))
    return bool(
        (known and speed2 < 1.0 + 9.0 * s2)
        or (speed2 < REST_SPEED**2 and s2 < (LONG_REST_VARIANCE if c.quiet > LONG_QUIET else REST_VARIANCE))
        or (fresh and not known and c.still > LONG_QUIET and speed2 < REST_SPEED**2 + 9.0 * s2)
        or (c.evidence > SURE and speed2 < REST_SPEED**2 + 9.0 * s2 and s2 < LONG_REST_VARIANCE)
    )


@kernel
def confirmed(c: Any) -> bool:
    """Whether the receiver's own speed says rest, too."""
    return bool(c.fix_speed <= REST_SPEED and 1e-9 * (c.t_ns - c.fix_ns) < FRESH_S)


@kernel
def rest_rate(c: Any, i: int) -> float:
    """Most mean rate about axis i, less the bias estimated, that may be rest, rad/s."""
    return REST_RATE + 3.0 * math.sqrt(variance(c, GYRO_BIAS + i))


@kernel
def level_force(c: Any, axis: int) -> float:
    """Variance, m^2/s^4, of the level specific force for what tilt and bias may contribute: a rest ties the two."""
    m = dcm_of_quat((c.q[0], c.q[1], c.q[2], c.q[3]))
    k = row(c, 0, ATTITUDE + 1 - axis, STANDARD_GRAVITY if axis == 1 else -STANDARD_GRAVITY)
    for j in range(3):
        k = row(c, k, ACCEL_BIAS + j, -m[3 * axis + j])
    return predicted(c, k)


@kernel
def unaccelerated(c: Any) -> bool:
    """Whether the mean specific force of the window is gravity, but for what tilt and bias may contribute."""
    most = REST_ACCEL + 3.0 * math.sqrt(max(level_force(c, 0), level_force(c, 1)))
    return bool(math.hypot(c.sum_n[0], c.sum_n[1]) < most * c.elapsed)


@kernel
def at_rest(c: Any) -> bool:
    """Whether the last two windows at least were at rest."""
    if c.quiet < 2 or not slow(c):
        return False
    if c.still > LONG_QUIET and confirmed(c):
        return True  # whatever tilt and biases: they are wrong if they contradict
    if not unaccelerated(c):
        return False
    for i in range(3):
        if abs(c.mean_w[i] - c.bg[i]) > rest_rate(c, i):
            return False
    return True
