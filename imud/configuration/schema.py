"""What `Settings` says of each key: its type, range and unit in words, its default in TOML, whether it is hot."""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

from .settings import Settings

_KINDS = {float: "number", int: "integer", bool: "true or false", str: "text"}


@dataclass(frozen=True)
class Key:
    """A setting. kind: type, range and unit in words. value: its default, in TOML. hint: its type, with what `settings`
    says of it.
    """

    table: str
    name: str
    kind: str
    value: str
    what: str
    hot: bool
    hint: Any

    @property
    def path(self) -> str:
        return f"{self.table}.{self.name}" if self.table else self.name


def is_table(kind: Any) -> bool:
    """Whether a field of the schema is a table of keys, not a value."""
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def keys(schema: type[msgspec.Struct] = Settings, table: str = "") -> Iterator[Key]:
    """Every key, the outermost first."""
    hints = get_type_hints(schema, include_extras=True)
    inner = []
    for field in msgspec.structs.fields(schema):
        hint = hints[field.name]
        if is_table(hint):
            inner.append((hint, field.name))
            continue
        kind, meta = kind_of(hint)
        default = field.default_factory() if field.default is msgspec.NODEFAULT else field.default
        value = json.dumps(default)  # is TOML, too, for all that settings are made of
        yield Key(table, field.name, kind, value, meta.description or "", bool((meta.extra or {}).get("hot")), hint)
    for hint, name in inner:
        yield from keys(hint, name)


def split(hint: Any) -> tuple[Any, msgspec.Meta]:
    """A type without its annotation, and the annotation."""
    if get_origin(hint) is Annotated:
        bare, meta = get_args(hint)[:2]
        return bare, meta
    return hint, msgspec.Meta()


def choices_of(hint: Any) -> list[Any]:
    """The types that a union allows, without None; of another type: itself."""
    is_union = get_origin(hint) in (Union, UnionType)
    return [choice for choice in get_args(hint) if choice is not NoneType] if is_union else [hint]


def kind_of(hint: Any) -> tuple[str, msgspec.Meta]:
    """The type of a value in words, with its range and unit; and what else the schema says of it."""
    bare, meta = split(hint)
    if len(choices_of(bare)) > 1 or choices_of(bare) != [bare]:
        kind = " or ".join(kind_of(choice)[0] for choice in choices_of(bare))
    elif get_origin(bare) is Literal:
        kind = " | ".join(f'"{choice}"' for choice in get_args(bare))
    elif get_origin(bare) is dict:
        kind = f"table: {kind_of(get_args(bare)[1])[0]}"
    elif get_origin(bare) is tuple:
        items = get_args(bare)
        count = "list" if items[-1] is Ellipsis else f"list of {len(items)}"
        kind = f"{count}: {kind_of(items[0])[0]}"
    else:
        kind = f"{_KINDS.get(bare, str(bare))}{_range(meta)}"
    return kind, meta


def rule_of(hint: Any) -> str:
    """What else a value must obey, in words after its type: of a list or a table, each of its values."""
    bare, meta = split(hint)
    if get_origin(bare) in (tuple, dict):
        return rule_of(get_args(bare)[0 if get_origin(bare) is tuple else 1])
    return str((meta.extra or {}).get("rule", ""))


def _range(meta: msgspec.Meta) -> str:
    """The range and unit of a number, as a continuation of its type's name."""
    extra = meta.extra or {}
    if "least" not in extra:
        return ""
    zero = " (or 0)" if extra["or_zero"] else ""
    return f" from {extra['least']:.9g} to {meta.le:.9g} {extra['unit']}".rstrip() + zero


def is_valid(value: Any, hint: Any) -> bool:
    """Whether a value, as TOML gives it, is of this type and within its range."""
    try:
        msgspec.convert(value, hint)
    except (msgspec.ValidationError, ValueError, OverflowError):
        return False
    _, meta = split(hint)
    extra = meta.extra or {}
    parts = value if isinstance(value, list) else value.values() if isinstance(value, dict) else [value]
    if not all(math.isfinite(part) for part in parts if isinstance(part, float)):
        return False
    return not extra.get("or_zero") or value == 0 or value >= extra["least"]
