"""Levelling: roll and pitch from the specific force, during coarse alignment.

The mean specific force is a measurement of gravity. Its sigma is that of rest, or of the acceleration measured by the
receiver, or of the acceleration of any vehicle. Between two measurements the gyro propagates the attitude, and the
gyro bias is estimated at the same time.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.earth import gravity
from ...tuning import Tunable
from ..ekf import (
    add_correction,
    add_covariance,
    add_variance,
    innovation_variance,
    set_jacobian,
    set_jacobian3,
    variance,
)
from ..fusion import NO_GATE, correct_state, gated_update
from ..mechanization import ned_to_body, rotation_matrix
from ..state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS

if TYPE_CHECKING:
    from ....math.rotation import Matrix
    from ..types import Core, Parameters


TUNABLES = (
    Tunable(
        "level_rest_sigma",
        0.02,
        "m/s^2",
        "Sigma of the mean specific force at rest as a measurement of gravity.",
        "Choice.",
    ),
    Tunable(
        "level_gnss_sigma", 0.3, "m/s^2", "Acceleration that a receiver's velocity does not show.", "Recorded drives."
    ),
    Tunable(
        "level_max_accel",
        1.0,
        "m/s^2",
        "Measured acceleration beyond which a pair levels only a tilt that is known less well: a turn lasts.",
        "levelled_sigma times gravity.",
    ),
    Tunable(
        "level_pair_age_s",
        3.0,
        "s",
        "Age up to which pairs of fixes level the frame instead of windows.",
        "Three fixes of a 1 Hz receiver.",
    ),
    Tunable(
        "level_vertical_sigma",
        0.03,
        "m/s^2",
        "Floor of the bias sigma that is learned from the vertical force.",
        "Gravity times half the square of a tilt.",
    ),
    Tunable(
        "level_motion_sigma",
        1.0,
        "m/s^2",
        "Sigma of the acceleration of a vehicle.",
        "Recorded vehicles: cars have 0.5 to 0.8, aircraft 2 to 3 m/s^2.",
    ),
    Tunable(
        "level_accel_time_s",
        1.0,
        "s",
        "Time constant of the acceleration of a vehicle.",
        "Choice: the median of vehicles is 2 s; with more than 1 s headings come later.",
    ),
    Tunable("level_gate", 25.0, "NIS", "Gate of a level force, beyond which P is inflated.", "Five sigma."),
    Tunable("level_turn_speed", 20.0, "m/s", "Speed assumed for the centripetal force of a turn.", "Choice."),
)


@kernel
def tilt_jacobian(c: Core, length: int, C_nb: Matrix, axis: int, gain: float, ago: float) -> int:
    """Append to the Jacobian the tilt about `axis` (0 north, 1 east) `ago` s ago, times `gain`; returns its length.

    The tilt then is the tilt now plus `ago` times the gyro bias error in navigation axes. length: of it so far.
    """
    for j in range(3):
        length = set_jacobian(c, length, GYRO_BIAS + j, gain * ago * C_nb[3 * axis + j])
    return set_jacobian(c, length, ATTITUDE + axis, gain)


@kernel
def share_excess(p: Parameters, c: Core, length: int, z: float, r: float, axis: int) -> float:
    """Inflate P for a level force z beyond its gate, in motion, along axis (0 north, 1 east).

    The tilt or the acceleration, of variance r, is larger than stated; each gets half of the excess. Returns that of
    the acceleration, m^2/s^4.
    """
    s = innovation_variance(c, length) + r
    if z * z < p.tuning.level_gate * s:
        return 0.0
    half, g = 0.5 * (z * z - s), gravity(c.nav.lat, c.nav.height)
    add_variance(c, ATTITUDE + 1 - axis, half / (g * g))
    for i in range(3):
        v = variance(c, GYRO_BIAS + i)
        if v > 0.25 * p.gyro_bias_sigma**2:
            add_variance(c, GYRO_BIAS + i, max(p.gyro_bias_wide**2 - v, 0.0))
    return half


@kernel
def widen_accel_bias(p: Parameters, c: Core, C_nb: Matrix, excess: float) -> None:
    """At the first rest: a force beyond gravity by `excess`, m/s^2, may show an accelerometer worse than its profile.

    The three of one sensor are alike: the excess is one observation of the variance of their biases, of as much weight
    as the profile's.
    """
    prior, length = p.accel_bias_sigma**2, set_jacobian3(c, 0, ACCEL_BIAS, (C_nb[6], C_nb[7], C_nb[8]))
    if excess * excess > prior and innovation_variance(c, length) > 0.5 * prior:
        for j in range(3):
            add_variance(c, ACCEL_BIAS + j, 0.5 * (excess * excess - prior))


@kernel
def keep_vertical_bias(c: Core, C_nb: Matrix, z: float, s: float) -> None:
    """Take back what the last update, of innovation z and variance s, has learned of the vertical gyro bias.

    While the heading is unknown a level force shows nothing of it: that it seems to comes of a wrong tilt, about which
    the model is linear. (Schmidt's filter: the bias is considered, not estimated.)
    """
    part = 0.0
    for i in range(3):
        part += C_nb[6 + i] * c.scratch.d[GYRO_BIAS + i]
    for i in range(3):
        add_correction(c, GYRO_BIAS + i, -C_nb[6 + i] * part * z / s)
        for j in range(i, 3):
            add_covariance(c, GYRO_BIAS + i, GYRO_BIAS + j, C_nb[6 + i] * C_nb[6 + j] * part * part / s)


@kernel
def lasting_accel_factor(p: Parameters, c: Core) -> float:
    """By how much the variance of a mean acceleration now counts more, since the last one had much of it, too.

    Of a first-order Gauss-Markov process, whose successive values correlate by k, many show as much as a share of
    (1 - k) / (1 + k) independent ones.
    """
    since_s = max(1e-9 * (c.nav.t_ns - c.alignment.level_accel_ns), 1e-3)
    c.alignment.level_accel_ns = c.nav.t_ns
    correlation = elementary.exp(-since_s / p.tuning.level_accel_time_s)
    return float((1.0 + correlation) / (1.0 - correlation))


@kernel
def fuse_gravity(
    p: Parameters, c: Core, fx: float, fy: float, fz: float, ago: float, accel: float, noise: float, axes: int
) -> None:
    """Fuse a mean specific force (fx, fy, fz; m/s^2, NED) as minus gravity, on the first `axes` axes.

    Sigmas, m/s^2: accel, of an acceleration, which lasts; noise, of what is independent from one mean to the next. The
    mean belongs to a time `ago` s in the past; since then the gyro bias error has changed the tilt.
    """
    C_nb, g, resting = rotation_matrix(c), gravity(c.nav.lat, c.nav.height), c.stationarity.at_rest != 0
    norm = math.sqrt(fx * fx + fy * fy + fz * fz)
    factor = 1.0
    if resting:
        widen_accel_bias(p, c, C_nb, norm - g)
    else:
        factor = lasting_accel_factor(p, c)
    for i in range(axes):
        # d (C f + phi x C f - C ba) = d (0, 0, -g) along a direction d; the heading error has no effect on it. North
        # and east: phi turns gravity, not the measured force, whose bias would make the filter inconsistent.
        dn, de, dd, length = 0.0, 0.0, 0.0, 0
        if i == 0:
            dn, z = 1.0, -fx
            length = tilt_jacobian(c, length, C_nb, 1, -g, ago)
        elif i == 1:
            de, z = 1.0, -fy
            length = tilt_jacobian(c, length, C_nb, 0, g, ago)
        elif resting and norm > 0.5 * g:  # the magnitude, which no tilt changes
            dn, de, dd, z = -fx / norm, -fy / norm, -fz / norm, norm - g
        else:
            dd, z = 1.0, -g - fz
            length = set_jacobian(c, length, ATTITUDE, fy)
            length = set_jacobian(c, length, ATTITUDE + 1, -fx)
        for j in range(3):
            length = set_jacobian(c, length, ACCEL_BIAS + j, -(dn * C_nb[j] + de * C_nb[3 + j] + dd * C_nb[6 + j]))
        if i == 2 and innovation_variance(c, length) < p.tuning.level_vertical_sigma**2:
            continue
        r = factor * accel * accel + noise * noise
        if i < 2 and not resting:
            r += share_excess(p, c, length, z, accel * accel + noise * noise, i)
        z, s, nis = gated_update(c, length, z, r, NO_GATE)
        if nis >= 0.0:
            keep_vertical_bias(c, C_nb, z, s)
    correct_state(p, c)


@kernel
def level_from_window(p: Parameters, c: Core, resting: bool) -> None:
    """Fuse the mean specific force of a stationarity window (call at its end, before it is cleared).

    In motion, with fixes, the velocity changes between fixes are more accurate: `level_from_velocity_change`.
    """
    if not resting and 1e-9 * (c.nav.t_ns - c.alignment.pair_start_ns) <= p.tuning.level_pair_age_s:
        return
    accel, noise = 0.0, p.tuning.level_rest_sigma
    if not resting:
        down, w = ned_to_body(c, (0.0, 0.0, 1.0)), c.imu.rate_b
        turn_rate = down[0] * w[0] + down[1] * w[1] + down[2] * w[2]
        accel, noise = elementary.hypot(p.tuning.level_motion_sigma, p.tuning.level_turn_speed * turn_rate), 0.0
    dv, dt = c.stationarity.delta_v, c.stationarity.duration
    fuse_gravity(p, c, dv[0] / dt, dv[1] / dt, dv[2] / dt, 0.5 * dt, accel, noise, 3)


@kernel
def level_from_velocity_change(p: Parameters, c: Core, fn: float, fe: float, dt: float, accel: float) -> None:
    """Fuse the mean level specific force (fn, fe; m/s^2, NED) of the last `dt` s as gravity.

    accel: m/s^2, magnitude of the acceleration that the receiver measured; its direction is not known yet.
    """
    g, noise = gravity(c.nav.lat, c.nav.height), p.tuning.level_gnss_sigma
    tilt2 = max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1))
    lasts = accel > p.tuning.level_max_accel and tilt2 * g * g < accel * accel + noise * noise
    if not c.stationarity.at_rest and not lasts:
        fuse_gravity(p, c, fn, fe, -g, 0.5 * dt, accel, noise, 2)
