"""Missing and clipped readings: what is integrated instead of them, and the variance that this adds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imud.drivers.sample import LIMITED_FORCE, LIMITED_RATE, NO_FORCE, NO_RATE, SUSPECT
from imud.drivers.sample import SATURATED as BEYOND_RANGE

from ...compile.jit import kernel
from ...math.earth import gravity
from ..tuning import Tunable
from .aiding.non_holonomic import reset_nhc
from .alignment.modes import ATTITUDE_LOST, HEADING_LOST, change_mode
from .alignment.velocity_pairs import restart_in_motion_alignment
from .ekf import add_covariance, add_variance, variance
from .mechanization import ned_to_body, rotation_matrix
from .propagation import add_gap_variance, gap_variances
from .rest import withdraw_rest
from .state import ATTITUDE, FORCES, NAVIGATING, POSITION, RATES, VELOCITY

if TYPE_CHECKING:
    from .types import Core, Parameters, StoredSample


TUNABLES = (
    Tunable(
        "near_range",
        0.9,
        "",
        "Share of the largest rate of the three axes from which an axis counts as saturated, too.",
        "Choice.",
    ),
    Tunable("over_range", 0.5, "", "Largest error of a clipped reading, as a share of the reading.", "Choice."),
    Tunable("rate_hold_s", 0.5, "s", "Time for which the last rate stands for missing ones.", "Choice."),
)


@kernel
def substitute_missing(p: Parameters, c: Core, sample: StoredSample) -> None:
    """Replace missing rates (held, later zero) and forces (no acceleration) of a sample; such a sample ends a rest."""
    if sample.flags & NO_RATE and sample.outage_s > p.tuning.rate_hold_s:
        for i in range(3):
            sample.w[i] = c.nav.bg[i]
    if sample.flags & NO_FORCE:
        weight = ned_to_body(c, (0.0, 0.0, -gravity(c.nav.lat, c.nav.height)))
        for i in range(3):
            sample.f[i] = weight[i] + c.nav.ba[i]
    withdraw_rest(c)


@kernel
def inflate_attitude(p: Parameters, c: Core, sample: StoredSample, fastest: float, q: float) -> None:
    """Add the variance q (rad^2) to the attitude about the body axes whose rate is missing or saturated.

    fastest: rad/s, largest rate of the three axes. An attitude that is too uncertain starts the alignment again.
    """
    C_nb = rotation_matrix(c)
    for axis in range(3):
        if sample.flags & NO_RATE or abs(c.imu.w[axis]) > p.tuning.near_range * fastest:
            for i in range(3):
                for k in range(i, 3):
                    add_covariance(c, ATTITUDE + i, ATTITUDE + k, q * C_nb[3 * i + axis] * C_nb[3 * k + axis])
    restart_in_motion_alignment(c)
    if c.alignment.mode == NAVIGATING and variance(c, ATTITUDE + 2) > p.tuning.max_heading_sigma**2:
        change_mode(p, c, HEADING_LOST)  # neither fixes nor the vehicle's constraint can correct such a heading
        reset_nhc(p, c)
    if max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1)) > p.tuning.lost_tilt**2:
        change_mode(p, c, ATTITUDE_LOST)


@kernel
def add_held_variance(p: Parameters, c: Core, sample: StoredSample, dt: float) -> None:
    """Add variance for damaged samples, for which the last good one stands; `sample` is the next, dt s later.

    A gap has a known sample at either end. Here one end is known, so that the variance is four times as large
    (Brownian motion against Brownian bridge); the first good sample shows how far the last one was off.
    """
    before = c.imu.held_s
    now = before + dt if sample.flags & SUSPECT else 0.0
    c.imu.held_s = now
    if before + now == 0.0:
        return
    level, vertical, velocity = gap_variances(p, c, sample.w, sample.f, max(before, now))
    if before > 0.0:
        known = gap_variances(p, c, c.imu.w, c.imu.f, before)
        level, vertical, velocity = level - known[0], vertical - known[1], velocity - known[2]
    add_gap_variance(c, 4.0 * max(level, 0.0), 4.0 * max(vertical, 0.0), 4.0 * max(velocity, 0.0))


@kernel
def inflate_covariance(p: Parameters, c: Core, sample: StoredSample, dt: float) -> None:
    """Add variance for missing and clipped rates and forces, for the duration of the outage; dt: s of this sample."""
    c.imu.saturated = 1 if sample.flags & BEYOND_RANGE else 0
    if sample.flags == 0:
        c.imu.outage_s[RATES] = c.imu.outage_s[FORCES] = 0.0
        return
    fastest = max(abs(c.imu.w[0]), abs(c.imu.w[1]), abs(c.imu.w[2]))
    largest = max(abs(c.imu.f[0]), abs(c.imu.f[1]), abs(c.imu.f[2]))
    max_turn_rate = (
        p.tuning.gap_turn
        if sample.flags & NO_RATE
        else p.tuning.over_range * fastest
        if sample.flags & LIMITED_RATE
        else 0.0
    )
    max_accel = (
        p.tuning.gap_accel
        if sample.flags & NO_FORCE
        else p.tuning.over_range * largest
        if sample.flags & LIMITED_FORCE
        else 0.0
    )
    for k in range(2):
        before, most = c.imu.outage_s[k], max_turn_rate if k == 0 else max_accel
        now = max(before + dt, sample.outage_s) if most > 0.0 else 0.0
        c.imu.outage_s[k] = now
        if most > 0.0 and k == 0:
            inflate_attitude(p, c, sample, fastest, most**2 * (now**2 - before**2))
        for i in range(3):
            if most > 0.0 and k == 1:
                add_variance(c, VELOCITY + i, most**2 * (now**2 - before**2))
                add_variance(c, POSITION + i, 0.25 * most**2 * (now**4 - before**4))
