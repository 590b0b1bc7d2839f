"""From the command's options to devices on a common motion."""

import argparse
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from . import sentence_playback
from .device import Device
from .faults.device import FaultyDevice
from .faults.fixes import FaultyFixes
from .faults.sensor import FaultyErrors
from .faults.spec import Fault, of_layer
from .faults.wire import Wire, WireLog
from .fixes import FixSource, SimulatedFixes
from .g350 import G350
from .g370 import VARIANTS, Windowed
from .motion import Mounted, Trajectory, rotation
from .nmea import FvM11
from .noise import DEG, IDEAL, M_G350, MILLI_G, Grade, ImuErrors, Signal
from .replay import RecordedFixes, RecordedImu, kind
from .rga300 import RGA300, Rga300
from .sampling import TICK_HZ
from .scenarios import SCENARIOS
from .sentence_playback import SentencePlayback
from .seraccel import SerAccel, Settings, mma7260

START = (35.6586, 139.7454, 60.0)  # latitude and longitude in deg, height in m: Tokyo


class MisuseError(Exception):
    """Options that do not go together."""


@dataclass(frozen=True)
class Scene:
    """What the devices go through: a scenario's trajectory, or recordings."""

    signal: Signal | None
    trajectory: Trajectory | None = None
    fixes: RecordedFixes | None = None
    sentences: list[tuple[float, bytes]] | None = None

    def time_zero(self) -> tuple[float, float]:
        """CLOCK_MONOTONIC and UTC of time 0, in s: now, or soon, when recorded epochs fall on whole UTC seconds."""
        now, utc = time.monotonic(), time.time()
        wait = -(utc + self.fixes.phase) % 1.0 if self.fixes else 0.0
        return now + wait, utc + wait


def scene(args: argparse.Namespace) -> Scene:
    """The scenario or recording that the options name. Raises DataError, MisuseError; OSError for a recording."""
    if args.replay:
        return _recorded(args)
    angles = (math.radians(angle) for angle in (args.roll_deg, args.pitch_deg, args.yaw_deg))
    trajectory = Trajectory(SCENARIOS[args.scenario](*angles), *START, delay_s=args.start_delay)
    mount = np.radians(args.mount_deg or (0.0, 0.0, 0.0))
    return Scene(Mounted(trajectory, rotation(mount[None])[0]), trajectory)


def _recorded(args: argparse.Namespace) -> Scene:
    files: dict[str, Path] = {}
    for path in args.replay:
        if (of := kind(path)) in files or {of, *files} >= {"gnss", "nmea"}:
            raise MisuseError(f"--replay: {path} and {files.get(of, *files.values())} are of one kind; give one")
        files[of] = path
    names = {name for name, _ in args.devices}
    if names - {"nmea"} and "imu" not in files:
        raise MisuseError(f"--replay: {', '.join(sorted(names - {'nmea'}))} needs an imu.csv")
    if "nmea" in names and "imu" in files and len(files) < 2:
        raise MisuseError("--replay: nmea needs a gnss.csv or a log of sentences as well")
    imu = RecordedImu(files["imu"], args.loop) if "imu" in files else None
    fixes = RecordedFixes(files["gnss"], imu, args.loop) if "gnss" in files else None
    return Scene(imu, None, fixes, sentence_playback.read(files["nmea"]) if "nmea" in files else None)


@dataclass(frozen=True)
class _Order:
    """One device of the command line."""

    args: argparse.Namespace
    scene: Scene
    utc: float  # of time 0, s
    name: str
    baud: int
    rng: np.random.Generator
    faults: list[Fault]

    @property
    def signal(self) -> Signal:
        assert self.scene.signal is not None, "`scene` refuses inertial sensors without a motion"
        return self.scene.signal

    @property
    def oscillator(self) -> float:
        return float(1.0 + self.args.clock_ppm * 1e-6)

    def errors(self, grade: Grade, tick_hz: float) -> ImuErrors:
        ideal = self.args.ideal or self.args.replay  # a recording has its own errors
        return FaultyErrors(
            replace(IDEAL, limit=grade.limit) if ideal else grade,
            self.rng,
            tick_hz,
            gyro_bias=_scaled(self.args.gyro_bias_dps, DEG),
            accel_bias=_scaled(self.args.accel_bias_mg, MILLI_G),
            gyro_slope=_scaled(self.args.gyro_slope_dps_per_k, DEG) or (0.0, 0.0, 0.0),
            faults=of_layer("sensor", self.faults),
        )


def device(
    args: argparse.Namespace,
    scene: Scene,
    utc: float,
    index: int,
    faults: Sequence[Fault] = (),
    log: WireLog | None = None,
) -> Device:
    """Device number `index` of the command line, with errors from a random stream of its own. utc: of time 0, in s.

    faults: its own; log: of what becomes of its messages.
    """
    name, baud = args.devices[index]
    order = _Order(args, scene, utc, name, baud, np.random.default_rng([args.seed, index]), list(faults))
    built = _windowed(order) if name in VARIANTS else _BUILDERS[name](order)
    if of_layer("wire", faults) or log is not None:
        rng = np.random.default_rng([args.seed, index, 1])
        built.uart.damage = Wire(name, of_layer("wire", faults), rng, log)
    happening = of_layer("device", faults)
    return FaultyDevice(built, happening) if happening else built


def _g350(order: _Order) -> Device:
    return G350(
        order.signal,
        order.errors(M_G350, TICK_HZ),
        order.baud,
        count_step=order.args.count_step,
        identity=not order.args.no_identity,
        oscillator=order.oscillator,
    )


def _windowed(order: _Order) -> Device:
    variant = VARIANTS[order.name]
    errors, step = order.errors(variant.grade, TICK_HZ), order.args.count_step
    return Windowed(variant, order.signal, errors, order.baud, count_step=step, oscillator=order.oscillator)


def _rga300(order: _Order) -> Device:
    rate_hz = order.args.stream_rate
    errors = order.errors(RGA300, rate_hz)
    return Rga300(order.signal, errors, order.baud, rate_hz=rate_hz, oscillator=order.oscillator)


def _seraccel(order: _Order) -> Device:
    settings = Settings(mode=order.args.stream_mode, rate_hz=order.args.stream_rate)
    errors, streaming = order.errors(mma7260(settings.rate_hz), settings.rate_hz), order.args.streaming
    return SerAccel(order.signal, errors, order.baud, settings, streaming=streaming, oscillator=order.oscillator)


def _nmea(order: _Order) -> Device:
    if order.scene.sentences is not None:
        return SentencePlayback(order.scene.sentences, order.baud, order.args.loop)
    source: FixSource
    if order.scene.fixes is not None:
        source = order.scene.fixes
    else:
        assert order.scene.trajectory is not None, "`scene` refuses a receiver without fixes"
        source = SimulatedFixes(order.scene.trajectory, order.rng, order.utc, order.args.ideal)
    faulty = FaultyFixes(source, of_layer("fixes", order.faults))
    return FvM11(faulty, order.utc, order.baud, order.args.rate, order.args.no_fix)


def _scaled(values: tuple[float, float, float] | None, unit: float) -> tuple[float, float, float] | None:
    return None if values is None else (values[0] * unit, values[1] * unit, values[2] * unit)


_BUILDERS: dict[str, Callable[[_Order], Device]] = {
    "g350": _g350,
    "nmea": _nmea,
    "rga300": _rga300,
    "seraccel": _seraccel,
}
