"""How far the epochs of fixes are believed: that depends on who states them, and on what the fixes themselves show.

A survey states its epochs to the sample, but a log may be off by some tenths of a second throughout, and a filter that
were sure of it would turn its heading instead. So the latency is first estimated, as of any receiver. Once a mistake of
that size is ruled out, the survey is right, and what is left is the inertial sensor's own delay.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import clear_time_offset, decorrelate, standard_deviation
from ..state import TIME_OFFSET

if TYPE_CHECKING:
    from ..types import Core, Fix, Parameters


TUNABLES = (
    Tunable("time_tag_tolerance_s", 1e-3, "s", "Two times closer than that are the same.", "Choice."),
    Tunable("reported_epoch_sigma", 0.07, "s", "Sigma of the epoch that a receiver reports.", "Recorded receivers."),
    Tunable("survey_sigma", 0.1, "m", "A position that good is a survey's.", "Choice."),
    Tunable(
        "survey_epoch_sigma",
        0.1,
        "s",
        "Sigma of a survey's epochs before they are confirmed.",
        "Logs wrong by tenths of seconds.",
    ),
    Tunable("confirmed_epoch_sigma", 2e-4, "s", "The same afterwards.", "The IMU's own delay."),
    Tunable(
        "epoch_mistake_s",
        0.05,
        "s",
        "A mistake of the epochs to be excluded first.",
        "Half of the step in which they are counted.",
    ),
)


@kernel
def set_initial_time_offset(p: Parameters, c: Core, fix: Fix, sigma: float) -> None:
    """At the first fix (sigma m): is its epoch the receiver's, or only its arrival, less the latency that is assumed?

    A survey's log that states no arrival states the epoch.
    """
    delay = 1e-9 * (fix.arrival_ns - fix.t_ns)
    c.integrity.survey_epochs = (
        1 if abs(delay) <= p.tuning.time_tag_tolerance_s and sigma < p.tuning.survey_sigma else 0
    )
    if c.integrity.survey_epochs != 0:
        decorrelate(c, TIME_OFFSET, p.tuning.survey_epoch_sigma**2)
    elif delay > p.tuning.time_tag_tolerance_s and abs(delay - p.assumed_latency) > p.tuning.time_tag_tolerance_s:
        decorrelate(c, TIME_OFFSET, p.tuning.reported_epoch_sigma**2)


@kernel
def confirm_survey_epochs(p: Parameters, c: Core) -> None:
    """After a fix: a survey's epochs are believed to the sample once the motion has shown that they are right."""
    late, most = abs(c.nav.time_offset), 3.0 * standard_deviation(c, TIME_OFFSET)
    if c.integrity.survey_epochs != 0 and late + most < p.tuning.epoch_mistake_s and late < most:
        clear_time_offset(c, p.tuning.confirmed_epoch_sigma**2)
        c.integrity.survey_epochs = 0
