"""Samples, fixes and measurements as they would be if time ran backward, so that a filter can run from end to start.

Positions, attitudes and specific forces stay, velocities, rates and gyro biases change their sign. The filter's earth
goes on turning forward, so two corrections make its equations of motion hold, with the earth's rate W and the velocity
v of the forward estimate:

    w' = -w + 2 W                         the filter subtracts W
    f' = f - 4 W x v                      it subtracts the Coriolis acceleration 2 W x v', with v' = -v

Both are in body axes. 0.2 deg of heading make an error of 0.05 deg/h in w', far less than a bias, which is estimated.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from imud.drivers.sample import POWER_ON, RECONNECTED

from ..estimators.aiding_source import AidingSource
from ..estimators.records import HEADING_VALID, NEW_RECEIVER, POSITION_VALID
from ..math.arrays import Records
from ..math.earth import EARTH_RATE_RADPS
from ..math.rotation_arrays import matrices

BLOCK = 65536  # rows
MAX_LATE_NS = 200_000_000  # velocities older than positions are newer backward: the filter needs the samples around


def reversed_samples(samples: Records, solutions: Records, of_interval: bool) -> Iterator[Records]:
    """Samples (SAMPLE, in body axes) in reverse order, in blocks; their times count from 0, the last one's.

    solutions: the forward estimates (SOLUTION), for the two corrections, which need position, velocity and heading.
    of_interval: the filter takes a reading for that of the interval which ends at its time. Backward that interval ends
    at the time of the sample before.
    """
    end_ns, last_tick = int(samples["t_ns"][-1]), int(samples["tick"][-1])
    after = 0  # flags of the sample after these
    for stop in range(len(samples), 0, -BLOCK):
        part = slice(max(stop - BLOCK, 0), stop)
        times = samples[["t_ns", "tick"]][part][::-1]
        readings = np.minimum(np.arange(part.start, part.stop) + of_interval, len(samples) - 1)
        rows, s = samples[readings][::-1].copy(), solutions[part][::-1]
        known = np.all([s["status"] & bit != 0 for bit in (POSITION_VALID, HEADING_VALID)], axis=0)[:, None]
        lat = np.where(known[:, 0], s["lat"], 0.0)
        earth = np.stack([np.cos(lat), np.zeros(len(lat)), -np.sin(lat)], axis=1) * EARTH_RATE_RADPS * known
        to_body = np.swapaxes(matrices(np.where(known, s["q_nb"], (1.0, 0.0, 0.0, 0.0))), 1, 2)
        coriolis = np.cross(earth, np.where(known, s["v"], 0.0))
        rows["t_ns"] = end_ns - times["t_ns"]
        rows["tick"] = last_tick - times["tick"]
        rows["w"] = 2.0 * np.einsum("nij,nj->ni", to_body, earth) - rows["w"]
        rows["f"] -= 4.0 * np.einsum("nij,nj->ni", to_body, coriolis)
        first = int(rows["flags"][-1])
        rows["flags"] = _seen_from_behind(rows["flags"], POWER_ON | RECONNECTED, after)
        after = first
        yield rows


def reversed_fixes(fixes: Records, end_ns: int, delay_s: float) -> Records:
    """Fixes (FIX) in reverse order, as late as they were, but at most MAX_LATE_NS. delay_s: by which they are older
    than their epochs say.
    """
    rows, late = fixes.copy(), np.minimum(fixes["arrival_ns"] - fixes["t_ns"], MAX_LATE_NS)
    rows["t_ns"] = end_ns - rows["t_ns"] + round(1e9 * delay_s)
    rows["v"] = -rows["v"]
    rows["course"] = np.mod(rows["course"] + math.pi, 2.0 * math.pi)
    rows["arrival_ns"] = rows["t_ns"] + late
    rows = _in_order(rows)
    rows["flags"] = _seen_from_behind(rows["flags"], NEW_RECEIVER)
    return rows


def reversed_measurements(measurements: Records, sources: Sequence[AidingSource], end_ns: int) -> Records:
    """Measurements (MEASUREMENT) of these aiding sources in reverse order, known at once."""
    rows = measurements.copy()
    rows["t_ns"] = end_ns - rows["t_ns"]
    for source in sources:
        rows["value"][rows["kind"] == source.kind] *= source.reversed_sign
    rows["arrival_ns"] = rows["t_ns"]
    return _in_order(rows)


def _seen_from_behind(flags: Any, marks: int, after: int = 0) -> Any:
    """Flags in reverse order. `marks` are on the first row behind an interruption: seen from behind, on the next one.

    after: flags of the row before these.
    """
    interrupted = flags & marks
    return flags - interrupted + np.append(after & marks, interrupted[:-1])


def _in_order(rows: Any) -> Records:
    ordered: Records = rows[np.argsort(rows["arrival_ns"], kind="stable")]
    return ordered
