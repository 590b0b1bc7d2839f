"""The table of aiding sources beside GNSS: a row and a branch each, and one in `_align` if it may give the heading."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...compile.jit import kernel
from .. import odometer_source
from ..records import (
    BAROMETER_SOURCE,
    BODY_VELOCITY_SOURCE,
    HEADING_SOURCE,
    MAGNETOMETER_SOURCE,
    ODOMETER_SOURCE,
    POSE_SOURCE,
    VELOCITY_SOURCE,
)
from .aiding import (
    barometer,
    external_pose,
    external_velocity,
    heading,
    heading_deviation,
    heading_turns,
    magnetometer,
    odometer,
    odometer_faults,
    source_age,
    two_wheels,
)
from .aiding.barometer import fuse_barometer
from .aiding.external_pose import fuse_pose
from .aiding.external_velocity import fuse_external_velocity
from .aiding.magnetometer import fuse_magnetometer
from .aiding.odometer import fuse_odometer
from .alignment.external_heading import align_with_compass, fuse_monitored_heading
from .alignment.external_pose import align_with_pose
from .alignment.magnetic_heading import align_with_field
from .state import NAVIGATING

if TYPE_CHECKING:
    from ..types import Innovation, Measurement
    from .types import Core, Parameters

SOURCES = (
    heading.SOURCE,
    odometer_source.SOURCE,
    barometer.SOURCE,
    external_pose.SOURCE,
    external_velocity.NED_SOURCE,
    external_velocity.BODY_SOURCE,
    magnetometer.SOURCE,
)
TUNABLES = (
    *heading.TUNABLES,
    *heading_deviation.TUNABLES,
    *heading_turns.TUNABLES,
    *source_age.TUNABLES,
    *odometer.TUNABLES,
    *odometer_faults.TUNABLES,
    *two_wheels.TUNABLES,
    *barometer.TUNABLES,
    *external_pose.TUNABLES,
    *external_velocity.TUNABLES,
    *magnetometer.TUNABLES,
)
# by source: the kind of innovation under which a measurement beyond the fusion horizon is reported as rejected
REJECTED_KIND = np.zeros(1 + max(source.kind for source in SOURCES), np.int64)
for _source in SOURCES:
    REJECTED_KIND[_source.kind] = next(iter(_source.innovations))


@kernel
def fuse_source(p: Parameters, c: Core, m: Measurement, innovations: list[Innovation]) -> int:
    """Fuse a measurement by its source's file; returns the rows of innovations written.

    During coarse alignment the barometer is fused as later, and a source that knows the heading may give it.
    """
    if c.alignment.mode == NAVIGATING or m.kind == BAROMETER_SOURCE:
        return _fuse(p, c, m, innovations)
    _align(p, c, m)
    return 0


@kernel
def _fuse(p: Parameters, c: Core, m: Measurement, innovations: list[Innovation]) -> int:
    if m.kind == HEADING_SOURCE:
        return fuse_monitored_heading(p, c, m, innovations)
    if m.kind == ODOMETER_SOURCE:
        return fuse_odometer(p, c, m, innovations)
    if m.kind == BAROMETER_SOURCE:
        return fuse_barometer(p, c, m, innovations)
    if m.kind == POSE_SOURCE:
        return fuse_pose(p, c, m, innovations)
    if m.kind == VELOCITY_SOURCE or m.kind == BODY_VELOCITY_SOURCE:
        return fuse_external_velocity(p, c, m, innovations)
    return fuse_magnetometer(p, c, m, innovations)


@kernel
def _align(p: Parameters, c: Core, m: Measurement) -> None:
    if m.kind == HEADING_SOURCE:
        align_with_compass(p, c, m)
    elif m.kind == POSE_SOURCE:
        align_with_pose(p, c, m)
    elif m.kind == MAGNETOMETER_SOURCE:
        align_with_field(p, c, m)
