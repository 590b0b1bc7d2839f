"""`imud replay`: recorded samples and fixes through the same filter as the daemon's, as fast as it goes."""

import argparse
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..configuration.settings import Settings
from ..errors import BadDataError, CannotCreateError, UsageError
from ..progress import Progress
from ..setup import config
from ..tables.output import open_output
from .arguments import above_zero, add_settings, at_least_one
from .files import input_file, refuse_overwriting

if TYPE_CHECKING:
    from ..estimators import Estimator
    from ..estimators.aiding_source import AidingSource
    from ..math.arrays import Records
    from ..tables.inputs import SkippedRows

_PERIOD_MAX_S, _FORCE_MPS2 = 0.2, (4.0, 25.0)  # beyond them the units of the file are probably wrong
_CHECKED_SAMPLES = 10_000  # of the specific force


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recordings", nargs="*", type=input_file, metavar="MCAP", help="recordings of imud; or:")
    parser.add_argument(
        "--imu", type=input_file, metavar="CSV", help="samples: t_s,gx_radps,…,az_mps2 (FRD); - for stdin"
    )
    parser.add_argument(
        "--gnss", type=input_file, metavar="CSV|NMEA", help="fixes: t_s,lat_deg,lon_deg,height_m,… or NMEA"
    )
    parser.add_argument(
        "--aiding", action="append", default=[], metavar="SOURCE=CSV", help="other measurements, as heading=hdg.csv"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="CSV",
        help="estimates; - for stdout; of several recordings a folder",
    )
    parser.add_argument("--jobs", type=at_least_one, default=1, metavar="N", help="recordings at a time (default 1)")
    parser.add_argument("--cluster", metavar="ADDRESS", help="the same on the workers of a Dask scheduler: HOST:8786")
    parser.add_argument(
        "--innovations", type=Path, metavar="CSV", help="of fixes, rest and constraints, for `imud report`"
    )
    parser.add_argument(
        "--states", type=Path, metavar="CSV", help="each second: delays, mounting, scale, covariance, …; not smoothed"
    )
    parser.add_argument("--estimator", metavar="NAME", help="default: navigation with --gnss, else attitude")
    parser.add_argument("--initial", default="", metavar="KEY=V,…", help="known start: lat_deg=…,lon_deg=…,yaw_deg=…")
    parser.add_argument("--rate", type=above_zero, metavar="HZ", help="thin the output (default: every sample)")
    parser.add_argument("--smooth", action="store_true", help="estimates from the data before and after each sample")
    parser.add_argument("--calibration", type=Path, metavar="TOML", help="of the sensor, as `imud calibrate` keeps it")
    add_settings(parser)


def _output_mask(t_ns: Any, rate_hz: float | None) -> Any:
    """Mask of the samples that start a new output period; None: all."""
    if rate_hz is None:
        return None
    slot = np.floor((t_ns - t_ns[0]) * 1e-9 * rate_hz + 1e-6)
    return np.concatenate([[True], np.diff(slot) > 0])


def _estimator_name(args: argparse.Namespace, settings: Settings) -> str:
    name = args.estimator or settings.estimator
    return ("navigation" if args.gnss else "attitude") if name == "auto" else name


def run(args: argparse.Namespace) -> int:
    aiding_files = (Path(text.partition("=")[2]) for text in args.aiding)
    inputs = [args.imu, args.gnss, args.calibration, args.config, *aiding_files, *args.recordings]
    refuse_overwriting([args.output, args.innovations, args.states], inputs)
    if args.recordings:
        from . import replay_recordings

        if args.imu or args.gnss or args.aiding:
            raise UsageError("replay: --imu, --gnss and --aiding are tables; name these or recordings, not both")
        return replay_recordings.run(args)
    if args.imu is None:
        raise UsageError("replay: name the recording: FILE.mcap, or --imu imu.csv [--gnss gnss.csv]")
    if args.cluster or args.jobs > 1:
        raise UsageError("replay: --cluster and --jobs are for recordings; tables are replayed here, by one process")
    settings = config.load(args.config, args.set)
    initial = config.initial_of(settings, args.initial)
    from ..batch import in_order_of_arrival, play
    from ..estimators import registry
    from ..pipeline import Filter
    from ..sensor_errors import calibration
    from ..sensor_monitor.findings import counted
    from ..tables.estimates import EstimateWriter
    from ..tables.filter_states import FilterStates, write_states
    from ..tables.inputs import SkippedRows, read_imu

    estimator = registry.by_name(_estimator_name(args, settings))
    left_out = SkippedRows(args.imu), SkippedRows(args.gnss)
    sources = _sources(args.aiding, estimator)
    samples, origin, skipped = read_imu(args.imu, left_out[0])
    fixes = _read_gnss(args.gnss, origin, samples, settings, left_out[1])
    rate_hz = 1e9 / float(np.median(np.diff(samples["t_ns"])))
    aiding = in_order_of_arrival(
        (*_read_aiding(sources, origin), *_readings(args.gnss, origin, samples, settings, estimator))
    )
    filter_ = Filter(estimator, settings, initial, rate_hz)
    if args.calibration is not None:
        filter_.calibrate(calibration.read(args.calibration))
    player = play
    if args.smooth:
        from ..smoothing import play_smoothed as player
    begin = time.perf_counter()
    with open_output(args.output) as file:
        writer = EstimateWriter(file, origin)
        innovations: list[Records] = []
        mask = _output_mask(samples["t_ns"], args.rate)
        progress = Progress(len(samples))
        states = FilterStates()
        each_second = None if args.states is None else partial(states.take, filter_)
        fed = player(filter_, samples, fixes, writer.write, mask, innovations.append, aiding, progress.at, each_second)
    if args.innovations is not None:
        _write_innovations(args.innovations, origin, innovations)
    if args.states is not None:
        write_states(args.states, origin, states.rows)
    _summary(samples, fixes, fed, skipped, time.perf_counter() - begin)
    for finding in counted(filter_.health):
        print(f"imud replay: {args.imu}: {finding}", file=sys.stderr)
    if args.gnss is not None and not len(fixes):
        print(f"imud replay: {args.gnss}: no fix in it", file=sys.stderr)
    left_out[0].judge(len(samples))
    left_out[1].judge(len(fixes))
    return 0


