"""Kernels as C, specialised by the types of their arguments as numba does it.

Kernels are written in a small part of Python: numbers, fixed-size records and arrays, tuples of numbers, loops. Each
(function, argument types) becomes one static C function; records become structs of the same layout. So C does the same
operations in the same order, whoever changes a kernel. What has no translation raises UnsupportedError with its line.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import system_calls
from .kinds import FLOAT, INT, STORAGE, VOID, Array, Kind, Record, Tuple, UnsupportedError, real, stored, unify, working
from .statements import Body, parameters

_PRELUDE = r"""
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
// by zero: 0, as in numba; and nothing traps
static inline int64_t floor_mod(int64_t a, int64_t b) {
  if (b == 0 || b == -1) return 0;
  int64_t r = a % b;
  return r && (r < 0) != (b < 0) ? r + b : r;
}
static inline int64_t floor_div(int64_t a, int64_t b) {
  if (b == 0 || b == -1) return b ? -a : 0;
  int64_t r = a % b;
  return a / b - (r && (r < 0) != (b < 0));
}
static inline int64_t abs_i(int64_t a) { return a < 0 ? -a : a; }
static inline int64_t max_i(int64_t a, int64_t b) { return b > a ? b : a; }
static inline int64_t min_i(int64_t a, int64_t b) { return b < a ? b : a; }
static inline double max_f(double a, double b) { return b > a ? b : a; }
static inline double min_f(double a, double b) { return b < a ? b : a; }
static inline int64_t float_bits(double a) { union { double f; int64_t i; } u = {.f = a}; return u.i; }
static inline double float_of_bits(int64_t a) { union { int64_t i; double f; } u = {.i = a}; return u.f; }
static inline double root(double a) { return a == -INFINITY ? INFINITY : fabs(sqrt(a)); }  // a ** 0.5
"""


@dataclass(frozen=True)
class Function:
    """A C function: its name and what it returns."""

    name: str
    returns: Kind


class Translation:
    """Collects structs and functions; `source` is the whole translation unit."""

    def __init__(self, with_lines: bool = False) -> None:
        """with_lines: say of each line of C to which line of Python it belongs, for debuggers, profilers and gcov."""
        self.with_lines = with_lines
        self._structs: dict[np.dtype[Any], Record] = {}
        self._tables: dict[tuple[Kind, str, str], str] = {}
        self._functions: dict[tuple[Any, tuple[Kind, ...]], Function] = {}
        self._begun: list[Any] = []  # functions that are being translated, each called by the one before
        self._declarations: dict[str, None] = {}  # in the order in which they were needed, each once
        self._bodies: list[str] = []
        self._system_calls: dict[str, None] = {}

    @property
    def source(self) -> str:
        """All of it, as one file of C."""
        calls = system_calls.definitions(list(self._system_calls))
        return "\n".join([system_calls.PRELUDE + _PRELUDE, *self._declarations, *self._bodies, calls])

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

    def system_call(self, name: str) -> str:
        """The name in C of a function of the C library."""
        self._system_calls.setdefault(name)
        self._declare(system_calls.declaration(name))
        return f"system_{name}"

    def function(self, kernel: Callable[..., Any], kinds: Sequence[Kind]) -> Function:
        """A kernel for these kinds of arguments. Raises UnsupportedError."""
        python = getattr(kernel, "py_func", kernel)
        key = python, tuple(working(kind) for kind in kinds)
        if key not in self._functions:
            if python in self._begun:
                raise UnsupportedError(f"{python.__module__}.{python.__qualname__} calls itself")
            self._begun.append(python)
            body = Body(self, python, key[1])
            body.translate()
            self._begun.pop()
            assert body.returns is not None
            done = self._functions[key] = Function(f"{python.__name__}_{len(self._functions)}", body.returns)
            head = f"{body.line_directive}static inline {done.returns.c} {done.name}({body.parameters})"
            self._bodies.append(f"{head}\n{{\n{body.text}{body.line_directive}}}\n")
        return self._functions[key]

    def export(self, kernel: Callable[..., Any], dtypes: Sequence[np.dtype[Any] | None], symbol: str) -> None:
        """Make a kernel visible as a function of integers: address and length of each array, and each integer.

        dtypes: of the elements of each array; None: an integer. Returns an integer; 0 if the kernel returns nothing.
        """
        kinds = [INT if dtype is None else self.array(dtype) for dtype in dtypes]
        function = self.function(kernel, kinds)
        names = parameters({f"a{i}": kind for i, kind in enumerate(kinds)})
        call = f"{function.name}({', '.join(f'({c}){name}' for c, name in names)})"
        body = f"{call}; return 0;" if function.returns == VOID else f"return {call};"
        self._bodies.append(f"int64_t {symbol}({', '.join(f'int64_t {n}' for _, n in names) or 'void'}) {{ {body} }}\n")
        assert function.returns in (VOID, INT) or function.returns.c == "bool", symbol
