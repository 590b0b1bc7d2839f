"""Boresights: constant angles by which a heading source, and a velocity sensor, are mounted off, as error states.

Two antennas, or a compass, are mounted by eye, and a settings file has the angle for which they were meant. A heading
that starts navigation is off by that angle, and so is the yaw; course and accelerations show it later. A sensor that
measures the velocity in its own axes is turned about all three of them. So the boresights b, of the heading and about
x, y and z of the velocity sensor, are estimated with their covariance with the error states x. P is the covariance of
x as without them; beside P are

    C = cov(x, b) and M = cov(b):    C <- T C (T: the transition matrix),    M <- M + Q dt,

and at a scalar update of Jacobians h of x and B of b (0 of most measurements), with innovation z of variance s,

    d = P h + C B,    e = C' h + M B,    x += d z / s,    b += e z / s,
    P <- P - d d' / s,    C <- C - d e' / s,    M <- M - e e' / s.

That is the Kalman filter of (x, b). Without a source its part of M is 0, and nothing of it is computed. A boresight of
a heading of more than some sigmas is no boresight: see `glr_tests.compass_offset`. B of a velocity u in the sensor's
axes: turned by a small angle b, the sensor shows u + u x b.

Source: Schmidt, Application of state-space methods to navigation problems (1966); Bierman (1977), sec. VIII.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from imud.drivers import elementary

from ...compile.jit import kernel
from ...math.lanes import subtract_scaled
from ...math.rotation import Quaternion, Vector, quat_exp, quat_product, quat_renormalised, quat_rotate_back
from ..tuning import Tunable
from .ekf import add_variance
from .error_model import apply_transition
from .state import (
    ATTITUDE,
    BODY_VELOCITY_AXIS,
    BORESIGHTS,
    COMPASS_AXIS,
    HEADING_BORESIGHT,
    NAVIGATING,
    STATES,
    VELOCITY_BORESIGHT,
)

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from .types import Core, Parameters, Transition

TUNABLES = (
    Tunable(
        "unknown_boresight_sigma",
        math.radians(3.0),
        "rad",
        "Sigma of a boresight of which the settings do not say it, or that motion has contradicted.",
        "Choice: mounting by eye.",
    ),
    Tunable(
        "heading_boresight_psd",
        math.radians(0.02) ** 2,
        "rad^2/s",
        "Random walk of a heading source's boresight, by load, bending and iron.",
        "As mount_psd.",
    ),
    Tunable(
        "velocity_boresight_sigma",
        math.radians(20.0),
        "rad",
        "Sigma of the angle about the vehicle's vertical by which a velocity sensor is turned, beyond the settings.",
        "Choice: as the forward axis of an odometer; motion shows it within seconds.",
    ),
    Tunable(
        "velocity_boresight_tilt_sigma",
        math.radians(3.0),
        "rad",
        "Sigma of the angle about each level axis by which a velocity sensor is turned, beyond the settings.",
        "As unknown_boresight_sigma: what is not level is seen, and a reversed axis is no tilt.",
    ),
    Tunable(
        "max_velocity_boresight",
        math.radians(60.0),
        "rad",
        "Largest turn of a velocity sensor beyond the settings that is believed.",
        "Three sigma: beyond it are other axes, as forward, left, up.",
        high=3.0,
    ),
    Tunable(
        "velocity_boresight_psd",
        math.radians(0.05) ** 2,
        "rad^2/s",
        "Random walk of the angles by which a velocity sensor is turned: its calibration, load and bending.",
        "Choice: 0.4 deg in a minute.",
    ),
)


@kernel
def is_estimated(c: Core, j: int) -> bool:
    """Whether boresight j is; all that belongs to one that is not is 0."""
    return bool(c.cov.boresight_covariance[j, j] > 0.0)


@kernel
def any_boresight(c: Core) -> bool:
    """Whether any is estimated. Then all are computed: beside each other, four cost as much as one."""
    return is_estimated(c, HEADING_BORESIGHT) or is_estimated(c, VELOCITY_BORESIGHT)


@kernel
def forget(c: Core, j: int) -> None:
    """Nothing is correlated with boresight j, and it is not estimated."""
    for i in range(STATES):
        c.cov.boresight[i, j] = 0.0
    for k in range(BORESIGHTS):
        c.cov.boresight_covariance[j, k] = c.cov.boresight_covariance[k, j] = 0.0


# the heading's


@kernel
def heading_boresight_variance(c: Core) -> float:
    """Variance of the heading's boresight, rad^2; 0 while no headings are used."""
    return float(c.cov.boresight_covariance[HEADING_BORESIGHT, HEADING_BORESIGHT])