def _write_innovations(path: Path, origin: int, innovations: "list[Records]") -> None:
    from ..estimators.records import INNOVATION
    from ..tables.estimates import write_innovations

    try:
        write_innovations(path, origin, np.concatenate([np.zeros(0, INNOVATION), *innovations]))
    except OSError as error:
        raise CannotCreateError(f"cannot write {path}: {error.strerror}") from error


def _read_gnss(
    path: Path | None, origin: int, samples: "Records", settings: Settings, left_out: "SkippedRows"
) -> "Records":
    from ..estimators.records import FIX
    from ..tables.fixes import fixes_of_file

    def warn(problem: str) -> None:
        print(f"imud replay: {path}: {problem}", file=sys.stderr)

    if path is None:
        return np.zeros(0, FIX)
    return fixes_of_file(path, origin, int(samples["t_ns"][0]), settings.gnss, warn, left_out)


def _sources(named: list[str], estimator: "Estimator") -> "list[tuple[AidingSource, Path]]":
    """The sources and files of `--aiding SOURCE=CSV`. Raises UsageError."""
    known = {source.name: source for source in estimator.sources}
    found = []
    for text in named:
        name, equals, path = text.partition("=")
        if not equals or name not in known:
            there_are = ", ".join(known) or "none"
            raise UsageError(f"--aiding {text}: it must be SOURCE=CSV; sources of {estimator.name}: {there_are}")
        found.append((known[name], input_file(path)))
    return found


def _read_aiding(sources: "list[tuple[AidingSource, Path]]", origin: int) -> "Iterator[Records]":
    """Measurements of each source."""
    from ..tables.inputs import SkippedRows, read_aiding

    return (read_aiding(source, path, origin, SkippedRows(path)) for source, path in sources)


def _readings(
    path: Path | None, origin: int, samples: "Records", settings: Settings, estimator: "Estimator"
) -> "Iterator[Records]":
    """Measurements in a receiver's log, if that is one of NMEA sentences."""
    from ..tables.lines import is_nmea

    if path is not None and estimator.sources and is_nmea(path):
        from ..tables.nmea_readings import readings_of_log

        yield readings_of_log(path, origin, int(samples["t_ns"][0]), settings, estimator.sources)


def _unit_warnings(samples: "Records") -> Iterator[str]:
    """Warnings of values that are probably in other units."""
    period_s = float(np.median(np.diff(samples["t_ns"]))) * 1e-9
    forces = samples["f"][:: max(1, len(samples) // _CHECKED_SAMPLES)]
    force, down = float(np.median(np.linalg.norm(forces, axis=1))), -float(np.median(forces[:, 2]))
    if period_s > _PERIOD_MAX_S:
        yield f"the samples are {period_s:g} s apart: is t_s in s?"
    if not _FORCE_MPS2[0] < force < _FORCE_MPS2[1]:
        yield f"the specific force is mostly {force:.3g} m/s^2, where gravity alone gives 9.8: is it in m/s^2?"
    elif down < -_FORCE_MPS2[0]:
        yield "the sensor is upside down; if it is not, its axes are others: --set imu.mount_rpy_deg=[180,0,0] for FLU"


def _summary(samples: "Records", fixes: "Records", fed: int, skipped: int, seconds: float) -> None:
    """Print the warnings and, on a terminal, the number of samples and the speed."""
    span = float(samples["t_ns"][-1] - samples["t_ns"][0]) * 1e-9
    if sys.stderr.isatty():
        speed = span / max(seconds, 1e-9)
        print(
            f"imud replay: {len(samples)} samples of {span:.1f} s in {seconds:.2f} s ({speed:.0f} x real time), "
            f"{fed} of {len(fixes)} fixes",
            file=sys.stderr,
        )
    for warning in _unit_warnings(samples):
        print(f"imud replay: {warning}", file=sys.stderr)
    if skipped:
        print(f"imud replay: {skipped} samples skipped: their time did not advance", file=sys.stderr)
    if len(fixes) and not fed:
        begin, end = (float(fixes["t_ns"][i] - samples["t_ns"][0]) * 1e-9 for i in (0, -1))
        raise BadDataError(
            f"no fix lies within the time of the samples: these last {span:.0f} s, the fixes are from {begin:+.0f} to "
            f"{end:+.0f} s after their beginning; are both files on the same clock (NMEA: t_s in UTC)?"
        )
