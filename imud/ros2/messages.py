"""Records as messages of ROS 2 in CDR, after REP-103, REP-105 and REP-145. The frames are in `frames`.

World is ENU, body FLU, quaternions x y z w; twists are in the body's axes. A covariance of an Imu message that begins
with -1 says that there is no such estimate. Covariances of an orientation are those of its roll, pitch and yaw.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from imud.drivers.sample import NO_FORCE, NO_RATE, SUSPECT

from ..estimators.records import ATTITUDE_VALID, HEIGHT_VALID, POSITION_VALID
from ..math.arrays import Floats
from ..recording.enu import ANTENNA, BODY, IMU, MAP, Vector, attitude, body, diagonal, world
from ..sensor_errors.profiles import SampleSigma
from .cdr import Cdr
from .frames import Transform

_NONE = [-1.0, *[0.0] * 8]
_NO_VECTOR, _NO_ROTATION = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
UNKNOWN_VAR = 1e6  # of what is not known, where a message has no way to say so: a height, rates
_NO_FIX, _FIX, _SATELLITE_AUGMENTED, _GROUND_AUGMENTED = -1, 0, 1, 2
_STATUS_OF_QUALITY = {0: _NO_FIX, 2: _SATELLITE_AUGMENTED, 4: _GROUND_AUGMENTED, 5: _GROUND_AUGMENTED}  # of GGA
_SERVICE_GPS = 1
_UNKNOWN, _APPROXIMATED, _DIAGONAL_KNOWN = 0, 1, 2
_OK, _WARN, _, _STALE = range(4)  # DiagnosticStatus


class Sigmas(NamedTuple):
    """What samples are worth. None: there is no such sensor, or it is not known."""

    gyro: SampleSigma | None = None
    accel: SampleSigma | None = None


def _measured(
    v: Sequence[float], sensor: SampleSigma | None, bias: Sequence[float] | None = None
) -> tuple[Sequence[float], list[float]]:
    """A measured vector (FRD) in FLU, and its covariance (row-major 3 x 3).

    bias: sigmas of the estimated biases. Where they are None or NaN the bias is that of the switch-on.
    """
    if sensor is None or not math.isfinite(sum(v)):
        return _NO_VECTOR, _NONE
    common = sensor.white**2 + (sensor.scale * math.hypot(*v)) ** 2
    biases = [s if math.isfinite(s) else sensor.bias for s in bias or [sensor.bias] * 3]
    return body(v), diagonal([math.sqrt(common + s * s) for s in biases])


def imu_raw(sample: np.void, unix_ns: int, sigmas: Sigmas) -> bytes:
    """sensor_msgs/msg/Imu, of a row of SAMPLE: as measured, without an orientation (REP-145)."""
    flags = int(sample["flags"])
    message = Cdr().header(unix_ns, IMU).quaternion(_NO_ROTATION).add("d", *_NONE)
    gyro = None if flags & (NO_RATE | SUSPECT) else sigmas.gyro
    accel = None if flags & (NO_FORCE | SUSPECT) else sigmas.accel
    for v, sensor in ((sample["w"], gyro), (sample["f"], accel)):
        vector, covariance = _measured(v.tolist(), sensor)
        message.add("d", *vector).add("d", *covariance)
    return message.bytes()


def imu(solution: np.void, unix_ns: int, sigmas: Sigmas) -> bytes:
    """sensor_msgs/msg/Imu, of a row of SOLUTION: without the biases, with gravity (REP-145)."""
    known = int(solution["status"]) & ATTITUDE_VALID
    message = Cdr().header(unix_ns, IMU).quaternion(attitude(solution["q_nb"].tolist()))
    message.add("d", *(diagonal(solution["sigma_rpy"].tolist()) if known else _NONE))
    for name, bias, sensor in (("w", "sigma_bg", sigmas.gyro), ("f", "sigma_ba", sigmas.accel)):
        vector, covariance = _measured(solution[name].tolist(), sensor, solution[bias].tolist())
        message.add("d", *vector).add("d", *covariance)
    return message.bytes()


def _nav_sat_fix(
    unix_ns: int, frame: str, status: int, position: Sequence[float], sigma: Sequence[float], kind: int
) -> bytes:
    """position: degrees, m; sigma: m, north east down. A height of NaN is not known."""
    east, north, up = (s * s for s in world(sigma))
    if not math.isfinite(position[2]):
        up, kind = UNKNOWN_VAR, min(kind, _APPROXIMATED)
    covariance = np.diag([east, north, up]).ravel().tolist() if kind else [0.0] * 9
    message = Cdr().header(unix_ns, frame).add("b", status).add("H", _SERVICE_GPS).add("d", *position)
    return message.add("d", *covariance).add("B", kind).bytes()


def filtered_fix(solution: np.void, unix_ns: int) -> bytes:
    """sensor_msgs/msg/NavSatFix, of a row of SOLUTION: the filter's position of the body."""
    known = int(solution["status"]) & POSITION_VALID
    position = _position(solution)
    if not known:
        return _nav_sat_fix(unix_ns, BODY, _NO_FIX, [math.nan] * 3, [math.nan] * 3, _UNKNOWN)
    return _nav_sat_fix(unix_ns, BODY, _FIX, position, solution["sigma_p"].tolist(), _DIAGONAL_KNOWN)


