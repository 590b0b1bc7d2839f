"""Rows of a recording that show how an inertial sensor's counter fits the host's time, and what its line lost."""

from typing import TYPE_CHECKING

import numpy as np

from ..math.arrays import Records

if TYPE_CHECKING:
    from ..sensors.inertial import Inertial

CLOCK_FIT = np.dtype(
    [
        ("t_ns", "<i8"),
        ("port", "<i8"),
        ("drift", "<f8"),
        ("sigma_drift", "<f8"),
        ("residual", "<f8"),
        ("late", "<f8"),
        ("latest", "<f8"),
        ("corrections", "<i8"),
        *((name, "<i8") for name in ("frames", "junk", "bad", "lost", "errors")),
    ]
)


def row_of(inertial: "Inertial", port: int, t_ns: int) -> Records:
    """An array of one CLOCK_FIT; unknown is NaN."""
    fit, clock, counted = inertial.clock_fit(), inertial.pipeline.clock[0], inertial.counters()
    row = np.zeros(1, CLOCK_FIT)
    row["t_ns"], row["port"] = t_ns, port
    row["drift"], row["sigma_drift"], row["residual"] = fit.drift, fit.sigma_drift, fit.residual_s
    row["late"], row["latest"] = 1e-9 * clock["late_ns"], 1e-9 * clock["latest_ns"]
    for name in ("frames", "junk", "bad", "lost", "errors"):
        row[name] = counted[name]
    row["corrections"] = clock["corrections"]
    return row
