"""Detects rest for calibrations, and rejects readings that no calibration can use: frozen, clipped, or not numbers."""

import math
from dataclasses import dataclass

import numpy as np

from ..math.arrays import Floats, Records

WINDOW_S = 0.5
_STILL = 3.0  # times the scatter of the tenth of the windows with the least scatter
_NOISE_DPS, _NOISE_MPS2 = 0.05, 0.02  # scatter of a sensor with much noise
_MOVING_DPS, _MOVING_MPS2 = 3.0, 0.7  # scatter that no sensor at rest has, only one in a hand
_REST_MIN_S = 2.0  # the shortest that counts
_SPIKES = 20  # readings beyond the end of the range that are no part of it


class UnfitError(Exception):
    """The recording does not suffice for the calibration; the message says why, and what to record instead."""


@dataclass(frozen=True)
class Interval:
    """A time at rest: its slice of the samples."""

    start: int
    stop: int


@dataclass(frozen=True)
class Estimate:
    """Values with their 1 sigma, same shape."""

    value: Floats
    sigma: Floats


def windows(values: Floats, m: int) -> Floats:
    """n x 3 cut into windows of m samples (k x m x 3)."""
    k = len(values) // m
    return values[: k * m].reshape(k, m, 3)


def refuse_broken(samples: Records) -> None:
    """Raises UnfitError if an axis never changes or the readings are not numbers."""
    for name, kind in (("w", "gyro"), ("f", "accelerometer")):
        values = samples[name]
        if not np.isfinite(values).all():
            raise UnfitError(f"the {kind} gives values that are no numbers")
        for axis, column in zip("xyz", values.T, strict=True):
            if (column == column[0]).all():
                raise UnfitError(f"the {kind}'s {axis} is frozen at {column[0]:g}: check the sensor first")
            edge = np.sort(np.abs(column))[-_SPIKES - 1 :][0]  # single spikes may be beyond it
            if (
                edge > 0.0
                and (np.abs(column) == edge).sum() > max(_SPIKES, 0.01 * len(column))
                and _is_flat(column, edge)
            ):
                raise UnfitError(f"the {kind}'s {axis} is at the end of its range ({edge:.4g})")


def _is_flat(column: Floats, edge: float) -> bool:
    """Whether values at the edge come in runs, as at a limit, and not now and then, as with a coarse resolution."""
    at = np.abs(column) == edge
    return bool((at[1:] & at[:-1]).sum() > 0.8 * at.sum() and at.sum() < 0.9 * len(column))


def rest_intervals(samples: Records, rate_hz: float) -> list[Interval]:
    """When the sensor was at rest, for two seconds or more. Raises UnfitError if never."""
    m = max(2, round(WINDOW_S * rate_hz))
    if len(samples) < 2 * m:
        raise UnfitError(f"{len(samples) / rate_hz:.1f} s are too short; record at least {_REST_MIN_S:.0f} s at rest")
    scatter_w = np.degrees(np.linalg.norm(windows(samples["w"], m).std(axis=1), axis=1))
    scatter_f = np.linalg.norm(windows(samples["f"], m).std(axis=1), axis=1)
    limit_w = min(_STILL * max(np.quantile(scatter_w, 0.1), _NOISE_DPS), _MOVING_DPS)
    limit_f = min(_STILL * max(np.quantile(scatter_f, 0.1), _NOISE_MPS2), _MOVING_MPS2)
    still = (scatter_w < limit_w) & (scatter_f < limit_f)
    force = windows(samples["f"], m).mean(axis=1)
    rate = np.degrees(windows(samples["w"], m).mean(axis=1))

    def moves(start: int, i: int) -> bool:
        """Evenly since that window, as in a bend, or with an acceleration that changes slowly."""
        turned, tilted = np.linalg.norm(rate[i] - rate[start]), np.linalg.norm(force[i] - force[start])
        return bool(turned > 3.0 * limit_w or tilted > limit_f)

    intervals, start = [], 0
    for i in range(1, len(still) + 1):
        if i == len(still) or not still[i] or not still[i - 1] or moves(start, i):
            if still[start] and (i - start) * m >= _REST_MIN_S * rate_hz:
                intervals.append(Interval(start * m, i * m))
            start = i
    if not intervals:
        raise UnfitError(f"the sensor was never at rest for {_REST_MIN_S:.0f} s: put it down and leave it alone")
    return intervals


def mean(values: Floats, m: int) -> Estimate:
    """Mean of n x 3 and its sigma, taken from the scatter of means over m samples: so slow noise counts, too."""
    means = windows(values, m).mean(axis=1)
    sigma = means.std(axis=0, ddof=1) / math.sqrt(len(means)) if len(means) > 1 else np.full(3, np.nan)
    return Estimate(values.mean(axis=0), sigma)
