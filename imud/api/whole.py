"""A whole array of samples at once: attitude, or attitude, velocity and position."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..batch import in_order_of_arrival, play, rate_hz_of
from ..estimators import Estimator
from ..estimators.records import FIX, INNOVATION
from ..math.arrays import Records
from ..pipeline import Filter
from ..sensor_monitor.findings import counted
from ..sensors.fix_consistency import consistent
from ..tables.clock_difference import warn_of_clocks
from ..tables.refused import without_refused
from ..tables.unit_check import unit_warnings
from .arguments import (
    Frames,
    check_frames,
    estimator_of,
    fixes_from,
    initial_of,
    measurements_from,
    samples_from,
    settings_of,
    source_of,
    split_imu,
    start_of,
)
from .solution import Solution

Setting = Mapping[str, Any] | Path | str | None


def attitude(
    t: Any,
    gyro: Any,
    accel: Any,
    temperature: Any = None,
    *,
    settings: Setting = None,
    initial: Mapping[str, float] | None = None,
    frames: Frames = "ned-frd",
    estimator: str | Estimator = "attitude",
    smooth: bool = False,
) -> Solution:
    """Attitude and gyro bias from gyro and accelerometer, causal, with sigmas; the bits of `imud replay --imu`.

    t: [n] s, increasing. gyro: [n, 3] rad/s. accel: [n, 3] specific force, m/s^2: at rest and level (0, 0, -g) in FRD,
    (0, 0, g) in FLU. temperature: [n] degC. settings: keys and values as in `--set`, or a configuration file; initial:
    as in `--initial`. smooth: estimates from the data before and after each sample, as of `imud replay --smooth`.
    frames: `ned-frd` or `enu-flu`, of what goes in and of what comes out. estimator: another one by its name, or an
    `imud.estimators.Estimator` of your own. Raises ValueError for what is wrong in arrays, ConfigError for what is
    wrong in settings, BadDataError if the settings forbid every fix, UsageError if the estimator cannot be
    smoothed. Warns of values that are probably in other units or axes, and of what the sensor monitor finds.

    >>> import numpy as np, imud
    >>> t = np.arange(300) / 100.0
    >>> accel = np.tile([0.0, -9.8 * np.sin(0.1), -9.8 * np.cos(0.1)], (300, 1))  # rolled to the right by 0.1 rad
    >>> print(round(np.radians(imud.attitude(t, np.zeros((300, 3)), accel).roll_deg[-1]), 2))
    0.1
    """
    return _run((t, gyro, accel, temperature), None, {}, settings, initial, frames, estimator_of(estimator), smooth)


def navigate(
    imu: Any,
    gnss: Any,
    aiding: Mapping[str, Any] | None = None,
    *,
    settings: Setting = None,
    initial: Mapping[str, float] | None = None,
    frames: Frames = "ned-frd",
    estimator: str | Estimator = "navigation",
    smooth: bool = False,
) -> Solution:
    """Attitude, velocity and position from inertial samples and fixes; the bits of `imud replay --imu --gnss`.

    imu: (t, gyro, accel) as for `attitude`; or a table (mapping of names to columns, DataFrame, structured array) with
    t, gyro, accel, or with the columns of `imu.csv`. gnss: a table with the columns of `gnss.csv`: t_s, lat_deg,
    lon_deg, height_m, and those that are known of sn_m, se_m, sd_m, vn_mps, ve_mps, vd_mps, quality, arrival_s, …
    aiding: tables of other sources by their names: `{"heading": table}`. Others and errors: as for `attitude`.

    >>> import numpy as np, imud
    >>> t = np.arange(500) / 100.0
    >>> imu = t, np.zeros((500, 3)), np.tile([0.0, 0.0, -9.8], (500, 1))
    >>> seconds = np.arange(1.0, 5.0)
    >>> gnss = {"t_s": seconds, "lat_deg": 48.0 + 0 * seconds, "lon_deg": 11.0 + 0 * seconds, "height_m": 0 * seconds}
    >>> bool(imud.navigate(imu, gnss).position_valid[-1])
    True
    """
    return _run(split_imu(imu), gnss, aiding or {}, settings, initial, frames, estimator_of(estimator), smooth)


def _run(
    imu: tuple[Any, Any, Any, Any],
    gnss: Any,
    aiding: Mapping[str, Any],
    settings: Setting,
    initial: Mapping[str, float] | None,
    frames: Frames,
    estimator: Estimator,
    smooth: bool,
) -> Solution:
    """imu: t, gyro, accel, temperature."""
    check_frames(frames)
    samples = samples_from(*imu, frames, None)
    if len(samples) < 2:
        raise ValueError(f"{len(samples)} samples; at least two are needed")
    origin = start_of(np.asarray(imu[0], float))
    chosen = settings_of(settings)
    fixes = np.zeros(0, FIX) if gnss is None else fixes_from(gnss, origin)
    fixes = consistent(without_refused(Path("gnss"), fixes, chosen.gnss, warnings.warn), warnings.warn)
    warn_of_clocks(samples, fixes, warnings.warn, "add {:g} s to the times of the fixes".format)
    sources = {name: source_of(name, estimator.sources) for name in aiding}
    measured = [measurements_from(sources[name], table, origin) for name, table in aiding.items()]
    filter_ = Filter(estimator, chosen, initial_of(chosen, initial), rate_hz_of(samples))
    rows: list[Records] = []
    innovations: list[Records] = [np.zeros(0, INNOVATION)]

    def take(block: Records) -> None:
        rows.append(block.copy())

    player = play
    if smooth:
        from ..smoothing import play_smoothed as player
    aiding_rows = in_order_of_arrival(measured)
    fed = player(filter_, samples, fixes, take, on_innovations=innovations.append, aiding=aiding_rows)
    for problem in (*unit_warnings(samples, "`frames` says which"), *counted(filter_.health), *filter_.findings()):
        warnings.warn(problem, stacklevel=3)
    if len(fixes) and not fed:
        warnings.warn("no fix lies within the time of the samples: are both on the same clock?", stacklevel=3)
    return Solution(np.concatenate(rows), np.concatenate(innovations), origin, frames)
