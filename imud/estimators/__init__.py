"""The estimators and the one small interface behind which they all stand.

An estimator is fixed-size nopython kernels on records: a parameter record (fixed after `configure`), a state record and
rows of `records`. Kernels never allocate, never raise, and depend on nothing but their arguments, so that the same
bytes give the same bits live and in replay.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from imud.configuration.settings import Initial, Settings
from imud.sensor_errors.stored_biases import Biases

from ..math.arrays import Floats, Records
from .aiding_source import AidingSource
from .tuning import Tunable


@dataclass(frozen=True)
class Estimator:
    """name: what the user calls it.

    configure(settings, rate_hz) -> parameters (1 element). start(parameters, initial) -> state (1 element).
    step(parameters[0], state[0], sample, solution): one inertial sample in, one solution row out.
    update(parameters[0], state[0], fix, innovations) -> rows of `innovations` written. None: takes no fixes.
    pending_innovations(state[0], innovations) -> rows of `innovations` that steps have made since
    the last call; None: never any.
    needs_gyros: useless on a sensor without rates about all three axes.
    aid(parameters[0], state[0], measurement, innovations) -> rows of `innovations`; a measurement (MEASUREMENT) of one
    of `sources`. None: GNSS only.
    tunables: the constants that the settings' table `NAME.tuning` may change.
    restore_biases(state, biases): begin with these instead of unknown ones. None: it cannot.
    checkpoint(state) -> record (1 element) with which resume(state, record) lets a state before its first sample go on
    after a restart of the program. None: it cannot.
    backward_tuning(solution, factor) -> tunables, by name, with which a filter begins at that solution with sigmas
    `factor` times as large, and takes epochs as known; for smoothing. None: it cannot run backward in time.
    fix_delay_s(state) -> by how much a fix is older than its epoch says, s. None: it does not estimate it.
    source_ages_s(state) -> by how much measurements are older than their epochs say, s, by the code of their source.
    None: it does not estimate it.
    source_estimates(state) -> by the code of a source, what was found out of it: `scale` (that of its readings),
    `offset_m`, each with its sigma (`s…`), and `finding`, why its measurements are not used. None: it finds nothing.
    variances(state) -> those of the horizontal position and height, m^2, horizontal velocity, (m/s)^2, and heading,
    rad^2; None: it does not navigate yet. None: it has none.
    place(state) -> latitude and longitude, rad, and height, m; None: not known yet. None: it has none.
    filter_states(state) -> at most one row of FILTER_STATES (`filter_states`): what it estimates beside its solution.
    None: nothing that others want to know.
    rates_of_interval: it takes a reading for that of the interval before its time; else for that of the instant.
    survives_power_on: a sample with POWER_ON resets its biases, or it estimates none; else it is started anew then.
    """

    name: str
    configure: Callable[[Settings, float], Records]
    start: Callable[[Records, Initial], Records]
    step: Callable[[Any, Any, Any, Any], None]
    update: Callable[[Any, Any, Any, Any], int] | None
    needs_gyros: bool = True
    survives_power_on: bool = False
    rates_of_interval: bool = False
    restore_biases: Callable[[Records, Biases], None] | None = None
    checkpoint: Callable[[Records], Records] | None = None
    resume: Callable[[Records, Records], None] | None = None
    backward_tuning: Callable[[Any, float], dict[str, float]] | None = None
    fix_delay_s: Callable[[Records], float] | None = None
    source_ages_s: Callable[[Records], Floats] | None = None
    source_estimates: Callable[[Records], dict[int, dict[str, float | str]]] | None = None
    variances: Callable[[Records], tuple[float, float, float, float] | None] | None = None
    place: Callable[[Records], tuple[float, float, float] | None] | None = None
    filter_states: Callable[[Records], Records] | None = None
    pending_innovations: Callable[[Any, Any], int] | None = None
    tunables: tuple[Tunable, ...] = ()
    aid: Callable[[Any, Any, Any, Any], int] | None = None
    sources: tuple[AidingSource, ...] = ()

    @property
    def table(self) -> str:
        """Its table in the settings."""
        return self.name.replace("-", "_")
