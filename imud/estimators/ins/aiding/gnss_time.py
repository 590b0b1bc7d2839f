"""The initial uncertainty of the time offset, which depends on the source of the epochs.

The epochs of a survey (post-processed, centimetres) are exact, unless its log is off by some tenths of a second
throughout; a filter that assumed zero offset would then turn its heading instead. So the time offset of a survey is
estimated first. Once an offset of that size is excluded, the epochs are taken as exact.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import decorrelate, standard_deviation
from ..state import EXACT_EPOCHS, REPORTED_EPOCHS, TIME_OFFSET, UNCONFIRMED_EPOCHS, VELOCITY_TIME_OFFSET

if TYPE_CHECKING:
    from ...types import Fix
    from ..types import Core, Parameters


TUNABLES = (
    Tunable(
        "time_tag_tolerance_s",
        1e-3,
        "s",
        "Largest difference of two times that count as equal.",
        "NMEA states milliseconds at best.",
    ),
    Tunable("reported_epoch_sigma", 0.07, "s", "Sigma of the epoch that a receiver reports.", "Recorded receivers."),
    Tunable("survey_sigma", 0.1, "m", "Largest sigma of a position that may be from a survey.", "RTK: centimetres."),
    Tunable(
        "survey_epoch_sigma",
        0.1,
        "s",
        "Sigma of a survey's epochs before they are confirmed.",
        "Logs wrong by tenths of seconds.",
    ),
    Tunable(
        "confirmed_epoch_sigma",
        2e-4,
        "s",
        "Sigma of a survey's epochs once they are confirmed.",
        "The IMU's own delay.",
    ),
    Tunable(
        "epoch_mistake_s",
        0.05,
        "s",
        "Error of a survey's epochs that must be excluded before they are confirmed.",
        "Half of the step in which they are counted.",
    ),
)


@kernel
def set_time_offset(c: Core, seconds: float, variance: float) -> None:
    """Set the time offset, with `variance` (s^2)."""
    c.nav.time_offset = seconds
    decorrelate(c, TIME_OFFSET, variance)


@kernel
def set_initial_time_offset(p: Parameters, c: Core, fix: Fix, sigma: float) -> None:
    """At the first fix (position sigma, m): set the time offset's variance by whether the epoch is reported or assumed.

    An epoch at the assumed latency before the arrival is assumed. A survey's log has no arrival: both times are equal.
    """
    delay = 1e-9 * (fix.arrival_ns - fix.t_ns)
    is_survey = abs(delay) <= p.tuning.time_tag_tolerance_s and sigma < p.tuning.survey_sigma
    c.integrity.epochs = UNCONFIRMED_EPOCHS if is_survey else REPORTED_EPOCHS
    if is_survey:
        decorrelate(c, TIME_OFFSET, p.tuning.survey_epoch_sigma**2)
    elif delay > p.tuning.time_tag_tolerance_s and abs(delay - p.assumed_latency) > p.tuning.time_tag_tolerance_s:
        decorrelate(c, TIME_OFFSET, p.tuning.reported_epoch_sigma**2)


@kernel
def reset_time_offsets(p: Parameters, c: Core, fix: Fix, sigma: float) -> None:
    """As before the first fix: what was learned with a heading that was wrong from the start is wrong, too."""
    set_time_offset(c, 0.0, p.tuning.time_offset_sigma**2)
    set_initial_time_offset(p, c, fix, sigma)
    c.nav.velocity_time_offset = 0.0
    decorrelate(c, VELOCITY_TIME_OFFSET, p.tuning.velocity_time_offset_sigma**2)


@kernel
def confirm_survey_epochs(p: Parameters, c: Core) -> None:
    """After a fix: take a survey's epochs as exact once the estimated time offset excludes a mistake and is about zero.

    Within one sigma: limit_sigmas would take half of the epochs that are wrong by 30 ms as exact.
    """
    offset, sigma = abs(c.nav.time_offset), standard_deviation(c, TIME_OFFSET)
    if c.integrity.epochs != UNCONFIRMED_EPOCHS:
        return
    if offset + p.tuning.limit_sigmas * sigma < p.tuning.epoch_mistake_s and offset < sigma:
        set_time_offset(c, 0.0, p.tuning.confirmed_epoch_sigma**2)
        c.integrity.epochs = EXACT_EPOCHS
