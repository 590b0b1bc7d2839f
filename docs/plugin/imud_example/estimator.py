"""The plainest estimator: it integrates the rates, from a level start, and says how little it knows."""

import math

import numpy as np

from imud.compile.jit import kernel
from imud.estimators import Estimator
from imud.estimators.blank_solution import blank
from imud.estimators.records import ATTITUDE_VALID
from imud.math.rotation import quat_exp, quat_normalised, quat_product

PARAMETERS = np.dtype([("drift", "<f8")], align=True)  # rad/s: what its sigma grows by
STATE = np.dtype([("samples", "<i8"), ("t_ns", "<i8"), ("q", "<f8", (4,)), ("sigma", "<f8")], align=True)
START_SIGMA, DRIFT = math.radians(10.0), math.radians(0.1)


def configure(settings, rate_hz):
    """Parameters (array of one `PARAMETERS`)."""
    p = np.zeros(1, PARAMETERS)
    p["drift"] = DRIFT
    return p


def start(parameters, initial):
    """A state (array of one `STATE`)."""
    s = np.zeros(1, STATE)
    s["q"] = (1.0, 0.0, 0.0, 0.0)
    s["sigma"] = START_SIGMA
    return s


@kernel
def step(p, s, sample, solution):
    """One sample in, one solution out."""
    blank(solution, sample.t_ns, sample)
    if s.samples > 0:
        T = (sample.t_ns - s.t_ns) * 1e-9
        turn = quat_exp(sample.w[0] * T, sample.w[1] * T, sample.w[2] * T)
        s.q[0], s.q[1], s.q[2], s.q[3] = quat_normalised(quat_product((s.q[0], s.q[1], s.q[2], s.q[3]), turn))
        s.sigma += p.drift * T
    s.samples += 1
    s.t_ns = sample.t_ns
    solution.status |= ATTITUDE_VALID
    for i in range(4):
        solution.q_nb[i] = s.q[i]
    for i in range(3):
        solution.sigma_rpy[i] = s.sigma


ESTIMATOR = Estimator("strapdown", configure, start, step, update=None)
