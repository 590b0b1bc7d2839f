"""The earth's magnetic field during coarse alignment gives a heading, unless a better one is known."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ...records import EARTH_DOWN_VALUE, EARTH_EAST_VALUE, EARTH_NORTH_VALUE
from ..aiding.magnetometer import (
    distrust_after_inflation,
    field_innovation,
    field_variance,
    has_field,
    is_contradicted,
    is_earths_field,
)
from ..ekf import variance
from ..mechanization import body_to_ned
from ..state import ATTITUDE
from .external_heading import align_with_heading

if TYPE_CHECKING:
    from ...types import Measurement
    from ..types import Core, Parameters


@kernel
def align_with_field(p: Parameters, c: Core, m: Measurement) -> None:
    """Set the heading by the field once tilt and place are known, if its sigma is one to start with."""
    if not has_field(p, m):
        return
    steady = is_earths_field(p, c, m)
    distrust_after_inflation(p, c, m, variance(c, ATTITUDE + 2))
    if not steady or is_contradicted(p, c, m):
        return
    tilt2 = max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1))
    steepness2 = m.value[EARTH_DOWN_VALUE] ** 2 / (m.value[EARTH_NORTH_VALUE] ** 2 + m.value[EARTH_EAST_VALUE] ** 2)
    sigma = math.sqrt(field_variance(p, c, m) + steepness2 * tilt2)
    known = c.alignment.heading_sigma
    if sigma > p.tuning.max_start_heading or 0.0 < known < sigma:
        return
    psi = field_innovation(c, m)
    x, y, _ = body_to_ned(c, (1.0, 0.0, 0.0))
    align_with_heading(p, c, elementary.atan2(y, x) + psi, sigma)
