"""The heading of a land vehicle after a gap in the inertial data, from the course of the first fix.

In the gap the vehicle may have turned by any angle, for which a linear update is wrong: its velocity is along its
forward axis, so the heading is the course less the direction of that axis in the body. The constraint, which would be
fused before the fix, waits for it. At a low speed both go on as they are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.rotation import dot, wrap_angle
from ...tuning import Tunable
from ..ekf import combine, decorrelate, rotate_tilt_covariance, variance
from ..lever_arm import antenna_velocity
from ..mechanization import body_to_ned, rotate_attitude
from ..state import ATTITUDE, MOUNT_YAW, NAVIGATING, NEVER_NS
from ..vehicle_axes import forward_axis, lateral_axis, vertical_axis
from .gnss_velocity import velocity_of
from .non_holonomic import sideslip_sigma

if TYPE_CHECKING:
    from ...types import Fix
    from ..types import Core, Parameters


TUNABLES = (
    Tunable(
        "least_course_speed",
        3.0,
        "m/s",
        "Speed from which a land vehicle goes on in the direction, forward or backward, in which it went before a gap.",
        "Choice: faster than a walk.",
    ),
)


@kernel
def wait_for_course(p: Parameters, c: Core) -> None:
    """After a gap: the constraint waits for a fix, if the vehicle is fast enough for its course to give the heading."""
    if elementary.hypot(c.nav.v_n[0], c.nav.v_n[1]) > p.tuning.least_course_speed:
        c.nhc.waits_since_ns = c.nav.t_ns


@kernel
def waits_for_course(p: Parameters, c: Core) -> bool:
    """Whether the constraint waits for a fix; not for long."""
    return bool(1e-9 * (c.nav.t_ns - c.nhc.waits_since_ns) < p.tuning.fresh_fix_s)


@kernel
def head_along_course(p: Parameters, c: Core, fix: Fix) -> None:
    """At the first fix after a gap: rotate the estimate to the heading that the course shows, if that is better."""
    waits = waits_for_course(p, c)
    c.nhc.waits_since_ns = NEVER_NS
    if not waits or not c.nhc.enabled or c.nhc.direction == 0.0 or c.alignment.mode != NAVIGATING:
        return
    antenna = antenna_velocity(c)
    north, east = velocity_of(p, fix, 0) - antenna[0], velocity_of(p, fix, 1) - antenna[1]
    speed = elementary.hypot(north, east)
    if not speed > p.tuning.least_course_speed or variance(c, ATTITUDE + 2) < p.tuning.max_start_heading**2:
        return
    f, s, w, along = forward_axis(c), lateral_axis(c), c.imu.rate_b, c.nhc.direction * speed
    across = c.nav.nhc_lever_arm * dot(vertical_axis(c), (w[0], w[1], w[2]))
    x, y, _ = body_to_ned(c, (along * f[0] + across * s[0], along * f[1] + across * s[1], along * f[2] + across * s[2]))
    psi = wrap_angle(elementary.atan2(east, north) - elementary.atan2(y, x))
    slip2 = c.nhc.noise_scale[0] * sideslip_sigma(p, c, speed) ** 2
    rotate_attitude(c, 0.0, 0.0, psi)
    rotate_tilt_covariance(c, psi)
    decorrelate(c, ATTITUDE + 2, (c.gnss.velocity_noise_var + slip2) / (speed * speed))
    combine(c, ATTITUDE + 2, MOUNT_YAW, -1.0)
