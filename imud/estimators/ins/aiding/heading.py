"""Heading from true north: dual-antenna receivers, gyro compasses (HDT, THS).

z = heading - yaw, with yaw = atan2(y, x) of the body's x axis in NED, extrapolated where the epoch is after the newest
sample. A measurement has value[0]: heading, rad, and sigma[0]: rad, NaN where it is not reported. During coarse
alignment `alignment.given_heading` takes it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...aiding_source import DEGREE, AidingSource, Column
from ...innovation_kinds import KINDS
from ...records import HEADING, HEADING_SOURCE
from ...tuning import Tunable
from ..ekf import set_jacobian
from ..fusion import correct_state, gated_update, write_innovation
from ..mechanization import body_to_ned, wrap_angle
from ..state import ATTITUDE

if TYPE_CHECKING:
    from ...types import Innovation, Measurement
    from ..types import Core, Parameters

SOURCE = AidingSource(
    "heading",
    HEADING_SOURCE,
    "HDG",
    {"heading_deg": Column(DEGREE, -360.0, 360.0)},
    {"sigma_deg": Column(DEGREE, 0.01, 180.0)},
    {HEADING: KINDS[HEADING]},
)
TUNABLES = (
    Tunable("heading_sigma", math.radians(1.0), "rad", "Sigma of a heading that reports none.", "Choice."),
    Tunable("heading_gate", 25.0, "NIS", "Gate of a heading.", "Five sigma."),
    Tunable("heading_min_level", 0.2, "", "Level part of the body's x axis below which it has no heading.", "Choice."),
)


@kernel
def sigma_of(p: Parameters, m: Measurement) -> float:
    """Sigma of a heading, rad: the reported one, else the tunable heading_sigma."""
    return m.sigma[0] if m.sigma[0] > 0.0 else p.tuning.heading_sigma


@kernel
def fuse_heading(p: Parameters, c: Core, m: Measurement, innovations: list[Innovation]) -> int:
    """Gate and fuse a heading while navigating; returns the rows of innovations (before: `alignment.given_heading`)."""
    x, y, z = body_to_ned(c, (1.0, 0.0, 0.0))
    level2 = x * x + y * y
    if level2 < p.tuning.heading_min_level**2:
        return 0
    # yaw of d = C e_x: its change is (d x (phi x d))_down / (x^2 + y^2)
    k = set_jacobian(c, 0, ATTITUDE, -x * z / level2)
    k = set_jacobian(c, k, ATTITUDE + 1, -y * z / level2)
    k = set_jacobian(c, k, ATTITUDE + 2, 1.0)
    rate = body_to_ned(c, (c.imu.rate_b[0], c.imu.rate_b[1], c.imu.rate_b[2]))[2]
    ahead_s = 1e-9 * (m.t_ns - c.nav.t_ns)  # 0 but for an epoch after the newest sample
    residual, r = wrap_angle(m.value[0] - math.atan2(y, x) - rate * ahead_s), sigma_of(p, m) ** 2
    value, s, nis = gated_update(c, k, residual, r, p.tuning.heading_gate)
    correct_state(p, c)
    return write_innovation(innovations, 0, m.t_ns, HEADING, value, s, nis >= 0.0)
