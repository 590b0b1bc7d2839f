"""A receiver's log of NMEA sentences: its fixes, placed in time near the samples of an inertial sensor, and what other
sensors say between them.
"""

import itertools
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from imud.drivers.driver import ReadingDecoder
from imud.drivers.fix import Fix, Reading
from imud.drivers.registry import by_name

from ..configuration.settings import Gnss
from ..errors import BadDataError
from ..math.arrays import Records
from ..sensors.gnss import record, refusal
from .lines import log_lines
from .refused import warn_of_refused

DAY_S = 86_400.0


def _instead(counters: Mapping[str, int]) -> str:
    """What a log without fixes has."""
    seen = "".join(f"; {count} x {what}" for what, count in counters.items())
    hint = ": accept them with --set gnss.require_checksum=false" if "no checksum" in counters else ""
    return seen + hint


def read_log(path: Path, settings: Gnss) -> tuple[list[Fix], list[Reading], Mapping[str, int]]:
    """Fixes and readings of an NMEA log in its order, and what its decoder counted. Arrivals are numbers of lines."""
    driver = by_name("nmea")
    assert driver.kind == "gnss"
    decoder = driver.new_decoder(not settings.require_checksum)
    fixes: list[Fix] = []
    for number, line in enumerate(itertools.chain(log_lines(path), [b"$"])):  # the last line may lack its end
        fixes += decoder.feed(line, number)
    fixes += decoder.flush(1 << 62)
    return fixes, decoder.take_readings() if isinstance(decoder, ReadingDecoder) else [], decoder.counters


def fixes_of_log(
    path: Path, origin: float, first_ns: int, settings: Gnss, warn: Callable[[str], object] = lambda _: None
) -> Records:
    """The fixes of an NMEA log, placed by their UTC time of day near the samples that start `first_ns` after `origin`.

    A log holds no arrival times: each fix is known `latency_s` after its epoch. warn: called if the settings refuse
    some. Raises BadDataError without any fix, or if the settings refuse all.
    """
    fixes, _, counters = read_log(path, settings)
    if not fixes:
        raise BadDataError(f"{path}: no fix in it{_instead(counters)}")
    start_s = origin + first_ns * 1e-9
    rows = []
    day = None
    refused: Counter[str] = Counter()
    for fix in fixes:
        if (why := refusal(fix, settings)) or fix.utc_s is None:
            refused[str(why)] += 1
            continue
        near = start_s if day is None else rows[-1]["t_ns"][0] * 1e-9 + origin
        day = round((near - fix.utc_s) / DAY_S)
        t_ns = round((fix.utc_s + day * DAY_S - origin) * 1e9)
        rows.append(record(fix, t_ns, t_ns + round(settings.latency_s * 1e9)))
    warn_of_refused(path, refused, len(fixes), warn)
    return np.concatenate(rows)
