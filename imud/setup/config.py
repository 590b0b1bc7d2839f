"""From TOML file and `--set KEY=VALUE` to `Settings`; reports every problem at once, each with its key and line.

Whatever the file or an option holds, the result is settings within the schema's ranges, or a ConfigError.
"""

import functools
import re
import reprlib
import tomllib
from collections.abc import Iterable, Mapping
from itertools import accumulate, chain, islice
from pathlib import Path
from typing import Any, get_type_hints

import msgspec

from ..configuration.schema import is_table, is_valid, keys, kind_of, rule_of
from ..configuration.settings import Initial, Settings
from ..errors import ConfigError
from ..folders import read_file

_FILE_MAX = 1 << 18  # bytes; all keys with their descriptions are 12 kB
_SHOWN = 80  # characters of what was given, in a message
_DOTS_MAX = 100  # in a line: the time that tomllib takes for a key goes with the square of its parts
_PROBLEMS_MAX = 50  # in one message
_NOT_TOML = (ValueError, RecursionError)  # TOMLDecodeError, an integer of thousands of digits; deeply nested arrays


@functools.cache
def _fields(schema: type[msgspec.Struct]) -> dict[str, Any]:
    """The type of each key, which takes long to find."""
    return get_type_hints(schema, include_extras=True)


def _problems(table: dict[str, Any], schema: type[msgspec.Struct], prefix: str = "") -> Iterable[tuple[str, str]]:
    """(key path, what is wrong) for every key of `table` that `schema` does not take."""
    fields = _fields(schema)
    for key, value in table.items():
        path = prefix + key
        if key not in fields:
            yield path, f"unknown key; {_hint(key, schema, prefix)}"
        elif is_table(fields[key]):
            if isinstance(value, dict):
                yield from _problems(value, fields[key], path + ".")
            else:
                yield path, "is a table of keys, not a value"
        elif not is_valid(value, fields[key]):
            kind, _ = kind_of(fields[key])
            rule = rule_of(fields[key]) if isinstance(value, str) == (kind == "text") else ""  # else its type is wrong
            shown = str(value).lower() if isinstance(value, bool) else reprlib.repr(value)
            yield path, f"must be {kind}{rule}, not {shown}"


def _hint(key: str, schema: type[msgspec.Struct], prefix: str) -> str:
    """Which key may be meant by one that `schema` does not have: that of another table, or one spelt similarly."""
    import difflib  # for typing errors only

    names = _fields(schema)
    near = [] if schema is Initial else [known.path for known in keys() if known.name == key]
    near = near or [prefix + name for name in difflib.get_close_matches(key, names, n=1, cutoff=0.5)]
    return f"did you mean {' or '.join(near)}?" if near else f"known here: {', '.join(names)}"


def _lines_of(text: str) -> dict[str, int]:
    """The line on which each key stands in the TOML text, for messages; keys of which this is not known are missing."""
    lines: dict[str, int] = {}
    table = ""
    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(r"\s*\[+\s*([\w.\-]+)\s*\]+", line):
            path, table = header[1], header[1] + "."
        elif assigned := re.match(r"\s*([\w.\-]+)\s*=", line):
            path = table + assigned[1]
        else:
            continue
        for table_or_key in accumulate(path.split("."), "{}.{}".format):
            lines.setdefault(table_or_key, number)
    return lines


def _assignment(text: str, option: str, example: str) -> tuple[list[str], Any]:
    """Key path and value. option: with a space, before what is shown of `text`; empty: it is of a file."""
    key, sign, value = text.partition("=")
    if not sign or not key.strip():
        given = text if text.isprintable() and len(text) <= _SHOWN else ascii(text)[:_SHOWN]
        raise ConfigError(f"{option}{given}: write it as KEY=VALUE, for example {option}{example}")
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except _NOT_TOML:
        parsed = value.strip()  # a bare word is a string
    return key.strip().split("."), parsed


def _merge(table: dict[str, Any], path: list[str], value: Any) -> None:
    for name in path[:-1]:
        inner = table.setdefault(name, {})
        if not isinstance(inner, dict):
            table[name] = inner = {}
        table = inner
    table[path[-1]] = value


def load(
    file: Path | None,
    overrides: Iterable[str] = (),
    given: Mapping[str, Any] | None = None,
    regular_only: bool = False,
) -> Settings:
    """Read and check. Overrides (KEY=VALUE) win over the file, `given` (values by key path) over both.

    regular_only: refuse a pipe, whose reading would wait for another program, and would find it empty a second time.
    Raises ConfigError listing every problem: unreadable file, TOML syntax, unknown keys, wrong types and ranges.
    """
    return loads("" if file is None else _read(file, regular_only), overrides, str(file), given)


