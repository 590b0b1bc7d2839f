"""From TOML file and `--set KEY=VALUE` to `Settings`; reports every problem at once, each with its key and line."""

import difflib
import math
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import msgspec

from ..errors import ConfigError
from .schema import is_table, keys, kind_of
from .settings import Settings

Struct = TypeVar("Struct", bound=msgspec.Struct)


def _problems(table: dict[str, Any], schema: type[msgspec.Struct], prefix: str = "") -> Iterable[tuple[str, str]]:
    """(key path, what is wrong) for every key of `table` that `schema` does not take."""
    fields = get_type_hints(schema, include_extras=True)
    for key, value in table.items():
        path = prefix + key
        if key not in fields:
            near = difflib.get_close_matches(key, fields, n=1, cutoff=0.5)
            hint = f"did you mean {prefix}{near[0]}?" if near else f"known here: {', '.join(fields)}"
            yield path, f"unknown key; {hint}"
        elif is_table(fields[key]):
            if isinstance(value, dict):
                yield from _problems(value, fields[key], path + ".")
            else:
                yield path, "is a table of keys, not a value"
        elif any(isinstance(one, float) and not math.isfinite(one) for one in _parts(value)):
            yield path, "must be finite"
        else:
            try:
                msgspec.convert(value, fields[key])
            except msgspec.ValidationError as error:
                yield path, f"{error}; it must be: {kind_of(fields[key])[0]}"


def _parts(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return list(value.values())
    return value if isinstance(value, list) else [value]


def _line_of(text: str, path: str) -> int | None:
    """Line on which the key stands in the TOML text, for the message; None if it cannot be told."""
    *tables, key = path.split(".")
    current: list[str] = []
    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(r"\s*\[+\s*([\w.\-]+)\s*\]+", line):
            current = header[1].split(".")
        elif (assigned := re.match(r"\s*([\w.\-]+)\s*=", line)) and current + assigned[1].split(".") == [*tables, key]:
            return number
    return None


def _assignment(text: str, option: str, example: str) -> tuple[list[str], Any]:
    key, sign, value = text.partition("=")
    if not sign or not key.strip():
        raise ConfigError(f"{option} {text}: write it as KEY=VALUE, for example {option} {example}")
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        parsed = value.strip()  # a bare word is a string
    return key.strip().split("."), parsed


def _merge(table: dict[str, Any], path: list[str], value: Any) -> None:
    for name in path[:-1]:
        inner = table.setdefault(name, {})
        if not isinstance(inner, dict):
            table[name] = inner = {}
        table = inner
    table[path[-1]] = value


def load(file: Path | None, overrides: Iterable[str] = ()) -> Settings:
    """Read and check. Overrides win over the file.

    Raises ConfigError listing every problem: unreadable file, TOML syntax, unknown keys, wrong types and ranges.
    """
    try:
        text = "" if file is None else file.read_text()
    except OSError as error:
        raise ConfigError(f"cannot read the configuration {file}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"the configuration {file} is no text: {error}") from error
    return loads(text, overrides, str(file))


def loads(text: str, overrides: Iterable[str] = (), name: str = "the configuration") -> Settings:
    """As `load`, for a text that messages call `name`."""
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{name} is not valid TOML: {error}") from error
    return from_table(table, overrides, name, text)


def from_table(table: dict[str, Any], overrides: Iterable[str], name: str, text: str = "") -> Settings:
    """As `loads`, for what the text (for line numbers, if there is one) was parsed to."""
    for override in overrides:
        _merge(table, *_assignment(override, "--set", "navigation.vehicle=land"))
    problems = []
    for path, what in (*_problems(table, Settings), *_unknown_names(table), *_tuning_problems(table)):
        line = _line_of(text, path)
        where = f"{name}:{line}: " if line else ""
        problems.append(f"{where}{path}: {what}")
    if problems:
        raise ConfigError("bad configuration\n  " + "\n  ".join(problems))
    return msgspec.convert(table, Settings)


def _unknown_names(table: dict[str, Any]) -> Iterable[tuple[str, str]]:
    """(key path, what is wrong) where a value must be one of the names that exist."""
    imu = table.get("imu")
    given = {"estimator": table.get("estimator"), "imu.profile": imu.get("profile") if isinstance(imu, dict) else None}
    if any(given.values()):
        from ..estimators.registry import NAMES
        from ..sensor_errors.profiles import PROFILES

        for (path, name), known in zip(given.items(), (NAMES, tuple(PROFILES)), strict=True):
            if isinstance(name, str) and name not in ("auto", *known):
                yield path, f"there is no {name!r}; known are auto, {', '.join(known)}"


def _tuning_problems(table: dict[str, Any]) -> Iterable[tuple[str, str]]:
    """(key path, what is wrong) where a tunable does not exist, or does not take the value."""
    tuned = {name: inner["tuning"] for name, inner in table.items() if isinstance(inner, dict) and "tuning" in inner}
    if tuned:
        from ..estimators import registry
        from ..estimators.tuning import problems

        for estimator in map(registry.by_name, registry.NAMES):
            given = tuned.get(estimator.table)
            if isinstance(given, dict) and all(isinstance(value, int | float) for value in given.values()):
                for name, what in problems(estimator.tunables, given):
                    yield f"{estimator.table}.tuning.{name}", what


def adopt(running: Settings, fresh: Settings) -> tuple[Settings, list[str], list[str]]:
    """`running` with the hot keys of `fresh`; also the changed keys that were taken, and those that need a restart."""
    taken, waiting = [], []
    for key in keys():
        before, after = _value(running, key.path), _value(fresh, key.path)
        if before == after:
            continue
        if key.hot:
            taken.append(key.path)
            table = msgspec.structs.replace(getattr(running, key.table), **{key.name: after})
            running = msgspec.structs.replace(running, **{key.table: table})
        else:
            waiting.append(key.path)
    return running, taken, waiting


def _value(settings: Settings, path: str) -> Any:
    value: Any = settings
    for name in path.split("."):
        value = getattr(value, name)
    return value


def parse_assignments(text: str, schema: type[Struct], option: str) -> Struct:
    """`a=1,b=2` as a struct, for options such as --initial. Raises ConfigError naming the option and all bad keys."""
    table: dict[str, Any] = {}
    for item in filter(None, text.split(",")):
        path, value = _assignment(item, option, "lat_deg=35.6")
        _merge(table, path, value)
    if problems := [f"{path}: {what}" for path, what in _problems(table, schema)]:
        raise ConfigError(f"{option}: " + "; ".join(problems))
    return msgspec.convert(table, schema)
