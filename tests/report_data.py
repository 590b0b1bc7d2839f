"""Innovations and samples for the tests of the report."""

import numpy as np

from imud.commands.report.session import Innovations
from imud.drivers.sample import SAMPLE

RNG_SEED = 5
WHITE = np.random.default_rng(RNG_SEED).normal(size=400)
WHITE = (WHITE - WHITE.mean()) / WHITE.std()


def innovations(z, used=None, sigma=2.0):
    used = np.ones(len(z), bool) if used is None else used
    return Innovations("run", "pn_m", np.arange(float(len(z))), sigma * z, np.full(len(z), sigma), used)


def still(n=4000, rate_hz=100.0):
    rng = np.random.default_rng(RNG_SEED)
    rows = np.zeros(n, SAMPLE)
    rows["t_ns"] = np.arange(n) * int(1e9 / rate_hz)
    rows["w"] = np.round(rng.normal(0.0, 1e-3, (n, 3)), 5)
    rows["f"] = np.round(np.array((0.0, 0.0, -9.81)) + rng.normal(0.0, 0.01, (n, 3)), 4)
    rows["temperature"] = np.nan
    return rows
