"""The fixes of a file, a table or a log of NMEA sentences."""

from collections.abc import Callable
from pathlib import Path

from ..configuration.settings import Gnss
from ..math.arrays import Records
from ..sensors.fix_consistency import consistent
from .inputs import SkippedRows, read_fixes
from .lines import is_nmea
from .nmea_log import fixes_of_log
from .refused import without_refused


def fixes_of_file(
    path: Path,
    origin: float,
    first_ns: int,
    settings: Gnss,
    warn: Callable[[str], object],
    left_out: SkippedRows | None = None,
) -> Records:
    """The fixes (array of FIX) that the settings allow, in order of arrival; first_ns: of the samples, after `origin`.

    Raises BadDataError if there is none, InputMissingError.
    """
    if is_nmea(path):
        return consistent(fixes_of_log(path, origin, first_ns, settings, warn), warn)
    return consistent(without_refused(path, read_fixes(path, origin, left_out), settings, warn), warn)
