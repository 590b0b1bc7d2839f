"""The contents of a recording: topics, schemas, and how records become messages and back without loss.

Rows of numbers are Protocol Buffers, what is rare is JSON. Numbers are in SI units, radians, NED and body FRD; their
names say so.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import msgspec
import numpy as np

from imud.drivers.capture_messages import CONNECTIONS, READS, READS_FIELDS
from imud.drivers.protobuf import BYTES, FIXED64, Field, delimited, description, single, tag, varint
from imud.drivers.sample import SAMPLE

from ..estimators.innovation_kinds import KINDS
from ..estimators.records import FIX, INNOVATION, SOLUTION
from ..math.arrays import Records
from .clock_fit import CLOCK_FIT
from .foxglove import FRAME_TRANSFORM, LOCATION_FIX
from .state_messages import STATES_FIELDS

SAMPLES, ESTIMATES, FIXES, CLOCK = "/imu/samples", "/estimate", "/gnss/fixes", "/imu/clock"
INNOVATIONS, EVENTS, SETTINGS, LOCATION, POSE = "/innovations", "/events", "/settings", "/location", "/tf"
RECEIVER_LOCATION = "/gnss/location"  # live only: in a recording the fixes have it
AIDING = "/aiding"
STATES = "/states"


class Schema(NamedTuple):
    """Of the messages on a topic. encoding: of the messages; schema_encoding: of `data`, which describes them."""

    name: str
    encoding: str
    schema_encoding: str
    data: bytes


@dataclass(frozen=True)
class Table:
    """Rows of `dtype` as messages; names: of each field, and what it is; more: fields behind them, for viewers only.

    Every field that is named is written, each number in 8 bytes, so that all messages have the same layout, and many
    rows are encoded or decoded at once. A change of these fields needs another version, here and in FORMAT.
    """

    topic: str
    name: str
    dtype: np.dtype[np.void]
    names: dict[str, tuple[str, str]]
    more: tuple[Field, ...] = ()

    def objects(self, rows: Records) -> list[dict[str, Any]]:
        """A dictionary for each row."""
        keys = [name for name, _ in self.names.values()]
        return [dict(zip(keys, _listed(row), strict=True)) for row in rows[list(self.names)].tolist()]

    def encode(self, rows: Records) -> list[bytes]:
        """A message for each row, without `more`."""
        layout = self._layout
        messages = np.full(len(rows), layout, layout.dtype)
        for field in self.names:
            messages[field] = rows[field]
        data, size = messages.tobytes(), layout.dtype.itemsize
        return [data[at : at + size] for at in range(0, len(data), size)]

    def decode(self, messages: Sequence[bytes]) -> Records:
        """The other way round. Raises ValueError for what is no such message."""
        layout = self._layout
        size = layout.dtype.itemsize
        read = np.frombuffer(b"".join([message[:size] for message in messages]), layout.dtype, len(messages))
        if not all((read[name] == layout[name]).all() for name in layout.dtype.names or () if name not in self.names):
            raise ValueError(f"it is no {self.schema.name}")
        rows = np.zeros(len(read), self.dtype)
        for field in self.names:
            rows[field] = read[field]
        return rows

    def read(self, schema: str, messages: Sequence[bytes]) -> Records:
        """Rows from the messages of a file, by the name of their schema there. Raises ValueError for another one."""
        readers = {self.schema.name: self.decode, f"imud.{self.name}": self.decode_json}
        if schema not in readers:
            raise ValueError(f"the schema {schema} on {self.topic} is not known")
        return readers[schema](messages)

    def decode_json(self, messages: Sequence[bytes]) -> Records:
        """The same of a recording before version 2; null is NaN."""
        objects = [msgspec.json.decode(message) for message in messages]
        rows = np.zeros(len(objects), self.dtype)
        for field, (name, _) in self.names.items():
            kind = self.dtype[field].base
            values = [entry[name] for entry in objects]
            rows[field] = values if kind.kind == "i" else np.array(values, float).reshape(rows[field].shape)
        return rows

    @property
    def fields(self) -> list[Field]:
        """Of the messages."""
        types = [("sfixed64" if kind.base.kind == "i" else "double", bool(kind.shape)) for kind in self._kinds]
        named = zip(self.names.values(), types, strict=True)
        own = [Field(i, name, kind, many, what) for i, ((name, what), (kind, many)) in enumerate(named, 1)]
        return [*own, *self.more]

    @functools.cached_property
    def schema(self) -> Schema:
        """Of its topic."""
        return _protobuf({f"imud.v2.{self.name}": self.fields})

    @property
    def _kinds(self) -> list[np.dtype[Any]]:
        return [self.dtype[field] for field in self.names]

    @functools.cached_property
    def _layout(self) -> Any:
        """A message whose numbers are zero; before each of them stand the constant bytes of its field."""
        parts: list[tuple[str, Any]] = []
        constant = []
        for i, (field, kind) in enumerate(zip(self.names, self._kinds, strict=True), 1):
            before = tag(i, BYTES) + varint(kind.itemsize) if kind.shape else tag(i, FIXED64)
            parts += [(f"{field} tag", f"V{len(before)}"), (field, kind)]
            constant.append((f"{field} tag", before))
        layout = np.zeros((), parts)
        for name, before in constant:
            layout[name] = np.void(before)
        return layout


def _listed(row: tuple[Any, ...]) -> list[Any]:
    return [value.tolist() if isinstance(value, np.ndarray) else value for value in row]


def _protobuf(messages: dict[str, Sequence[Field]]) -> Schema:
    """Of the last of these messages."""
    return Schema(list(messages)[-1], "protobuf", "protobuf", description(messages))


def _json(name: str, properties: dict[str, Any]) -> Schema:
    schema = msgspec.json.encode({"title": name, "type": "object", "properties": properties})
    return Schema(name, "json", "jsonschema", schema)


_T = ("t_ns", "CLOCK_MONOTONIC of the host, ns")
SAMPLE_TABLE = Table(
    SAMPLES,
    "Sample",
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
    "Estimate",
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
    "Fix",
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
    "Innovation",
    INNOVATION,
    {
        "t_ns": ("t_ns", "epoch of the measurement on CLOCK_MONOTONIC, ns"),
        "kind": ("kind", "code of what was measured; see `what`"),
        "value": ("value", "measured minus predicted"),
        "variance": ("S", "predicted variance of `value`"),
        "used": ("used", "1 fused, 0 rejected by its gate"),
    },
    (
        Field(6, "sigma", "float", about="square root of S; NaN: not known"),
        Field(7, "normalised", "float", about="value / sigma; of a filter that is right its variance is 1"),
        Field(8, "what", "string", about="the kind in words, with the unit of value and sigma"),
        Field(9, "verdict", "string"),
    ),
)
CLOCK_TABLE = Table(
    CLOCK,
    "Clock",
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
_NUMBERS = {"type": "array", "items": {"type": ["number", "null"]}, "minItems": 3, "maxItems": 6}

SCHEMAS: dict[str, Schema] = {  # by topic
    **{table.topic: table.schema for table in TABLES},
    READS: _protobuf({"imud.v3.Reads": READS_FIELDS}),
    STATES: _protobuf({"imud.v1.States": STATES_FIELDS}),
    LOCATION: _protobuf(LOCATION_FIX),
    RECEIVER_LOCATION: _protobuf(LOCATION_FIX),
    POSE: _protobuf(FRAME_TRANSFORM),
    CONNECTIONS: _json(
        "imud.Connection",
        {
            **{"t_ns": _WHEN, "port": {"type": "integer"}, "path": _TEXT, "streaming": {"type": "boolean"}},
            **{"kind": _TEXT, "driver": _TEXT, "configured": _ANY, "calibration": _ANY},
            "repeated": {"type": "boolean"},
        },
    ),
    EVENTS: _json("imud.Event", {"t_ns": _WHEN, "level": _TEXT, "text": _TEXT, "facts": _ANY}),
    AIDING: _json(
        "imud.Measurement",
        {
            **{"t_ns": {**_WHEN, "description": "epoch on CLOCK_MONOTONIC, ns"}, "arrival_ns": _WHEN},
            "source": {**_TEXT, "description": "name of the aiding source"},
            "value": {**_NUMBERS, "description": "SI units; its columns in their order"},
            "sigma": {**_NUMBERS, "description": "1 sigma of each; null: not known"},
        },
    ),
    SETTINGS: _json("imud.Settings", {"t_ns": _WHEN, "settings": _ANY}),
}


def innovation_messages(rows: Records) -> list[bytes]:
    """Rows of INNOVATION, each with what follows from it."""
    messages = []
    for message, row in zip(INNOVATION_TABLE.encode(rows), rows, strict=True):
        sigma = math.sqrt(row["variance"]) if row["variance"] > 0.0 else math.nan
        more = single(6, sigma) + single(7, float(row["value"]) / sigma)
        words = delimited(8, KINDS[int(row["kind"])].words) + delimited(9, "used" if row["used"] else "rejected")
        messages.append(message + more + words)
    return messages
