"""Samples whose values are probably in other units or axes than those of a table of samples."""

import math
from collections.abc import Iterator

import numpy as np

from ..math.arrays import Records

_PERIOD_MAX_S, _FORCE_MPS2 = 0.2, (4.0, 25.0)
_RATE_RADPS = 6.0  # one sample in ten is faster in what spins, and in a table of degrees of a car that turns
_CHECKED_SAMPLES = 10_000  # of the specific force and the rates


def unit_warnings(samples: Records, other_axes: str) -> Iterator[str]:
    """Sentences about samples (array of SAMPLE). other_axes: how a user says which axes the sensor has."""
    period_s = float(np.median(np.diff(samples["t_ns"]))) * 1e-9
    checked = samples[:: max(1, len(samples) // _CHECKED_SAMPLES)]
    forces, rate = checked["f"], float(np.quantile(np.linalg.norm(checked["w"], axis=1), 0.9))
    force, down = float(np.median(np.linalg.norm(forces, axis=1))), -float(np.median(forces[:, 2]))
    for name, values in (("gyro", samples["w"]), ("accelerometer", samples["f"])):
        constant = np.ptp(values, axis=0) == 0.0
        if 0 < constant.sum() < 3:
            still = ", ".join(axis for axis, is_constant in zip("xyz", constant, strict=True) if is_constant)
            yield f"{name} {still} never changes, as an axis that was not recorded: the estimates may be wrong"
    if period_s > _PERIOD_MAX_S:
        yield f"the samples are {period_s:g} s apart: is their time in s?"
    if rate > _RATE_RADPS:
        yield f"one sample in ten turns faster than {rate:.3g} rad/s, {math.degrees(rate):.0f} deg/s: is it in rad/s?"
    if not _FORCE_MPS2[0] < force < _FORCE_MPS2[1]:
        yield f"the specific force is mostly {force:.3g} m/s^2, gravity alone gives 9.8: is it in m/s^2, with gravity?"
    elif down < -_FORCE_MPS2[0]:
        yield f"the sensor is upside down; if it is not, its axes are others: {other_axes}"
