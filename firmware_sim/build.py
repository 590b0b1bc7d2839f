"""From the command's options to devices on a common motion."""

import argparse
import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from . import recorded_bytes, sentence_playback
from .device import OTHERS, POLLED, RECEIVERS, Device
from .faults.device import FaultyDevice
from .faults.fixes import FaultyFixes
from .faults.readings import FaultyReadings
from .faults.sensor import FaultyErrors
from .faults.spec import Fault, of_layer
from .faults.wire import Wire, WireLog
from .fixes import FixSource, SimulatedFixes
from .g350 import G350
from .g370 import VARIANTS, Windowed
from .iio import Device as IioDevice
from .iio import IioChip
from .iio_chips import CHIPS
from .iio_polled import PolledDevice
from .motion import Mounted, Trajectory, rotation
from .nmea import FvM11
from .noise import DEG, IDEAL, M_G350, MILLI_G, Grade, ImuErrors, Signal
from .other_sensors import KINDS as OTHER_KINDS
from .other_sensors import OtherSensor
from .programs import Program
from .recorded_bytes import BytePlayback, Playback, RecordedPort
from .replay import RecordedFixes, RecordedImu, kind
from .rga300 import RGA300, Rga300
from .sampling import TICK_HZ
from .scenarios import SCENARIOS
from .sentence_playback import SentencePlayback
from .seraccel import SerAccel, Settings, mma7260
from .ublox import NEO_M8N, ZED_F9P, Model, Ublox

_log = logging.getLogger("firmware_sim.replay")

START = (35.6586, 139.7454, 60.0)  # latitude and longitude in deg, height in m: Tokyo


class UsageError(Exception):
    """Options that contradict each other."""


@dataclass(frozen=True)
class Scene:
    """The common motion of the devices: a scenario's trajectory, or recordings."""

    signal: Signal | None
    trajectory: Trajectory | None = None
    fixes: RecordedFixes | None = None
    sentences: list[tuple[float, bytes]] | None = None
    ports: list[RecordedPort] | None = None  # one per device
    playback: Playback | None = None

    def time_zero(self) -> tuple[float, float]:
        """CLOCK_MONOTONIC and UTC of time 0, in s: now, or soon, when recorded epochs fall on whole UTC seconds."""
        now, utc = time.monotonic(), time.time()
        wait = -(utc + self.fixes.phase) % 1.0 if self.fixes else 0.0
        return now + wait, utc + wait


def scene(args: argparse.Namespace) -> Scene:
    """The scenario or recording that the options name. Raises DataError, UsageError; OSError for a recording."""
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
            raise UsageError(f"--replay: {path} and {files.get(of, *files.values())} are of one kind; give one")
        files[of] = path
    if "mcap" in files:
        return _recorded_bytes(args, files)
    names = {name for name, _ in args.devices}
    if others := sorted(names & set(OTHERS)):
        raise UsageError(f"--replay: {', '.join(others)} needs a scenario")
    if inertial := sorted(names - set(RECEIVERS)) if "imu" not in files else []:
        raise UsageError(f"--replay: {', '.join(inertial)} needs an imu.csv")
    if names & {"ubx", "m8"}:
        raise UsageError("--replay: a u-blox receiver reports more than these files have: use nmea")
    if "nmea" in names and "imu" in files and len(files) < 2:
        raise UsageError("--replay: nmea needs a gnss.csv or a log of sentences as well")
    imu = RecordedImu(files["imu"], args.loop) if "imu" in files else None
    fixes = RecordedFixes(files["gnss"], imu, args.loop) if "gnss" in files else None
    return Scene(imu, None, fixes, sentence_playback.read(files["nmea"]) if "nmea" in files else None)


