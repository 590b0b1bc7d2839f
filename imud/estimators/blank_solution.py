"""A solution row in which nothing is known: what an estimator does not estimate stays NaN."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers.sample import SATURATED as BEYOND_RANGE

from ..compile.jit import kernel
from .records import SATURATED

if TYPE_CHECKING:
    from .types import Sample, Solution


@kernel
def blank(out: Solution, t_ns: int, sample: Sample) -> None:
    """Fill `out` (SOLUTION) with NaN but for its time, the sample's own rate and force, and the range warning."""
    out.t_ns = t_ns
    out.status = SATURATED if sample.flags & BEYOND_RANGE != 0 else 0
    out.lat = out.lon = out.height = math.nan
    for i in range(4):
        out.q_nb[i] = math.nan
    for i in range(3):
        out.w[i] = sample.w[i]
        out.f[i] = sample.f[i]
        out.v[i] = out.bg[i] = out.ba[i] = math.nan
        out.sigma_p[i] = out.sigma_v[i] = out.sigma_rpy[i] = math.nan
        out.sigma_bg[i] = out.sigma_ba[i] = math.nan