def _position(solution: np.void) -> tuple[float, float, float]:
    height = float(solution["height"]) if int(solution["status"]) & HEIGHT_VALID else math.nan
    return math.degrees(solution["lat"]), math.degrees(solution["lon"]), height


def receiver_fix(fix: np.void, unix_ns: int, derived: Vector) -> bytes:
    """sensor_msgs/msg/NavSatFix, of a row of FIX: the antenna's, as the receiver reports it.

    derived: sigma north, east, down that stand for those it does not report.
    """
    reported = fix["sigma"].tolist()
    sigma = [s if math.isfinite(s) else d for s, d in zip(reported, derived, strict=True)]
    kind = _DIAGONAL_KNOWN if math.isfinite(sum(reported)) else _APPROXIMATED
    status = _STATUS_OF_QUALITY.get(int(fix["quality"]), _FIX)
    position = (math.degrees(fix["lat"]), math.degrees(fix["lon"]), float(fix["height"]))
    return _nav_sat_fix(unix_ns, ANTENNA, status, position, sigma, kind)


def odometry(solution: np.void, unix_ns: int, place: Vector, gyro: SampleSigma | None) -> bytes:
    """nav_msgs/msg/Odometry of the body in the map, of a row of SOLUTION with a position. place: ENU, m."""
    message = Cdr().header(unix_ns, MAP).text(BODY)
    message.add("d", *place).quaternion(attitude(solution["q_nb"].tolist()))
    east, north, up = world(solution["sigma_p"].tolist())
    if not int(solution["status"]) & HEIGHT_VALID:
        up = math.sqrt(UNKNOWN_VAR)
    message.add("d", *np.diag(np.square([east, north, up, *solution["sigma_rpy"]])).ravel().tolist())
    velocity, spread = body_velocity(solution)
    rates, variances = _measured(solution["w"].tolist(), gyro, solution["sigma_bg"].tolist())
    covariance = np.diag([UNKNOWN_VAR] * 6)
    covariance[:3, :3] = spread
    if variances is not _NONE:
        covariance[3:, 3:] = np.reshape(variances, (3, 3))
    return message.add("d", *velocity).add("d", *rates).add("d", *covariance.ravel().tolist()).bytes()


def body_velocity(solution: np.void) -> tuple[list[float], Floats]:
    """The velocity in the body (FLU) and its covariance (3 x 3): that of the velocity in NED, and what the errors of
    the attitude make of it.
    """
    r_nb, v = _matrix(solution["q_nb"].tolist()), solution["v"]
    north, east, down = v.tolist()
    cross = np.array([[0.0, down, -east], [-down, 0.0, north], [east, -north, 0.0]])  # axis @ cross: v x axis
    yaw = math.atan2(r_nb[1, 0], r_nb[0, 0])
    axes = np.array([r_nb[:, 0], (-math.sin(yaw), math.cos(yaw), 0.0), (0.0, 0.0, 1.0)])  # of roll, pitch, yaw
    errors = np.diag(solution["sigma_v"]), solution["sigma_rpy"][:, np.newaxis] * (axes @ cross)
    turned = np.vstack([v, *errors]) @ r_nb * (1.0, -1.0, -1.0)
    return turned[0].tolist(), turned[1:].T @ turned[1:]


def _matrix(q: Sequence[float]) -> Floats:
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def transforms(unix_ns: int, known: Iterable[tuple[str, str, Transform]]) -> bytes:
    """tf2_msgs/msg/TFMessage. known: of each transform parent, child, and the child's place in the parent."""
    entries = list(known)
    message = Cdr().add("I", len(entries))
    for parent, child, (place, q) in entries:
        message.header(unix_ns, parent).text(child).add("d", *place).quaternion(q)
    return message.bytes()


def time_reference(unix_ns: int, utc_ns: int) -> bytes:
    """sensor_msgs/msg/TimeReference: what the receiver calls the instant that the host calls `unix_ns`."""
    return Cdr().header(unix_ns, "").time(utc_ns).text("gnss").bytes()


class Diagnosis(NamedTuple):
    """A part of the program: faults in words (None: there is no such part), and what else is known of it."""

    name: str
    faults: Sequence[str] | None
    hardware: str = ""
    values: Mapping[str, object] = {}


_FAULTS = {"aligning", "coasting", "rejecting", "saturated"}  # of the words for the status bits


def filter_diagnosis(estimator: str, state: str) -> Diagnosis:
    """state: the status bits as words, separated by commas."""
    return Diagnosis("filter", [word for word in state.split(",") if word in _FAULTS], estimator, {"state": state})


def diagnostics(unix_ns: int, parts: Sequence[Diagnosis]) -> bytes:
    """diagnostic_msgs/msg/DiagnosticArray."""
    message = Cdr().header(unix_ns, "").add("I", len(parts))
    for name, faults, hardware, values in parts:
        level = _STALE if faults is None else _WARN if faults else _OK
        text = "there is none" if faults is None else "; ".join(faults) or "ok"
        message.add("B", level).text(f"imud: {name}").text(text).text(hardware)
        message.add("I", len(values))
        for key, value in values.items():
            message.text(key).text(str(value))
    return message.bytes()
