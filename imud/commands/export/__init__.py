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
    from ...recording.source import Recording
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


class _Export:
    """Plays a recording into the outputs that the user asked for."""

    def __init__(self, recording: "Recording", smoothed: bool) -> None:
        from ...recording.player import Handlers, Player, ignore
        from ...recording.source import adapter
        from ...tables.filter_states import FilterStates

        self._recording = recording
        self._targets: list[Target] = []
        self._folders: list[CsvFolder | ParquetFolder] = []  # the targets that have the filter's states, too
        self._states = FilterStates()
        self._smoother = _smoother(self._targets) if smoothed else None
        on_update = self._smoother.take_fix if self._smoother else ignore
        adapt = adapter(None, (), None)
        self._settings = recording.settings(adapt)
        handlers = Handlers(self._step, on_update, self._write_fix, self._write_measurement, recording.notes.append)
        self._player = Player(self._settings, adapt, Initial(), handlers)

    def _step(self, samples: "Records", solutions: "Records") -> None:
        if self._smoother is not None:
            self._smoother.step(self._player.filter, samples, solutions)
        for target in self._targets:
            target.step(samples, solutions)
        if self._folders:
            self._states.take(self._player.filter, int(solutions[-1]["t_ns"]))

    def _write_fix(self, fix: "Records") -> None:
        for target in self._targets:
            target.write_fix(fix)

    def _write_measurement(self, measurement: "Records", innovations: "Records") -> None:
        if self._smoother is not None:
            self._smoother.take_measurement(measurement, innovations)
        sources = self._player.filter.estimator.sources
        source = next(each for each in sources if each.kind == measurement[0]["kind"])
        for folder in self._folders:
            folder.write_measurement(source, measurement)

    def open(self, args: argparse.Namespace, tracks: dict[str, Path], stack: ExitStack) -> None:
        """Create the outputs."""
        offset_ns = self._recording.unix_less_monotonic_ns
        if args.csv:
            self._folders.append(CsvFolder(args.csv, args.rate, stack))
        if args.parquet:
            self._folders.append(ParquetFolder(args.parquet, args.rate, stack))
        self._targets += self._folders
        if args.ros2:
            from ...ros2.bag import Bag

            lever_arm_m = self._settings.navigation.lever_arm
            self._targets.append(Bag(args.ros2, args.rate, offset_ns, self._player, lever_arm_m, stack))
        if tracks:
            self._targets.append(TrackFiles(tracks, args.rate, offset_ns, stack))

    def play(self) -> None:
        """Write all of the recording. Raises BadDataError."""
        recording, progress = self._recording, Progress(1000)
        for entry in recording.entries(self._player.TOPICS):
            self._player.take(entry)
            progress.at(1000 * recording.read_bytes // max(recording.bytes, 1))
        for folder in self._folders:
            folder.write_states(self._states.rows)
        progress.at(1000)
        if self._smoother is not None:
            self._smoother.finish()

    def check(self) -> None:
        """Note that there were no samples. Raises BadDataError if there were no fixes, either."""
        if self._player.samples:
            return
        notes = self._recording.notes
        problem = f"{self._recording.path}: no samples of an inertial sensor in it"
        if not any(target.fixes for target in self._targets):
            raise BadDataError("; ".join([problem, *notes]))
        notes.append(f"{problem}: there are fixes only")


def _smoother(targets: "list[Target]") -> "Segments":
    """What smooths, for the tracks among the targets."""
    from ...smoothing import Segments

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
    if args.smooth and not tracks:
        raise UsageError("export: --smooth is for --gpx, --kml and --geojson; of tables: imud replay --smooth")
    refuse_overwriting([args.ros2, *tracks.values()], args.recording)
    from ...recording.source import Recording, print_notes

    recording = Recording(args.recording)
    export = _Export(recording, args.smooth)
    with ExitStack() as stack:
        export.open(args, tracks, stack)
        export.play()
    export.check()
    print_notes("export", recording.notes)
    return 0
