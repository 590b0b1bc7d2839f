"""What users pass: arrays, tables, settings. Whatever is wrong is a ValueError that says what and where."""

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from imud.drivers.sample import SAMPLE

from ..configuration.settings import Initial, Settings
from ..errors import UsageError
from ..estimators import Estimator, registry
from ..estimators.aiding_source import AidingSource
from ..math.arrays import Floats, Records
from ..setup import config
from ..tables.inputs import FIX_COLUMNS, IMU_COLUMNS, TEMPERATURE, checked_fix, fixes_of, measurements_of, ns_since

Frames = Literal["ned-frd", "enu-flu"]
FLU = np.array([1.0, -1.0, -1.0])


def table_of(what: str, columns: Any) -> dict[str, Floats]:
    """Columns by name, of a mapping, a DataFrame or a structured array. what: names the argument to the user."""
    if isinstance(columns, str | Path):
        raise ValueError(f"{what} is a path; it must be a table: read the file with pandas or numpy")
    names = getattr(getattr(columns, "dtype", None), "names", None)
    if names is None and not hasattr(columns, "keys"):
        tables = "a mapping of names to columns, a DataFrame of pandas or a structured array"
        raise ValueError(f"{what} is of the type {type(columns).__name__}; it must be {tables}")
    return {str(name): np.asarray(columns[name]) for name in names or columns.keys()}


