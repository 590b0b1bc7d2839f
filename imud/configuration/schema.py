"""What `Settings` says of each of its keys: its type in words, its default in TOML, whether it is hot."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

from .settings import Settings

_LIMITS = (("ge", "≥"), ("gt", ">"), ("le", "≤"), ("lt", "<"))
_KINDS = {float: "number", int: "integer", bool: "true or false", str: "text"}


@dataclass(frozen=True)
class Key:
    """A setting. `value` is its default, in TOML."""

    table: str
    name: str
    kind: str
    value: str
    what: str
    hot: bool

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
        yield Key(table, field.name, kind, value, meta.description or "", bool((meta.extra or {}).get("hot")))
    for hint, name in inner:
        yield from keys(hint, name)


def kind_of(hint: Any) -> tuple[str, msgspec.Meta]:
    """The type of a value in words, with what else the schema says of it: unit, range."""
    meta = msgspec.Meta()
    if get_origin(hint) is Annotated:
        hint, meta = get_args(hint)[:2]
    limits = " and ".join(
        f"{sign} {getattr(meta, name):g}" for name, sign in _LIMITS if getattr(meta, name) is not None
    )
    if get_origin(hint) is Literal:
        kind = " | ".join(f'"{choice}"' for choice in get_args(hint))
    elif get_origin(hint) in (Union, UnionType):
        kind = " or ".join(kind_of(choice)[0] for choice in get_args(hint) if choice is not NoneType)
    elif get_origin(hint) is dict:
        kind = f"table: {kind_of(get_args(hint)[1])[0]}"
    elif get_origin(hint) is tuple:
        items = get_args(hint)
        count = "list" if items[-1] is Ellipsis else f"list of {len(items)}"
        kind = f"{count}: {kind_of(items[0])[0]}"
    else:
        kind = _KINDS.get(hint, str(hint))
    return f"{kind} {limits}".strip(), meta
