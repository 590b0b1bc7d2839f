"""The filters, to be stepped by hand: samples as they come, fixes and other measurements in between."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..estimators import Estimator
from ..estimators.filter_states import cells
from ..estimators.records import INNOVATION, PENDING_MAX, SOLUTION
from ..math.arrays import Records
from ..pipeline import Filter
from ..sensors.gnss import refusals
from ..tables.inputs import FIX_COLUMNS
from .arguments import (
    Frames,
    check_frames,
    columns_of,
    estimator_of,
    fixes_from,
    forbid_other_names,
    initial_of,
    measurements_from,
    samples_from,
    settings_of,
    source_of,
    start_of,
)
from .solution import Solution


class AttitudeFilter:
    """Attitude from gyro and accelerometer: what `imud run` does with one port. Not thread-safe.

    >>> import imud
    >>> attitude = imud.AttitudeFilter(rate_hz=100.0)
    >>> for k in range(300):
    ...     solution = attitude.step(k / 100.0, [0.0, 0.0, 0.0], [0.0, 0.0, -9.8])
    >>> bool(solution.attitude_valid[0])
    True
    """

    estimator = "attitude"

    def __init__(
        self,
        rate_hz: float,
        *,
        settings: Mapping[str, Any] | Path | str | None = None,
        initial: Mapping[str, float] | None = None,
        frames: Frames = "ned-frd",
        estimator: str | Estimator | None = None,
    ) -> None:
        """rate_hz: of the samples. settings: keys and values as in `--set`, or a configuration file. initial: what is
        known at the start, as in `--initial`: lat_deg, yaw_deg, … frames: of all arrays, see `Solution`. estimator:
        another one by its name, or an `imud.estimators.Estimator` of your own. Raises ConfigError for what is wrong in
        settings, ValueError for the rest.
        """
        if not 0.0 < rate_hz < 1e6:
            raise ValueError(f"rate_hz is {rate_hz}; it must be above 0 and below 1e6")
        check_frames(frames)
        chosen = estimator_of(estimator or self.estimator)
        self.frames = frames
        self._settings = settings_of(settings)
        self._filter = Filter(chosen, self._settings, initial_of(self._settings, initial), rate_hz)
        self._origin: int | None = None
        self._last_ns = np.iinfo(np.int64).min
        self._waiting: list[Records] = []

    def step(self, t: Any, gyro: Any, accel: Any, temperature: Any = None) -> Solution:
        """The estimates of the next sample, or samples.

        t: s, a number or [n], later than all before. gyro: rad/s, [3] or [n, 3]. accel: specific force, m/s^2, [3] or
        [n, 3]: at rest and level (0, 0, -g) in FRD, (0, 0, g) in FLU. temperature: degC. Raises ValueError.
        """
        samples = samples_from(t, gyro, accel, temperature, self.frames, self._origin)
        if not len(samples):
            return self._solution(np.zeros(0, SOLUTION))
        if samples["t_ns"][0] <= self._last_ns and self._origin is not None:
            raise ValueError(f"t is {np.atleast_1d(t)[0]}, not later than that of the sample before")
        if self._origin is None:
            self._origin = start_of(np.atleast_1d(np.asarray(t, float)))
        self._last_ns = int(samples["t_ns"][-1])
        out = np.zeros(len(samples), SOLUTION)
        for begin in range(0, len(samples), PENDING_MAX // 4):
            part = slice(begin, begin + PENDING_MAX // 4)
            self._filter.run(samples[part], out[part])
            self._waiting.append(self._filter.pending_innovations().copy())
        return self._solution(out)

    def filter_states(self) -> dict[str, float]:
        """What the filter estimates beside its newest solution, and with an `s` in front its sigma: time offset, lever
        arm, mounting, scale factors, errors of other sources, the covariance of position, velocity and attitude.

        Names and units are those of the columns of `states.csv`; in NED and FRD always.
        What is not estimated is not in it.
        """
        columns = cells(self._filter.filter_states())
        return {name: float(column[0]) for name, column in columns.items() if len(column)}

    def _solution(self, out: Records) -> Solution:
        innovations, self._waiting = np.concatenate([np.zeros(0, INNOVATION), *self._waiting]), []
        return Solution(out, innovations, self._origin or 0, self.frames)


class NavigationFilter(AttitudeFilter):
    """Attitude, velocity and position (INS/GNSS): what `imud run` does with an inertial sensor and a receiver.

    >>> import imud
    >>> navigation = imud.NavigationFilter(rate_hz=100.0)
    >>> for k in range(300):
    ...     solution = navigation.step(k / 100.0, [0.0, 0.0, 0.0], [0.0, 0.0, -9.8])
    ...     if k % 100 == 50:
    ...         navigation.fix(t_s=k / 100.0, lat_deg=48.0, lon_deg=11.0, height_m=500.0, sn_m=1.0, se_m=1.0, sd_m=2.0)
    >>> bool(solution.position_valid[0])
    True
    """

    estimator = "navigation"

    def fix(self, **columns: float) -> None:
        """A fix that became known before the next sample; columns by names as in `gnss.csv`: t_s, lat_deg, lon_deg,
        height_m, and what else is known of it: sn_m, se_m, sd_m, vn_mps, ve_mps, vd_mps, quality, …

        Its innovations are in the next step's solution. A fix that the settings forbid is not used, with a warning.
        Raises ValueError.
        """
        forbid_other_names("fix()", columns, FIX_COLUMNS)
        fixes = fixes_from(columns, self._known_origin())
        for fix, refusal in zip(fixes, refusals(fixes, self._settings.gnss), strict=True):
            if refusal is not None:
                warnings.warn(f"a fix is not used: {refusal}", stacklevel=2)
            else:
                self._waiting.append(self._filter.update(np.array([fix])).copy())

    def aid(self, source: str, **columns: float) -> None:
        """A measurement of an aiding source: `heading`, … with columns as in its table: t_s, heading_deg, sigma_deg.

        Raises ValueError.
        """
        chosen = source_of(source, self._filter.estimator.sources)
        forbid_other_names(f"aid({source!r})", columns, columns_of(chosen))
        self._waiting.append(self._filter.aid(measurements_from(chosen, columns, self._known_origin())).copy())

    def _known_origin(self) -> int:
        if self._origin is None:
            raise ValueError("step through a sample first: it begins the time axis")
        return self._origin
