"""Whether the body rests, from the inertial sensor alone, and whether the rate it then shows may be the gyro's bias.

Rest is: for REST_S no sample far from the running means, mean rate and direction of the force unchanged since, a rate
that a bias can explain, and a force that is weight in the known attitude: else it is steady acceleration. A rate that
keeps changing, however slowly, is a smooth road and no bias.

A vehicle on a smooth road is as quiet as one that stands. Which it does, its shaking tells: roads shake a vehicle that
goes, whatever its engine does. Where its way shook it no more than its engine, the speed tells that it should have
left, none but for the errors of the integral if it stands. The longer all is even, the likelier it stands.

What seems to accelerate and yet stands, or does so evenly for longer than vehicles do, rests in a false attitude.

Steady slow rotation about the vertical looks just like a bias; it is told from one by what is known already. A mean
rate that contradicts the known bias is not taken until the growing variance of the bias allows it; unless it is the
smaller and so the likelier bias: then the body turned before and rests now. That is believed soon if the force is the
one that was seen when the bias was learnt, as on a turntable; in an even curve the force is another, and then only what
lasts longer than curves do is believed.
"""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import measure, reset
from ...kernels.rotation import Vector, dcm_of_quat, quat_rotate
from .covariance import grow, variance
from .lost import disbelieve
from .state import ACCEL_BIAS, ACCEL_SCALE, ATTITUDE, GYRO_BIAS, GYRO_MATRIX, STATES, VELOCITY
from .staying import TRAVEL, TRAVEL_S
from .strapdown import corrected_force

MEAN_S = 0.35
REST_S = 1.0
RATE_DEVIATION = 0.035  # rad/s, of a sample from the mean
FORCE_DEVIATION = 0.5  # m/s^2
TURNED = 0.1  # m/s^2, of the mean force since the quiet began
CHANGED = 6.0  # sigma, of the mean rate
GATE = 5.0  # sigma, against what is known of the bias
PLAUSIBLE = 4.0  # sigma, against what the maker promises
BIAS_FLOOR = 5e-4  # rad/s, how well a bias is ever known (warming, counts, earth rate)
FORCE_FLOOR = 0.03  # m/s^2
FALSE_WEIGHT = 2.5  # sigma
LEVEL_ANEW = 0.1  # rad
WAIT_S = 3.0
CURVE_S = 60.0  # no curve is even for so long
CALMER = 5.0  # a way is shaken by its road; the amplitudes of neighbouring classes of roads differ by 2 (ISO 8608)
GOES_ON = math.log(3.0)  # log odds of a vehicle's going on to its standing, as far as is known otherwise


@kernel
def watch(p: Any, s: Any, w: Vector, f: Vector, dt: float) -> None:
    """Count for how long samples have been near their running means; a sample that is not starts the means anew."""
    fade = dt / (min(MEAN_S, s.quiet_s + dt) + dt)
    rate2 = force2 = turned2 = changed2 = mean2 = 0.0
    for i in range(3):
        s.w_mean[i] += fade * (w[i] - s.w_mean[i])
        s.f_mean[i] += fade * (f[i] - s.f_mean[i])
        if s.quiet_s < MEAN_S:
            s.w_anchor[i], s.f_anchor[i] = s.w_mean[i], s.f_mean[i]
        rate2 += (w[i] - s.w_mean[i]) ** 2
        force2 += (f[i] - s.f_mean[i]) ** 2
        turned2 += (s.f_mean[i] - s.f_anchor[i]) ** 2
        changed2 += (s.w_mean[i] - s.w_anchor[i]) ** 2
        mean2 = max(mean2, s.w_mean[i] ** 2)
    s.quiet_s += dt
    quiet = rate2 < RATE_DEVIATION**2 and force2 < FORCE_DEVIATION**2 and turned2 < TURNED**2
    quiet = quiet and changed2 < BIAS_FLOOR**2 + CHANGED**2 * p.gyro_psd / MEAN_S
    if not quiet or mean2 > PLAUSIBLE**2 * p.gyro_bias_var:
        restart(s, w, f)


@kernel
def restart(s: Any, w: Vector, f: Vector) -> None:
    """Begin to count, with the means at these readings."""
    s.quiet_s = 0.0
    for i in range(3):
        s.w_mean[i], s.f_mean[i] = w[i], f[i]
        s.w_anchor[i], s.f_anchor[i] = w[i], f[i]


