"""A heading measured during coarse alignment, by two antennas or a gyro compass, is accepted once the tilt is known."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ..ekf import decorrelate
from ..glr_tests.compass_offset import open_compass_offset
from ..mechanization import body_to_ned, wrap_angle
from ..state import ATTITUDE
from .heading_acceptance import rotate_to_heading
from .modes import HEADING_KNOWN, change_mode
from .velocity_pairs import is_levelled

if TYPE_CHECKING:
    from ..types import Core, Parameters


@kernel
def align_with_heading(p: Parameters, c: Core, yaw: float, sigma: float) -> bool:
    """Rotate the level frame to `yaw`, rad, once roll and pitch are known; start navigation if there was a fix.

    Returns whether it was.
    """
    x, y, _ = body_to_ned(c, (1.0, 0.0, 0.0))
    if not is_levelled(p, c) or x * x + y * y < p.tuning.heading_min_level**2:
        return False
    rotate_to_heading(p, c, wrap_angle(yaw - elementary.atan2(y, x)), sigma)
    decorrelate(c, ATTITUDE + 2, sigma * sigma)
    if c.gnss.fix_count > 0:
        change_mode(p, c, HEADING_KNOWN)
    open_compass_offset(c, True)
    return True
