"""`imud allan`: a sensor's noise from a recording at rest, beside its data sheet, as numbers, plot and settings."""

import argparse
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import BadDataError, CannotCreateError, UsageError
from ..progress import Progress
from .files import input_file, refuse_overwriting

if TYPE_CHECKING:
    from ..sensor_errors.noise import AllanDeviation, Coefficient

_DEG = math.degrees(1.0)
_MG = 1e3 / 9.80665


@dataclass(frozen=True)
class _Unit:
    """A coefficient in data-sheet units, from SI by `factor`; the setting and the field of a profile it becomes."""

    factor: float
    text: str
    setting: str = ""
    field: str = ""


_KINDS = {
    "gyro": (
        _Unit(_DEG * 60.0, "deg/√h", "gyro_random_walk_deg_per_sqrt_h", "gyro_noise"),
        _Unit(_DEG * 3600.0, "deg/h", "gyro_bias_instability_deg_per_h", "gyro_bias_instability"),
        _Unit(_DEG * 3600.0 * 60.0, "deg/h/√h"),
    ),
    "accel": (
        _Unit(60.0, "(m/s)/√h", "accel_random_walk_mps_per_sqrt_h", "accel_noise"),
        _Unit(_MG, "mG", "accel_bias_instability_mg", "accel_bias_instability"),
        _Unit(_MG * 60.0, "mG/√h"),
    ),
}
_SI = {"gyro": ("rad/s/√Hz", "rad/s", "rad/s/√s"), "accel": ("m/s²/√Hz", "m/s²", "m/s²/√s")}
_NAMES = ("random walk N", "bias instability B", "rate random walk K")
_MOTION_RATIO = 10.0  # change of the mean rate from one second to the next, over the median change
_MOTION_RADPS = math.radians(1.0)  # the same: at rest no gyro that is used changes so much
Found = dict[str, dict[str, "AllanDeviation"]]  # by kind and letter of those axes that the sensor has


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "recording", type=input_file, metavar="CSV|MCAP", help="at rest: t_s,gx_radps,…,az_mps2, or imud's"
    )
    parser.add_argument("-o", "--output", type=Path, metavar="HTML", help="the curves as a page that works offline")
    parser.add_argument("--settings", type=Path, metavar="TOML", help="write the [noise] table of a configuration")
    parser.add_argument("--sheet", default="m-g350", metavar="PROFILE", help="to compare with (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="everything in SI for machines")


def run(args: argparse.Namespace) -> int:
    from ..recording.samples import read_samples
    from ..sensor_errors.profiles import PROFILES

    refuse_overwriting([args.output, args.settings], [args.recording])
    if args.sheet not in PROFILES:
        raise UsageError(f"--sheet {args.sheet}: there is no such profile; known are {', '.join(PROFILES)}")
    samples, _, _ = read_samples(args.recording)
    rate_hz = _rate(args.recording, samples["t_ns"])
    found = _deviations(args.recording, samples, rate_hz)
    sheet, head, motion = PROFILES[args.sheet], _head(len(samples), rate_hz), _motion(samples, rate_hz)
    if args.json:
        print(json.dumps(_si_results(found, rate_hz)))
    else:
        print(head)
        _print(found, sheet, args.sheet)
        if motion:
            print(f"\n{motion}")
    if args.settings:
        _write(args.settings, _settings(found, args.recording))
    if args.output:
        text = f"{head}\n{motion}".strip()
        _draw(args.output, f"imud allan: {args.recording.name}", text, found, sheet, args.sheet)
    return 0


def _deviations(path: Path, samples: Any, rate_hz: float) -> Found:
    """The Allan deviations of each axis that the sensor has. Raises BadDataError."""
    from ..sensor_errors.noise import allan_deviation

    found: Found = {kind: {} for kind in _KINDS}
    progress = Progress(6)
    for number, (kind, column) in enumerate([(k, i) for k in _KINDS for i in range(3)]):
        rates = samples["w" if kind == "gyro" else "f"][:, column]
        try:
            if np.ptp(rates) > 0.0:  # else the sensor has no such axis
                found[kind]["xyz"[column]] = allan_deviation(rates, rate_hz)
        except ValueError as error:
            raise BadDataError(f"{path}: {error}") from error
        progress.at(number + 1)
    if not any(found.values()):
        raise BadDataError(f"{path}: every axis is constant: there is no noise to measure")
    return found


def _rate(path: Path, t_ns: Any) -> float:
    """Samples per second. Raises BadDataError if too many are missing for an Allan deviation."""
    steps = np.diff(t_ns)
    period = float(np.median(steps))
    missing = 1.0 - len(steps) / float(np.sum(np.rint(steps / period)))
    if missing > 0.01:
        raise BadDataError(f"{path}: {missing:.1%} of the samples are missing; an Allan deviation needs all of them")
    return float(1e9 * len(steps) / (t_ns[-1] - t_ns[0]) * (1.0 + missing))


def _formatted(coefficient: "Coefficient", unit: _Unit) -> str:
    if coefficient.bound:
        return f"< {coefficient.value * unit.factor:.3g}"
    return f"{coefficient.value * unit.factor:.4g} ± {coefficient.sigma * unit.factor:.2g}"


def _coefficients(deviation: "AllanDeviation") -> "tuple[Coefficient, ...]":
    return deviation.random_walk, deviation.instability, deviation.rate_walk


def _head(n: int, rate_hz: float) -> str:
    return f"{n} samples at {rate_hz:.6g} Hz, {n / rate_hz:.0f} s; ± is 1 sigma, < an upper bound: record longer"


def _rows(found: Found, sheet: Any, kind: str) -> list[tuple[str, ...]]:
    """Of each coefficient its name, the values of the axes, and what the data sheet says, with the unit."""
    rows = []
    for i, (what, unit) in enumerate(zip(_NAMES, _KINDS[kind], strict=True)):
        values = {axis: _formatted(_coefficients(deviation)[i], unit) for axis, deviation in found[kind].items()}
        known = f"{getattr(sheet, unit.field) * unit.factor:.3g}" if unit.field else ""
        rows.append((what, *(values.get(axis, "never changes") for axis in "xyz"), f"{known} {unit.text}"))
    return rows


def _print(found: Found, sheet: Any, name: str) -> None:
    for kind in _KINDS:
        print(f"\n{kind:<20}{'x':>20}{'y':>20}{'z':>20}   {name}")
        for what, x, y, z, known in _rows(found, sheet, kind):
            print(f"{what:<20}{x:>20}{y:>20}{z:>20}   {known}")


def _motion(samples: Any, rate_hz: float) -> str:
    """A warning if the rates show motion: the result is then the motion, not the noise."""
    m = max(1, round(rate_hz))
    whole = len(samples) // m * m
    means = np.linalg.norm(samples["w"][:whole].reshape(-1, m, 3).mean(axis=1), axis=1)
    steps = np.abs(np.diff(means))
    if len(steps) > 10 and steps.max() > min(_MOTION_RATIO * (np.median(steps) + 1e-6), _MOTION_RADPS):
        at = (int(np.argmax(steps)) + 1) * m / rate_hz
        return f"The sensor has moved, most at {at:.0f} s: the result is its motion, not its noise."
    return ""


def _si_results(found: Found, rate_hz: float) -> dict[str, Any]:
    """All results in SI, for JSON."""
    axes = {}
    for kind, deviations in found.items():
        for axis, deviation in deviations.items():
            values = zip(("N", "B", "K"), _SI[kind], _coefficients(deviation), strict=True)
            axes[f"{kind}_{axis}"] = {
                "tau_s": deviation.tau.tolist(),
                "deviation": deviation.deviation.tolist(),
                "sigma": deviation.sigma.tolist(),
                **{
                    letter: {"value": c.value, "sigma": None if c.bound else c.sigma, "bound": c.bound, "unit": unit}
                    for letter, unit, c in values
                },
            }
    return {"rate_hz": rate_hz, **axes}


def _settings(found: Found, recording: Path) -> str:
    """The [noise] table: for each coefficient the worst axis; one that is only bounded is left to the profile."""
    name = recording.name if recording.name.isprintable() else ascii(recording.name)
    lines = [f"# from {name} by `imud allan`", "[noise]"]
    for kind, units in _KINDS.items():
        for i, unit in enumerate(units):
            known = [c.value for axis in found[kind].values() if not (c := _coefficients(axis)[i]).bound]
            if unit.setting and known and len(known) == len(found[kind]):
                lines.append(f"{unit.setting} = {max(known) * unit.factor:.4g}")
    return "\n".join(lines) + "\n"


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise CannotCreateError(f"cannot write {path}: {error.strerror}") from error


def _draw(path: Path, title: str, text: str, found: Found, sheet: Any, name: str) -> None:
    from .. import figures
    from ..figures import Figure, Panel, Trace

    if not figures.available():
        raise UsageError("plots need plotly: pip install 'imud[plots]'")
    table = [("", *"xyz", name)]
    table += [(f"{kind}: {row[0]}", *row[1:]) for kind in _KINDS for row in _rows(found, sheet, kind)]
    panels = []
    for kind, (walk, unit, _) in _KINDS.items():
        traces = []
        for k, (axis, d) in enumerate(found[kind].items()):
            traces.append(Trace(axis, d.tau, d.deviation * unit.factor, d.sigma * unit.factor, colour=k))
            traces.append(Trace(f"{axis}: N, B, K", d.tau, d.fitted * unit.factor, colour=k, dashed=True))
        if traces:
            tau = traces[0].x
            traces.append(Trace(f"N of {name}", tau, getattr(sheet, walk.field) / np.sqrt(tau) * unit.factor, colour=3))
        panels.append(Panel(kind, "averaging time τ, s", f"Allan deviation, {unit.text}", traces, logarithmic=True))
    try:
        figures.write(title, text, [Figure("Overlapping Allan deviation ± 1 σ", panels)], path, table)
    except OSError as error:
        raise CannotCreateError(f"cannot write {path}: {error.strerror}") from error
