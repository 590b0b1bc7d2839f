"""The time offset of the fixes: its initial uncertainty depends on the source of the epochs.

The epochs of a survey (post-processed, centimetres) are exact, unless its log is off by some tenths of a second
throughout; a filter that assumed zero offset would then turn its heading instead. So the time offset of a survey is
estimated first. Once an offset of that size is excluded, the epochs are taken as exact.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import add_covariance, covariance, decorrelate, standard_deviation, variance
from ..mechanization import displace
from ..state import EXACT_EPOCHS, POSITION, REPORTED_EPOCHS, TIME_OFFSET, UNCONFIRMED_EPOCHS, VELOCITY_TIME_OFFSET

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
def set_time_offset(c: Core, seconds: float, var: float) -> None:
    """Set the time offset, with the variance var (s^2)."""
    c.nav.time_offset = seconds
    decorrelate(c, TIME_OFFSET, var)


@kernel
def move_time_offset(c: Core, d: float, var: float) -> None:
    """Positions are late by d more, s, of variance var (s^2), and velocities are not: the estimate moves by v d.

    Both time offsets lose their other correlations. P += var u u', with 1 at TIME_OFFSET, -1 at VELOCITY_TIME_OFFSET
    and the velocity at POSITION in u: an offset and a displacement along the track cancel in every position.
    """
    v = c.nav.v_n
    of_velocity = variance(c, TIME_OFFSET) + 2.0 * covariance(c, TIME_OFFSET, VELOCITY_TIME_OFFSET)
    of_velocity += variance(c, VELOCITY_TIME_OFFSET)
    set_time_offset(c, c.nav.time_offset + d, max(of_velocity, 0.0) + var)
    c.nav.velocity_time_offset -= d
    decorrelate(c, VELOCITY_TIME_OFFSET, var)
    add_covariance(c, TIME_OFFSET, VELOCITY_TIME_OFFSET, -var)
    displace(c, d * v[0], d * v[1], d * v[2])
    for i in range(3):
        for k in range(i, 3):
            add_covariance(c, POSITION + i, POSITION + k, var * v[i] * v[k])
        add_covariance(c, POSITION + i, TIME_OFFSET, var * v[i])
        add_covariance(c, POSITION + i, VELOCITY_TIME_OFFSET, -var * v[i])


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
