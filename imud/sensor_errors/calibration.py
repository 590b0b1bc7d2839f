"""The calibration of one particular sensor: biases, scale and misalignment, mounting; a file per serial number.

A file is always replaced as a whole. Each part of it says when, at which temperature and how well it was found.
"""

import functools
import math
import os
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from imud.drivers.driver import Identity
from imud.drivers.sample import MOUNTING_UNKNOWN

from ..compile.jit import interpreted, kernel
from ..errors import BadDataError, CannotCreateError, InputMissingError
from ..folders import folders_for, read_file
from ..math.arrays import Floats, Records
from ..math.rotation import dcm_of_quat, quat_of_euler
from .magnetometer import REMAINING_T
from .mounting_error import MOUNTING_ERROR, set_covariance

Triple = tuple[float, float, float]
StoredTime = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]  # ns; JSON knows integers of any length
Matrix = tuple[Triple, Triple, Triple]
NOTHING: Triple = (0.0, 0.0, 0.0)
MAX_MOUNTING_SIGMA_DEG = 10.0  # of an angle that counts as known
_COMMON = Path("/var/lib/imud")
_MOST = {  # beyond any sensor, of what samples are corrected by
    "bias_radps": 10.0,
    "slope_radps_per_k": 1.0,
    "temperature_c": 1000.0,
    "bias_mps2": 100.0,
    "matrix": 10.0,
    "rpy_deg": 360.0,
}


class _Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Numbers of a sensor that cannot be raise ValueError, wherever they come from."""

    def __post_init__(self) -> None:
        for name, most in _MOST.items():
            numbers = np.ravel(getattr(self, name, 0.0))
            unknown = np.isnan(numbers) & (name == "temperature_c")
            if not (unknown | (np.abs(numbers) <= most)).all():
                raise ValueError(f"{name} = {numbers.tolist()} is not between {-most:g} and {most:g}")


class Gyro(_Part, frozen=True, forbid_unknown_fields=True):
    """rate = measured - bias - slope * (temperature - temperature_c), in the sensor's axes."""

    date: str
    bias_radps: Triple
    sigma_radps: Triple  # 1 sigma of the bias
    temperature_c: float = math.nan
    slope_radps_per_k: Triple = NOTHING
    slope_sigma_radps_per_k: Triple = NOTHING


class Accelerometer(_Part, frozen=True, forbid_unknown_fields=True):
    """force = matrix (measured - bias), in the sensor's axes."""

    date: str
    bias_mps2: Triple
    matrix: Matrix
    sigma_mps2: Triple  # 1 sigma of the bias
    residual_mps2: float  # root mean square of |force| - g over the positions
    positions: int
    temperature_c: float = math.nan


class Mounting(_Part, frozen=True, forbid_unknown_fields=True):
    """The sensor's axes in the vehicle's, as `imu.mount_rpy_deg`."""

    date: str
    rpy_deg: Triple
    sigma_deg: Triple


class RelativeMounting(_Part, frozen=True, forbid_unknown_fields=True):
    """The axes that a sensor's mounting gives, in the body axes of a sensor that was in use before."""

    rpy_deg: Triple
    covariance_deg2: Matrix  # of a small rotation in body axes

    @property
    def sigma_deg(self) -> float:
        """Of the axis about which it is known worst."""
        return math.sqrt(float(np.linalg.eigvalsh(self.covariance_deg2)[-1]))


UNKNOWN_MOUNTING = RelativeMounting(NOTHING, ((180.0**2, 0.0, 0.0), (0.0, 180.0**2, 0.0), (0.0, 0.0, 180.0**2)))


def relative_mounting_of(turn: Floats, covariance: Floats) -> RelativeMounting:
    """That of a rotation matrix [3, 3] to body axes, and its covariance [3, 3], rad^2."""
    (a, b, c), (d, e, f), (g, h, i) = np.degrees(np.degrees(covariance)).tolist()
    return RelativeMounting(mounting_of(turn, NOTHING).rpy_deg, ((a, b, c), (d, e, f), (g, h, i)))


def mounting_of(turn: Floats, sigma_rad: Triple, date: str = "") -> Mounting:
    """The mounting whose matrix, from the sensor's to the other axes, is `turn` [3, 3]."""
    roll, pitch = math.atan2(turn[2, 1], turn[2, 2]), -math.asin(max(-1.0, min(1.0, turn[2, 0])))
    rpy, sigma = (
        np.degrees(angles).tolist() for angles in ((roll, pitch, math.atan2(turn[1, 0], turn[0, 0])), sigma_rad)
    )
    return Mounting(date, tuple(rpy), tuple(sigma))


