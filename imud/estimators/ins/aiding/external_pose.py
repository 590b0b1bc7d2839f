"""Position of another system, and its yaw where it has one: lidar or camera on a map, ultra-wideband, tags.

z = p_pose - p - C_nb l, in m, NED, and yaw_pose - yaw; l: the point of the pose, from the IMU, in the body. A
measurement has value: latitude and longitude, rad, height, m, yaw, rad, the last two NaN where they are not known;
sigma: north, east, down, m, and yaw, rad, NaN where it is not reported.

*Gate.* A pose is used as a whole or not at all: a system that is lost is wrong in every element. *Repetition.* A pose
that repeats the last one to the last digit tells nothing new, as of a system that has stopped. *Time.* Its errors last
for a while: the gate has the variance of a single pose, the update that of what all those know that share an error.
*Return.* Where poses are accepted again, they or the estimate were wrong: the distance is stated as an error, and from
then on, if it is large for its sigma, the sigma of a lasting error of the poses, until they have agreed for a while.
*Trust.* A map may be turned: while the motion contradicts a heading that has the yaws of poses, no pose is used, until
their yaws have agreed for `heading_trust_s`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.rotation import wrap_angle
from ...aiding_source import DEGREE, AidingSource, Column
from ...innovation_kinds import KINDS
from ...records import HEIGHT_VALUE, LAT_VALUE, LON_VALUE, POSE_D, POSE_E, POSE_N, POSE_SOURCE, POSE_YAW, YAW_VALUE
from ...tuning import Tunable
from ..ekf import innovation_variance, set_jacobian, set_jacobian3
from ..fusion import NO_GATE, REJECT, correct_state, correlated_update, write_innovation
from ..integrity.reset_inflation import inflate_position
from ..lever_arm import attitude_row
from ..mechanization import body_to_ned, ned_difference
from ..state import ATTITUDE, HEADING_AXIS, NEVER_NS, OTHER_AXIS, POSITION
from .external_aid import is_new, others_of_error, time_since_last
from .heading import agreeing_since, yaw_jacobian

if TYPE_CHECKING:
    from ....math.arrays import Reals
    from ....math.rotation import Vector
    from ...types import Innovation, Measurement
    from ..types import Core, Parameters

_METRES = Column(1.0, 1e-3, 1e4)
SOURCE = AidingSource(
    "pose",
    POSE_SOURCE,
    "POSE",
    {
        "lat_deg": Column(DEGREE, -90.0, 90.0),
        "lon_deg": Column(DEGREE, -180.0, 360.0),
        "height_m": Column(1.0, -2000.0, 20000.0),
        "yaw_deg": Column(DEGREE, -360.0, 360.0),
    },
    {"sn_m": _METRES, "se_m": _METRES, "sd_m": _METRES, "syaw_deg": Column(DEGREE, 0.01, 180.0)},
    {kind: KINDS[kind] for kind in (POSE_N, POSE_E, POSE_D, POSE_YAW)},
    optional=("height_m", "yaw_deg"),
)
TUNABLES = (
    Tunable("pose_sigma", 0.5, "m", "Sigma of a position that reports none.", "Ultra-wideband: 0.1 to 0.5 m."),
    Tunable("pose_yaw_sigma", math.radians(2.0), "rad", "Sigma of a yaw that reports none.", "Choice."),
    Tunable("pose_correlation_s", 1.0, "s", "Correlation time of the errors of poses.", "Choice: one view, one error."),
    Tunable("pose_time_sigma", 0.02, "s", "Unknown age of a pose.", "Choice: half a period of 25 Hz."),
    Tunable("pose_return_gate", 9.0, "NIS", "Beyond it a pose that returns has a lasting error.", "Three sigma."),
    Tunable("pose_age_s", 10.0, "s", "Time in which the error by an unknown age lasts.", "Until the motion changes."),
    Tunable("pose_offset_s", 300.0, "s", "Correlation time of the lasting error of poses that return.", "Choice."),
    Tunable(
        "pose_agreement_s",
        30.0,
        "s",
        "Time in which agreement lowers the sigma of the lasting error of poses that return.",
        "Choice.",
    ),
    Tunable("pose_gate", 25.0, "NIS", "Gate of each element of a pose.", "Five sigma."),
)


@kernel
def element_sigma(p: Parameters, m: Measurement, i: int) -> float:
    """Sigma of element i: the reported one, else the tunable."""
    if m.sigma[i] > 0.0:
        return m.sigma[i]
    return p.tuning.pose_yaw_sigma if i == 3 else p.tuning.pose_sigma


@kernel
def pose_differences(p: Parameters, c: Core, m: Measurement, arm: Vector, differences: Reals) -> None:
    """differences <- pose minus prediction: north, east, down, m, and yaw, rad; NaN where it is not known.

    arm: lever arm, NED.
    """
    ahead_s = 1e-9 * (m.t_ns - c.nav.t_ns)  # 0 but for an epoch after the newest sample
    north, east = ned_difference(c, c.nav.lat, c.nav.lon, m.value[LAT_VALUE], m.value[LON_VALUE])
    differences[0], differences[1], differences[2] = north, east, c.nav.height - m.value[HEIGHT_VALUE]
    for i in range(3):
        differences[i] -= arm[i]
        differences[i] -= c.nav.v_n[i] * ahead_s
    differences[3] = math.nan
    x, y, _ = body_to_ned(c, (1.0, 0.0, 0.0))
    if math.isfinite(m.value[YAW_VALUE]) and x * x + y * y >= p.tuning.heading_min_level**2:
        rate = body_to_ned(c, (c.imu.rate_b[0], c.imu.rate_b[1], c.imu.rate_b[2]))[2]
        differences[3] = wrap_angle(m.value[YAW_VALUE] - elementary.atan2(y, x) - rate * ahead_s)


@kernel
def pose_jacobian(c: Core, arm: Vector, i: int) -> int:
    """Jacobian of element i; returns its length."""
    if i == 3:
        x, y, z = body_to_ned(c, (1.0, 0.0, 0.0))
        return yaw_jacobian(c, x, y, z)
    return set_jacobian3(c, set_jacobian(c, 0, POSITION + i, 1.0), ATTITUDE, attitude_row(arm, i))


@kernel
def lasting_variances(p: Parameters, c: Core, i: int) -> tuple[float, float]:
    """Variances of element i by the unknown age of the pose, and by its lasting error."""
    rate = body_to_ned(c, (c.imu.rate_b[0], c.imu.rate_b[1], c.imu.rate_b[2]))[2] if i == 3 else c.nav.v_n[i]
    timing = rate * rate * (p.tuning.pose_time_sigma**2 + c.scratch.age_variance)
    return timing, c.pose.offset_variance[i] if i < 3 else 0.0


@kernel
def update_offset(p: Parameters, c: Core, i: int, z: float, s: float, dt: float) -> None:
    """Of a used pose, z: its innovation, m, s: its variance. The lasting error begins with its return, unless that is
    within three sigma, and ends with its agreement."""
    g = c.pose
    if g.rejected:
        inflate_position(c, i, z * z)
        if z * z > p.tuning.pose_return_gate * s:
            g.offset_variance[i] = max(g.offset_variance[i], z * z)
    elif z * z < g.offset_variance[i]:
        g.offset_variance[i] += (z * z - g.offset_variance[i]) * min(dt / p.tuning.pose_agreement_s, 1.0)


@kernel
def distrust_poses(c: Core) -> None:
    """The way the vehicle moves contradicts the heading, and poses have a yaw: none is used until that agrees."""
    if c.pose.yaw_ns != NEVER_NS:
        c.pose.distrusted = 1
        c.pose.agreeing_ns = NEVER_NS


@kernel
def check_yaw_trust(p: Parameters, c: Core, t_ns: int, agrees: bool) -> None:
    """Trust poses again after a time in which their yaws agree."""
    g = c.pose
    g.agreeing_ns = agreeing_since(g.agreeing_ns, t_ns, agrees)
    if agrees and 1e-9 * (t_ns - g.agreeing_ns) > p.tuning.heading_trust_s:
        g.distrusted = 0


@kernel
def fuse_pose(p: Parameters, c: Core, m: Measurement, innovations: list[Innovation]) -> int:
    """Gate and fuse a pose while navigating; returns the rows of innovations (before: `alignment.external_pose`)."""
    g = c.pose
    if not math.isfinite(m.value[LON_VALUE]) or not is_new(g, m):
        return write_innovation(innovations, 0, m.t_ns, POSE_N, math.nan, math.nan, False)
    l = p.pose_lever_arm  # noqa: E741 as in the literature
    arm = body_to_ned(c, (l[0], l[1], l[2]))
    differences = np.empty(4)
    pose_differences(p, c, m, arm, differences)
    used = not g.distrusted
    for i in range(4):
        z = differences[i]
        timing, offset = lasting_variances(p, c, i)
        r = element_sigma(p, m, i) ** 2 + timing + offset
        s = innovation_variance(c, pose_jacobian(c, arm, i)) + r
        used = used and not z * z > p.tuning.pose_gate * s  # what is not known passes
        if i == 3 and math.isfinite(z):
            g.yaw_ns = m.t_ns
            if g.distrusted:
                check_yaw_trust(p, c, m.t_ns, not z * z > p.tuning.pose_gate * s)
    dt = time_since_last(g, m)
    others = others_of_error(dt, p.tuning.pose_correlation_s)
    others_of_age = others_of_error(dt, p.tuning.pose_age_s)
    others_of_offset = others_of_error(dt, p.tuning.pose_offset_s)
    n = 0
    for i in range(4):
        z, r = differences[i], element_sigma(p, m, i) ** 2
        if not math.isfinite(z):
            continue
        length, gate = pose_jacobian(c, arm, i), NO_GATE if used else REJECT
        timing, offset = lasting_variances(p, c, i)
        shared = others * r + others_of_age * timing + others_of_offset * offset
        axis = HEADING_AXIS if i == 3 else OTHER_AXIS
        value, s, _ = correlated_update(c, length, z, r + timing + offset, shared, gate, axis)
        if used and i < 3:
            update_offset(p, c, i, z, s, dt)
        n = write_innovation(innovations, n, m.t_ns, POSE_N + i, value, s, used)
    if used:
        correct_state(p, c)
        g.last_used_ns = c.nav.t_ns
    g.rejected = 0 if used else 1
    return n
