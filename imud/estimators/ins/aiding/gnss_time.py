"""How far the epochs of fixes are believed: that depends on who states them, and on what the fixes themselves show.

A survey states its epochs to the sample, but a log may be off by some tenths of a second throughout, and a filter that
were sure of it would turn its heading instead. So the latency is first estimated, as of any receiver. Once a mistake of
that size is ruled out, the survey is right, and what is left is the inertial sensor's own delay.
"""

from typing import Any

from ....compile.jit import kernel
from ..ekf import clear_time_offset, decorrelate, standard_deviation
from ..state import TIME_OFFSET

TIME_TAG_TOLERANCE_S, REPORTED_EPOCH_SIGMA = 1e-3, 0.07  # s
SURVEY_SIGMA, SURVEY_EPOCH_SIGMA, CONFIRMED_EPOCH_SIGMA = (
    0.1,
    0.1,
    2e-4,
)  # m, s, s: of a survey's epochs, before and after that
EPOCH_MISTAKE_S = 0.05  # half of the step in which receivers and logs count epochs


@kernel
def set_initial_time_offset(p: Any, c: Any, fix: Any, sigma: float) -> None:
    """At the first fix (sigma m): is its epoch the receiver's, or only its arrival, less the latency that is assumed?

    A survey's log that states no arrival states the epoch.
    """
    delay = 1e-9 * (fix.arrival_ns - fix.t_ns)
    c.integrity.survey_epochs = 1 if abs(delay) <= TIME_TAG_TOLERANCE_S and sigma < SURVEY_SIGMA else 0
    if c.integrity.survey_epochs != 0:
        decorrelate(c, TIME_OFFSET, SURVEY_EPOCH_SIGMA**2)
    elif delay > TIME_TAG_TOLERANCE_S and abs(delay - p.assumed_latency) > TIME_TAG_TOLERANCE_S:
        decorrelate(c, TIME_OFFSET, REPORTED_EPOCH_SIGMA**2)


@kernel
def confirm_survey_epochs(c: Any) -> None:
    """After a fix: a survey's epochs are believed to the sample once the motion has shown that they are right."""
    late, most = abs(c.nav.time_offset), 3.0 * standard_deviation(c, TIME_OFFSET)
    if c.integrity.survey_epochs != 0 and late + most < EPOCH_MISTAKE_S and late < most:
        clear_time_offset(c, CONFIRMED_EPOCH_SIGMA**2)
        c.integrity.survey_epochs = 0
