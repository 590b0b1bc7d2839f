"""`imud calibrate`: one sensor's errors, estimated from a recording and saved by serial number for the daemon."""

import argparse
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ..errors import BadDataError, UsageError
from .files import input_file

_SERIAL_MAX = 100  # characters
_MG = 1e3 / 9.80665
MAGNETOMETER = "mag"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    kinds = "; ".join(f"{kind}: {what}" for kind, (_, what) in _CALIBRATIONS.items())
    parser.add_argument("what", choices=_CALIBRATIONS, metavar="WHAT", help=kinds)
    parser.add_argument(
        "recording",
        type=input_file,
        metavar="CSV|MCAP",
        help="inertial samples (mag: a magnetometer's) in the sensor's own axes; or imud's recording",
    )
    parser.add_argument(
        "--serial", metavar="NUMBER", help="of the sensor, as `imud probe` prints it (default: the recording's)"
    )
    parser.add_argument(
        "--latitude", type=float, default=45.0, metavar="DEG", help="for gravity (default: %(default)s)"
    )
    parser.add_argument(
        "--strength",
        type=float,
        metavar="UT",
        help="of the earth's field, for mag (default: as recorded)",
    )
    parser.add_argument(
        "--state", type=Path, metavar="FOLDER", help="save the result there, not where the daemon reads it"
    )
    parser.add_argument("--dry-run", action="store_true", help="only show the result")


def run(args: argparse.Namespace) -> int:
    from ..sensor_errors import calibration
    from ..sensor_errors.rest import UnfitError, refuse_broken

    if not -90.0 <= args.latitude <= 90.0:
        raise UsageError(f"--latitude {args.latitude}: write degrees, -90 to 90")
    if not (args.serial or "").isprintable() or len(args.serial or "") > _SERIAL_MAX:
        raise UsageError(f"--serial: at most {_SERIAL_MAX} printable characters, as `imud probe` shows them")
    samples, serial = _read(args)
    folders = [args.state] if args.state else None
    known = calibration.load(serial, folders)
    try:
        if args.what == MAGNETOMETER:
            part = _magnetometer(samples, args)
        else:
            refuse_broken(samples)
            rate_hz = 1e9 / float(np.median(np.diff(samples["t_ns"])))
            part = _CALIBRATIONS[args.what][0](samples, rate_hz, args)
    except UnfitError as error:
        raise BadDataError(f"{args.recording}: {error}") from error
    if args.dry_run:
        return 0
    path = calibration.save(msgspec.structs.replace(known, **part), folders)
    use = (
        "`imud replay --calibration` takes it" if args.state else "the daemon applies it when the sensor next connects"
    )
    print(f"{serial}: saved in {path}; {use}", file=sys.stderr)
    return 0


def _read(args: argparse.Namespace) -> tuple[Any, str]:
    """The samples, and the name under which their sensor's calibration is saved."""
    from ..tables.inputs import is_recording, read_aiding, read_imu

    if is_recording(args.recording):
        from ..recording.samples import fields_of, own_samples_of

        samples, serial = (fields_of if args.what == MAGNETOMETER else own_samples_of)(args.recording)
        if not (args.serial or serial):
            raise UsageError(
                f"{args.recording} has no inertial sensor: give --serial NUMBER, as `imud probe` prints it"
            )
        return samples, args.serial or serial
    if not args.serial:
        raise UsageError(f"{args.recording} names no sensor: give --serial NUMBER, as `imud probe` prints it")
    if args.what == MAGNETOMETER:
        from ..estimators.ins.aiding.magnetometer import SOURCE

        return read_aiding(SOURCE, args.recording, 0), args.serial
    return read_imu(args.recording)[0], args.serial


def _today() -> str:
    return time.strftime("%Y-%m-%d", time.gmtime())


def _temperature(samples: Any) -> float:
    return float(np.mean(samples["temperature"]))


