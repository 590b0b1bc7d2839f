"""`imud export`: a recording as CSV files, for ROS 2, or as tracks for maps. It is replayed: every sample counts."""

import argparse
import math
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Protocol

import msgspec
import numpy as np

from ..configuration.settings import Initial
from ..errors import BadDataError, CannotCreateError, UsageError
from ..progress import Progress
from .arguments import above_zero
from .files import refuse_overwriting

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import TextIO

    from ..math.arrays import Floats, Records
    from ..recording.tracks import Track
    from ..smoothing import Segments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, nargs="+", metavar="MCAP", help="the files of one recording")
    parser.add_argument("--csv", type=Path, metavar="DIR", help="imu.csv, gnss.csv and est.csv")
    parser.add_argument("--ros2", type=Path, metavar="MCAP", help="the messages of `imud ros2`, in ENU and FLU")
    parser.add_argument("--smooth", action="store_true", help="a track more: from the data before and after each point")
    for name in FORMATS:
        parser.add_argument(f"--{name}", type=Path, metavar="FILE", help="tracks of the estimates and of the receiver")
    parser.add_argument(
        "--rate", type=above_zero, default=0.0, metavar="HZ", help="of the estimates (default: all; tracks: 1)"
    )


FORMATS = ("gpx", "kml", "geojson")  # of tracks
_TRACK_HZ = 1.0


class Target(Protocol):
    """An output of the export. fixes: how many were written."""

    fixes: int

    def step(self, samples: "Records", solutions: "Records") -> None: ...
    def write_fix(self, fix: "Records") -> None: ...


class CsvFolder:
    """imu.csv and gnss.csv as `imud replay` reads them, est.csv as it writes it; all on the same clock."""

    def __init__(self, folder: Path, rate_hz: float, stack: ExitStack) -> None:
        from ..recording.writer import Thinner
        from ..tables.estimates import EstimateWriter
        from ..tables.inputs import IMU_COLUMNS, TEMPERATURE

        try:
            folder.mkdir(exist_ok=True)
            files = {name: stack.enter_context((folder / f"{name}.csv").open("wb")) for name in ("imu", "gnss", "est")}
        except OSError as error:
            raise CannotCreateError(f"cannot write in {folder}: {error.strerror}") from error
        self._imu: BinaryIO = files["imu"]
        self._gnss: BinaryIO = files["gnss"]
        self._est = EstimateWriter(files["est"], 0, 256)
        self._thinner = Thinner(rate_hz)
        self.fixes = 0
        self._columns: tuple[str, ...] = (*IMU_COLUMNS, TEMPERATURE)
        self._begun = self._has_tilt = False
        self._gnss.write(f"{','.join(_FIX_COLUMNS)}\n".encode())
        stack.callback(self.close)

    def step(self, samples: "Records", solutions: "Records") -> None:
        """Rows of SAMPLE and SOLUTION."""
        if not self._begun:
            self._begin(bool(samples["down"].any()))
        tilt = [_tilt_deg(samples["down"])] if self._has_tilt else []
        cells = np.column_stack([samples["w"], samples["f"], samples["temperature"], *tilt])
        texts = msgspec.json.encode(cells.tolist())[2:-2].replace(b"null", b"").split(b"],[")  # NaN is null
        times = map(_seconds, samples["t_ns"].tolist())
        self._imu.write(b"".join(b"%s,%s\n" % (t.encode(), text) for t, text in zip(times, texts, strict=True)))
        self._est.write(self._thinner.kept(solutions))

    def _begin(self, has_tilt: bool) -> None:
        """The head of imu.csv, once it is known whether the device computes its own tilt."""
        from ..tables.inputs import DEVICE_TILT

        self._begun, self._has_tilt = True, has_tilt
        self._imu.write(f"{','.join((*self._columns, *(DEVICE_TILT if has_tilt else ())))}\n".encode())

    def close(self) -> None:
        """Also a table without a row has a head."""
        if not self._begun:
            self._begin(False)

    def write_fix(self, fix: "Records") -> None:
        """A FIX."""
        self.fixes += 1
        row = fix[0]
        cells: list[float | str] = [
            math.degrees(row["lat"]),
            math.degrees(row["lon"]),
            float(row["height"]),
            _seconds(row["arrival_ns"]),
        ]
        cells += [*row["sigma"].tolist(), float(row["hdop"]), *row["v"].tolist(), float(row["speed"])]
        cells += [math.degrees(row["course"]), int(row["quality"]), int(row["satellites"]), *row["sigma_v"].tolist()]
        self._gnss.write(_row(int(row["t_ns"]), cells))


_FIX_COLUMNS = (
    *("t_s", "lat_deg", "lon_deg", "height_m", "arrival_s", "sn_m", "se_m", "sd_m", "hdop"),
    *("vn_mps", "ve_mps", "vd_mps", "speed_mps", "course_deg", "quality", "satellites"),
    *("svn_mps", "sve_mps", "svd_mps"),
)


def _seconds(t_ns: int) -> str:
    return f"{int(t_ns) // 1_000_000_000}.{int(t_ns) % 1_000_000_000:09d}"


def _row(t_ns: int, cells: Iterable[float | str]) -> bytes:
    texts = ["" if cell != cell else str(cell) for cell in cells]  # noqa: PLR0124 - NaN is unknown, and left empty
    return f"{_seconds(t_ns)},{','.join(texts)}\n".encode()


