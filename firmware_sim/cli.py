"""`imud sim` and `python -m imud.firmware_sim`: which devices, on which motion, with which errors, for how long."""

import argparse
import logging
import math
import signal
import sys
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from .device import OTHERS, POLLED, PROGRAMS, RECEIVERS
from .faults import spec
from .faults.spec import Fault
from .iio_chips import CHIPS

if TYPE_CHECKING:
    from .build import Scene
    from .emulator import EmulatedPort, Task
    from .faults.wire import WireLog

KERNEL = (*CHIPS, *POLLED)  # devices that a driver of the kernel has
EXIT_USAGE, EXIT_DATA, EXIT_NO_INPUT, EXIT_NO_OUTPUT, EXIT_INTERRUPTED = 64, 65, 66, 73, 130
DEFAULT_BAUD = {"g350": 460800, "nmea": 9600, "rga300": 38400, "seraccel": 57600, "ubx": 38400, "m8": 9600}
DEFAULT_BAUD |= dict.fromkeys(OTHERS, 38400)
DEFAULT_BAUD |= {"g364": 460800, "g365": 460800, "g370": 460800}
SERACCEL_MODES = ("gravity", "raw", "binary")
SCENARIO_NAMES = ("rest", "turntable", "car", "figure8")
BAUDS = (4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)

STAND_IN = Path(__file__).parent / "stand_in"  # packages spidev and gpiod that reach the emulated sensors

Triple = tuple[float, float, float]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the emulator."""
    parser.usage = "%(prog)s DEVICE [DEVICE ...] [OPTION ...]"
    parser.epilog = (
        "--replay takes a recording (MCAP), whose bytes are sent; imu.csv and gnss.csv of `imud export --csv`; or a "
        "receiver's sentences. Epson on SPI:\n"
        f"  PYTHONPATH={STAND_IN} \\\n"
        "  IMUD_SIM='g350 --scenario car' imud --port spi:0.0 --set spi.data_ready=gpiochip0:24"
    )
    add = parser.add_argument
    chips = ", ".join(name for name in KERNEL if name != "swapped")  # which is for tests
    help_ = f"{', '.join(DEFAULT_BAUD)}; also @BAUD. With --iio-root: {chips}"
    add("devices", nargs="+", type=_device, metavar="DEVICE", help=help_)
    add("--send", metavar="ADDRESS", help=f"where {', '.join(PROGRAMS)} send")
    add("--iio-root", type=Path, metavar="DIR", help="folder that gets sys/ and dev/ as the kernel has them")
    scenarios = ", ".join(SCENARIO_NAMES)
    add("--scenario", choices=SCENARIO_NAMES, default="rest", metavar="NAME", help=f"{scenarios} (default rest)")
    add("--replay", nargs="+", type=Path, metavar="FILE", help="instead: a recording's bytes, or its samples")
    add("--loop", action="store_true", help="repeat the recording; else silence after its end")
    add("--link", action="append", type=Path, default=[], metavar="PATH", help="stable name; one per line, in order")
    add("--seed", type=int, default=1, metavar="N", help="of noise and biases (default 1)")
    add("--seconds", type=_span, default=math.inf, metavar="N", help="end after that")
    add("--rate", type=float, default=1.0, metavar="HZ", help="fixes per second, 1 to 5; the host sets the IMU's rate")
    add("--stream-rate", type=float, default=100.0, metavar="HZ", help="of rga300 and seraccel, 1 to 160 (default 100)")
    add(
        "--stream-mode",
        choices=SERACCEL_MODES,
        default="gravity",
        metavar="NAME",
        help="gravity, raw, binary: seraccel",
    )
    add("--streaming", action="store_true", help="a seraccel that streams, a u-blox that sends UBX")
    add("--roll-deg", type=float, default=0.0, metavar="X", help="attitude at rest and on the turntable")
    add("--pitch-deg", type=float, default=0.0, metavar="X")
    add("--yaw-deg", type=float, default=0.0, metavar="X")
    add("--heading-sigma-deg", type=float, metavar="X", help="receiver with two antennas: error of its heading")
    add("--start-delay", type=_span, default=0.0, metavar="S", help="rest before the scenario begins")
    add("--no-fix", type=_span, default=2.5, metavar="S", help="how long the receiver searches (default 2.5)")
    add("--ideal", action="store_true", help="no noise, no biases, no GNSS errors")
    add("--gyro-bias-dps", type=_triple, metavar="X,Y,Z", help="instead of drawn ones; write =-0.3,0,0 if negative")
    add("--accel-bias-mg", type=_triple, metavar="X,Y,Z")
    add("--gyro-slope-dps-per-k", type=_triple, metavar="X,Y,Z", help="biases follow the temperature (first minutes)")
    add("--mount-deg", type=_triple, metavar="R,P,Y", help="how the sensors sit in the vehicle: imu.mount_rpy_deg")
    add("--clock-ppm", type=float, default=0.0, metavar="X", help="error of the IMU's clock")
    add("--count-step", type=int, metavar="N", help="COUNT per sample (default: of 2 kHz ticks)")
    add("--no-identity", action="store_true", help="an IMU without product name and serial number")
    add("--truth", type=Path, metavar="FILE", help="write the true motion there, CSV at 100 Hz")
    add_faults(parser)
    add("--wire-log", type=Path, metavar="FILE", help="write every message there, as sent and as damaged, CSV")
    speed = parser.add_mutually_exclusive_group()
    speed.add_argument("--realtime", dest="fast", action="store_false", help=argparse.SUPPRESS)
    speed.add_argument("--speed", type=float, default=1.0, metavar="X", help="so many times as fast as real time")
    speed.add_argument("--fast", action="store_true", help="as fast as read; a host that stamps arrivals is misled")
    parser.set_defaults(fast=False)
    add("--patient", action="store_true", help="bytes wait until the host reads them, and none is lost")
    add("--parent", type=int, metavar="PID", help=argparse.SUPPRESS)


class _FaultsHelp(argparse.Action):
    """Print the list of faults, and end."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(spec.help_text())
        parser.exit()


