"""The estimators and the one small interface behind which they all stand.

An estimator is fixed-size nopython kernels on records: a parameter record (fixed after `configure`), a state record and
rows of `records`. Kernels never allocate, never raise, and depend on nothing but their arguments, so that the same
bytes give the same bits live and in replay.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..configuration.settings import Initial, Settings
from ..math.arrays import Floats, Records
from ..sensor_errors.stored_biases import Biases
from .aiding_source import AidingSource
from .tuning import Tunable


@dataclass(frozen=True)
class Estimator:
    """What imud knows of an estimator: kernels, and functions that Python calls now and then.

    parameters and state are structured arrays of one element; kernels get the element itself. None: the estimator
    has none of it. The smallest one is in `docs/plugin`.
    """

    name: str  # what the user calls it
    configure: Callable[[Settings, float], Records]  # (settings, rate_hz) -> parameters
    start: Callable[[Records, Initial], Records]  # (parameters, initial) -> state
    step: Callable[[Any, Any, Any, Any], None]  # kernel (parameters, state, sample, solution): one row of SOLUTION
    update: Callable[[Any, Any, Any, Any], int] | None  # kernel (parameters, state, fix, innovations) -> rows written

    # Other measurements, innovations, constants
    aid: Callable[[Any, Any, Any, Any], int] | None = None  # as `update`, for a MEASUREMENT
    sources: tuple[AidingSource, ...] = ()  # of these measurements
    pending_innovations: Callable[[Any, Any], int] | None = None  # kernel (state, innovations) -> rows, made by steps
    tunables: tuple[Tunable, ...] = ()  # what the settings' table `NAME.tuning` may change

    # Which sensors suit it
    needs_gyros: bool = True  # it is useless on a sensor without rates about all three axes
    survives_power_on: bool = False  # a sample with POWER_ON resets its biases, if it has any; else it is started anew
    rates_of_interval: bool = False  # a rate is the mean of the interval before its time; else that of the instant

    # (state): whether the filter can go on; if not, as with a negative variance, it is started anew
    is_valid: Callable[[Records], bool] | None = None

    # A restart of the program
    restore_biases: Callable[[Records, Biases], None] | None = None  # (state, biases): begin with these
    checkpoint: Callable[[Records], Records] | None = None  # (state) -> record, with which
    resume: Callable[[Records, Records], None] | None = None  # (state, record) goes on, before the first sample

    # Smoothing: (parameters, state, solution, factor) -> tunables, by name, with which a filter begins at the last
    # solution of a run that ended in this state, its sigmas times `factor`; None: it cannot run backward in time
    backward_tuning: Callable[[Any, Records, Any, float], dict[str, float]] | None = None
    # (parameters, state, fixes) -> the fixes without what is of an earlier time than their epochs, which backward in
    # time would be of a later one
    backward_fixes: Callable[[Records, Records, Records], Records] | None = None

    # What the state says, for outputs and reports
    fix_delay_s: Callable[[Records], float] | None = None  # by how much fixes are older than their epochs, s
    source_ages_s: Callable[[Records], Floats] | None = None  # the same of measurements, by the code of their source
    # by the code of a source: `scale` and `offset_m` of its readings, each with its sigma (`s…`); `finding`: why its
    # measurements are not used
    source_estimates: Callable[[Records], dict[int, dict[str, float | str]]] | None = None
    # (parameters, state): what contradicts the settings, in words
    findings: Callable[[Records, Records], tuple[str, ...]] | None = None
    # of horizontal position and height, m^2, horizontal velocity, (m/s)^2, heading, rad^2; None before it navigates
    variances: Callable[[Records], tuple[float, float, float, float] | None] | None = None
    place: Callable[[Records], tuple[float, float, float] | None] | None = None  # latitude, longitude, rad; height, m
    filter_states: Callable[[Records], Records] | None = None  # at most one row of FILTER_STATES
    attitude: Callable[[Records], Floats] | None = None  # q_nb, of those whose `filter_states` have its covariance

    @property
    def table(self) -> str:
        """Its table in the settings."""
        return self.name.replace("-", "_")