class Magnetometer(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """field = matrix (measured - bias), in the magnetometer's axes, where it is mounted."""

    date: str
    bias_ut: Triple
    matrix: Matrix
    sigma_ut: float  # 1 sigma of a component of the corrected field
    residual_ut: float  # root mean square of the strengths
    coverage: float  # share of all directions from which there were readings


class Calibration(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Of the sensor `serial`; a part that was never calibrated is None."""

    serial: str
    gyro: Gyro | None = None
    accelerometer: Accelerometer | None = None
    mounting: Mounting | None = None
    magnetometer: Magnetometer | None = None
    relative_mounting: RelativeMounting | None = None  # against a sensor in use before; never in a file

    @property
    def parts(self) -> dict[str, str]:
        """The parts that are known, and when each was found."""
        known = {name: getattr(self, name) for name in ("gyro", "accelerometer", "mounting", "magnetometer")}
        return {name: part.date for name, part in known.items() if part is not None}


CORRECTION = np.dtype(
    [
        ("gyro", "<f8", (9,)),  # row-major, from sensor to body axes
        ("accel", "<f8", (9,)),
        ("gyro_bias", "<f8", (3,)),  # rad/s, sensor's axes
        ("gyro_slope", "<f8", (3,)),  # rad/s/K
        ("temperature", "<f8"),  # degC, of gyro_bias
        ("accel_bias", "<f8", (3,)),  # m/s^2
        ("turn", "<f8", (9,)),  # of directions: the mounting alone
        ("flags", "<i8"),  # of every sample: MOUNTING_UNKNOWN or 0
        ("mounting_error", MOUNTING_ERROR),  # of a relative mounting
        ("field", "<f8", (9,)),  # row-major, from the magnetometer's to body axes
        ("field_bias", "<f8", (3,)),  # T, its axes
        ("field_sigma", "<f8"),  # T, of a component of the corrected field; NaN: not known
    ],
    align=True,
)


@functools.lru_cache(maxsize=4)
def _rotation(rpy_deg: Triple) -> Floats:
    q = interpreted(quat_of_euler)(*(math.radians(angle) for angle in rpy_deg))
    return np.array(interpreted(dcm_of_quat)(q)).reshape(3, 3)


def correction(
    calibration: Calibration, mount_rpy_deg: Triple, magnetometer_mount_rpy_deg: Triple = NOTHING
) -> Records:
    """The parameters of `correct` (array of one CORRECTION). The user's mounting overrides the calibrated one."""
    rpy = mount_rpy_deg
    if rpy == NOTHING and calibration.mounting is not None:
        rpy = calibration.mounting.rpy_deg
    turn = _rotation(rpy)
    c = np.zeros(1, CORRECTION)
    if (relative := calibration.relative_mounting) is not None:
        turn = _rotation(relative.rpy_deg) @ turn
        c["flags"] = MOUNTING_UNKNOWN if relative == UNKNOWN_MOUNTING else 0
        set_covariance(c["mounting_error"], np.radians(np.radians(relative.covariance_deg2)))
    field, c["field_sigma"] = _rotation(magnetometer_mount_rpy_deg), math.nan
    if (magnetometer := calibration.magnetometer) is not None:
        field, c["field_bias"] = field @ np.array(magnetometer.matrix), 1e-6 * np.array(magnetometer.bias_ut)
        c["field_sigma"] = max(1e-6 * magnetometer.sigma_ut, REMAINING_T)
    c["field"] = field.ravel()
    c["turn"] = c["gyro"] = c["accel"] = turn.ravel()
    if calibration.gyro is not None:
        gyro = calibration.gyro
        c["gyro_bias"], c["gyro_slope"], c["temperature"] = gyro.bias_radps, gyro.slope_radps_per_k, gyro.temperature_c
    if calibration.accelerometer is not None:
        accel = calibration.accelerometer
        c["accel_bias"], c["accel"] = accel.bias_mps2, (turn @ np.array(accel.matrix)).ravel()
    return c


@kernel
def correct(sample: Any, c: Any) -> None:
    """Correct a sample by the calibrated errors, and rotate it from the sensor's into body axes."""
    sample.flags |= c.flags
    rise = sample.temperature - c.temperature
    if not math.isfinite(rise):
        rise = 0.0
    w0 = sample.w[0] - c.gyro_bias[0] - rise * c.gyro_slope[0]
    w1 = sample.w[1] - c.gyro_bias[1] - rise * c.gyro_slope[1]
    w2 = sample.w[2] - c.gyro_bias[2] - rise * c.gyro_slope[2]
    f0, f1, f2 = sample.f[0] - c.accel_bias[0], sample.f[1] - c.accel_bias[1], sample.f[2] - c.accel_bias[2]
    d0, d1, d2 = sample.down[0], sample.down[1], sample.down[2]
    w, f, down, W, F, D = sample.w, sample.f, sample.down, c.gyro, c.accel, c.turn
    for i in range(3):
        w[i] = W[3 * i] * w0 + W[3 * i + 1] * w1 + W[3 * i + 2] * w2
        f[i] = F[3 * i] * f0 + F[3 * i + 1] * f1 + F[3 * i + 2] * f2
        down[i] = D[3 * i] * d0 + D[3 * i + 1] * d1 + D[3 * i + 2] * d2


def corrected_fields(fields: Floats, c: Records) -> Floats:
    """Magnetic fields [n, 3], T, corrected and turned from the magnetometer's into body axes; c: one CORRECTION."""
    x, y, z = (fields - c["field_bias"]).T
    rows = c["field"].reshape(3, 3)
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in rows], axis=1)


