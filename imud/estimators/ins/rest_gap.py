"""A gap that began at rest: whether the body was moved while nobody measured.

No sensor has seen a rotation about the vertical. Either the body was left alone, and its heading is as it was, or it
was moved, and its heading is any: the variance is the probability of that times pi^2 / 3. Beforehand it is what the
length of the gap gives. At the first rest after the gap gravity shows more: what was moved stands at another tilt, by
`moved_tilt` in each axis, except for the share `level_places`, where the ground is level; what was not moved stands as
before, within the noise and, if the sensor was switched on, the change of its accelerometer biases. Bayes' rule gives
the probability afterwards. Until then the variance is no part of P, but of the stated sigma. A body that the next fix
at rest finds elsewhere was moved: its heading is lost.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from ...math.earth import STANDARD_GRAVITY
from ..tuning import Tunable
from .aiding.gnss_noise import horizontal_sigma
from .alignment.modes import HEADING_LOST, change_mode
from .ekf import add_covariance, variance
from .glr_tests.compass_offset import state_turn
from .lever_arm import antenna_position
from .mechanization import body_to_ned, ned_difference
from .state import ATTITUDE, POSITION

if TYPE_CHECKING:
    from ...math.rotation import Vector
    from ..types import Fix
    from .types import Core, Parameters

TUNABLES = (
    Tunable(
        "moved_tilt",
        math.radians(1.0),
        "rad",
        "Sigma of the change of roll, and of pitch, of a body that was moved and is at rest again.",
        "Choice: roads fall by 1 to 3 % to the side.",
    ),
    Tunable(
        "unmoved_tilt",
        math.radians(0.1),
        "rad",
        "Sigma of the change of roll, and of pitch, of a body that was not moved in a gap at rest.",
        "Choice: who gets into a car leans it.",
    ),
    Tunable(
        "level_places",
        0.05,
        "",
        "Share of the moved bodies that stand at the same tilt again, as on a level floor.",
        "Choice.",
        high=1.0,
    ),
    Tunable(
        "moved_windows",
        4,
        "windows",
        "Windows without rest after which a body that was at rest before a gap counts as moved.",
        "2 s.",
    ),
    Tunable(
        "elsewhere_gate", 25.0, "", "Squared distance of the next fix, over its variance, of a moved body.", "5 sigma."
    ),
)
_ANY_HEADING2 = math.pi**2 / 3.0  # rad^2, variance of a uniform one
_LARGEST_EXPONENT = 50.0


@kernel
def vertical_in_ned(c: Core) -> Vector:
    """The axis about which a body turns unseen, NED: what is vertical in it on average."""
    m = c.stationarity.mean_down
    return body_to_ned(c, (m[0], m[1], m[2]))


@kernel
def add_turn(c: Core, turned2: float) -> None:
    """Add the variance (rad^2) of a turn that was not measured to the attitude."""
    state_turn(c, turned2)
    axis = vertical_in_ned(c)
    for i in range(3):
        for k in range(i, 3):
            add_covariance(c, ATTITUDE + i, ATTITUDE + k, turned2 * axis[i] * axis[k])


@kernel
def keep_place(c: Core) -> None:
    """Before a gap is propagated: keep where a body at rest is."""
    if c.stationarity.at_rest and c.gnss.fix_count > 0:
        c.rest_gap.lat, c.rest_gap.lon = c.nav.lat, c.nav.lon
        c.rest_gap.place2 = variance(c, POSITION) + variance(c, POSITION + 1)


@kernel
def begin_rest_gap(p: Parameters, c: Core, turned2: float, new_biases: bool) -> None:
    """After a gap that began at rest: judge later whether the body was turned, of variance `turned2` beforehand.

    new_biases: the sensor may have been switched off and on.
    """
    g, s = c.rest_gap, c.stationarity
    add_turn(c, g.turn2)  # of a gap before that was not judged in time
    g.turn2, g.window_count = min(turned2, _ANY_HEADING2), 0
    for i in range(3):
        g.force[i] = s.mean_f[i]
    g.force2 = 2.0 * (p.accel_psd + s.vibration_accel_psd) / p.tuning.rest_window_s
    if new_biases:  # the difference of two, and twice that: far ones are commoner than a normal distribution has them
        g.force2 += 4.0 * p.accel_bias_sigma**2


@kernel
def moved_likelihood(p: Parameters, c: Core) -> float:
    """Likelihood of the direction of gravity in the body if it was moved in the gap, over that if it was not."""
    f, before = c.stationarity.mean_f, c.rest_gap.force
    g2 = STANDARD_GRAVITY**2
    x = (f[1] * before[2] - f[2] * before[1]) / g2
    y = (f[2] * before[0] - f[0] * before[2]) / g2
    z = (f[0] * before[1] - f[1] * before[0]) / g2
    unmoved2 = p.tuning.unmoved_tilt**2 + c.rest_gap.force2 / g2
    moved2 = unmoved2 + p.tuning.moved_tilt**2
    logarithm = elementary.log(unmoved2 / moved2) + 0.5 * (x * x + y * y + z * z) * (1.0 / unmoved2 - 1.0 / moved2)
    level = p.tuning.level_places
    return float(level + (1.0 - level) * elementary.exp(min(logarithm, _LARGEST_EXPONENT)))


@kernel
def moves(p: Parameters, c: Core) -> bool:
    """Whether a recent fix shows motion."""
    fresh = c.gnss.fix_count > 0 and 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) < p.tuning.fresh_fix_s
    return bool(fresh and c.gnss.speed > p.tuning.slow_motion_min_speed)


@kernel
def judge_rest_gap(p: Parameters, c: Core) -> None:
    """At the end of a window: how probable it is that the body was turned in the gap.

    The second window of low motion decides, unless a fix shows motion: the velocity is not known well enough yet to
    detect a rest.
    """
    g, low_motion_count = c.rest_gap, c.stationarity.low_motion_count
    if low_motion_count == 0:
        g.place2 = 0.0  # the next fix shows the motion since, too
    if g.turn2 == 0.0:
        return
    g.window_count += 1
    if low_motion_count > 1 and not moves(p, c):
        moved = g.turn2 * moved_likelihood(p, c)
        add_turn(c, _ANY_HEADING2 * moved / (moved + _ANY_HEADING2 - g.turn2))
    elif g.window_count >= p.tuning.moved_windows:
        add_turn(c, g.turn2)
    else:
        return
    g.turn2 = 0.0


@kernel
def compare_place(p: Parameters, c: Core, fix: Fix) -> None:
    """At a fix: a body that has been at rest since the gap, but is elsewhere, was moved meanwhile."""
    g = c.rest_gap
    if g.place2 == 0.0 or c.stationarity.low_motion_count == 0:
        return
    arm, sigma = antenna_position(c), horizontal_sigma(p, fix)
    north, east = ned_difference(c, g.lat, g.lon, fix.lat, fix.lon)
    variance_of_both = g.place2 + 2.0 * sigma * sigma
    g.place2 = 0.0
    if (north - arm[0]) ** 2 + (east - arm[1]) ** 2 > p.tuning.elsewhere_gate * variance_of_both:
        change_mode(p, c, HEADING_LOST)
