"""`imud export`: a recording as CSV or Parquet files, for ROS 2, or as tracks for maps.

It is replayed: every sample counts.
"""

import argparse
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from ...configuration.settings import Initial
from ...errors import BadDataError, UsageError
from ...progress import Progress
from ..arguments import above_zero
from ..files import refuse_overwriting
from .csv_folder import CsvFolder
from .parquet_folder import ParquetFolder
from .track_files import TrackFiles

if TYPE_CHECKING:
    from ...math.arrays import Records
    from ...smoothing import Segments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, nargs="+", metavar="MCAP", help="the files of one recording")
    parser.add_argument("--csv", type=Path, metavar="DIR", help="imu.csv, gnss.csv, est.csv, … of it")
    parser.add_argument("--parquet", type=Path, metavar="DIR", help="the same as Parquet files")
    parser.add_argument("--ros2", type=Path, metavar="MCAP", help="the messages of `imud ros2`, in ENU and FLU")
    parser.add_argument("--smooth", action="store_true", help="a track more: from the data before and after each point")
    for name in FORMATS:
        parser.add_argument(f"--{name}", type=Path, metavar="FILE", help="tracks of the estimates and of the receiver")
    parser.add_argument(
        "--rate", type=above_zero, default=0.0, metavar="HZ", help="of the estimates (default: all; tracks: 1)"
    )


FORMATS = ("gpx", "kml", "geojson")  # of tracks


class Target(Protocol):
    """An output of the export. fixes: how many were written."""

    fixes: int

    def step(self, samples: "Records", solutions: "Records") -> None: ...
    def write_fix(self, fix: "Records") -> None: ...


def _smoother(targets: "list[Target]", tracks: dict[str, Path]) -> "Segments":
    """What smooths, for the tracks among the targets. Raises UsageError if none is asked for."""
    from ...smoothing import Segments

    if not tracks:
        raise UsageError("export: --smooth is for --gpx, --kml and --geojson; of tables: imud replay --smooth")

    def write(solutions: "Records") -> None:
        for target in targets:
            if isinstance(target, TrackFiles):
                target.write_smoothed(solutions)

    return Segments(write)


def run(args: argparse.Namespace) -> int:
    tracks = {name: path for name in FORMATS if (path := getattr(args, name))}
    if not (args.csv or args.parquet or args.ros2 or tracks):
        raise UsageError(
            "export: name an output: --csv DIR, --parquet DIR, --ros2 OUT.mcap, --gpx, --kml or --geojson FILE"
        )
    refuse_overwriting([args.ros2, *tracks.values()], args.recording)
    from ...recording.player import Player, ignore
    from ...recording.source import Recording, adapter, print_notes
    from ...tables.filter_states import FilterStates

    recording = Recording(args.recording)
    adapt = adapter(None, (), None)
    settings, progress = recording.settings(adapt), Progress(1000)
    targets: list[Target] = []
    folders: list[CsvFolder | ParquetFolder] = []
    states = FilterStates()
    smoother = _smoother(targets, tracks) if args.smooth else None

    def step(samples: "Records", solutions: "Records") -> None:
        if smoother is not None:
            smoother.step(player.filter, samples, solutions)
        for target in targets:
            target.step(samples, solutions)
        if folders:
            states.take(player.filter, int(solutions[-1]["t_ns"]))

    def write_fix(fix: "Records") -> None:
        for target in targets:
            target.write_fix(fix)

    def write_measurement(measurement: "Records", innovations: "Records") -> None:
        if smoother is not None:
            smoother.take_measurement(measurement, innovations)
        source = next(each for each in player.filter.estimator.sources if each.kind == measurement[0]["kind"])
        for folder in folders:
            folder.write_measurement(source, measurement)

    on_update = smoother.take_fix if smoother else ignore
    player = Player(
        settings, adapt, Initial(), step, on_update, recording.notes.append, on_fix=write_fix, on_aid=write_measurement
    )
    with ExitStack() as stack:
        offset_ns = recording.unix_less_monotonic_ns
        if args.csv:
            folders.append(CsvFolder(args.csv, args.rate, stack))
        if args.parquet:
            folders.append(ParquetFolder(args.parquet, args.rate, stack))
        targets += folders
        if args.ros2:
            from ...ros2.bag import Bag

            targets.append(Bag(args.ros2, args.rate, offset_ns, player, settings.navigation.lever_arm_m, stack))
        if tracks:
            targets.append(TrackFiles(tracks, args.rate, offset_ns, stack))
        for entry in recording.entries(Player.TOPICS):
            player.take(entry)
            progress.at(1000 * recording.read_bytes // max(recording.bytes, 1))
        for folder in folders:
            folder.write_states(states.rows)
        progress.at(1000)
        if smoother is not None:
            smoother.finish()
    if not player.samples:
        problem = f"{recording.path}: no samples of an inertial sensor in it"
        if not any(target.fixes for target in targets):
            raise BadDataError("; ".join([problem, *recording.notes]))
        recording.notes.append(f"{problem}: there are fixes only")
    print_notes("export", recording.notes)
    return 0