def numbers(what: str, values: Any) -> Floats:
    """An array of floats. what: names the argument to the user. numpy would make ns since 1970 of dates."""
    array = np.asarray(values)
    if array.dtype.kind in "mM":
        raise ValueError(f"{what} has dates or time spans ({array.dtype}); it must have numbers: times in s")
    try:
        return array.astype(float, copy=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{what}: {error}") from error


def forbid_other_names(call: str, given: Iterable[str], known: Iterable[str]) -> None:
    """A misspelt name would be a value that is not known."""
    known = tuple(known)
    if others := [name for name in given if name not in known]:
        raise ValueError(f"{call} takes no {', '.join(others)}; it takes {', '.join(known)}")


def settings_of(settings: Mapping[str, Any] | Path | str | None) -> Settings:
    """From keys and values as in `--set` (also numpy's), or from a configuration file. Raises ConfigError."""
    if isinstance(settings, Mapping):
        plain = {name: value.tolist() if hasattr(value, "tolist") else value for name, value in settings.items()}
        return config.loads("", given=plain, name="settings")
    if settings is None:
        return config.loads("", given=None, name="settings")
    return config.load(Path(settings))


def initial_of(settings: Settings, initial: Mapping[str, float] | None) -> Initial:
    """What is known at the start, by the settings and by names as in `--initial`. Raises ConfigError."""
    text = ",".join(f"{name}={float(value)!r}" for name, value in (initial or {}).items())
    return config.initial_of(settings, text)


def estimator_of(estimator: str | Estimator) -> Estimator:
    """The one of this name, or the user's own. Raises ValueError naming those there are."""
    if isinstance(estimator, Estimator):
        return estimator
    try:
        return registry.by_name(estimator)
    except UsageError as error:
        raise ValueError(str(error)) from error


def check_frames(frames: str) -> None:
    if frames not in ("ned-frd", "enu-flu"):
        raise ValueError(f"frames is {frames!r}; it must be 'ned-frd' or 'enu-flu'")


def rows_of(table: Mapping[str, Any]) -> list[dict[str, float]]:
    """One mapping for each row; columns of one value are those of one row."""
    columns = {name: np.atleast_1d(numbers(name, values)) for name, values in table.items()}
    lengths = {len(values) for values in columns.values()}
    if len(lengths) > 1:
        raise ValueError(f"the columns have different lengths: { ({n: len(v) for n, v in columns.items()}) }")
    return [dict(zip(columns, map(float, row), strict=True)) for row in zip(*columns.values(), strict=True)]


def samples_from(t: Any, gyro: Any, accel: Any, temperature: Any, frames: Frames, origin: int | None) -> Records:
    """Samples (array of SAMPLE), t_ns since `origin` in s; None: since the whole second before the first one."""
    times = np.atleast_1d(numbers("t", t))
    n = len(times)
    vectors = {}
    for name, values in (("gyro", gyro), ("accel", accel)):
        array = numbers(name, values)
        array = array.reshape(1, 3) if array.shape == (3,) else array
        if array.shape != (n, 3):
            raise ValueError(f"{name} has the shape {array.shape}; with {n} times it must be ({n}, 3)")
        vectors[name] = array * FLU if frames == "enu-flu" else array
    for name, array in (("t", times), *vectors.items()):
        bad = ~np.isfinite(array) if array.ndim == 1 else ~np.isfinite(array).all(axis=1)
        if bad.any():
            raise ValueError(f"{name}[{int(np.argmax(bad))}] is not finite")
    samples = np.zeros(n, SAMPLE)
    samples["t_ns"] = ns_since(times, start_of(times) if origin is None else origin)
    back = np.diff(samples["t_ns"]) <= 0
    if back.any():
        row = int(np.argmax(back)) + 1
        if times[row] > times[row - 1]:  # by less than 1 ns, or beyond what 64 bits of ns can hold
            raise ValueError(f"t[{row}] is {times[row] - times[0]:g} s after t[0]: is it in s?")
        raise ValueError(f"t[{row}] is not later than the time before it")
    samples["tick"] = np.arange(n)
    samples["w"], samples["f"] = vectors["gyro"], vectors["accel"]
    samples["temperature"] = np.nan if temperature is None else numbers("temperature", temperature)
    return samples


def start_of(times: Floats) -> int:
    """The origin of a time axis: the whole second at or before its first time."""
    return math.floor(float(times[0])) if len(times) else 0


def split_imu(imu: Any) -> tuple[Any, Any, Any, Any]:
    """t, gyro, accel, temperature: of (t, gyro, accel), of a table with these names, or with those of `imu.csv`."""
    if isinstance(imu, tuple | list):
        if len(imu) != 3:
            raise ValueError(f"imu has {len(imu)} elements; it must be (t, gyro, accel) or a table")
        return *imu, None
    table = table_of("imu", imu)
    if {"t", "gyro", "accel"} <= table.keys():
        return table["t"], table["gyro"], table["accel"], table.get("temperature")
    if missing := [name for name in IMU_COLUMNS if name not in table]:
        raise ValueError(
            f"imu has no column {', '.join(missing)}; it needs t, gyro, accel, or {', '.join(IMU_COLUMNS)}"
        )
    gyro, accel = (np.stack([table[name] for name in IMU_COLUMNS[k : k + 3]], axis=1) for k in (1, 4))
    return table["t_s"], gyro, accel, table.get(TEMPERATURE)


def fixes_from(gnss: Any, origin: int) -> Records:
    """Fixes (array of FIX) of a table with columns as in gnss.csv."""
    table = table_of("gnss", gnss)
    if missing := [name for name in ("t_s", "lat_deg", "lon_deg", "height_m") if name not in table]:
        raise ValueError(f"gnss has no column {', '.join(missing)}; its columns are those of `gnss.csv`")
    rows = rows_of({name: values for name, values in table.items() if name in FIX_COLUMNS})
    checked = [checked_fix(f"gnss, row {i}", row) for i, row in enumerate(rows)]
    return fixes_of([row for row in checked if math.isfinite(row["lat_deg"]) and row.get("quality") != 0.0], origin)


def source_of(name: str, known: Iterable[AidingSource]) -> AidingSource:
    """The source of this name."""
    sources = {source.name: source for source in known}
    if name not in sources:
        raise ValueError(f"there is no aiding source {name!r}; there are: {', '.join(sources) or 'none'}")
    return sources[name]


def columns_of(source: AidingSource) -> tuple[str, ...]:
    """What a table of its measurements may have."""
    return ("t_s", *source.names, "arrival_s")


def measurements_from(source: AidingSource, table: Any, origin: int) -> Records:
    """Measurements (array of MEASUREMENT) of the source."""
    columns = table_of(source.name, table)
    if missing := [*(() if "t_s" in columns else ("t_s",)), *source.missing(columns)]:
        raise ValueError(f"{source.name} has no column {', '.join(missing)}")
    known = {name: values for name, values in columns.items() if name in columns_of(source)}
    return measurements_of(source, rows_of(known), origin)
