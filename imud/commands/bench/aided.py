"""What measurements beside GNSS cost the navigation filter: each source, and all of them at once."""

from collections.abc import Callable

from ...batch import NO_MEASUREMENT, in_order_of_arrival, play
from ...configuration.settings import Initial, Settings
from ...estimators import registry
from ...estimators.records import MAGNETOMETER_SOURCE
from ...math.arrays import Records
from ...pipeline import Filter
from . import signals
from .table import Section
from .throughput import START_S, timed
from .turns import Turns

_LATE_NS = 100_000_000
_REWIND = "the samples since each epoch, here all of them, are integrated a second time"
_UPDATES = "a pose is four updates of 40 states, a velocity three, the others are one"
_TOGETHER = (
    "thirteen updates of 40 states ten times a second, and nearly all of them again, as fixes are late: each could "
    "cost little more than subtracting one outer product from P"
)


def aiding(seconds: int, rounds: int) -> Section:
    """The filter's speed with sources of 10 Hz, as a share of its speed without, in turns."""
    section = Section(f"Aligned navigation filter with sources of {signals.AIDING_HZ} Hz, {seconds} s at 1 kHz")
    known = [s for s in registry.by_name("navigation").sources if s.kind != MAGNETOMETER_SOURCE]  # off by default
    each = [signals.measurements(START_S + seconds, source.kind) for source in known]
    late = each[0].copy()
    late["arrival_ns"] += _LATE_NS
    together = in_order_of_arrival(each)
    turns = Turns(rounds, *(_replay(seconds, rows) for rows in (NO_MEASUREMENT, *each, late, together)))
    sample_s = turns.median(0) / (seconds * signals.RATE_HZ)
    measured = seconds * signals.AIDING_HZ  # of each source
    for i, source in enumerate(known, 1):
        cost = (turns.median(i) - turns.median(0)) / measured / sample_s
        note = f"one measurement costs as much as {cost:.0f} samples"
        speed = turns.ratio(0, i)
        section.add(f"speed with {source.name}, against without", speed, "x", least=0.9, note=note, reason=_UPDATES)
    speed = turns.ratio(0, len(known) + 1)
    section.add(f"with {known[0].name} that comes 0.1 s late", speed, "x", note=_REWIND)
    section.add(f"with all {len(known)} of them", turns.ratio(0, len(known) + 2), "x", least=0.9, reason=_TOGETHER)
    return section


def _replay(seconds: int, measurements: Records) -> Callable[[], float]:
    """Times what comes after the alignment, in which the filter without sources has less to do."""
    samples, fixes = signals.samples((START_S + seconds) * signals.RATE_HZ), signals.fixes(START_S + seconds)
    begun = START_S * signals.RATE_HZ
    begun_ns = samples["t_ns"][begun - 1]

    def run_once() -> float:
        filter_ = Filter(registry.by_name("navigation"), Settings(), Initial(), float(signals.RATE_HZ))
        play(filter_, samples[:begun].copy(), fixes, lambda rows: None, aiding=measurements)
        later = samples[begun:].copy()
        later_fixes, later_measurements = (rows[rows["arrival_ns"] > begun_ns] for rows in (fixes, measurements))
        return timed(lambda: play(filter_, later, later_fixes, lambda rows: None, aiding=later_measurements))

    return run_once
