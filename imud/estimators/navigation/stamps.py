"""How far the epochs of fixes are believed: that depends on who states them, and on what the fixes themselves show.

A survey states its epochs to the sample, but a log may be off by some tenths of a second throughout, and a filter that
were sure of it would turn its heading instead. So the latency is first estimated, as of any receiver. Once a mistake of
that size is ruled out, the survey is right, and what is left is the inertial sensor's own delay.
"""

from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import reset
from .covariance import deviation
from .state import LATENCY, STATES

STAMP_S, STATED_SIGMA = 1e-3, 0.07  # s
CENTIMETRES, LOGGED_SIGMA, CONFIRMED_SIGMA = 0.1, 0.1, 2e-4  # m, s, s: of a survey's epochs, before and after that
MISTAKE_S = 0.05  # half of the step in which receivers and logs count epochs


@kernel
def trust_stamp(p: Any, c: Any, fix: Any, sigma: float) -> None:
    """At the first fix (sigma m): is its epoch the receiver's, or only its arrival, less the latency that is assumed?

    A survey's log that states no arrival states the epoch.
    """
    delay = 1e-9 * (fix.arrival_ns - fix.t_ns)
    c.surveyed = 1 if abs(delay) <= STAMP_S and sigma < CENTIMETRES else 0
    if c.surveyed != 0:
        reset(c.P, STATES, LATENCY, LOGGED_SIGMA**2)
    elif delay > STAMP_S and abs(delay - p.latency) > STAMP_S:
        reset(c.P, STATES, LATENCY, STATED_SIGMA**2)


@kernel
def confirm_stamp(c: Any) -> None:
    """After a fix: a survey's epochs are believed to the sample once the motion has shown that they are right."""
    late, most = abs(c.latency), 3.0 * deviation(c, LATENCY)
    if c.surveyed != 0 and late + most < MISTAKE_S and late < most:
        c.latency = 0.0
        reset(c.P, STATES, LATENCY, CONFIRMED_SIGMA**2)
        c.surveyed = 0
