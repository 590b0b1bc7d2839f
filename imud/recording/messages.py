"""The contents of a recording: topics, JSON schemas, and how records become JSON and back without loss.

Numbers are in SI units, radians, NED and body FRD; their names say so. NaN is null. Doubles are written so that they
read back bit for bit.
"""

import math
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from imud.drivers.capture import CONNECTIONS, RAW
from imud.drivers.sample import SAMPLE

from ..estimators.innovation_kinds import KINDS
from ..estimators.records import FIX, INNOVATION, SOLUTION
from ..math.arrays import Records
from .clock_fit import CLOCK_FIT

SAMPLES, ESTIMATES, FIXES, CLOCK = "/imu/samples", "/estimate", "/gnss/fixes", "/imu/clock"
INNOVATIONS, EVENTS, SETTINGS, LOCATION, POSE = "/innovations", "/events", "/settings", "/location", "/tf"
RECEIVER_LOCATION = "/gnss/location"  # live only: in a recording the fixes tell it
AIDING = "/aiding"


@dataclass(frozen=True)
class Table:
    """Rows of `dtype` as JSON objects; names: of each field, and what it is."""

    topic: str
    schema: str
    dtype: np.dtype[np.void]
    names: dict[str, tuple[str, str]]

    def objects(self, rows: Records) -> list[dict[str, Any]]:
        """One for each row."""
        keys = [name for name, _ in self.names.values()]
        return [dict(zip(keys, _listed(row), strict=True)) for row in rows.tolist()]

    def rows(self, objects: list[dict[str, Any]]) -> Records:
        """The other way round; null is NaN."""
        rows = np.zeros(len(objects), self.dtype)
        for field, (name, _) in self.names.items():
            kind = self.dtype[field].base
            values = [entry[name] for entry in objects]
            rows[field] = values if kind.kind == "i" else np.array(values, float).reshape(rows[field].shape)
        return rows

    def json_schema(self) -> bytes:
        properties = {name: _property(self.dtype[field], what) for field, (name, what) in self.names.items()}
        return _schema(self.schema, properties)


def _listed(row: tuple[Any, ...]) -> list[Any]:
    return [value.tolist() if isinstance(value, np.ndarray) else value for value in row]


def _property(kind: np.dtype[Any], what: str) -> dict[str, Any]:
    number: dict[str, Any] = {"type": "integer" if kind.base.kind == "i" else ["number", "null"]}
    if kind.shape:
        n = kind.shape[0]
        return {"type": "array", "items": number, "minItems": n, "maxItems": n, "description": what}
    return number | {"description": what}


def _schema(title: str, properties: dict[str, Any]) -> bytes:
    return msgspec.json.encode({"title": title, "type": "object", "properties": properties})


_T = ("t_ns", "CLOCK_MONOTONIC of the host, ns")
SAMPLE_TABLE = Table(
    SAMPLES,
    "imud.Sample",
    SAMPLE,
    {
        "t_ns": _T,
        "tick": ("tick", "counter of the device"),
        "w": ("w_radps", "angular rate, body FRD, rad/s, calibrated"),
        "f": ("f_mps2", "specific force, body FRD, m/s^2, calibrated; at rest and level (0, 0, -g)"),
        "down": ("down", "unit vector down by the device itself; zeros: it has none"),
        "temperature": ("temperature_c", "degC"),
        "flags": (
            "flags",
            "bits: 1 suspect, 2 saturated, 4 device error, 8 no rate, 16 no force, 32 gyro saturated, "
            "64 accelerometer saturated, 128 first after a power-on",
        ),
        "outage_s": ("unseen_s", "s since rates, or forces, were last credible"),
    },
)
ESTIMATE_TABLE = Table(
    ESTIMATES,
    "imud.Estimate",
    SOLUTION,
    {
        "t_ns": _T,
        "status": (
            "status",
            "bits: 1 attitude, 2 heading, 4 position valid, 8 rest, 16 coasting, 32 rejecting, 64 saturated, "
            "128 height valid",
        ),
        "lat": ("lat_rad", "WGS-84, rad"),
        "lon": ("lon_rad", "rad"),
        "height": ("height_m", "above the ellipsoid, m"),
        "v": ("v_mps", "NED, m/s"),
        "q_nb": ("q_nb", "Hamilton, scalar first, from body FRD to NED"),
        "w": ("w_radps", "body rate without bias, rad/s"),
        "f": ("f_mps2", "specific force without bias, m/s^2"),
        "bg": ("gyro_bias_radps", "rad/s"),
        "ba": ("accel_bias_mps2", "m/s^2"),
        "sigma_p": ("sigma_p_m", "1 sigma, north east down, m"),
        "sigma_v": ("sigma_v_mps", "1 sigma, m/s"),
        "sigma_rpy": ("sigma_rpy_rad", "1 sigma of roll, pitch, yaw, rad"),
        "sigma_bg": ("sigma_gyro_bias_radps", "1 sigma, rad/s"),
        "sigma_ba": ("sigma_accel_bias_mps2", "1 sigma, m/s^2"),
    },
)
FIX_TABLE = Table(
    FIXES,
    "imud.Fix",
    FIX,
    {
        "t_ns": ("t_ns", "epoch on CLOCK_MONOTONIC, ns"),
        "arrival_ns": ("arrival_ns", "when it became known, ns"),
        "lat": ("lat_rad", "WGS-84, rad"),
        "lon": ("lon_rad", "rad"),
        "height": ("height_m", "above the ellipsoid, m"),
        "sigma": ("sigma_m", "1 sigma north, east, down, m"),
        "hdop": ("hdop", "horizontal dilution of precision"),
        "v": ("v_mps", "NED, m/s"),
        "speed": ("speed_mps", "over ground, m/s"),
        "course": ("course_rad", "from true north, rad"),
        "quality": ("quality", "as NMEA GGA"),
        "satellites": ("satellites", "in use; -1: unknown"),
        "sigma_v": ("sigma_v_mps", "1 sigma of v_mps, m/s"),
    },
)
INNOVATION_TABLE = Table(
    INNOVATIONS,
    "imud.Innovation",
    INNOVATION,
    {
        "t_ns": ("t_ns", "epoch of the measurement on CLOCK_MONOTONIC, ns"),
        "kind": ("kind", "code of what was measured; see `what`"),
        "value": ("value", "measured minus predicted"),
        "variance": ("S", "predicted variance of `value`"),
        "used": ("used", "1 fused, 0 rejected by its gate"),
    },
)
CLOCK_TABLE = Table(
    CLOCK,
    "imud.Clock",
    CLOCK_FIT,
    {
        "t_ns": _T,
        "port": ("port", "of the inertial sensor"),
        "drift": ("drift", "of the sensor's clock against the host's, positive when slow; times 1e6 it is in ppm"),
        "sigma_drift": ("sigma_drift", "1 sigma, by the scatter of the arrivals alone"),
        "residual": ("residual_s", "median distance of the earliest arrivals from the fitted line, s"),
        "late": ("late_s", "how much later than at best samples come, mean of late, s"),
        "latest": ("latest_s", "and at most, s"),
        "corrections": ("corrections", "of the counter, since the connection"),
        "frames": ("frames", "good ones since the connection"),
        "junk": ("junk", "bytes outside of frames"),
        "bad": ("bad", "damaged frames"),
        "lost": ("lost", "samples that the counter says are missing"),
        "errors": ("errors", "frames with the device's own error bit"),
    },
)
TABLES = (SAMPLE_TABLE, ESTIMATE_TABLE, FIX_TABLE, INNOVATION_TABLE, CLOCK_TABLE)