def _read(file: Path, regular_only: bool) -> str:
    try:
        if regular_only:
            data = read_file(file)
        else:
            with file.open("rb") as opened:
                data = opened.read(_FILE_MAX + 1)
        if len(data) > _FILE_MAX:
            raise ConfigError(f"the configuration {file} is longer than {_FILE_MAX >> 10} KiB: not a configuration")
        return data.decode("utf-8-sig")  # editors on Windows begin a file with its mark
    except OSError as error:
        raise ConfigError(f"cannot read the configuration {file}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"the configuration {file} is not UTF-8 text: {error}") from error


def loads(
    text: str,
    overrides: Iterable[str] = (),
    name: str = "the configuration",
    given: Mapping[str, Any] | None = None,
) -> Settings:
    """As `load`, for a text that messages call `name`."""
    try:
        if any(line.count(".") > _DOTS_MAX for line in text.splitlines()):
            raise RecursionError
        table = tomllib.loads(text) if text else {}
    except RecursionError:
        raise ConfigError(f"{name} is not valid TOML: arrays or tables are nested too deeply") from None
    except ValueError as error:
        raise ConfigError(f"{name} is not valid TOML: {error}") from error
    return from_table(table, overrides, name, text, given)


def from_table(
    table: dict[str, Any],
    overrides: Iterable[str],
    name: str,
    text: str = "",
    given: Mapping[str, Any] | None = None,
) -> Settings:
    """As `loads`, for what the text (for line numbers, if there is one) was parsed to."""
    for override in overrides:
        _merge(table, *_assignment(override, "--set ", "navigation.vehicle=land"))
    for key, value in (given or {}).items():
        _merge(table, key.split("."), value)
    lines = _lines_of(text)
    found = chain(_problems(table, Settings), _unknown_names(table), _more_problems(table))
    problems = []
    for path, what in islice(found, _PROBLEMS_MAX):
        where = f"{name}:{lines[path]}: " if path in lines else ""
        problems.append(f"{where}{path[:80]}: {what}")
    if problems:
        more = ["and more"] if next(found, None) else []
        raise ConfigError("bad configuration\n  " + "\n  ".join(problems + more))
    return msgspec.convert(table, Settings)


def _unknown_names(table: dict[str, Any]) -> Iterable[tuple[str, str]]:
    """(key path, what is wrong) where a value must be one of the names that exist."""
    imu = table.get("imu")
    given = {"estimator": table.get("estimator"), "imu.profile": imu.get("profile") if isinstance(imu, dict) else None}
    if any(given.values()):
        from imud.drivers.plugins import plugins

        from ..estimators.registry import NAMES
        from ..sensor_errors.profiles import PROFILES

        estimators = (*NAMES, *plugins("imud.estimators"))
        for (path, name), known in zip(given.items(), (estimators, tuple(PROFILES)), strict=True):
            if isinstance(name, str) and name not in ("auto", *known):
                yield path, f"there is no {repr(name)[:_SHOWN]}; known are auto, {', '.join(known)}"


def _more_problems(table: dict[str, Any]) -> Iterable[tuple[str, str]]:
    """(key path, what is wrong) where a tunable or a value of the start does not exist, or does not take the value."""
    if isinstance(start := table.get("initial"), str):
        try:
            parse_initial(start, "")
        except ConfigError as error:
            yield "initial", str(error)
    tuned = {name: inner["tuning"] for name, inner in table.items() if isinstance(inner, dict) and "tuning" in inner}
    if tuned:
        from ..estimators import registry
        from ..estimators.tuning import problems

        for estimator in map(registry.by_name, registry.NAMES):
            given = tuned.get(estimator.table)
            if isinstance(given, dict) and all(isinstance(value, int | float) for value in given.values()):
                for name, what in problems(estimator.tunables, given):
                    yield f"{estimator.table}.tuning.{name}", what


def initial_of(settings: Settings, more: str = "") -> Initial:
    """What is known of the start by the settings, and by `--initial`, which wins. Raises ConfigError."""
    return parse_initial(f"{settings.initial},{more}")


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


def parse_initial(text: str, option: str = "--initial ") -> Initial:
    """What is known of the start, as `--initial` takes it: `lat_deg=35.5,yaw_deg=-46`. Raises ConfigError.

    option: that had the text, with a space, for messages; empty: a file had it.
    """
    table: dict[str, Any] = {}
    for item in filter(None, text.split(",")):
        path, value = _assignment(item, option, "lat_deg=35.6")
        _merge(table, path, value)
    if problems := [f"{path}: {what}" for path, what in _problems(table, Initial)]:
        raise ConfigError(option + "; ".join(problems))
    return msgspec.convert(table, Initial)