@kernel
def set_heading_row(c: Core) -> None:
    """scratch.boresight_row <- B of a heading."""
    for j in range(BORESIGHTS):
        c.scratch.boresight_row[j] = 1.0 if j == HEADING_BORESIGHT else 0.0


@kernel
def prior_variance(p: Parameters, c: Core) -> float:
    """Variance of the boresight before it is estimated, rad^2: that of the settings, unless motion contradicted it."""
    sigma = p.heading_boresight_sigma if p.heading_boresight_sigma > 0.0 else p.tuning.unknown_boresight_sigma
    return float(max(sigma * sigma, c.heading_aid.boresight_prior))


@kernel
def add_boresight_variance(c: Core, variance: float) -> None:
    """While headings are used: the boresight is known less well by this variance, rad^2."""
    if heading_boresight_variance(c) > 0.0:
        c.cov.boresight_covariance[HEADING_BORESIGHT, HEADING_BORESIGHT] += variance


@kernel
def begin_boresight(p: Parameters, c: Core) -> None:
    """A heading comes: its boresight is estimated from now on."""
    if heading_boresight_variance(c) == 0.0:
        c.heading_aid.boresight_prior = prior_variance(p, c)
        c.cov.boresight_covariance[HEADING_BORESIGHT, HEADING_BORESIGHT] = c.heading_aid.boresight_prior


@kernel
def widen_boresight_prior(p: Parameters, c: Core) -> float:
    """Motion contradicts the boresight that was stated: nothing is known of it. Returns the added variance, rad^2."""
    g = c.heading_aid
    before = g.boresight_prior
    g.boresight_prior = max(before, p.tuning.unknown_boresight_sigma**2)
    return float(g.boresight_prior - before)


@kernel
def forget_boresight(p: Parameters, c: Core) -> None:
    """The headings are not used any more; what they have done to the error states is in P."""
    widen_boresight_prior(p, c)
    c.heading_aid.boresight = 0.0
    forget(c, HEADING_BORESIGHT)


@kernel
def share_boresight(c: Core) -> None:
    """The yaw has just been set to a heading: it has the error of the boresight."""
    variance = heading_boresight_variance(c)
    for i in range(STATES):
        c.cov.boresight[i, HEADING_BORESIGHT] = 0.0
    c.cov.boresight[ATTITUDE + 2, HEADING_BORESIGHT] = -variance
    add_variance(c, ATTITUDE + 2, variance)


@kernel
def set_opened_variance(c: Core, variance: float) -> None:
    """So much of the headings' deviation, rad^2, P has; none when the heading is anew that of a compass."""
    c.heading_aid.opened_variance = variance


@kernel
def widen_unused_boresight(p: Parameters, c: Core) -> None:
    """No heading has been used, so that nothing is correlated with the boresight: nothing is known of it."""
    c.cov.boresight_covariance[HEADING_BORESIGHT, HEADING_BORESIGHT] += widen_boresight_prior(p, c)


@kernel
def reopen_boresight(c: Core, off: float) -> None:
    """The compass has turned, or iron came near it: of its boresight only is known that it is off by so much, rad."""
    forget(c, HEADING_BORESIGHT)
    c.cov.boresight_covariance[HEADING_BORESIGHT, HEADING_BORESIGHT] = off * off


# the velocity sensor's


@kernel
def sensor_axes(c: Core) -> Quaternion:
    """From the axes of the velocity sensor to the body's, as far as it is known."""
    q = c.nav.velocity_mount
    return q[0], q[1], q[2], q[3]


