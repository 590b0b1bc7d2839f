"""The age of a source's measurements beyond their epochs: late ones without a time of their own, or a wrong clock.

A bank of ages, each with its probability. For each age a the measurement is compared with the filter's own motion at
its epoch less a, from the snapshots of the fusion horizon: of a speed or velocity the velocity there, of a pose the
position and yaw. A slow mean of the difference is subtracted, as an error of scale, heading or map lasts; what remains
is an acceleration or a turn seen at the wrong time. At a constant velocity all ages fit equally and nothing is learned.
The square of the normalised remainder is bounded, as slips and jumps are not noise, and readings within
`age_correlation_s` count as one. An age may change (`age_change_s`) or drift (`age_drift_s`), so that no age is
excluded for ever.

A measurement is fused at its epoch less the age, once no age at all is less probable than the others; the variance of
the age, times the squared acceleration or velocity, is a variance of the measurement.

Source: multiple-model estimation (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking, 11.6).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.earth import SEMI_MAJOR_M
from ....math.rotation import dot, quat_rotate, quat_rotate_back, wrap_angle
from ...records import (
    BODY_VELOCITY_SOURCE,
    HEADING_SOURCE,
    LAT_VALUE,
    LON_VALUE,
    ODOMETER_SOURCE,
    POSE_SOURCE,
    VELOCITY_SOURCE,
    YAW_VALUE,
)
from ...tuning import Tunable
from ..state import AGE_STEP_NS, AGES, NAVIGATING, NEVER_NS, NO_AGE, SNAPSHOTS

if TYPE_CHECKING:
    from ....math.arrays import Reals
    from ....math.rotation import Quaternion
    from ...types import Measurement
    from ..types import Imu, Nav, Parameters, SourceAge, State

TUNABLES = (
    Tunable("age_interval_s", 0.19, "s", "Least time between readings that an age is learned from.", "5 Hz suffice."),
    Tunable(
        "age_mean_s",
        3.0,
        "s",
        "Time of the mean that is subtracted from what readings and estimate differ by.",
        "Choice: a change of speed.",
    ),
    Tunable("age_gap_s", 2.0, "s", "Pause of the readings after which the mean of age_mean_s begins anew.", "Choice."),
    Tunable("age_correlation_s", 1.0, "s", "Correlation time of what is left.", "A slip, an error of the map."),
    Tunable("age_gate", 9.0, "NIS", "Bound of the square of what is left.", "Three sigma."),
    Tunable("age_speed_noise", 0.05, "m/s", "What is left of a speed of the right age, besides its sigma.", "Choice."),
    Tunable("age_position_noise", 0.3, "m", "What is left of a pose of the right age, besides its sigma.", "Choice."),
    Tunable("age_yaw_noise", 0.03, "rad", "What is left of a yaw of the right age, besides its sigma.", "Choice."),
    Tunable("age_prior", 0.1, "", "Probability that a source is late, or its clock wrong.", "Choice.", high=0.5),
    Tunable("age_change_s", 3600.0, "s", "Mean time between changes of an age.", "Choice: once an hour."),
    Tunable("age_drift_s", 1000.0, "s", "Time in which an age moves by a step of the bank.", "0.1 ms in a second."),
)
AHEAD_NS = 50_000_000  # an epoch may be newer than the newest sample by that, as samples arrive in bursts


@kernel
def yaw_difference(q: Quaternion, yaw: float) -> float:
    """Yaw of an attitude less another one, rad."""
    x, y, _ = quat_rotate(q, (1.0, 0.0, 0.0))
    return wrap_angle(elementary.atan2(y, x) - yaw)


@kernel
def motion(p: Parameters, m: Measurement, nav: Nav, imu: Imu, cos_lat: float) -> tuple[float, float, float]:
    """What the measurement would be of this state, up to a sign: speed or velocity, m/s; position less pose, m; yaw
    less the measured one, rad. cos_lat: at the pose."""
    q = (nav.q_nb[0], nav.q_nb[1], nav.q_nb[2], nav.q_nb[3])
    if m.kind == VELOCITY_SOURCE:
        return nav.v_n[0], nav.v_n[1], 0.0
    if m.kind == HEADING_SOURCE:
        return 0.0, 0.0, yaw_difference(q, m.value[0] - p.heading_boresight)
    if m.kind == POSE_SOURCE:
        l = p.pose_lever_arm  # noqa: E741 as in the literature
        arm = quat_rotate(q, (l[0], l[1], l[2]))
        east = (nav.lon - m.value[LON_VALUE]) * cos_lat
        turn = yaw_difference(q, m.value[YAW_VALUE]) if math.isfinite(m.value[YAW_VALUE]) else 0.0
        return SEMI_MAJOR_M * (nav.lat - m.value[LAT_VALUE]) + arm[0], SEMI_MAJOR_M * east + arm[1], turn
    v = quat_rotate_back(q, (nav.v_n[0], nav.v_n[1], nav.v_n[2]))
    if m.kind == BODY_VELOCITY_SOURCE:
        q = (nav.velocity_mount[0], nav.velocity_mount[1], nav.velocity_mount[2], nav.velocity_mount[3])
        return quat_rotate_back(q, v)[0], 0.0, 0.0
    wheel, w = p.odometer_lever_arm, imu.rate_b
    f = (nav.forward[0], nav.forward[1], nav.forward[2])
    turned = (
        w[1] * wheel[2] - w[2] * wheel[1],
        w[2] * wheel[0] - w[0] * wheel[2],
        w[0] * wheel[1] - w[1] * wheel[0],
    )
    return abs((1.0 + nav.odometer_scale) * (dot(f, v) + dot(f, turned))), 0.0, 0.0


@kernel
def age_noise(p: Parameters, m: Measurement) -> float:
    """Variance of what is left at the right age."""
    if m.kind == POSE_SOURCE:
        sigma = m.sigma[0] if m.sigma[0] > 0.0 else p.tuning.pose_sigma
        return sigma * sigma + p.tuning.age_position_noise**2
    sigma = m.sigma[0] if m.sigma[0] > 0.0 else p.tuning.odometer_sigma
    return sigma * sigma + p.tuning.age_speed_noise**2 + (p.tuning.odometer_slip * m.value[0]) ** 2


@kernel
def remainder(
    p: Parameters, g: SourceAge, i: int, x: float, y: float, turn: float, noise: float, turn_noise: float, dt: float
) -> float:
    """Normalised square of a difference (x, y, turn) at age i less its mean, which it updates. dt: since the last, s.

    Infinite until the mean has been taken over its whole time.
    """
    if not dt < p.tuning.age_gap_s or g.known_s[i] == 0.0:
        g.known_s[i], g.mean[i, 0], g.mean[i, 1], g.mean[i, 2] = 0.0, x, y, turn
    g.known_s[i] += min(dt, p.tuning.age_gap_s)
    dx, dy, turned = x - g.mean[i, 0], y - g.mean[i, 1], wrap_angle(turn - g.mean[i, 2])
    nis = (dx * dx + dy * dy) / noise + turned * turned / turn_noise
    share = min(dt / min(p.tuning.age_mean_s, g.known_s[i]), 1.0)
    g.mean[i, 0] += share * dx
    g.mean[i, 1] += share * dy
    g.mean[i, 2] = wrap_angle(g.mean[i, 2] + share * turned)
    return math.inf if g.known_s[i] < p.tuning.age_mean_s else nis


@kernel
def weigh_ages(p: Parameters, g: SourceAge, nis: Reals, weight: float) -> None:
    """Multiply probabilities with likelihoods; where no age fits the source itself has jumped, and means begin anew."""
    least, settled = math.inf, False
    for i in range(AGES):
        least = min(least, nis[i])
        settled = settled or g.known_s[i] >= p.tuning.age_mean_s
    for i in range(AGES):
        if settled and least > p.tuning.age_gate:
            g.known_s[i] = 0.0
        elif settled:
            g.probability[i] *= elementary.exp(weight * min(nis[i], p.tuning.age_gate))


@kernel
def compare_ages(p: Parameters, s: State, m: Measurement, g: SourceAge, dt: float) -> None:
    """Multiply the probability of each age with the likelihood of the measurement. dt: time since the last, s."""
    c, noise = s.core[0], age_noise(p, m)
    heading = m.kind == HEADING_SOURCE
    yaw_sigma = m.sigma[0] if heading else m.sigma[3]
    if not yaw_sigma > 0.0:
        yaw_sigma = p.tuning.heading_sigma if heading else p.tuning.pose_yaw_sigma
    turn_noise = yaw_sigma**2 + p.tuning.age_yaw_noise**2
    nis = np.empty(AGES)
    zx = abs(m.value[0]) if m.kind == ODOMETER_SOURCE else 0.0 if heading or m.kind == POSE_SOURCE else m.value[0]
    zy = m.value[1] if m.kind == VELOCITY_SOURCE else 0.0
    k, oldest = s.snapshot_count, max(0, s.snapshot_count - SNAPSHOTS)
    cos_lat = math.fabs(elementary.cos(m.value[LAT_VALUE])) if m.kind == POSE_SOURCE else 1.0
    bx, by, bw = motion(p, m, c.nav, c.imu, cos_lat)
    before_ns, after_ns, ax, ay, aw = c.nav.t_ns, c.nav.t_ns, bx, by, bw
    for i in range(AGES):
        t_ns = m.t_ns - (i - NO_AGE) * AGE_STEP_NS
        if c.nav.t_ns < t_ns < c.nav.t_ns + AHEAD_NS:
            t_ns = c.nav.t_ns
        while before_ns > t_ns and k > oldest:
            after_ns, ax, ay, aw = before_ns, bx, by, bw
            k -= 1
            e = s.snapshots[k % SNAPSHOTS]
            if e.alignment.mode != NAVIGATING:
                k = oldest
            else:
                before_ns = e.nav.t_ns
                bx, by, bw = motion(p, m, e.nav, e.imu, cos_lat)
        nis[i] = math.inf  # of an epoch that is not known: in the future, or before the horizon
        if before_ns <= t_ns <= after_ns:
            share = (t_ns - before_ns) / max(after_ns - before_ns, 1)
            x, y = bx + share * (ax - bx), by + share * (ay - by)
            turn = wrap_angle(bw + share * wrap_angle(aw - bw))
            nis[i] = remainder(p, g, i, zx - x, zy - y, -turn, noise, turn_noise, dt)
        else:
            g.known_s[i] = 0.0
    weigh_ages(p, g, nis, -0.5 * min(dt / p.tuning.age_correlation_s, 1.0))


@kernel
def prior_of_age(p: Parameters, i: int) -> float:
    """Probability of age i before anything is known."""
    return 1.0 - p.tuning.age_prior if i == NO_AGE else p.tuning.age_prior / (AGES - 1)


@kernel
def change_ages(p: Parameters, g: SourceAge, dt: float) -> None:
    """Make the sum of the probabilities one; ages may have changed or drifted since the last measurement."""
    total = 0.0
    for i in range(AGES):
        total += g.probability[i]
    drift, change = min(dt / p.tuning.age_drift_s, 0.25), min(dt / p.tuning.age_change_s, 1.0)
    for i in range(AGES):
        g.probability[i] /= total
    last = g.probability[0]
    for i in range(AGES):
        own = g.probability[i]
        following = g.probability[i + 1] if i + 1 < AGES else own
        drifted = own + drift * (last - 2.0 * own + following)
        g.probability[i] = drifted + change * (prior_of_age(p, i) - drifted)
        last = own


@kernel
def estimate_age(g: SourceAge) -> None:
    """Mean and variance of the age; no age while that is more probable than all others together."""
    mean, square = 0.0, 0.0
    for i in range(AGES):
        age = 1e-9 * AGE_STEP_NS * (i - NO_AGE)
        mean += g.probability[i] * age
        square += g.probability[i] * age * age
    g.age = 0.0 if g.probability[NO_AGE] > 0.5 else mean
    g.variance = max(square - 2.0 * mean * g.age + g.age * g.age, 0.0)
    if g.age != 0.0:
        g.variance += (1e-9 * AGE_STEP_NS) ** 2 / 12.0


@kernel
def learn_age(p: Parameters, s: State, m: Measurement) -> None:
    """Learn a source's age from a measurement, before the rewind to its epoch."""
    g, c = s.source_ages[m.kind], s.core[0]
    if m.kind not in (ODOMETER_SOURCE, POSE_SOURCE, VELOCITY_SOURCE, BODY_VELOCITY_SOURCE, HEADING_SOURCE):
        return
    if m.kind in (POSE_SOURCE, VELOCITY_SOURCE) and not math.isfinite(m.value[1]):
        return
    dt = 1e-9 * (m.t_ns - g.last_ns) if g.last_ns != NEVER_NS else 2.0 * p.tuning.age_gap_s
    if c.alignment.mode != NAVIGATING or m.t_ns > c.nav.t_ns + AHEAD_NS or dt < p.tuning.age_interval_s:
        return
    g.last_ns = m.t_ns
    compare_ages(p, s, m, g, dt)
    change_ages(p, g, dt)
    estimate_age(g)
