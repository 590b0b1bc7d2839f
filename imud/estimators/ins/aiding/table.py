"""The aiding sources other than GNSS: one row and one branch for each. Everything else about a source is its file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ....compile.jit import kernel
from ...records import HEADING, HEADING_SOURCE
from . import heading
from .heading import fuse_heading

if TYPE_CHECKING:
    from ..types import Core, Innovation, Measurement, Parameters

REJECTED_KIND = np.array([0, HEADING])  # by source: the innovation that says that a measurement was too old
TUNABLES = (*heading.TUNABLES,)


@kernel
def fuse_source(p: Parameters, c: Core, m: Measurement, innovations: list[Innovation]) -> int:
    """Fuse a measurement by its source's file; returns the rows of innovations written."""
    if m.kind == HEADING_SOURCE:
        return fuse_heading(p, c, m, innovations)
    return 0
