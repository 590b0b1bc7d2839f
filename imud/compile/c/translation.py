"""Kernels as C, specialised by the types of their arguments as numba does it.

Kernels are written in a small part of Python: numbers, fixed-size records and arrays, tuples of numbers, loops. Each
(function, argument types) becomes one static C function; records become structs of the same layout. So C does the same
operations in the same order, whoever changes a kernel. What has no translation raises UnsupportedError with its line.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from . import system_calls
from .kinds import INT, VOID, Kind, UnsupportedError, working
from .statements import Body, parameters
from .unit import Function, Unit

_PRELUDE = r"""
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#ifndef EXPORTED
#define EXPORTED(name) name
#endif
// by zero: 0, as in numba; and nothing traps. A division by a known power of two is a shift
#define POWER_OF_TWO(b) (__builtin_constant_p(b) && (b) > 0 && ((b) & ((b) - 1)) == 0)
static inline int64_t floor_mod(int64_t a, int64_t b) {
  if (POWER_OF_TWO(b)) return a & (b - 1);
  if (b == 0 || b == -1) return 0;
  int64_t r = a % b;
  return r && (r < 0) != (b < 0) ? r + b : r;
}
static inline int64_t floor_div(int64_t a, int64_t b) {
  if (POWER_OF_TWO(b)) return a >> __builtin_ctzll(b);
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
_ALWAYS_INLINE = "inline __attribute__((always_inline))"  # of a kernel that is `unrolled`


class Translation(Unit):
    """Collects declarations and functions; `source` is the whole file."""

    def __init__(self, with_lines: bool = False) -> None:
        super().__init__(with_lines)
        self._functions: dict[tuple[Any, tuple[Kind, ...]], Function] = {}
        self._begun: list[Any] = []  # functions that are being translated, each called by the one before
        self._bodies: list[str] = []

    @property
    def source(self) -> str:
        """All of it, as one file of C."""
        calls = system_calls.definitions(list(self._system_calls))
        return "\n".join([system_calls.PRELUDE + _PRELUDE, *self._declarations, *self._bodies, calls])

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
            inline = _ALWAYS_INLINE if getattr(kernel, "targetoptions", {}).get("forceinline") else "inline"
            head = f"{body.line_directive}static {inline} {done.returns.c} {done.name}({body.parameters})"
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
        integers = ", ".join(f"int64_t {n}" for _, n in names) or "void"
        self._bodies.append(f"int64_t EXPORTED({symbol})({integers}) {{ {body} }}\n")
        assert function.returns in (VOID, INT) or function.returns.c == "bool", symbol
