"""Records as messages of ROS 2 in CDR, after REP-103, REP-105 and REP-145. The frames are in `frames`.

World is ENU, body FLU, quaternions x y z w; twists are in the body's axes. A covariance of an Imu message that begins
with -1 says that there is no such estimate. Covariances of an orientation are those of its roll, pitch and yaw.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imud.drivers.sample import NO_FORCE, NO_RATE, SUSPECT

from ..compile.entry import entry
from ..estimators.records import ATTITUDE_VALID, HEIGHT_VALID, POSITION_VALID
from ..math.arrays import Floats, Indices, Records
from ..recording.enu import ANTENNA, BODY, IMU, MAP, ODOM, attitude, world
from ..sensor_errors.profiles import SampleSigma
from .cdr import Cdr
from .frames import Transform
from .reckoning import BODY_VELOCITY, body_velocities

_NONE = [-1.0, *[0.0] * 8]
_NO_ROTATION = (1.0, 0.0, 0.0, 0.0)
UNKNOWN_VAR = 1e6  # of what is not known, where a message has no way to say so: a height, rates
# Largest sigma, rate or force: more, or no number, is what a damaged state has, and its square may not be finite.
_LARGEST = 1e9
_NO_FIX, _FIX, _SATELLITE_AUGMENTED, _GROUND_AUGMENTED = -1, 0, 1, 2
_STATUS_OF_QUALITY = {0: _NO_FIX, 2: _SATELLITE_AUGMENTED, 4: _GROUND_AUGMENTED, 5: _GROUND_AUGMENTED}  # of GGA
_SERVICE_GPS = 1
_UNKNOWN, _APPROXIMATED, _DIAGONAL_KNOWN = 0, 1, 2
_OK, _WARN, _, _STALE = range(4)  # DiagnosticStatus


class Sigmas(NamedTuple):
    """What samples are worth. None: there is no such sensor, or it is not known."""

    gyro: SampleSigma | None = None
    accel: SampleSigma | None = None


def _variances(sigma: Floats) -> Floats:
    """Squares of sigmas, always finite."""
    finite = np.where(np.abs(sigma) < _LARGEST, sigma, _LARGEST)
    return np.asarray(finite * finite)


def _measured(v: Floats, sensor: SampleSigma | None, is_known: Any = True, bias: Floats | None = None) -> Floats:
    """Measured vectors (n x 3, FRD) in FLU, and behind each its covariance (row-major 3 x 3): n x 12.

    bias: sigmas of the estimated biases. Where they are None or NaN the bias is that of the switch-on.
    """
    rows = np.zeros((len(v), 12))
    rows[:, 3] = -1.0
    if sensor is not None:
        biases = np.full(v.shape, math.nan) if bias is None else np.array(bias)
        known = np.empty(len(v), np.int64)
        known[:] = is_known
        what = np.array([sensor.white**2, sensor.scale, sensor.bias])
        fill_measured(np.array(v).ravel(), known, biases.ravel(), what, rows.ravel())
    return rows


@entry
def fill_measured(v: Floats, known: Indices, biases: Floats, sensor: Floats, rows: Floats) -> None:
    """See `_measured`. sensor: variance of its white noise, sigmas of its scale and of its bias at the switch-on."""
    for i in range(len(known)):
        x, y, z = v[3 * i], v[3 * i + 1], v[3 * i + 2]
        if not known[i] or not (abs(x) < _LARGEST and abs(y) < _LARGEST and abs(z) < _LARGEST):
            continue
        row = rows[12 * i :]
        row[0], row[1], row[2] = x, -y, -z
        size = sensor[1] * math.sqrt(x * x + y * y + z * z)
        for k in range(3):
            bias = biases[3 * i + k]
            bias = bias if math.isfinite(bias) else sensor[2]
            bias = bias if abs(bias) < _LARGEST else _LARGEST
            sigma = math.sqrt(sensor[0] + size * size + bias * bias)
            row[3 + 4 * k] = sigma * sigma


def imu_raw(samples: Records, unix_ns: Indices, sigmas: Sigmas) -> Cdr:
    """sensor_msgs/msg/Imu, of rows of SAMPLE: as measured, without an orientation (REP-145)."""
    n, flags = len(samples), samples["flags"]
    message = Cdr(n).header(unix_ns, IMU).quaternion(_NO_ROTATION).add("d", *_NONE)
    rates = _measured(samples["w"], sigmas.gyro, flags & (NO_RATE | SUSPECT) == 0)
    return message.doubles(rates, _measured(samples["f"], sigmas.accel, flags & (NO_FORCE | SUSPECT) == 0))


def imu(solutions: Records, unix_ns: Indices, sigmas: Sigmas) -> Cdr:
    """sensor_msgs/msg/Imu, of rows of SOLUTION: without the biases, with gravity (REP-145)."""
    known = solutions["status"] & ATTITUDE_VALID != 0
    covariance = _diagonal(_variances(solutions["sigma_rpy"]))
    covariance[~known] = _NONE
    rates = _measured(solutions["w"], sigmas.gyro, bias=solutions["sigma_bg"])
    forces = _measured(solutions["f"], sigmas.accel, bias=solutions["sigma_ba"])
    message = Cdr(len(solutions)).header(unix_ns, IMU).quaternion(attitude(solutions["q_nb"].T))
    return message.doubles(covariance, rates, forces)


def _diagonal(variances: Floats) -> Floats:
    """Row-major covariances (n x k k) of independent components (n x k)."""
    n, k = variances.shape
    rows = np.zeros((n, k * k))
    rows[:, :: k + 1] = variances
    return rows


def _nav_sat_fix(
    unix_ns: Indices, frame: str, status: Any, position: Floats, sigma: Floats, kind: NDArray[np.int64]
) -> Cdr:
    """position: degrees, m; sigma: m, north east down. A height of NaN is not known."""
    variances = _variances(np.stack(world(sigma.T), axis=1))
    blind = ~np.isfinite(position[:, 2])
    variances[blind, 2] = UNKNOWN_VAR
    kind = np.where(blind, np.minimum(kind, _APPROXIMATED), kind)
    variances[kind == _UNKNOWN] = 0.0
    message = Cdr(len(position)).header(unix_ns, frame).add("b", status).add("H", _SERVICE_GPS)
    return message.doubles(position, _diagonal(variances)).add("B", kind)


def filtered_fix(solutions: Records, unix_ns: Indices) -> Cdr:
    """sensor_msgs/msg/NavSatFix, of rows of SOLUTION: the filter's position of the body."""
    known = solutions["status"] & POSITION_VALID != 0
    known &= np.isfinite(solutions["lat"]) & np.isfinite(solutions["lon"])  # a damaged state may say that it is valid
    height = np.where(solutions["status"] & HEIGHT_VALID != 0, solutions["height"], np.nan)
    position = np.full((len(solutions), 3), np.nan)  # also where the place holds a signalling NaN, of which numpy warns
    position[known, 0], position[known, 1] = np.degrees(solutions["lat"][known]), np.degrees(solutions["lon"][known])
    position[known, 2] = height[known]
    status, kind = np.where(known, _FIX, _NO_FIX), np.where(known, _DIAGONAL_KNOWN, _UNKNOWN)
    return _nav_sat_fix(unix_ns, BODY, status, position, solutions["sigma_p"], kind)