@kernel
def begin_velocity_boresight(p: Parameters, c: Core) -> None:
    """A velocity in the sensor's own axes comes: how it is turned is estimated from now on."""
    M = c.cov.boresight_covariance
    if is_estimated(c, VELOCITY_BORESIGHT):
        return
    for i in range(4):
        c.nav.velocity_mount[i] = p.velocity_mount[i]
    down, tilt2 = quat_rotate_back(sensor_axes(c), (0.0, 0.0, 1.0)), p.tuning.velocity_boresight_tilt_sigma**2
    for j in range(3):
        for k in range(3):
            yaw2 = (p.tuning.velocity_boresight_sigma**2 - tilt2) * down[j] * down[k]
            M[VELOCITY_BORESIGHT + j, VELOCITY_BORESIGHT + k] = yaw2 + (tilt2 if j == k else 0.0)


@kernel
def forget_velocity_boresight(c: Core) -> None:
    """What shows how the velocity sensor is turned, the heading or its own velocities, was wrong."""
    for j in range(VELOCITY_BORESIGHT, BORESIGHTS):
        forget(c, j)


@kernel
def is_turned_too_far(p: Parameters, c: Core) -> bool:
    """Whether the velocity sensor seems to be turned by more than its mounting explains: its axes are others."""
    half = 0.0  # cosine of half the angle
    for i in range(4):
        half += p.velocity_mount[i] * c.nav.velocity_mount[i]
    return abs(half) < elementary.cos(0.5 * p.tuning.max_velocity_boresight)


@kernel
def set_velocity_row(c: Core, u: Vector, i: int) -> float:
    """scratch.boresight_row <- B of component i of a velocity u in the sensor's axes.

    Returns the variance of what is not linear in it: half the angle times the linear part.
    """
    row, M = c.scratch.boresight_row, c.cov.boresight_covariance
    x = (0.0, u[2], -u[1])
    y = (-u[2], 0.0, u[0])
    z = (u[1], -u[0], 0.0)
    row[HEADING_BORESIGHT] = 0.0
    row[VELOCITY_BORESIGHT], row[VELOCITY_BORESIGHT + 1], row[VELOCITY_BORESIGHT + 2] = x[i], y[i], z[i]
    turned2 = 0.0
    for k in range(3):  # of all three components
        a = (x[k], y[k], z[k])
        for j in range(3):
            for l in range(3):  # noqa: E741 as in the literature
                turned2 += a[j] * M[VELOCITY_BORESIGHT + j, VELOCITY_BORESIGHT + l] * a[l]
    angle2 = 0.0
    for j in range(VELOCITY_BORESIGHT, BORESIGHTS):
        angle2 += M[j, j]
    return float(0.25 * angle2 * turned2)


@kernel
def turn_velocity_mount(c: Core, x: float, y: float, z: float) -> None:
    """The velocity sensor is turned by these small angles, rad, about its own axes, beyond the estimate."""
    q = quat_renormalised(quat_product(sensor_axes(c), quat_exp(x, y, z)))
    for i in range(4):
        c.nav.velocity_mount[i] = q[i]


# of both


@kernel
def propagate_boresights(p: Parameters, c: Core, transition: Transition) -> None:
    """C and M over the interval of a transition."""
    if c.alignment.mode != NAVIGATING or not any_boresight(c):
        return
    apply_transition(c.cov.boresight, BORESIGHTS, transition)
    for j in range(BORESIGHTS):
        if is_estimated(c, j):
            psd = p.tuning.heading_boresight_psd if j == HEADING_BORESIGHT else p.tuning.velocity_boresight_psd
            c.cov.boresight_covariance[j, j] += psd * transition.interval


@kernel
def has_boresight(axis: int) -> bool:
    """Whether B of a measurement is in scratch.boresight_row; axis: see `fusion.fuse`."""
    return axis in (COMPASS_AXIS, BODY_VELOCITY_AXIS)


