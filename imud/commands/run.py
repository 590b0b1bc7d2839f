"""`imud run`: the daemon. Arguments to settings, ports to sensors, signals to an orderly end."""

import argparse
import signal
from collections.abc import Callable

from ..client import GPSD_ADDRESS
from ..configuration.fields import replace
from ..configuration.settings import Settings
from ..daemon import simulated
from ..errors import CannotCreateError, ConfigError, ImudError, UsageError
from ..process import log
from ..setup import config
from .arguments import add_settings, seed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--port",
        action="append",
        default=[],
        metavar="DEV[:DRIVER[@BAUD]]",
        help="a serial port, spi:BUS.DEVICE, iio:NAME, gpsd://HOST, sim:SCENARIO, replay:MCAP; repeat for the receiver",
    )
    parser.add_argument("--seed", type=seed, default=1, metavar="N", help="of the errors of sim: devices (default 1)")
    parser.add_argument("--estimator", metavar="NAME", help="default: navigation with two ports, else attitude")
    parser.add_argument("--initial", metavar="KEY=V,…", help="known start: lat_deg=…,lon_deg=…,yaw_deg=…")
    parser.add_argument("--listen", metavar="ADDR", help=f"gpsd JSON: HOST:PORT or /path (default {GPSD_ADDRESS})")
    parser.add_argument("--rtcm", metavar="SOURCE", help="data of an RTK base for the receiver: HOST:PORT or a path")
    parser.add_argument("--record", metavar="MCAP", help="record everything: raw bytes, estimates, innovations, events")
    parser.add_argument(
        "--wait",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="wait for absent and silent devices (default), or exit with 69",
    )
    add_settings(parser)
    parser.add_argument("--check", action="store_true", help="check the configuration and exit")
    levels = ("debug", "info", "warning", "error")
    parser.add_argument("--log-level", default="info", choices=levels, help="of the log on stderr (default info)")
    parser.add_argument(
        "--log-format", default="text", choices=("text", "json"), help="of the log; json: one object a line"
    )


def run(args: argparse.Namespace) -> int:
    if args.config is not None:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})  # it waits for the daemon, which reads the file again
    settings = _settings(args)
    if args.check:
        _check(settings)
        print("the configuration is valid")
        return 0
    if not settings.ports:
        raise UsageError("no port: name one, for example --port /dev/ttyUSB0, or try `imud demo`")
    from ..daemon.loop import Daemon
    from ..recording.control import Recordings
    from ..recording.ports import expanded

    settings = replace(settings, ports=expanded(settings.ports))
    with (
        simulated.emulated(settings.ports, args.seed, settings.aiding.listen) as emulated,
        Recordings(settings) as recordings,
    ):
        log.configure(args.log_level, recordings.event, args.log_format)
        texts = settings.ports

        def reread() -> Settings:
            fresh = _settings(args, regular_only=True)
            same = expanded(fresh.ports) == texts
            return simulated.settings_of(fresh, emulated if same else simulated.Emulated(fresh.ports))

        settings = simulated.settings_of(settings, emulated)
        hot = None if args.config is None else reread
        return Daemon(settings, wait=args.wait, reread=hot, recordings=recordings).run()


def _check(settings: Settings) -> None:
    """The checks that need no device: all of them, each by itself. Raises what the daemon would, or ConfigError."""
    errors = []
    for name, check in _checks(settings).items():
        try:
            check()
        except ImudError as error:
            errors.append(type(error)(str(error) if name in str(error) else f"{name}: {error}"))
    if len(errors) == 1:
        raise errors[0]
    if errors:
        raise ConfigError("bad configuration\n  " + "\n  ".join(map(str, errors)))


def _checks(settings: Settings) -> dict[str, Callable[[], object]]:
    """Each by the setting that it reads, for messages that do not name it."""
    from ..daemon import aiding_socket
    from ..daemon.corrections import address_of
    from ..outputs.addresses import addresses_of, parse_path
    from ..outputs.nmea import udp_address
    from ..outputs.plugin import installed
    from ..setup import choices

    checks: dict[str, Callable[[], object]] = {
        "port": lambda: _check_ports(settings),
        "estimator": lambda: choices.estimators(settings),
        "record.folder": lambda: _check_folder(settings.record.folder),
        "gpsd.listen": lambda: addresses_of(settings.gpsd),
        "outputs": lambda: [installed(name) for name in settings.outputs],
    }
    if stream := settings.stream.listen:
        checks["stream.listen"] = lambda: parse_path(stream)
    if settings.nmea.udp:
        checks["nmea.udp"] = lambda: udp_address(settings.nmea)
    if aiding := settings.aiding.listen:
        checks["aiding.listen"] = lambda: aiding_socket.address_of(aiding)
    if rtcm := settings.gnss.rtcm:
        checks["gnss.rtcm"] = lambda: address_of(rtcm)
    return checks


def _check_ports(settings: Settings) -> None:
    from ..setup import choices

    simulated.check(settings.ports)
    real = tuple(text for text in settings.ports if not text.startswith(simulated.SCHEME))
    choices.ports(replace(settings, ports=real))


def _check_folder(folder: str) -> None:
    from ..recording.control import folder_trouble

    if trouble := folder_trouble(folder):
        raise CannotCreateError(trouble)


def _settings(args: argparse.Namespace, regular_only: bool = False) -> Settings:
    """The configuration file and what overrides it; regular_only: as in `config.load`. Raises ConfigError."""
    given = {
        "ports": args.port,
        "gpsd.listen": args.listen,
        "record.path": args.record,
        "gnss.rtcm": args.rtcm,
        "initial": args.initial,
    }
    settings = config.load(args.config, args.set, {key: value for key, value in given.items() if value}, regular_only)
    return replace(settings, estimator=args.estimator) if args.estimator else settings
