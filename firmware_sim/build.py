"""From the command's options to devices on a common motion."""

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .device import Device
from .fixes import FixSource, SimulatedFixes
from .g350 import G350
from .g370 import VARIANTS, Windowed
from .motion import Trajectory
from .nmea import FvM11
from .noise import DEG, IDEAL, M_G350, MILLI_G, Grade, ImuErrors
from .replay import RecordedFixes, RecordedImu
from .rga300 import RGA300, Rga300
from .sampling import TICK_HZ, Signal
from .scenarios import SCENARIOS
from .seraccel import SerAccel, Settings, mma7260

START = (35.6586, 139.7454, 60.0)  # latitude and longitude in deg, height in m: Tokyo


@dataclass(frozen=True)
class Scene:
    """What the devices go through. trajectory is None for a recording, fixes for a scenario."""

    signal: Signal
    trajectory: Trajectory | None
    fixes: RecordedFixes | None

    def time_zero(self) -> tuple[float, float]:
        """CLOCK_MONOTONIC and UTC of time 0, in s: now, or soon, when recorded epochs fall on whole UTC seconds."""
        now, utc = time.monotonic(), time.time()
        wait = -(utc + self.fixes.phase) % 1.0 if self.fixes else 0.0
        return now + wait, utc + wait


def scene(args: argparse.Namespace) -> Scene:
    """The scenario or recording that the options name. Raises DataError, OSError for a recording."""
    if args.replay:
        imu = RecordedImu(args.replay[0], args.loop)
        return Scene(imu, None, RecordedFixes(args.replay[1], imu) if len(args.replay) > 1 else None)
    angles = (math.radians(angle) for angle in (args.roll_deg, args.pitch_deg, args.yaw_deg))
    trajectory = Trajectory(SCENARIOS[args.scenario](*angles), *START, delay_s=args.start_delay)
    return Scene(trajectory, trajectory, None)


def device(args: argparse.Namespace, scene: Scene, utc: float, index: int) -> Device:
    """Device number `index` of the command line, with errors from a random stream of its own. utc: of time 0, in s."""
    name, baud = args.devices[index]
    rng = np.random.default_rng([args.seed, index])
    if name in VARIANTS:
        return _windowed(args, scene, name, baud, rng)
    return _BUILDERS[name](args, scene, utc, baud, rng)


def _g350(args: argparse.Namespace, scene: Scene, _utc: float, baud: int, rng: np.random.Generator) -> Device:
    errors = _errors(args, M_G350, rng, TICK_HZ)
    identity = not args.no_identity
    return G350(scene.signal, errors, baud, count_step=args.count_step, identity=identity, oscillator=_oscillator(args))


def _windowed(args: argparse.Namespace, scene: Scene, name: str, baud: int, rng: np.random.Generator) -> Device:
    variant = VARIANTS[name]
    errors = _errors(args, variant.grade, rng, TICK_HZ)
    return Windowed(variant, scene.signal, errors, baud, count_step=args.count_step, oscillator=_oscillator(args))


def _rga300(args: argparse.Namespace, scene: Scene, _utc: float, baud: int, rng: np.random.Generator) -> Device:
    errors = _errors(args, RGA300, rng, args.stream_rate)
    return Rga300(scene.signal, errors, baud, rate_hz=args.stream_rate, oscillator=_oscillator(args))


def _seraccel(args: argparse.Namespace, scene: Scene, _utc: float, baud: int, rng: np.random.Generator) -> Device:
    settings = Settings(mode=args.stream_mode, rate_hz=args.stream_rate)
    errors = _errors(args, mma7260(args.stream_rate), rng, args.stream_rate)
    return SerAccel(scene.signal, errors, baud, settings, streaming=args.streaming, oscillator=_oscillator(args))


def _errors(args: argparse.Namespace, grade: Grade, rng: np.random.Generator, tick_hz: float) -> ImuErrors:
    ideal = args.ideal or args.replay  # a recording has its own errors
    return ImuErrors(
        replace(IDEAL, limit=grade.limit) if ideal else grade,
        rng,
        tick_hz,
        gyro_bias=_scaled(args.gyro_bias_dps, DEG),
        accel_bias=_scaled(args.accel_bias_mg, MILLI_G),
    )


def _oscillator(args: argparse.Namespace) -> float:
    return float(1.0 + args.clock_ppm * 1e-6)


def _nmea(args: argparse.Namespace, scene: Scene, utc: float, baud: int, rng: np.random.Generator) -> Device:
    source: FixSource
    if scene.fixes is not None:
        source = scene.fixes
    elif scene.trajectory is not None:
        source = SimulatedFixes(scene.trajectory, rng, utc, args.ideal)
    else:
        raise ValueError("a receiver needs fixes: give --replay a gnss.csv as well")
    return FvM11(source, utc, baud, args.rate, args.no_fix)


def _scaled(values: tuple[float, float, float] | None, unit: float) -> tuple[float, float, float] | None:
    return None if values is None else (values[0] * unit, values[1] * unit, values[2] * unit)


_BUILDERS: dict[str, Callable[[argparse.Namespace, Scene, float, int, np.random.Generator], Device]] = {
    "g350": _g350,
    "nmea": _nmea,
    "rga300": _rga300,
    "seraccel": _seraccel,
}
