"""Headings of two antennas or a gyro compass: accepted once the tilt is known, and monitored while navigating."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.rotation import wrap_angle
from ..aiding.heading import check_turns, contradicts_itself, distrust_compass, fuse_heading, heading_of, sigma_of
from ..boresights import begin_boresight, share_boresight
from ..ekf import decorrelate
from ..glr_tests.compass_offset import open_compass_offset
from ..mechanization import body_to_ned
from ..state import ATTITUDE
from .heading_acceptance import rotate_to_heading
from .modes import GIVEN_HEADING_WRONG, HEADING_KNOWN, HEADING_LOST, change_mode
from .velocity_pairs import is_levelled

if TYPE_CHECKING:
    from ...types import Innovation, Measurement
    from ..types import Core, Parameters


@kernel
def align_with_heading(p: Parameters, c: Core, yaw: float, sigma: float) -> bool:
    """Rotate the level frame to `yaw`, rad, once roll and pitch are known; start navigation if there was a fix.

    Returns whether it was.
    """
    x, y, _ = body_to_ned(c, (1.0, 0.0, 0.0))
    if not is_levelled(p, c) or x * x + y * y < p.tuning.heading_min_level**2:
        return False
    if sigma > p.tuning.max_valid_heading_sigma:  # so is one of which nothing is known
        return False
    rotate_to_heading(p, c, wrap_angle(yaw - elementary.atan2(y, x)), sigma)
    decorrelate(c, ATTITUDE + 2, sigma * sigma)
    if c.gnss.fix_count > 0:
        change_mode(p, c, HEADING_KNOWN)
    open_compass_offset(c, True)
    return True


@kernel
def align_with_compass(p: Parameters, c: Core, m: Measurement) -> None:
    """Replace the arbitrary origin of the heading by that of a compass, unless the motion has contradicted it."""
    if c.heading_aid.distrusted:
        return
    begin_boresight(p, c)
    if align_with_heading(p, c, heading_of(p, c, m), sigma_of(p, m)):
        share_boresight(c)


@kernel
def fuse_monitored_heading(p: Parameters, c: Core, m: Measurement, innovations: list[Innovation]) -> int:
    """Fuse a heading while navigating, and begin anew where it shows that the heading is wrong that a compass gave."""
    rows = fuse_heading(p, c, m, innovations)
    if contradicts_itself(p, c, m):
        distrust_compass(p, c)
        change_mode(p, c, HEADING_LOST)
    elif check_turns(p, c):
        change_mode(p, c, GIVEN_HEADING_WRONG)
    return rows