def folders() -> list[Path]:
    """The folders of calibrations, in order of preference: the machine's, then the service's or the user's own."""
    return [_COMMON, *folders_for("state")]


def _name(serial: str) -> str:
    return f"calibration-{re.sub(r'[^A-Za-z0-9._-]', '_', serial)}.toml"


def load(serial: str, where: list[Path] | None = None) -> Calibration:
    """The calibration of the sensor `serial`, empty if there is none. Raises as `read` does if there is one."""
    for folder in folders() if where is None else where:
        path = folder / _name(serial)
        if os.path.lexists(path):
            return read(path)
    return Calibration(serial)


def name_of(identity: Identity) -> str:
    """The name under which a sensor's calibration is saved: its serial number, or else its model."""
    return identity.serial or identity.model or identity.driver


def of(identity: Identity) -> Calibration:
    """The calibration of the sensor that was found. Raises BadDataError."""
    return load(name_of(identity))


def read(path: Path) -> Calibration:
    """The calibration in a file. Raises InputMissingError, BadDataError."""
    try:
        return msgspec.convert(tomllib.loads(read_file(path).decode()), Calibration)
    except OSError as error:
        raise InputMissingError(f"{path} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # not UTF-8, not TOML, other keys or values; nested too deeply
        raise BadDataError(f"{path} is no calibration: {error}; calibrate again or delete it") from error


def save(calibration: Calibration, where: list[Path] | None = None) -> Path:
    """Replace the file as a whole, in the first folder that may be written. Raises CannotCreateError, also where a file
    of another folder, which cannot be replaced, would be used instead.
    """
    candidates, refused = folders() if where is None else where, ""
    for folder in candidates:
        path = folder / _name(calibration.serial)
        try:
            if folder is candidates[-1]:
                folder.mkdir(parents=True, exist_ok=True)
            _replace(path, _toml(calibration))
            return path
        except OSError as error:
            refused += f"\n  {folder}: {error.strerror}"
        if os.path.lexists(path):
            refused += f"; {path.name} in it would be used instead of a new one elsewhere"
            break
    raise CannotCreateError(f"cannot save the calibration:{refused}")


def _replace(path: Path, text: str) -> None:
    """Replace a file as a whole; its folder has to be there. Raises OSError, and leaves nothing behind."""
    import tempfile  # a daemon saves none

    with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False) as file:
        new = Path(file.name)
        try:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
            new.chmod(0o644)
            new.replace(path)
        except OSError:
            new.unlink(missing_ok=True)
            raise


def _toml(calibration: Calibration) -> str:
    lines = [f"serial = {_value(calibration.serial)}"]
    for name in calibration.parts:
        part = getattr(calibration, name)
        lines += ["", f"[{name}]", *(f"{field} = {_value(getattr(part, field))}" for field in part.__struct_fields__)]
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    """A value of a calibration as TOML; floats read back bit for bit."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_value, value))}]"
    return msgspec.json.encode(value).decode() if isinstance(value, str) else repr(value)