def add_faults(parser: argparse.ArgumentParser) -> None:
    """Declare --faults and --faults-help."""
    parser.add_argument(
        "--faults", default="", metavar="SPEC", help='what goes wrong: "flip=0.01,cut=0.01;gnss:loss@20-40"'
    )
    parser.add_argument("--faults-help", action=_FaultsHelp, nargs=0, help="what can go wrong, as a list")


def run(args: argparse.Namespace) -> int:
    """Emulate until a signal or the end. Returns the exit code."""
    from . import build
    from .replay import DataError

    if not logging.getLogger().handlers:
        logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="%(name)s: %(message)s")
    problem = _usage_error(args)
    if problem:
        return _fail(EXIT_USAGE, problem)
    try:
        faults = spec.parse(args.faults, [name for name, _ in args.devices])
        scene = build.scene(args)
    except spec.SpecError as error:
        return _fail(EXIT_USAGE, f"--faults: {error}")
    except build.UsageError as error:
        return _fail(EXIT_USAGE, str(error))
    except DataError as error:
        return _fail(EXIT_DATA, str(error))
    except OSError as error:
        return _fail(EXIT_NO_INPUT, f"{error.filename}: {error.strerror}")
    try:
        return _emulate(args, scene, faults)
    except OSError as error:
        return _fail(EXIT_NO_OUTPUT, f"{error.filename or 'stdout'}: {error.strerror}")


def _device(text: str) -> tuple[str, int]:
    name, _, baud = text.partition("@")
    if text in (*KERNEL, *PROGRAMS):
        return text, 0
    if name not in DEFAULT_BAUD or (baud and baud not in map(str, BAUDS)):
        raise argparse.ArgumentTypeError(
            f"{text!r}: a device is {' or '.join((*DEFAULT_BAUD, *PROGRAMS))}, optionally @ and one of "
            f"{', '.join(map(str, BAUDS))}"
        )
    return name, int(baud or DEFAULT_BAUD[name])


def _span(text: str) -> float:
    with suppress(ValueError):
        if (value := float(text)) >= 0.0:
            return value
    raise argparse.ArgumentTypeError(f"{text!r}: a time in seconds is needed")


def _triple(text: str) -> Triple:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: three numbers with commas between are needed") from None
    return x, y, z


def _usage_error(args: argparse.Namespace) -> str:
    """The error in the combination of the arguments; empty: none."""
    names = [name for name, _ in args.devices]
    chips = [name for name in names if name in KERNEL]
    programs = [name for name in names if name in PROGRAMS]
    checks = [
        (bool(chips) and args.iio_root is None, f"{', '.join(chips)}: say where sysfs is imitated: --iio-root DIR"),
        (
            bool(programs) and args.send is None,
            f"{', '.join(programs)}: say where the daemon listens (aiding.listen): --send ADDRESS",
        ),
        (bool(args.send) and not _is_address(args.send), "--send: an address is /path or HOST:PORT"),
        (
            bool(chips + programs) and (args.replay or args.fast or args.speed != 1.0),
            f"{', '.join(chips + programs)}: in real time only, no --replay",
        ),
        (len(args.link) > len(names) - len(chips + programs), "more --link than devices on lines"),
        (len(set(args.link)) < len(args.link), "two devices cannot have the same --link"),
        (not 1.0 <= args.rate <= 5.0, "--rate: the receiver gives 1 to 5 fixes per second"),
        (not 1.0 <= args.stream_rate <= 160.0, "--stream-rate: 1 to 160 samples per second"),
        (bool(args.replay) and args.truth is not None, "--truth: a recording knows no truth"),
        (args.loop and not args.replay, "--loop goes with --replay"),
        (not 0.01 <= args.speed <= 1000.0, "--speed: 0.01 to 1000"),
        (args.seed < 0, "--seed must not be negative"),
        (abs(args.clock_ppm) > 10000.0, "--clock-ppm: at most 10000"),
    ]
    return next((text for wrong, text in checks if wrong), "")