def _recorded_bytes(args: argparse.Namespace, files: dict[str, Path]) -> Scene:
    if len(files) > 1:
        raise UsageError(f"--replay: {files['mcap']} has all devices; give no other file with it")
    found = recorded_bytes.read(files["mcap"])
    ports, playback = recorded_bytes.choose(found, [name for name, _ in args.devices], args.loop)
    for line in recorded_bytes.summary(ports):
        _log.info("%s", line)
    rest = Trajectory(SCENARIOS["rest"](0.0, 0.0, 0.0), *START)  # of what the device says beside its stream
    return Scene(Mounted(rest, np.eye(3)), rest, ports=ports, playback=playback)


@dataclass(frozen=True)
class _DeviceOptions:
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
    def search_s(self) -> float:
        """How long a receiver knows no position: with recorded bytes until these begin."""
        return math.inf if self.scene.ports is not None else float(self.args.no_fix)

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

    faults: its own; log: of its messages, as sent and as arrived.
    """
    name, baud = args.devices[index]
    options = _DeviceOptions(args, scene, utc, name, baud, np.random.default_rng([args.seed, index]), list(faults))
    built = _BUILDERS[name](options)
    if (wire := _wire(args, index, faults, log)) is not None:
        built.uart.damage = wire
    if scene.ports is not None and scene.playback is not None:
        leads = index == next((i for i, port in enumerate(scene.ports) if port.device not in RECEIVERS), 0)
        built = BytePlayback(built, scene.ports[index], scene.playback, leads)
    device_faults = of_layer("device", faults)
    return FaultyDevice(built, device_faults) if device_faults else built


def kernel_device(
    args: argparse.Namespace,
    scene: Scene,
    index: int,
    faults: Sequence[Fault],
    start: float,
    log: WireLog | None = None,
) -> IioChip | PolledDevice:
    """Chip number `index` of the command line, behind the kernel. start: CLOCK_MONOTONIC of time 0, in s; log: of the
    readings of a barometer or magnetometer."""
    name, _ = args.devices[index]
    before = sum(_iio_devices(other) for other, _ in args.devices[:index])
    if name in POLLED:
        assert scene.trajectory is not None, "`cli` refuses it with a recording"
        rng, wire = np.random.default_rng([args.seed, index]), _wire(args, index, faults, log)
        return PolledDevice(name, before, scene.trajectory, rng, args.iio_root, faults, ideal=args.ideal, wire=wire)
    return _iio_chip(args, scene, index, faults, start, before)


def program(
    args: argparse.Namespace,
    scene: Scene,
    utc: float,
    index: int,
    faults: Sequence[Fault] = (),
    log: WireLog | None = None,
) -> Program:
    """Device number `index` of the command line, a program that sends datagrams; arguments: see `device`."""
    assert scene.trajectory is not None, "`cli` refuses it with a recording"
    name, _ = args.devices[index]
    rng, wire = np.random.default_rng([args.seed, index]), _wire(args, index, faults, log)
    return Program(name, scene.trajectory, rng, args.send, utc, faults, ideal=args.ideal, wire=wire)


def _wire(args: argparse.Namespace, index: int, faults: Sequence[Fault], log: WireLog | None) -> Wire | None:
    """What damages, or logs, the messages of device number `index`; None: nothing does."""
    damaging = of_layer("wire", faults)
    if not damaging and log is None:
        return None
    return Wire(args.devices[index][0], damaging, np.random.default_rng([args.seed, index, 1]), log)


def _iio_devices(name: str) -> int:
    """How many `iio:deviceN` the kernel has of it."""
    return len(CHIPS[name].parts) if name in CHIPS else int(name in POLLED)


def _iio_chip(
    args: argparse.Namespace, scene: Scene, index: int, faults: Sequence[Fault], start: float, first: int
) -> IioChip:
    name, _ = args.devices[index]
    chip = CHIPS[name]
    grade = Grade(
        random_walk=(chip.noise[0] * DEG, chip.noise[1] * MILLI_G),
        turn_on=(chip.turn_on[0] * DEG, chip.turn_on[1] * MILLI_G),
        in_run=(10.0 * DEG / 3600.0, 0.1 * MILLI_G),
        scale=(0.005, 0.005),
        misalignment=(0.1 * DEG, 0.1 * DEG),
        limit=chip.limit,
    )

    def errors(rate_hz: float) -> ImuErrors:
        rng = np.random.default_rng([args.seed, index])
        return _DeviceOptions(args, scene, 0.0, name, 0, rng, list(faults)).errors(grade, rate_hz)

    signal = _DeviceOptions(args, scene, 0.0, name, 0, np.random.default_rng(), []).signal
    devices = [IioDevice(first + i, chip, part, signal, errors, args.iio_root) for i, part in enumerate(chip.parts)]
    return IioChip(name, devices, start, [*of_layer("plug", faults), *of_layer("buffer", faults)])


def _g350(options: _DeviceOptions) -> Device:
    return G350(
        options.signal,
        options.errors(M_G350, TICK_HZ),
        options.baud,
        count_step=options.args.count_step,
        identity=not options.args.no_identity,
        oscillator=options.oscillator,
    )


def _windowed(options: _DeviceOptions) -> Device:
    variant = VARIANTS[options.name]
    errors, step = options.errors(variant.grade, TICK_HZ), options.args.count_step
    return Windowed(variant, options.signal, errors, options.baud, count_step=step, oscillator=options.oscillator)


def _rga300(options: _DeviceOptions) -> Device:
    rate_hz = options.args.stream_rate
    errors = options.errors(RGA300, rate_hz)
    return Rga300(options.signal, errors, options.baud, rate_hz=rate_hz, oscillator=options.oscillator)


def _seraccel(options: _DeviceOptions) -> Device:
    settings = Settings(mode=options.args.stream_mode, rate_hz=options.args.stream_rate)
    errors, streaming = options.errors(mma7260(settings.rate_hz), settings.rate_hz), options.args.streaming
    return SerAccel(options.signal, errors, options.baud, settings, streaming=streaming, oscillator=options.oscillator)


def _nmea(options: _DeviceOptions) -> Device:
    if options.scene.sentences is not None:
        return SentencePlayback(options.scene.sentences, options.baud, options.args.loop)
    return FvM11(_fixes(options), options.utc, options.baud, options.args.rate, options.search_s)


def _other(options: _DeviceOptions) -> Device:
    assert options.scene.trajectory is not None, "`scene` refuses it without a motion"
    fault = FaultyReadings(of_layer("reading", options.faults))
    return OtherSensor(
        OTHER_KINDS[options.name], options.scene.trajectory, options.rng, options.baud, options.args.ideal, fault
    )


def _ublox(model: Model) -> Callable[[_DeviceOptions], Device]:
    def build(options: _DeviceOptions) -> Device:
        rate, mixed = options.args.rate, options.args.streaming or options.scene.ports is not None
        return Ublox(_fixes(options), options.utc, options.baud, rate, options.search_s, model, mixed=mixed)

    return build


def _fixes(options: _DeviceOptions) -> FixSource:
    source: FixSource
    if options.scene.fixes is not None:
        source = options.scene.fixes
    else:
        assert options.scene.trajectory is not None, "`scene` refuses a receiver without fixes"
        source = SimulatedFixes(
            options.scene.trajectory, options.rng, options.utc, options.args.ideal, options.args.heading_sigma_deg
        )
    return FaultyFixes(source, of_layer("fixes", options.faults))


def _scaled(values: tuple[float, float, float] | None, unit: float) -> tuple[float, float, float] | None:
    return None if values is None else (values[0] * unit, values[1] * unit, values[2] * unit)


_BUILDERS: dict[str, Callable[[_DeviceOptions], Device]] = {
    **dict.fromkeys(OTHERS, _other),
    **dict.fromkeys(VARIANTS, _windowed),
    "g350": _g350,
    "m8": _ublox(NEO_M8N),
    "nmea": _nmea,
    "rga300": _rga300,
    "seraccel": _seraccel,
    "ubx": _ublox(ZED_F9P),
}
