"""Estimates for Foxglove's map and 3-D view: LocationFix, and FrameTransform from ENU to body FLU (REP-103)."""

import math
from typing import Any

from ..estimators.records import ATTITUDE_VALID, HEIGHT_VALID, POSITION_VALID
from .enu import ANTENNA, BODY, MAP, LocalMap, Vector, attitude, diagonal, world

_APPROXIMATED, _DIAGONAL_KNOWN = 1, 2  # LocationFix


def _time(unix_ns: int) -> dict[str, int]:
    seconds, ns = divmod(unix_ns, 1_000_000_000)
    return {"sec": seconds, "nsec": ns}


def location(estimate: dict[str, Any], unix_ns: int) -> dict[str, Any] | None:
    """None while the position is not valid. The altitude is null while the height is not."""
    if not estimate["status"] & POSITION_VALID:
        return None
    height = estimate["height_m"] if estimate["status"] & HEIGHT_VALID else None
    return _location_fix(unix_ns, BODY, estimate, height, estimate["sigma_p_m"], _DIAGONAL_KNOWN)


def receiver_location(fix: dict[str, Any], sigma: Vector, unix_ns: int) -> dict[str, Any]:
    """The same of a fix. sigma: north, east, down, m, derived where the receiver reports none."""
    height = fix["height_m"]
    return _location_fix(unix_ns, ANTENNA, fix, None if height != height else height, sigma, _APPROXIMATED)  # noqa: PLR0124 - NaN


def _location_fix(
    unix_ns: int, frame: str, position: dict[str, Any], height: float | None, sigma: Vector, kind: int
) -> dict[str, Any]:
    return {
        "timestamp": _time(unix_ns),
        "frame_id": frame,
        "latitude": math.degrees(position["lat_rad"]),
        "longitude": math.degrees(position["lon_rad"]),
        "altitude": height,
        "position_covariance": diagonal(world(sigma)),
        "position_covariance_type": kind,
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
