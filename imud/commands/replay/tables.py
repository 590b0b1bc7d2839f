"""`imud replay --imu CSV …`: tables of samples, fixes and other measurements through a filter."""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from ...batch import in_order_of_arrival, play, rate_hz_of
from ...configuration.settings import Settings
from ...errors import BadDataError, CannotCreateError, UsageError
from ...estimators import Estimator, registry
from ...estimators.aiding_source import AidingSource
from ...estimators.records import FIX, INNOVATION
from ...math.arrays import Records
from ...pipeline import Filter
from ...progress import Progress
from ...recording.thinner import Thinner
from ...sensor_errors import calibration
from ...sensor_monitor.findings import counted
from ...sensors.receiver import TOO_LATE_NS
from ...setup import config
from ...tables.clock_difference import warn_of_clocks
from ...tables.estimates import EstimateWriter, write_innovations
from ...tables.filter_states import FilterStates, write_states
from ...tables.fixes import fixes_of_file
from ...tables.inputs import SkippedRows, read_aiding, read_imu
from ...tables.lines import is_nmea
from ...tables.output import open_output
from ...tables.unit_check import unit_warnings
from ..files import input_file


def run(args: argparse.Namespace) -> int:
    settings = config.load(args.config, args.set)
    initial = config.initial_of(settings, args.initial)
    estimator = registry.by_name(_estimator_name(args, settings))
    left_out = SkippedRows(args.imu), SkippedRows(args.gnss)
    sources = _sources(args.aiding, estimator)
    samples, origin, skipped = read_imu(args.imu, left_out[0])
    gnss_origin = origin - (args.gnss_offset or 0.0)
    fixes = _read_gnss(args.gnss, gnss_origin, samples, settings, left_out[1])
    tables = (read_aiding(source, path, origin, SkippedRows(path)) for source, path in sources)
    aiding = in_order_of_arrival((*tables, *_readings(args.gnss, gnss_origin, samples, settings, estimator)))
    filter_ = Filter(estimator, settings, initial, rate_hz_of(samples))
    if args.calibration is not None:
        filter_.calibrate(calibration.read(args.calibration))
    begin = time.perf_counter()
    fed = _replay(args, origin, filter_, samples, fixes, aiding)
    _summary(samples, fixes, fed, skipped, time.perf_counter() - begin)
    for finding in counted(filter_.health):
        print(f"imud replay: {args.imu}: {finding}", file=sys.stderr)
    for finding in filter_.findings():
        print(f"imud replay: {finding}", file=sys.stderr)
    if args.gnss is not None and not len(fixes):
        print(f"imud replay: {args.gnss}: no fix in it", file=sys.stderr)
    elif len(fixes) and (late_ns := float(np.median(fixes["arrival_ns"] - fixes["t_ns"]))) > TOO_LATE_NS:
        late = f"its fixes arrive {late_ns * 1e-9:.1f} s after their t_s"
        print(f"imud replay: {args.gnss}: {late}: navigation uses none that is more than 2 s late", file=sys.stderr)
    if args.gnss is not None:
        warn_of_clocks(samples, fixes, _warning_of(args.gnss), partial(_clock_remedy, args.gnss_offset or 0.0))
    left_out[0].judge(len(samples))
    left_out[1].judge(len(fixes))
    return 0


def _replay(
    args: argparse.Namespace, origin: int, filter_: Filter, samples: Records, fixes: Records, aiding: Records
) -> int:
    """Write the files that are asked for; returns how many fixes the filter was given."""
    player = play
    if args.smooth:
        from ...smoothing import play_smoothed as player
    innovations: list[Records] = []
    states, thinner = FilterStates(), Thinner(args.rate or 0.0, int(samples["t_ns"][0]))
    with open_output(args.output) as file:
        writer = EstimateWriter(file, origin)
        fed = player(
            filter_,
            samples,
            fixes,
            lambda solutions: writer.write(thinner.kept(solutions)),
            on_innovations=innovations.append,
            aiding=aiding,
            on_progress=Progress(len(samples)).at,
            each_second=None if args.states is None else partial(states.take, filter_),
        )
    if args.innovations is not None:
        _write_innovations(args.innovations, origin, innovations)
    if args.states is not None:
        write_states(args.states, origin, states.rows)
    return fed


def _estimator_name(args: argparse.Namespace, settings: Settings) -> str:
    name = args.estimator or settings.estimator
    return ("navigation" if args.gnss else "attitude") if name == "auto" else name


def _write_innovations(path: Path, origin: int, innovations: list[Records]) -> None:
    try:
        write_innovations(path, origin, np.concatenate([np.zeros(0, INNOVATION), *innovations]))
    except OSError as error:
        raise CannotCreateError(f"cannot write {path}: {error.strerror}") from error


def _read_gnss(
    path: Path | None, origin: float, samples: Records, settings: Settings, left_out: SkippedRows
) -> Records:
    """origin: of the samples, by the clock of the fixes."""
    if path is None:
        return np.zeros(0, FIX)
    return fixes_of_file(path, origin, int(samples["t_ns"][0]), settings.gnss, _warning_of(path), left_out)


def _warning_of(path: Path) -> Callable[[str], None]:
    """What prints a problem of a file."""
    return lambda problem: print(f"imud replay: {path}: {problem}", file=sys.stderr)


def _clock_remedy(offset_s: float, behind_s: float) -> str:
    """What corrects times of fixes that are `behind_s` behind those of the samples with an offset of `offset_s`."""
    corrected = f"{offset_s + behind_s:.2f}".rstrip("0").rstrip(".")
    return f"--gnss-offset={corrected} corrects that"


def _sources(named: list[str], estimator: Estimator) -> list[tuple[AidingSource, Path]]:
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


def _readings(
    path: Path | None, origin: float, samples: Records, settings: Settings, estimator: Estimator
) -> Iterator[Records]:
    """Measurements in a receiver's log, if that is one of NMEA sentences."""
    if path is not None and estimator.sources and is_nmea(path):
        from ...tables.nmea_readings import readings_of_log

        yield readings_of_log(path, origin, int(samples["t_ns"][0]), settings, estimator.sources, _warning_of(path))


def _summary(samples: Records, fixes: Records, fed: int, skipped: int, seconds: float) -> None:
    """Print the warnings and, on a terminal, the number of samples and the speed."""
    span = float(samples["t_ns"][-1] - samples["t_ns"][0]) * 1e-9
    if sys.stderr.isatty():
        speed = span / max(seconds, 1e-9)
        print(
            f"imud replay: {len(samples)} samples of {span:.1f} s in {seconds:.2f} s ({speed:.0f} x real time), "
            f"{fed} of {len(fixes)} fixes",
            file=sys.stderr,
        )
    for warning in unit_warnings(samples, "--set imu.mount_rpy_deg=[180,0,0] for FLU"):
        print(f"imud replay: {warning}", file=sys.stderr)
    if skipped:
        print(f"imud replay: {skipped} samples skipped: their time did not advance", file=sys.stderr)
    if len(fixes) and not fed:
        begin, end = (float(fixes["t_ns"][i] - samples["t_ns"][0]) * 1e-9 for i in (0, -1))
        raise BadDataError(
            f"no fix lies within the time of the samples: these last {span:.0f} s, the fixes are from {begin:+.0f} to "
            f"{end:+.0f} s after their beginning; are both files on the same clock (NMEA: t_s in UTC)? "
            "--gnss-offset is added to the times of the fixes"
        )
