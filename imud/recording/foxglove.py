"""Estimates for Foxglove's map and 3-D view: LocationFix, and FrameTransform from ENU to body FLU (REP-103).

https://github.com/foxglove/foxglove-sdk/tree/main/schemas/proto/foxglove
"""

import math
from collections.abc import Sequence
from typing import Any

from imud.drivers.protobuf import Field, delimited, doubles, integer

from ..estimators.records import ATTITUDE_VALID, HEIGHT_VALID, POSITION_VALID
from .enu import ANTENNA, BODY, MAP, LocalMap, Vector, attitude, diagonal, world

_APPROXIMATED, _DIAGONAL_KNOWN = 1, 2  # LocationFix
_TIMESTAMP = {"google.protobuf.Timestamp": (Field(1, "seconds", "int64"), Field(2, "nanos", "int32"))}
LOCATION_FIX: dict[str, Sequence[Field]] = _TIMESTAMP | {
    "foxglove.LocationFix": (
        *(Field(i, name, "double") for i, name in enumerate(("latitude", "longitude", "altitude"), 1)),
        Field(4, "position_covariance", "double", True, "m^2, east north up, row-major"),
        Field(5, "position_covariance_type", "int32", about="1: approximated, 2: the diagonal is known"),
        Field(6, "timestamp", "google.protobuf.Timestamp"),
        Field(7, "frame_id", "string"),
    )
}
FRAME_TRANSFORM: dict[str, Sequence[Field]] = _TIMESTAMP | {
    "foxglove.Vector3": tuple(Field(i, name, "double") for i, name in enumerate("xyz", 1)),
    "foxglove.Quaternion": tuple(Field(i, name, "double") for i, name in enumerate("xyzw", 1)),
    "foxglove.FrameTransform": (
        Field(1, "timestamp", "google.protobuf.Timestamp"),
        Field(2, "parent_frame_id", "string"),
        Field(3, "child_frame_id", "string"),
        Field(4, "translation", "foxglove.Vector3"),
        Field(5, "rotation", "foxglove.Quaternion"),
    ),
}


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


def encoded_location(fix: dict[str, Any] | None) -> bytes | None:
    """A LocationFix as a message; None: there is none. An altitude that is not known is NaN."""
    if fix is None:
        return None
    altitude = math.nan if fix["altitude"] is None else fix["altitude"]
    places = doubles(1, fix["latitude"]) + doubles(2, fix["longitude"]) + doubles(3, altitude)
    covariance = doubles(4, *fix["position_covariance"]) + integer(5, fix["position_covariance_type"])
    return places + covariance + delimited(6, _encoded_time(fix["timestamp"])) + delimited(7, fix["frame_id"])


def encoded_transform(pose: dict[str, Any] | None) -> bytes | None:
    """A FrameTransform as a message; None: there is none."""
    if pose is None:
        return None
    frames = delimited(2, pose["parent_frame_id"]) + delimited(3, pose["child_frame_id"])
    translation, rotation = (
        b"".join(doubles(i, pose[name][axis]) for i, axis in enumerate(axes, 1))
        for name, axes in (("translation", "xyz"), ("rotation", "xyzw"))
    )
    return delimited(1, _encoded_time(pose["timestamp"])) + frames + delimited(4, translation) + delimited(5, rotation)


def _encoded_time(time: dict[str, int]) -> bytes:
    return integer(1, time["sec"]) + integer(2, time["nsec"])
