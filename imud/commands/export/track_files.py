"""A recording as tracks for maps: GPX, KML, GeoJSON."""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import CannotCreateError

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import TextIO

    from ...math.arrays import Records
    from ...recording.tracks import Track

_TRACK_HZ = 1.0


class TrackFiles:
    """The files of the tracks, written at the end."""

    def __init__(self, paths: dict[str, Path], rate_hz: float, offset_ns: int, stack: ExitStack) -> None:
        from ...recording.thinner import Thinner
        from ...recording.tracks import WRITERS, Track

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
        from ...recording.tracks import point_of_solution

        for solution in self._thinner.kept(solutions):
            self._estimates.add(point_of_solution(solution, self._offset_ns))

    def write_smoothed(self, solutions: "Records") -> None:
        """Rows of SOLUTION."""
        from ...recording.tracks import point_of_solution

        for solution in self._thinner_of_smoothed.kept(solutions):
            self._smoothed.add(point_of_solution(solution, self._offset_ns))

    def write_fix(self, fix: "Records") -> None:
        """A FIX."""
        from ...recording.tracks import point_of_fix

        self.fixes += 1
        self._fixes.add(point_of_fix(fix[0], self._offset_ns))

    def _write(self, write: "Callable[[TextIO, list[Track]], None]", file: "TextIO") -> None:
        write(file, [track for track in (self._estimates, self._smoothed, self._fixes) if track.segments])