@kernel
def unexplained(s: Any) -> float:
    """The acceleration in the mean force, m/s^2, if errors of attitude and accelerometer do not explain it, else 0."""
    C = dcm_of_quat((s.q[0], s.q[1], s.q[2], s.q[3]))
    f = corrected_force(s, s.f_mean[0], s.f_mean[1], s.f_mean[2])
    n = quat_rotate((s.q[0], s.q[1], s.q[2], s.q[3]), f)
    acceleration = (n[0], n[1], n[2] + s.gravity)
    tilt = ((0.0, n[2]), (-n[2], 0.0), (n[1], -n[0]))
    for i in range(3):
        s.columns[0], s.values[0] = ATTITUDE, tilt[i][0]
        s.columns[1], s.values[1] = ATTITUDE + 1, tilt[i][1]
        for m in range(3):
            s.columns[2 + m], s.values[2 + m] = ACCEL_BIAS + m, -C[3 * i + m]
            s.columns[5 + m], s.values[5 + m] = ACCEL_SCALE + m, -C[3 * i + m] * f[m]
        known = measure(s.P, STATES, s.columns, s.values, 8, s.d) + FORCE_FLOOR**2
        if acceleration[i] * acceleration[i] > GATE**2 * known:
            return math.sqrt(acceleration[0] ** 2 + acceleration[1] ** 2 + acceleration[2] ** 2)
    return 0.0


@kernel
def calm(s: Any) -> bool:
    """Is the body shaken far less than it was while it travelled?"""
    return bool(CALMER * s.shaking < s.way_shaking)


@kernel
def stands(s: Any) -> bool:
    """Is it likelier that a body that travelled stands than that it goes on evenly, whichever way?"""
    travel2 = s.travel[0] + s.travel[1]
    if travel2 < TRAVEL**2 or calm(s):
        return True
    for i in range(2):
        still = variance(s, VELOCITY + i)
        going = still + travel2
        odds = 0.5 * (math.log(going / still) - s.v[i] * s.v[i] * (1.0 / still - 1.0 / going))
        if odds + s.quiet_s / TRAVEL_S < GOES_ON:
            return False
    return True


@kernel
def weigh(p: Any, s: Any) -> None:
    """At the first rest, see whether the accelerometer is as good as assumed."""
    s.weighed = 1
    f = s.f_mean
    excess = math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]) - s.gravity
    if excess * excess < FALSE_WEIGHT**2 * (p.accel_bias_var + s.gravity * s.gravity * p.accel_scale_var):
        return
    for i in range(3):
        grow(s, ACCEL_BIAS + i, p.accel_bias_doubt)
        grow(s, ACCEL_SCALE + i, p.accel_scale_doubt)
    for i in range(9):
        grow(s, GYRO_MATRIX + i, p.gyro_matrix_doubt)
    if p.accel_bias_doubt > 0.0:
        for i in range(2):
            grow(s, ATTITUDE + i, LEVEL_ANEW**2)


@kernel
def contradicts(s: Any) -> bool:
    """Is the mean rate not the bias that is known?"""
    for i in range(3):
        d = s.w_mean[i] - s.bg[i]
        if d * d > GATE**2 * (variance(s, GYRO_BIAS + i) + BIAS_FLOOR**2):
            return True
    return False


@kernel
def turned_before(s: Any) -> bool:
    """Is the mean rate, which contradicts the known bias, the likelier one, and has been for long enough?"""
    known2 = shown2 = moved2 = 0.0
    for i in range(3):
        known2 += s.bg[i] ** 2
        shown2 += s.w_mean[i] ** 2
        moved2 += (s.f_mean[i] - s.f_rest[i]) ** 2
    return shown2 < known2 and s.contradicted_s > (WAIT_S if moved2 < TURNED**2 else CURVE_S)


@kernel
def judge(p: Any, s: Any) -> bool:
    """Is this rest, with a mean rate that may correct the gyro bias? To be asked once per covariance interval."""
    s.resting = 0
    if s.quiet_s < REST_S:
        s.contradicted_s = 0.0
        return False
    if s.weighed == 0:
        weigh(p, s)
    turns = contradicts(s)
    acceleration = unexplained(s)
    if acceleration > 0.0 and not turns and s.quiet_s > (WAIT_S if calm(s) else TRAVEL_S):
        disbelieve(p, s, acceleration)
        restart(s, (s.w[0], s.w[1], s.w[2]), (s.f[0], s.f[1], s.f[2]))
    if acceleration > 0.0 or not stands(s):
        return False
    if not turns:
        if s.contradicted_s > 0.0:  # the rate has just changed
            restart(s, (s.w[0], s.w[1], s.w[2]), (s.f[0], s.f[1], s.f[2]))
            s.contradicted_s = 0.0
            return False
        s.resting = 1
        for i in range(3):
            s.f_rest[i] = s.f_mean[i]
        return True
    s.contradicted_s += s.span
    if turned_before(s):
        for i in range(3):
            reset(s.P, STATES, GYRO_BIAS + i, p.gyro_bias_var)
    return False