def _is_address(text: str) -> bool:
    host, _, port = text.rpartition(":")
    return "/" in text or (bool(host) and port.isdigit() and int(port) < 65536)


def _fail(code: int, message: str) -> int:
    print(f"imud sim: {message}", file=sys.stderr)
    return code


def _devices(
    args: argparse.Namespace,
    scene: "Scene",
    faults: list[list[Fault]],
    time_zero: tuple[float, float],
    wires: "WireLog | None",
    stack: ExitStack,
) -> "tuple[list[EmulatedPort], list[Task]]":
    """The named devices: those on ports, and those that need none. time_zero: see `Scene`."""
    from .build import device, kernel_device, program
    from .emulator import EmulatedPort

    start, utc = time_zero
    links = iter([*args.link, *[None] * len(args.devices)])
    ports: list[EmulatedPort] = []
    tasks: list[Task] = []
    for i, (name, _) in enumerate(args.devices):
        if name in KERNEL:
            chip = kernel_device(args, scene, i, faults[i], start, wires)
            stack.enter_context(chip)
            tasks.append(chip)
            print(name, chip.path, flush=True)
        elif name in PROGRAMS:
            sender = stack.enter_context(program(args, scene, utc, i, faults[i], wires))
            tasks.append(sender)
            print(name, sender.path, flush=True)
        else:
            built = device(args, scene, utc, i, faults[i], wires)
            outages = [fault.span for fault in spec.of_layer("plug", faults[i])]
            port = EmulatedPort(name, built, next(links), outages, patient=args.fast or args.patient)
            ports.append(stack.enter_context(port))
    return ports, tasks


def _emulate(args: argparse.Namespace, scene: "Scene", faults: list[list[Fault]]) -> int:
    from .emulator import AsFastAsRead, RealTime, TruthLog, end_with_parent, serve
    from .faults.wire import WireLog

    signals: list[int] = []
    with ExitStack() as stack:
        for number in (signal.SIGINT, signal.SIGTERM):
            before = signal.signal(number, lambda number, _: signals.append(number))
            stack.callback(signal.signal, number, before)
        if args.parent is not None:
            end_with_parent(args.parent)
        time_zero = scene.time_zero()
        start, _ = time_zero
        wires = stack.enter_context(closing(WireLog(args.wire_log, start))) if args.wire_log else None
        ports, tasks = _devices(args, scene, faults, time_zero, wires, stack)
        if args.truth is not None and scene.trajectory is not None:
            tasks.append(stack.enter_context(closing(TruthLog(args.truth, scene.trajectory, start))))
        for port in ports:
            print(port.name, port.path, flush=True)
        leaders = [port for port in ports if port.name not in (*RECEIVERS, *OTHERS)] or ports
        clock = AsFastAsRead(leaders) if args.fast else RealTime(start, args.speed)
        serve(ports, tasks, clock, args.seconds, lambda: bool(signals))
        for port in ports:
            _log_summary(port)
    return EXIT_INTERRUPTED if signal.SIGINT in signals else 0


def _log_summary(port: "EmulatedPort") -> None:
    import numpy as np

    from .faults.wire import Wire

    log = logging.getLogger("firmware_sim")
    wire = port.device.uart.damage
    if isinstance(wire, Wire):
        log.info("%s: %s", port.name, wire.summary())
    if port.lost:
        log.info("%s: %d bytes lost: the host did not read them", port.name, port.lost)
    if port.late_s:
        late = 1e3 * np.percentile(port.late_s, (50.0, 99.0, 100.0))
        log.info("%s: written late by %.2f / %.2f / %.1f ms (median, 99 %%, most)", port.name, *late)
    if port.longest_wait_s:
        log.info("%s: bytes waited for the kernel for up to %.3f s", port.name, port.longest_wait_s)
