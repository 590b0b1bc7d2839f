"""Poses of another system during coarse alignment: they start navigation where no receiver has given a fix yet."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...records import HEIGHT_VALUE, LAT_VALUE, LON_VALUE, YAW_VALUE
from ..aiding.external_pose import element_sigma
from ..aiding.gnss_noise import count_fix
from ..ekf import decorrelate
from ..mechanization import body_to_ned, displace, set_position
from ..state import NEVER_NS, POSITION
from .external_heading import align_with_heading

if TYPE_CHECKING:
    from ...types import Measurement
    from ..types import Core, Parameters


@kernel
def align_with_pose(p: Parameters, c: Core, m: Measurement) -> None:
    """Set the heading to the pose's, and the position, unless a receiver has one; that starts navigation.

    A heading that the motion has contradicted is left out. Where it is known from elsewhere, the end of a window of
    samples starts navigation.
    """
    if not math.isfinite(m.value[LON_VALUE]):
        return
    if c.gnss.last_used_ns == NEVER_NS:  # so the position is that of the IMU, as one that the user gives
        set_position(c, m.value[LAT_VALUE], m.value[LON_VALUE], m.value[HEIGHT_VALUE])
        l = p.pose_lever_arm  # noqa: E741 as in the literature
        arm = body_to_ned(c, (l[0], l[1], l[2]))
        displace(c, -arm[0], -arm[1], -arm[2])
        turned2 = 0.0 if math.isfinite(m.value[YAW_VALUE]) else l[0] ** 2 + l[1] ** 2 + l[2] ** 2
        for i in range(3):
            known = i < 2 or math.isfinite(m.value[HEIGHT_VALUE])
            sigma = element_sigma(p, m, i) if known else p.tuning.unknown_height
            decorrelate(c, POSITION + i, sigma**2 + turned2)
        if c.gnss.fix_count == 0:
            count_fix(c)
    if math.isfinite(m.value[YAW_VALUE]) and not c.pose.distrusted:
        align_with_heading(p, c, m.value[YAW_VALUE], element_sigma(p, m, YAW_VALUE))
