"""Messages of ROS 2 in CDR: sensor_msgs/Imu, NavSatFix, nav_msgs/Odometry, after REP-103, REP-105 and REP-145.

World is ENU (`map`), body FLU (`base_link`), quaternions x y z w; twists are in the body's axes. A covariance that
begins with -1 says that there is no such estimate, one of zeros that it is not known.
"""

import math
import struct
from collections.abc import Iterable, Sequence

import numpy as np

from ..estimators.records import ATTITUDE_VALID, HEIGHT_VALID, POSITION_VALID
from .enu import LocalMap, attitude, body, diagonal, world
from .foxglove import BODY, MAP

_NONE = [-1.0, *[0.0] * 8]
_UNKNOWN = [0.0] * 9
_STATUS_FIX, _STATUS_NO_FIX, _SERVICE_GPS, _DIAGONAL_KNOWN = 0, -1, 1, 2


class Cdr:
    """A message as it grows: each number aligned to its size, from behind the 4-byte header."""

    def __init__(self) -> None:
        self._data = bytearray(b"\x00\x01\x00\x00")

    def add(self, code: str, *numbers: float) -> "Cdr":
        """Numbers of the `struct` code."""
        size = struct.calcsize(code)
        self._data += bytes(-(len(self._data) - 4) % size)
        self._data += struct.pack(f"<{len(numbers)}{code}", *numbers)
        return self

    def text(self, text: str) -> "Cdr":
        """A string."""
        data = text.encode() + b"\0"
        self.add("I", len(data))
        self._data += data
        return self

    def header(self, unix_ns: int, frame: str) -> "Cdr":
        """std_msgs/Header."""
        return self.add("i", unix_ns // 1_000_000_000).add("I", unix_ns % 1_000_000_000).text(frame)

    def bytes(self) -> bytes:
        """All of it."""
        return bytes(self._data)


def _quaternion(q_nb: Sequence[float]) -> tuple[float, float, float, float]:
    w, x, y, z = attitude(q_nb)
    return x, y, z, w


def imu(solution: np.void, unix_ns: int) -> bytes:
    """sensor_msgs/msg/Imu, of a row of SOLUTION: without the biases, with gravity (REP-145)."""
    known = int(solution["status"]) & ATTITUDE_VALID
    message = Cdr().header(unix_ns, BODY).add("d", *_quaternion(solution["q_nb"].tolist()))
    message.add("d", *(diagonal(solution["sigma_rpy"].tolist()) if known else _NONE))
    message.add("d", *body(solution["w"].tolist())).add("d", *_UNKNOWN)
    return message.add("d", *body(solution["f"].tolist())).add("d", *_UNKNOWN).bytes()


def nav_sat_fix(solution: np.void, unix_ns: int) -> bytes:
    """sensor_msgs/msg/NavSatFix, of a row of SOLUTION: the filter's position; an unknown altitude is NaN."""
    known = int(solution["status"]) & POSITION_VALID
    lat, lon = (math.degrees(solution[name]) for name in ("lat", "lon"))
    altitude = float(solution["height"]) if int(solution["status"]) & HEIGHT_VALID else math.nan
    message = Cdr().header(unix_ns, BODY).add("b", _STATUS_FIX if known else _STATUS_NO_FIX).add("H", _SERVICE_GPS)
    message.add("d", lat, lon, altitude)
    covariance = diagonal(world(solution["sigma_p"].tolist())) if known else _UNKNOWN
    return message.add("d", *covariance).add("B", _DIAGONAL_KNOWN if known else 0).bytes()


def odometry(solution: np.void, unix_ns: int, plane: LocalMap) -> bytes | None:
    """nav_msgs/msg/Odometry, of a row of SOLUTION; None while there is no position."""
    if not int(solution["status"]) & POSITION_VALID:
        return None
    q = attitude(solution["q_nb"].tolist())
    place = plane.place(*(float(solution[name]) for name in ("lat", "lon", "height")))
    message = Cdr().header(unix_ns, MAP).text(BODY).add("d", *place).add("d", *_quaternion(solution["q_nb"].tolist()))
    message.add("d", *_six(world(solution["sigma_p"].tolist()), solution["sigma_rpy"].tolist()))
    r = _matrix(q)
    v, sigma = world(solution["v"].tolist()), world(solution["sigma_v"].tolist())
    turned = [[r[j][i] for j in range(3)] for i in range(3)]  # from world to body
    velocity = [sum(row[j] * v[j] for j in range(3)) for row in turned]
    spread = [sum((row[j] * sigma[j]) ** 2 for j in range(3)) ** 0.5 for row in turned]
    message.add("d", *velocity).add("d", *body(solution["w"].tolist()))
    return message.add("d", *_six(spread, (0.0, 0.0, 0.0))).bytes()


def _six(first: Iterable[float], second: Iterable[float]) -> list[float]:
    """Row-major 6 x 6 covariance of independent components."""
    return np.diag(np.square([*first, *second])).ravel().tolist()


def _matrix(q: Sequence[float]) -> list[list[float]]:
    w, x, y, z = q
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


_SEPARATOR = "=" * 80
_PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "sensor_msgs/NavSatStatus": (
        "int8 STATUS_NO_FIX=-1\nint8 STATUS_FIX=0\nint8 STATUS_SBAS_FIX=1\nint8 STATUS_GBAS_FIX=2\nint8 status\n"
        "uint16 SERVICE_GPS=1\nuint16 SERVICE_GLONASS=2\nuint16 SERVICE_COMPASS=4\nuint16 SERVICE_GALILEO=8\n"
        "uint16 service"
    ),
}
_WHOLE = {
    "sensor_msgs/msg/Imu": (
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance"
    ),
    "sensor_msgs/msg/NavSatFix": (
        "std_msgs/Header header\nsensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\n"
        "float64 altitude\nfloat64[9] position_covariance\nuint8 COVARIANCE_TYPE_UNKNOWN=0\n"
        "uint8 COVARIANCE_TYPE_APPROXIMATED=1\nuint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2\n"
        "uint8 COVARIANCE_TYPE_KNOWN=3\nuint8 position_covariance_type"
    ),
    "nav_msgs/msg/Odometry": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
        "geometry_msgs/TwistWithCovariance twist"
    ),
}


def definition(name: str) -> str:
    """The text that describes a message type, with all that it consists of."""
    texts, wanted = [_WHOLE[name]], [_WHOLE[name]]
    seen: set[str] = set()
    while wanted:
        for word in wanted.pop().split():
            if word in _PARTS and word not in seen:
                seen.add(word)
                wanted.append(_PARTS[word])
                texts.append(f"{_SEPARATOR}\nMSG: {word}\n{_PARTS[word]}")
    return "\n".join(texts) + "\n"