_ANY = {"type": "object"}
_TEXT = {"type": "string"}
_WHEN = {"type": "integer", "description": _T[1]}
_VECTOR = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
_QUATERNION = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyzw"}}
_TIME = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer", "minimum": 0}},
}
_THREE = {"type": "array", "items": {"type": ["number", "null"]}, "minItems": 3, "maxItems": 3}
_NINE = {"type": "array", "items": {"type": "number"}, "minItems": 9, "maxItems": 9}

SCHEMAS: dict[str, bytes] = {
    **{table.schema: table.json_schema() for table in TABLES},
    "imud.Raw": _schema("imud.Raw", {"t_ns": _WHEN, "data": {**_TEXT, "contentEncoding": "base64"}, "pulse_ns": _WHEN}),
    "imud.Connection": _schema(
        "imud.Connection",
        {
            **{"t_ns": _WHEN, "port": {"type": "integer"}, "path": _TEXT, "streaming": {"type": "boolean"}},
            **{"kind": _TEXT, "driver": _TEXT, "configured": _ANY, "calibration": _ANY},
            "repeated": {"type": "boolean"},
        },
    ),
    "imud.Event": _schema("imud.Event", {"t_ns": _WHEN, "level": _TEXT, "text": _TEXT, "facts": _ANY}),
    "imud.Measurement": _schema(
        "imud.Measurement",
        {
            **{"t_ns": {**_WHEN, "description": "epoch on CLOCK_MONOTONIC, ns"}, "arrival_ns": _WHEN},
            "source": {**_TEXT, "description": "name of the aiding source"},
            "value": {**_THREE, "description": "SI units; its columns in their order"},
            "sigma": {**_THREE, "description": "1 sigma of each; null: not known"},
        },
    ),
    "imud.Settings": _schema("imud.Settings", {"t_ns": _WHEN, "settings": _ANY}),
    "foxglove.LocationFix": _schema(
        "foxglove.LocationFix",
        {
            "timestamp": _TIME,
            "frame_id": _TEXT,
            **{name: {"type": "number"} for name in ("latitude", "longitude")},
            "altitude": {"type": ["number", "null"]},
            "position_covariance": {**_NINE, "description": "m^2, east north up, row-major"},
            "position_covariance_type": {"type": "integer"},
        },
    ),
    "foxglove.FrameTransform": _schema(
        "foxglove.FrameTransform",
        {
            "timestamp": _TIME,
            "parent_frame_id": _TEXT,
            "child_frame_id": _TEXT,
            "translation": _VECTOR,
            "rotation": _QUATERNION,
        },
    ),
}
TOPICS = {
    **{table.topic: table.schema for table in TABLES},
    CONNECTIONS: "imud.Connection",
    EVENTS: "imud.Event",
    SETTINGS: "imud.Settings",
    AIDING: "imud.Measurement",
    LOCATION: "foxglove.LocationFix",
    RECEIVER_LOCATION: "foxglove.LocationFix",
    POSE: "foxglove.FrameTransform",
}


def schema_of(topic: str) -> str:
    """Name of the schema of what is on the topic."""
    return "imud.Raw" if topic.startswith(RAW) else TOPICS[topic]


def innovation(entry: dict[str, Any]) -> dict[str, Any]:
    """An innovation with what follows from it."""
    variance = entry["S"]
    known = variance is not None and variance > 0.0
    return {
        **entry,
        "what": KINDS[entry["kind"]].words,
        "sigma": math.sqrt(variance) if known else None,
        "normalised": entry["value"] / math.sqrt(variance) if known else None,
        "verdict": "used" if entry["used"] else "rejected",
    }
