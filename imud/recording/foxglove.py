"""Estimates for Foxglove's map and 3-D view: LocationFix, and FrameTransform from ENU to body FLU (REP-103)."""

import math
from typing import Any

from ..estimators.records import ATTITUDE_VALID, HEIGHT_VALID, POSITION_VALID
from .enu import LocalMap, attitude, diagonal, world

MAP, BODY = "map", "base_link"
_DIAGONAL_KNOWN = 2  # LocationFix


def _time(unix_ns: int) -> dict[str, int]:
    seconds, ns = divmod(unix_ns, 1_000_000_000)
    return {"sec": seconds, "nsec": ns}


def location(estimate: dict[str, Any], unix_ns: int) -> dict[str, Any] | None:
    """None while the position is not valid. The altitude is null while the height is not."""
    if not estimate["status"] & POSITION_VALID:
        return None
    return {
        "timestamp": _time(unix_ns),
        "frame_id": MAP,
        "latitude": math.degrees(estimate["lat_rad"]),
        "longitude": math.degrees(estimate["lon_rad"]),
        "altitude": estimate["height_m"] if estimate["status"] & HEIGHT_VALID else None,
        "position_covariance": diagonal(world(estimate["sigma_p_m"])),
        "position_covariance_type": _DIAGONAL_KNOWN,
    }


def transform(estimate: dict[str, Any], unix_ns: int, plane: LocalMap) -> dict[str, Any] | None:
    """None while the attitude is not valid. The body stays at the origin until its position is known."""
    if not estimate["status"] & ATTITUDE_VALID:
        return None
    place = (0.0, 0.0, 0.0)
    if estimate["status"] & POSITION_VALID:
        place = plane.place(estimate["lat_rad"], estimate["lon_rad"], estimate["height_m"])
    w, x, y, z = attitude(estimate["q_nb"])
    return {
        "timestamp": _time(unix_ns),
        "parent_frame_id": MAP,
        "child_frame_id": BODY,
        "translation": dict(zip("xyz", place, strict=True)),
        "rotation": {"x": x, "y": y, "z": z, "w": w},
    }