def receiver_fixes(fixes: Records, unix_ns: Indices, derived: Floats) -> Cdr:
    """sensor_msgs/msg/NavSatFix, of rows of FIX: the antenna's, as the receiver reports it.

    derived: sigma north, east, down (n x 3) that stand for those it does not report.
    """
    reported = np.isfinite(fixes["sigma"])
    sigma = np.where(reported, fixes["sigma"], derived)
    kind = np.where(reported.all(axis=1), _DIAGONAL_KNOWN, _APPROXIMATED)
    status = np.array([_STATUS_OF_QUALITY.get(quality, _FIX) for quality in fixes["quality"].tolist()])
    position = np.stack([np.degrees(fixes["lat"]), np.degrees(fixes["lon"]), fixes["height"]], axis=1)
    return _nav_sat_fix(unix_ns, ANTENNA, status, position, sigma, kind)


def odometry(solutions: Records, unix_ns: Indices, place: Floats, gyro: SampleSigma | None) -> Cdr:
    """nav_msgs/msg/Odometry of the body in the map, of rows of SOLUTION with a position. place: ENU (n x 3), m."""
    sigmas = np.hstack([np.stack(world(solutions["sigma_p"].T), axis=1), solutions["sigma_rpy"]])
    variances = _variances(sigmas)
    variances[solutions["status"] & HEIGHT_VALID == 0, 2] = UNKNOWN_VAR
    message = Cdr(len(solutions)).header(unix_ns, MAP).text(BODY).doubles(place)
    message.quaternion(attitude(solutions["q_nb"].T)).doubles(_diagonal(variances))
    velocity, spread = body_velocity(solutions)
    rates = _measured(solutions["w"], gyro, bias=solutions["sigma_bg"])
    covariance = np.zeros((len(solutions), 6, 6))
    covariance[:, :3, :3], covariance[:, 3:, 3:] = spread, rates[:, 3:].reshape(-1, 3, 3)
    covariance[rates[:, 3] < 0.0, 3:, 3:] = UNKNOWN_VAR * np.eye(3)
    return message.doubles(velocity, rates[:, :3], covariance.reshape(-1, 36))


def body_velocity(solutions: Records) -> tuple[Floats, Floats]:
    """Velocities in the body (FLU, n x 3) and their covariances (n x 3 x 3)."""
    found = np.empty(len(solutions), BODY_VELOCITY)
    body_velocities(np.ascontiguousarray(solutions), found)
    covariance = found["covariance"].reshape(-1, 3, 3)
    covariance[~np.isfinite(covariance).all(axis=(1, 2))] = _LARGEST * _LARGEST * np.eye(3)
    return found["velocity"], covariance


def motion(unix_ns: Indices, map_to_odom: Floats, odom_to_body: Floats) -> Cdr:
    """tf2_msgs/msg/TFMessage of both. n x 7 each: place and quaternion, scalar first."""
    message = Cdr(len(unix_ns)).add("I", 2)
    for parent, child, rows in ((MAP, ODOM, map_to_odom), (ODOM, BODY, odom_to_body)):
        message.header(unix_ns, parent).text(child).doubles(rows[:, :3]).quaternion(rows[:, 3:].T)
    return message


def transforms(unix_ns: int, known: Iterable[tuple[str, str, Transform]]) -> bytes:
    """tf2_msgs/msg/TFMessage. known: of each transform parent, child, and the child's place in the parent."""
    entries = list(known)
    message = Cdr().add("I", len(entries))
    for parent, child, (place, q) in entries:
        message.header(unix_ns, parent).text(child).add("d", *place).quaternion(q)
    return message.only()


def time_references(unix_ns: Indices, utc_ns: Indices) -> Cdr:
    """sensor_msgs/msg/TimeReference: what the receiver calls the instants that the host calls `unix_ns`."""
    return Cdr(len(unix_ns)).header(unix_ns, "").time(utc_ns).text("gnss")


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
    return message.only()
