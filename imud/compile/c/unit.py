"""What the functions of one file of C have in common: its structs, tables and helpers, each declared once."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import system_calls
from .kinds import FLOAT, STORAGE, Array, Kind, Record, Tuple, real, stored, unify, working

_LONG_RECORD = 256  # bytes


@dataclass(frozen=True)
class Function:
    """A C function: its name and what it returns."""

    name: str
    returns: Kind


class Unit(ABC):
    """Collects the declarations that the translated functions need."""

    def __init__(self, with_lines: bool = False) -> None:
        """with_lines: say of each line of C to which line of Python it belongs, for debuggers, profilers and gcov."""
        self.with_lines = with_lines
        self._structs: dict[np.dtype[Any], Record] = {}
        self._tables: dict[tuple[Kind, str, str], str] = {}
        self._declarations: dict[str, None] = {}  # in the order in which they were needed, each once
        self._system_calls: dict[str, None] = {}

    @abstractmethod
    def function(self, kernel: Callable[..., Any], kinds: Sequence[Kind]) -> Function:
        """A kernel for these kinds of arguments. Raises UnsupportedError."""

    def _declare(self, text: str) -> None:
        self._declarations.setdefault(text)

    def record(self, dtype: np.dtype[Any]) -> Record:
        """The record of a numpy dtype, declared with the same layout on first use."""
        if dtype not in self._structs:
            assert dtype.names is not None and dtype.fields is not None
            fields = []
            for name in dtype.names:
                base, shape = dtype[name].subdtype or (dtype[name], ())
                fields.append(f"  {stored(self.of_dtype(base))} {name}{''.join(f'[{n}]' for n in shape)};")
            struct = f"struct record_{len(self._structs)}"
            lines = [f"{struct} {{", *fields, "};"]
            for name in dtype.names:
                lines.append(f'_Static_assert(offsetof({struct}, {name}) == {dtype.fields[name][1]}, "layout");')
            lines.append(f'_Static_assert(sizeof({struct}) == {dtype.itemsize}, "layout");')
            self._declare("\n".join(lines))
            self._structs[dtype] = Record(dtype, struct)
        return self._structs[dtype]

    def of_dtype(self, dtype: np.dtype[Any]) -> Kind:
        """What an element or a field of this dtype is in an expression."""
        base, shape = dtype.subdtype or (dtype, ())
        kind: Kind = self.record(base) if base.names else STORAGE[base.str[1:]]
        for n in reversed(shape):
            kind = Array(kind, n)
        return kind

    def array(self, dtype: Any) -> Array:
        """A one-dimensional array of unknown length."""
        return Array(self.of_dtype(np.dtype(dtype)), None)

    def table(self, values: np.ndarray[Any, Any]) -> tuple[str, Array]:
        """A constant array, and its name."""
        item = self.of_dtype(values.dtype)
        numbers = ", ".join(real(v) if item == FLOAT else str(int(v)) for v in values.ravel())
        sizes = "".join(f"[{n}]" for n in values.shape)
        name = self._tables.setdefault((item, sizes, numbers), f"table_{len(self._tables)}")
        self._declare(f"static const {stored(item)} {name}{sizes} = {{{numbers}}};")
        kind = item
        for n in reversed(values.shape):
            kind = Array(kind, n)
        assert isinstance(kind, Array)
        return name, kind

    def tuple_of(self, kinds: Sequence[Kind]) -> Tuple:
        """The tuple of these values."""
        item = working(kinds[0])
        for kind in kinds[1:]:
            item = unify(item, working(kind))
        made = Tuple(item, len(kinds))
        self._declare(f"typedef struct {{ {item.c} v[{made.n}]; }} {made.c};")
        return made

    def power(self, exponent: int, kind: Kind) -> str:
        """The name of a function that takes this power in the order in which numba multiplies."""
        name = f"power{exponent}_{'f' if kind == FLOAT else 'i'}"
        steps = []
        while exponent:
            steps += ["r = r * a;"] if exponent & 1 else []
            exponent >>= 1
            steps += ["a = a * a;"] if exponent else []
        self._declare(f"static inline {kind.c} {name}({kind.c} a) {{ {kind.c} r = 1; {' '.join(steps)} return r; }}")
        return name

    def record_copy(self, to: str, source: str, record: Record) -> str:
        """The statement that copies a record. A long one is copied by the C library, whose vectors are faster than the
        `rep movsq` of gcc: 40 cycles for each. The assembler line hides the length from the compiler."""
        if record.dtype.itemsize < _LONG_RECORD:
            return f"*{to} = *{source};"
        self._declare(
            "static inline void copy_record(void *to, const void *from, size_t n) "
            '{ __asm__("" : "+r"(n)); __builtin_memmove(to, from, n); }'
        )
        return f"copy_record({to}, {source}, {record.dtype.itemsize});"

    def system_call(self, name: str) -> str:
        """The name in C of a function of the C library."""
        self._system_calls.setdefault(name)
        self._declare(system_calls.declaration(name))
        return f"system_{name}"
