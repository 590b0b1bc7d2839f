"""What the attitude filter claims: a row of SOLUTION with its status bits."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary
from imud.drivers.sample import SATURATED as BEYOND_RANGE
from imud.drivers.sample import UNCONFIRMED_RATE

from ...compile.jit import kernel
from ...math.rotation import UNKNOWN_ANGLE
from ..records import AT_REST, ATTITUDE_VALID, HEADING_VALID, SATURATED
from .mechanization import compensate_force, compensate_rate
from .stamps import turn_in_stamp_error

if TYPE_CHECKING:
    from ..types import Solution
    from .types import Parameters, State


@kernel
def write_solution(p: Parameters, s: State, flags: int, out: Solution) -> None:
    """Write a row of SOLUTION; what this filter does not estimate is NaN."""
    nav, cov, c = s.nav, s.cov, p.tuning
    status = 0
    cut_off = s.clipping.missing_angle + turn_in_stamp_error(s)  # rad, about any axis
    unseen = elementary.hypot(s.attitude_step.possible_tilt_error, s.motion.hidden_tilt)  # of roll and pitch
    unseen = elementary.hypot(unseen, elementary.hypot(cut_off, s.hypotheses.possible_tilt_error))
    unseen = elementary.hypot(unseen, elementary.hypot(s.stationarity.hidden_tilt, s.stationarity.possible_tilt))
    if flags & UNCONFIRMED_RATE != 0:
        cut_off = unseen = UNKNOWN_ANGLE
    cov.unseen_tilt, cov.unseen_yaw = unseen, cut_off
    if (
        s.levelling.initialised == 1
        and s.levelling.coarse == 0  # how fast a body accelerates that moves already, nothing has shown yet
        and elementary.hypot(cov.sigma_tilt, unseen) < c.valid_tilt_rad
        and s.imu.outage_s < c.long_gap_s
    ):
        status |= ATTITUDE_VALID
        if s.levelling.true_heading == 1 and cov.sigma_rpy[2] < c.valid_heading_rad:
            status |= HEADING_VALID
    if s.stationarity.stationary == 1:
        status |= AT_REST
    if flags & BEYOND_RANGE != 0:
        status |= SATURATED
    out.t_ns = s.t_ns
    out.status = status
    out.lat = out.lon = out.height = math.nan
    w = compensate_rate(nav, s.imu.w[0] - nav.bg[0], s.imu.w[1] - nav.bg[1], s.imu.w[2] - nav.bg[2])
    f = compensate_force(nav, s.imu.f[0], s.imu.f[1], s.imu.f[2])
    for i in range(4):
        out.q_nb[i] = nav.q_nb[i]
    for i in range(3):
        out.v[i] = out.sigma_p[i] = out.sigma_v[i] = math.nan
        out.w[i] = w[i]
        out.f[i] = f[i]
        out.bg[i] = nav.bg[i]
        out.ba[i] = nav.ba[i]
        out.sigma_rpy[i] = min(elementary.hypot(cov.sigma_rpy[i], unseen if i < 2 else cut_off), UNKNOWN_ANGLE)
        out.sigma_bg[i] = elementary.hypot(cov.sigma_bg[i], s.stationarity.hidden_turn[i])
        out.sigma_ba[i] = cov.sigma_ba[i]