@kernel
def covariances_with_boresights(c: Core, length: int, factor: float, measured: bool, e: Reals) -> None:
    """e <- factor C' h, and M B if it is measured; the Jacobian has `length` elements, B is in scratch."""
    for j in range(BORESIGHTS):
        e[j] = 0.0
    for k in range(length):
        for j in range(BORESIGHTS):
            e[j] += factor * c.scratch.values[k] * c.cov.boresight[c.scratch.columns[k], j]
    if measured:
        for j in range(BORESIGHTS):
            for k in range(BORESIGHTS):
                e[j] += c.cov.boresight_covariance[j, k] * c.scratch.boresight_row[k]


@kernel
def boresight_part(c: Core, length: int) -> float:
    """2 B' C' h + B' M B: what boresights add to h P h'; the Jacobian has `length` elements, B is in scratch."""
    part = 0.0
    e = np.empty(BORESIGHTS)
    covariances_with_boresights(c, length, 2.0, True, e)
    for j in range(BORESIGHTS):
        part += c.scratch.boresight_row[j] * e[j]
    return float(part)


@kernel
def add_boresights(c: Core, length: int, axis: int) -> float:
    """Add C B to P h in scratch.d; returns what boresights add to the variance of the innovation."""
    if not has_boresight(axis):
        return 0.0
    for i in range(STATES):
        for j in range(BORESIGHTS):
            c.scratch.d[i] += c.scratch.boresight_row[j] * c.cov.boresight[i, j]
    return boresight_part(c, length)


@kernel
def compute_boresight_gain(c: Core, length: int, s: float, axis: int) -> None:
    """scratch.boresight_e <- e, scratch.boresight_gain <- e / s; s, axis: see `fusion.fuse`."""
    if any_boresight(c):
        covariances_with_boresights(c, length, 1.0, has_boresight(axis), c.scratch.boresight_e)
        for j in range(BORESIGHTS):
            c.scratch.boresight_gain[j] = c.scratch.boresight_e[j] / s


@kernel
def correct_boresights(c: Core, a: float) -> None:
    """Correct b by a times scratch.boresight_e."""
    e = c.scratch.boresight_e
    c.heading_aid.boresight += a * e[HEADING_BORESIGHT]
    if is_estimated(c, VELOCITY_BORESIGHT):
        turn_velocity_mount(c, a * e[VELOCITY_BORESIGHT], a * e[VELOCITY_BORESIGHT + 1], a * e[VELOCITY_BORESIGHT + 2])


@kernel
def remove_drift_from_boresights(c: Core, column: int, d: tuple[float, float], nn: float, ne: float, ee: float) -> None:
    """What `fault_sensitivity.remove_drift` does to the error states, of the boresights: b, C and M."""
    v, w, e = c.faults.sensitivity, c.faults.boresight_sensitivity, c.scratch.boresight_e
    for j in range(BORESIGHTS):
        e[j] = 0.0
        if not is_estimated(c, j):
            continue
        a = nn * w[j, column] + ne * w[j, column + 1]
        b = ne * w[j, column] + ee * w[j, column + 1]
        for i in range(STATES):
            c.cov.boresight[i, j] += a * v[i, column] + b * v[i, column + 1]
        for k in range(BORESIGHTS):
            if is_estimated(c, k):
                c.cov.boresight_covariance[j, k] += a * w[k, column] + b * w[k, column + 1]
        e[j] = -(w[j, column] * d[0] + w[j, column + 1] * d[1])
    correct_boresights(c, 1.0)


@kernel
def update_boresights(c: Core, z: float, s: float) -> None:
    """b, C and M by an innovation z of variance s; d, e and e / s are in scratch."""
    if not any_boresight(c):
        return
    e, gain, M = c.scratch.boresight_e, c.scratch.boresight_gain, c.cov.boresight_covariance
    for i in range(STATES):
        if c.scratch.d[i] != 0.0:
            subtract_scaled(c.cov.boresight, i, gain, c.scratch.d[i])
    for j in range(BORESIGHTS):
        variance = M[j, j]
        for k in range(BORESIGHTS):
            M[j, k] -= gain[j] * e[k]
        if variance > 0.0:
            M[j, j] = max(M[j, j], 1e-12)
    correct_boresights(c, z / s)