def _triple(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _print_values(title: str, values: Any, sigma: Any, factor: float, unit: str) -> None:
    cells = (f"{axis} {v * factor:+.4f} ± {s * factor:.4f}" for axis, v, s in zip("xyz", values, sigma, strict=True))
    print(f"{title}: {', '.join(cells)} {unit}")


def _gyro_bias(samples: Any, rate_hz: float, args: argparse.Namespace) -> dict[str, Any]:
    from ..sensor_errors.calibration import Gyro
    from ..sensor_errors.gyro import bias

    found = bias(samples, rate_hz)
    _print_values("gyro bias", found.value, found.sigma, math.degrees(1.0), "deg/s")
    value, sigma = _triple(found.value), _triple(found.sigma)
    return {"gyro": Gyro(_today(), value, sigma, _temperature(samples))}


def _gyro_slope(samples: Any, rate_hz: float, args: argparse.Namespace) -> dict[str, Any]:
    from ..sensor_errors.calibration import Gyro
    from ..sensor_errors.gyro import slope

    bias, change, at = slope(samples, rate_hz)
    _print_values(f"gyro bias at {at:.1f} degC", bias.value, bias.sigma, math.degrees(1.0), "deg/s")
    _print_values("its slope", change.value, change.sigma, math.degrees(1.0), "deg/s/K")
    gyro = Gyro(_today(), _triple(bias.value), _triple(bias.sigma), at, _triple(change.value), _triple(change.sigma))
    return {"gyro": gyro}


def _accelerometer(samples: Any, rate_hz: float, args: argparse.Namespace) -> dict[str, Any]:
    from ..compile.jit import interpreted
    from ..math.earth import gravity
    from ..sensor_errors.accelerometer import FULL, accelerometer, positions
    from ..sensor_errors.calibration import Accelerometer

    forces = positions(samples, rate_hz)
    bias, matrix, residual = accelerometer(forces, interpreted(gravity)(math.radians(args.latitude), 0.0))
    _print_values("accelerometer bias", bias.value, bias.sigma, _MG, "mG")
    x, y, z = (100.0 * (1.0 / value - 1.0) for value in np.diag(matrix))
    print(f"scale error: x {x:+.3f}, y {y:+.3f}, z {z:+.3f} %")
    if len(forces) >= FULL:
        xy, xz, yz = (math.degrees(matrix[i, j]) for i, j in ((0, 1), (0, 2), (1, 2)))
        print(f"misalignment: xy {xy:+.3f}, xz {xz:+.3f}, yz {yz:+.3f} deg")
    else:
        print(f"misalignment: not determined by {len(forces)} positions; it needs {FULL}, edges and corners too")
    print(f"residual: {residual * _MG:.2f} mG in {len(forces)} positions")
    found = Accelerometer(
        date=_today(),
        bias_mps2=_triple(bias.value),
        matrix=(_triple(matrix[0]), _triple(matrix[1]), _triple(matrix[2])),
        sigma_mps2=_triple(bias.sigma),
        residual_mps2=residual,
        positions=len(forces),
        temperature_c=_temperature(samples),
    )
    return {"accelerometer": found}


def _mounting(samples: Any, rate_hz: float, args: argparse.Namespace) -> dict[str, Any]:
    from ..sensor_errors.calibration import mounting_of
    from ..sensor_errors.mounting import mounting

    matrix, sigma = mounting(samples, rate_hz)
    found = mounting_of(matrix, _triple(sigma), _today())
    cells = (
        f"{n} {v:+.2f} ± {s:.2f}"
        for n, v, s in zip(("roll", "pitch", "yaw"), found.rpy_deg, found.sigma_deg, strict=True)
    )
    print(f"mounting: {', '.join(cells)} deg")
    return {"mounting": found}


def _magnetometer(readings: Any, args: argparse.Namespace) -> dict[str, Any]:
    """readings: of MEASUREMENT."""
    from ..sensor_errors.calibration import Magnetometer
    from ..sensor_errors.magnetometer import iron

    if args.strength is not None and not 15.0 <= args.strength <= 75.0:
        raise UsageError(f"--strength {args.strength:g}: that of the earth's field is 22 to 67 uT")
    known = np.linalg.norm(readings["value"][:, 3:], axis=1)
    known = known[np.isfinite(known)]
    strength = 1e-6 * args.strength if args.strength else float(np.mean(known)) if len(known) else None
    bias, matrix, residual, sigma, coverage = iron(readings["value"][:, :3], strength)
    _print_values("hard iron", bias, np.full(3, math.sqrt(max(sigma**2 - residual**2, 0.0))), 1e6, "uT")
    for row in matrix:
        print("soft iron: " + ", ".join(f"{value:+.4f}" for value in row))
    print(f"readings: {len(readings)}, from {100.0 * coverage:.0f} % of all directions")
    print(f"residual: {1e6 * residual:.2f} uT of the strength; sigma of the field: {1e6 * sigma:.2f} uT")
    print(f"sigma of a heading: {math.degrees(sigma / 20e-6):.1f} deg by this at 20 uT level, beside the surroundings'")
    rows = (_triple(matrix[0]), _triple(matrix[1]), _triple(matrix[2]))
    found = Magnetometer(_today(), _triple(1e6 * bias), rows, 1e6 * sigma, 1e6 * residual, coverage)
    return {"magnetometer": found}


_CALIBRATIONS: dict[str, tuple[Callable[..., dict[str, Any]], str]] = {
    MAGNETOMETER: (_magnetometer, "a magnetometer's hard and soft iron, from slow turns about all axes"),
    "still": (_gyro_bias, "the gyro's bias, from ten seconds at rest"),
    "temperature": (_gyro_slope, "its bias and slope, from a warm-up at rest with a column temperature_c"),
    "faces": (_accelerometer, "the accelerometer, from two seconds at rest on each of six sides, or more"),
    "mounting": (
        _mounting,
        "the sensor's orientation in the vehicle, from a rest on level ground and a start forwards",
    ),
}
