"""What a value is in C: numbers, tuples, records, arrays, and what is known while translating."""

import math
from dataclasses import dataclass


class UnsupportedError(Exception):
    """A construct that this translator does not know."""


@dataclass(frozen=True)
class Scalar:
    """int64_t, double or bool; `storage` differs for the elements of records and arrays."""

    kind: str  # i, f, b
    c: str


@dataclass(frozen=True)
class Tuple:
    """A struct whose only member is an array v."""

    item: object
    n: int

    @property
    def c(self):
        return f"t{self.n}_{self.item.c}"


@dataclass(frozen=True)
class Record:
    """A pointer to a struct."""

    dtype: object
    name: str

    @property
    def c(self):
        return f"struct {self.name} *"


@dataclass(frozen=True)
class Array:
    """A pointer to the first element; n None: the length is passed beside it."""

    item: object
    n: int | None

    @property
    def c(self):
        if isinstance(self.item, Array):
            return f"{self.item.whole} *"
        return f"{self.item.c}" if isinstance(self.item, Record) else f"{self.item.c} *"

    @property
    def whole(self):
        """The type of the array itself, for arrays of arrays of numbers."""
        item = self.item.whole if isinstance(self.item, Array) else self.item.c
        return f"__typeof__({item}[{self.n}])"


@dataclass(frozen=True)
class Constant:
    """A number or another object known now."""

    value: object


INT, FLOAT, BOOL = Scalar("i", "int64_t"), Scalar("f", "double"), Scalar("b", "bool")
STORAGE = {
    "i8": INT, "f8": FLOAT, "b1": BOOL, "u1": Scalar("i", "uint8_t"), "i4": Scalar("i", "int32_t"),
    "u2": Scalar("i", "uint16_t"), "u4": Scalar("i", "uint32_t"), "i2": Scalar("i", "int16_t"),
}  # fmt: skip
WORKING = {"i": INT, "f": FLOAT, "b": BOOL}


def unify(a, b):
    """The type of a variable that holds both."""
    if a is None or a == b:
        return b
    if isinstance(a, Scalar) and isinstance(b, Scalar):
        return WORKING["f" if "f" in (a.kind, b.kind) else "i"]
    if isinstance(a, Tuple) and isinstance(b, Tuple) and a.n == b.n:
        return Tuple(unify(a.item, b.item), a.n)
    raise UnsupportedError(f"a variable is {a} and {b}")


def real(value):
    """A number as C writes it, to the last bit."""
    if math.isnan(value):
        return "NAN"
    return ("-" if value < 0.0 else "") + "INFINITY" if math.isinf(value) else float(value).hex()