def _tilt_deg(down: "Floats") -> "Floats":
    """Roll and pitch, (n, 2), of the verticals (n, 3); NaN where the device gives none."""
    tilt: Floats = np.degrees(
        np.column_stack([np.arctan2(down[:, 1], down[:, 2]), np.arctan2(-down[:, 0], np.hypot(down[:, 1], down[:, 2]))])
    )
    tilt[~down.any(axis=1)] = np.nan
    return tilt


class TrackFiles:
    """The files of the tracks, written at the end."""

    def __init__(self, paths: dict[str, Path], rate_hz: float, offset_ns: int, stack: ExitStack) -> None:
        from ..recording.tracks import WRITERS, Track
        from ..recording.writer import Thinner

        self._estimates = Track("imud", "the filter's estimates, each from what was known then")
        self._smoothed = Track("smoothed", "the estimates, each from the data before and after it")
        self._fixes = Track("receiver", "the receiver's fixes")
        self._thinner, self._thinner_of_smoothed = Thinner(rate_hz or _TRACK_HZ), Thinner(rate_hz or _TRACK_HZ)
        self._offset_ns = offset_ns
        self.fixes = 0
        for name, path in paths.items():
            try:
                file = stack.enter_context(path.open("w", encoding="utf-8"))
            except OSError as error:
                raise CannotCreateError(f"cannot write {path}: {error.strerror}") from error
            stack.callback(self._write, WRITERS[name], file)

    def step(self, samples: "Records", solutions: "Records") -> None:
        """Rows of SAMPLE and SOLUTION."""
        from ..recording.tracks import point_of_solution

        for solution in self._thinner.kept(solutions):
            self._estimates.add(point_of_solution(solution, self._offset_ns))

    def write_smoothed(self, solutions: "Records") -> None:
        """Rows of SOLUTION."""
        from ..recording.tracks import point_of_solution

        for solution in self._thinner_of_smoothed.kept(solutions):
            self._smoothed.add(point_of_solution(solution, self._offset_ns))

    def write_fix(self, fix: "Records") -> None:
        """A FIX."""
        from ..recording.tracks import point_of_fix

        self.fixes += 1
        self._fixes.add(point_of_fix(fix[0], self._offset_ns))

    def _write(self, write: "Callable[[TextIO, list[Track]], None]", file: "TextIO") -> None:
        write(file, [track for track in (self._estimates, self._smoothed, self._fixes) if track.segments])


def _smoother(targets: "list[Target]", tracks: dict[str, Path]) -> "Segments":
    """What smooths, for the tracks among the targets. Raises UsageError if none is asked for."""
    from ..smoothing import Segments

    if not tracks:
        raise UsageError("export: --smooth is for --gpx, --kml and --geojson; of tables: imud replay --smooth")

    def write(solutions: "Records") -> None:
        for target in targets:
            if isinstance(target, TrackFiles):
                target.write_smoothed(solutions)

    return Segments(write)


def run(args: argparse.Namespace) -> int:
    tracks = {name: path for name in FORMATS if (path := getattr(args, name))}
    if not (args.csv or args.ros2 or tracks):
        raise UsageError("export: name an output: --csv DIR, --ros2 OUT.mcap, --gpx, --kml or --geojson FILE")
    refuse_overwriting([args.ros2, *tracks.values()], args.recording)
    from ..recording.player import Player, ignore
    from ..recording.source import Recording, adapter, tell

    recording = Recording(args.recording)
    adapt = adapter(None, (), None)
    settings, progress = recording.settings(adapt), Progress(1000)
    targets: list[Target] = []
    smoother = _smoother(targets, tracks) if args.smooth else None

    def step(samples: "Records", solutions: "Records") -> None:
        if smoother is not None:
            smoother.step(player.filter, samples, solutions)
        for target in targets:
            target.step(samples, solutions)

    def write_fix(fix: "Records") -> None:
        for target in targets:
            target.write_fix(fix)

    on_update, on_aid = (smoother.take_fix, smoother.take_measurement) if smoother else (ignore, ignore)
    player = Player(
        settings, adapt, Initial(), step, on_update, recording.notes.append, on_fix=write_fix, on_aid=on_aid
    )
    with ExitStack() as stack:
        offset_ns = recording.unix_less_monotonic_ns
        if args.csv:
            targets.append(CsvFolder(args.csv, args.rate, stack))
        if args.ros2:
            from ..ros2.bag import Bag

            targets.append(Bag(args.ros2, args.rate, offset_ns, player, settings.navigation.lever_arm_m, stack))
        if tracks:
            targets.append(TrackFiles(tracks, args.rate, offset_ns, stack))
        for entry in recording.entries(Player.TOPICS):
            player.take(entry)
            progress.at(1000 * recording.read_bytes // max(recording.bytes, 1))
        if smoother is not None:
            smoother.finish()
    if not player.samples:
        problem = f"{recording.path}: no samples of an inertial sensor in it"
        if not any(target.fixes for target in targets):
            raise BadDataError("; ".join([problem, *recording.notes]))
        recording.notes.append(f"{problem}: there are fixes only")
    tell("export", recording.notes)
    return 0
