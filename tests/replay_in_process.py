"""Samples and fixes through everything that `imud replay --imu` runs: sensor monitor, calibration, estimator.

Every figure of accuracy comes this way, so that it is the figure that users get.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imud.batch import NO_MEASUREMENT, play, rate_hz_of
from imud.configuration.settings import Initial, Settings
from imud.estimators import registry
from imud.estimators.ins.state import STATES
from imud.estimators.records import FIX, INNOVATION
from imud.math.kalman import unpack
from imud.pipeline import Filter
from imud.smoothing import play_smoothed

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Records = NDArray[np.void]

NO_FIXES = np.zeros(0, FIX)


def new_filter(estimator: str, samples: Records, settings: Settings | None = None, initial: Initial | None = None):
    """The filter that `imud replay` makes for these samples."""
    return Filter(registry.by_name(estimator), settings or Settings(), initial or Initial(), rate_hz_of(samples))


def replay(
    filter_: Filter, samples: Records, fixes: Records = NO_FIXES, aiding: Records = NO_MEASUREMENT
) -> tuple[Records, Records]:
    """(solutions of all samples, innovations); all goes in when it arrives. `samples` stay as they are.

    aiding: array of MEASUREMENT, in order of arrival.
    """
    solutions: list[Records] = []
    innovations: list[Records] = [np.zeros(0, INNOVATION)]
    order = np.argsort(fixes["arrival_ns"], kind="stable")
    play(
        filter_,
        samples.copy(),
        fixes[order],
        lambda rows: solutions.append(rows.copy()),
        on_innovations=innovations.append,
        aiding=aiding,
    )
    out = np.concatenate(solutions)
    check_variances(filter_, out)
    return out, np.concatenate(innovations)


def check_variances(filter_: Filter, out: Records) -> None:
    """None has become negative or not a number, in the solutions or in the INS's covariance."""
    for name, of in (("sigma_p", "lat"), ("sigma_v", "lat"), ("sigma_rpy", "t_ns")):
        known = np.isfinite(out[of])
        assert (out[name][known] >= 0.0).all(), f"{name} is negative or no number"
    if "core" in (filter_.state.dtype.names or ()):
        variances = np.diag(unpack(filter_.state["core"][0, 0]["cov"]["P"], STATES))
        assert (variances >= 0.0).all(), f"variances are {variances[~(variances >= 0.0)]}"


def smoothed_solutions(filter_: Filter, samples: Records, fixes: Records = NO_FIXES) -> Records:
    """Those of `imud replay --smooth`. `samples` stay as they are."""
    rows: list[Records] = []
    order = np.argsort(fixes["arrival_ns"], kind="stable")
    play_smoothed(filter_, samples.copy(), fixes[order], lambda block: rows.append(block.copy()))
    return np.concatenate(rows)
