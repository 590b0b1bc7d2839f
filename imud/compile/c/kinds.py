"""The kinds of values of a kernel in C: a number, a tuple, a record, or an array."""

import math
from dataclasses import dataclass
from typing import Any, Union

import numpy as np


class UnsupportedError(Exception):
    """A construct that the translator does not know; the message has file, line and source text."""


class ConflictError(Exception):
    """Two values of kinds that no variable can hold both."""


@dataclass(frozen=True)
class Scalar:
    """A number. kind: i (integer), f (float), b (bool), v (no value at all); c: its type in C."""

    kind: str
    c: str


@dataclass(frozen=True)
class Tuple:
    """n values of one kind: a struct whose only member is an array v."""

    item: "Kind"
    n: int

    @property
    def c(self) -> str:
        return f"t{self.n}_{self.item.c}"


@dataclass(frozen=True)
class Record:
    """A record of this dtype, by its address."""

    dtype: np.dtype[Any]
    struct: str

    @property
    def c(self) -> str:
        return f"{self.struct} *"


@dataclass(frozen=True)
class Array:
    """An array, by the address of its first element. n None: its length is in a second variable, NAME_n."""

    item: "Kind"
    n: int | None

    @property
    def c(self) -> str:
        return f"{stored(self.item)} *"


Kind = Union[Scalar, Tuple, Record, Array]  # noqa: UP007 - the classes refer to it before it exists
Value = tuple[str, Kind]  # an expression in C, and what it is

INT, FLOAT, BOOL, VOID = Scalar("i", "int64_t"), Scalar("f", "double"), Scalar("b", "bool"), Scalar("v", "void")
# elements of arrays and fields of records, by numpy's type codes; in expressions they become INT, FLOAT or BOOL
STORAGE = {
    "f8": FLOAT,
    "b1": BOOL,
    "i8": INT,
    "i4": Scalar("i", "int32_t"),
    "i2": Scalar("i", "int16_t"),
    "i1": Scalar("i", "int8_t"),
    "u8": Scalar("i", "uint64_t"),
    "u4": Scalar("i", "uint32_t"),
    "u2": Scalar("i", "uint16_t"),
    "u1": Scalar("i", "uint8_t"),
}
_WORKING = {"i": INT, "f": FLOAT, "b": BOOL, "v": VOID}


def working(kind: Kind) -> Kind:
    """What a value of this kind is once it is in a variable: the narrow integers of storage become int64_t."""
    return _WORKING[kind.kind] if isinstance(kind, Scalar) else kind


def stored(kind: Kind) -> str:
    """The C type of an element of an array, or of a field of a record."""
    match kind:
        case Array():
            return f"__typeof__({stored(kind.item)}[{kind.n}])"
        case Record():
            return kind.struct
        case _:
            return kind.c


def unify(a: Kind | None, b: Kind) -> Kind:
    """The kind of a variable that holds both. Raises ConflictError."""
    if a is None or a == b:
        return b
    if isinstance(a, Scalar) and isinstance(b, Scalar) and VOID not in (a, b):
        return FLOAT if FLOAT in (a, b) else INT
    if isinstance(a, Tuple) and isinstance(b, Tuple) and a.n == b.n:
        return Tuple(unify(a.item, b.item), a.n)
    raise ConflictError(f"variable that is both {a.c} and {b.c}")


def real(value: float) -> str:
    """A number as C writes it, to the last bit."""
    if math.isnan(value):
        return "NAN"
    return ("-" if value < 0.0 else "") + "INFINITY" if math.isinf(value) else float(value).hex()


def literal(value: Any) -> Value:
    """A number that is known while translating."""
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower(), BOOL
    if isinstance(value, int | np.integer):
        return f"INT64_C({int(value)})" if value >= 0 else f"(-INT64_C({-int(value)}))", INT
    return f"({real(value)})", FLOAT
