"""What other sensors say in a receiver's log of NMEA sentences, as measurements: headings, speeds, air pressures.

A log holds no arrival times, and such sentences no time of their own. One in the burst of a fix has its time; of
several between two fixes the first has the time of the earlier fix, and the others follow at equal intervals.
"""

import itertools
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from imud.drivers.fix import Fix, Reading
from imud.drivers.nmea.readings import READERS

from ..configuration.settings import Settings
from ..estimators.aiding_source import AidingSource, ImpossibleValueError
from ..estimators.records import MEASUREMENT
from ..math.arrays import Records
from ..sensors.aiding import NamedMeasurement
from ..sensors.nmea_aiding import measured_of
from .lines import log_lines
from .nmea_log import DAY_S, read_log

_KINDS = re.compile(rb"(" + b"|".join(kind.encode() for kind in READERS) + rb"),")
_FARTHEST_S = 10.0  # between fixes: what lies between two farther apart has no time


def readings_of_log(
    path: Path,
    origin: float,
    first_ns: int,
    settings: Settings,
    sources: Iterable[AidingSource],
    warn: Callable[[str], object],
) -> Records:
    """Measurements (array of MEASUREMENT) of these sources, in order of arrival, placed as `fixes_of_log` places fixes.

    warn: is called with what is left out for its impossible values. Raises InputMissingError.
    """
    rows, refused = [np.zeros(0, MEASUREMENT)], defaultdict[str, list[str]](list)
    if any(map(_KINDS.search, log_lines(path))):
        fixes, readings, _ = read_log(path, settings.gnss)
        known = tuple(sources)
        for reading, utc_s in timed(fixes, readings):
            if (measured := measured_of(reading, settings.gnss, settings.aiding)) is None:
                continue
            day = round((origin + first_ns * 1e-9 - utc_s) / DAY_S)
            t_ns = round((utc_s + day * DAY_S - origin) * 1e9)
            arrival_ns = t_ns + round(settings.gnss.latency_s * 1e9)
            try:
                row = NamedMeasurement(*measured, t_ns, arrival_ns).row(known)
            except ImpossibleValueError as error:
                refused[measured[0]].append(str(error))
                continue
            if row is not None:
                rows.append(row)
    for source, reasons in refused.items():
        warn(f"{len(reasons)} readings for {source} are not used; the first: {reasons[0]}")
    found = np.concatenate(rows)
    return found[np.argsort(found["arrival_ns"], kind="stable")]


def timed(fixes: Sequence[Fix], readings: Iterable[Reading]) -> Iterable[tuple[Reading, float]]:
    """Readings and their times, s of the UTC day; those whose time cannot be known are left out."""
    epochs = [fix.utc_s for fix in fixes if fix.utc_s is not None]
    interval_s = {before: (after - before) % DAY_S for before, after in itertools.pairwise(epochs)}
    alike: dict[tuple[str, float], list[Reading]] = {}
    for reading in readings:
        if reading.utc_s is not None:
            alike.setdefault((reading.source, reading.utc_s), []).append(reading)
    for (_, utc_s), group in alike.items():
        step_s = interval_s.get(utc_s, _FARTHEST_S) / len(group)
        for k, reading in enumerate(group if step_s * len(group) < _FARTHEST_S else group[:1]):
            yield reading, utc_s + k * step_s
