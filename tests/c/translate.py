"""Kernels as C: the same functions, specialised by the types of their arguments as numba does it, for comparison.

Kernels are written in a small part of Python: numbers, fixed-size records and arrays, tuples of numbers, loops. Each
(function, argument types) becomes one static C function; records become structs of the same layout. The two then do
the same work by construction, whoever changes a kernel. What is not understood raises UnsupportedError with its place.
"""

import numpy as np

from .kinds import FLOAT, INT, STORAGE, WORKING, Array, Record, Scalar, Tuple, UnsupportedError, real, unify
from .statements import Function

__all__ = ["FLOAT", "INT", "Translation", "UnsupportedError"]

PRELUDE = r"""
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
static inline int64_t floor_mod(int64_t a, int64_t b) { int64_t r = a % b; return r && (r < 0) != (b < 0) ? r + b : r; }
static inline int64_t floor_div(int64_t a, int64_t b) { return (a - floor_mod(a, b)) / b; }
static inline int64_t abs_i(int64_t a) { return a < 0 ? -a : a; }
static inline int64_t max_i(int64_t a, int64_t b) { return b > a ? b : a; }
static inline int64_t min_i(int64_t a, int64_t b) { return b < a ? b : a; }
static inline double max_f(double a, double b) { return b > a ? b : a; }
static inline double min_f(double a, double b) { return b < a ? b : a; }
static inline double square_f(double a) { return a * a; }
static inline int64_t square_i(int64_t a) { return a * a; }
"""


class Translation:
    """Collects structs and functions; `source` is the whole translation unit."""

    def __init__(self):
        self._structs, self._tuples, self._tables, self._done = {}, {}, {}, {}
        self._declarations, self._bodies = [], []
        self._names = set()

    def record(self, dtype):
        """The Record of a numpy dtype, declared on first use."""
        if dtype not in self._structs:
            fields = []
            for name in dtype.names:
                kind = dtype.fields[name][0]
                base, shape = kind.subdtype or (kind, ())
                c = self.record(base).c.rstrip(" *") if base.names else STORAGE[base.str[1:]].c
                fields.append(f"  {c} {name}{''.join(f'[{n}]' for n in shape)};")
            name = f"record_{len(self._structs)}"
            self._structs[dtype] = Record(dtype, name)
            body = "\n".join(fields)
            size = f'_Static_assert(sizeof(struct {name}) == {dtype.itemsize}, "layout");'
            self._declarations.append(f"struct {name} {{\n{body}\n}};\n{size}")
        return self._structs[dtype]

    def of_dtype(self, dtype):
        """What an element or field of this dtype is in an expression."""
        base, shape = dtype.subdtype or (dtype, ())
        kind = self.record(base) if base.names else STORAGE[base.str[1:]]
        for n in reversed(shape):
            kind = Array(kind, n)
        return kind

    def array(self, dtype):
        """A one-dimensional array argument of unknown length."""
        return Array(self.of_dtype(np.dtype(dtype)), None)

    def table(self, values):
        """A constant array."""
        kind = self.of_dtype(values.dtype)
        numbers = ", ".join(real(v) if kind.kind == "f" else str(int(v)) for v in values.ravel())
        sizes = "".join(f"[{n}]" for n in values.shape)
        name = f"table_{len(self._tables)}"
        if (found := self._tables.setdefault((kind, sizes, numbers), name)) == name:
            self._declarations.append(f"static const {kind.c} {name}{sizes} = {{{numbers}}};")
        for n in reversed(values.shape):
            kind = Array(kind, n)
        return found, kind

    def tuple_of(self, kinds):
        item = None
        for kind in kinds:
            item = unify(item, WORKING[kind.kind] if isinstance(kind, Scalar) else kind)
        made = Tuple(item, len(kinds))
        if made.c not in self._tuples:
            self._tuples[made.c] = made
            self._declarations.append(f"typedef struct {{ {item.c} v[{made.n}]; }} {made.c};")
        return made

    def function(self, kernel, kinds, exported=None):
        """C name and return type of a kernel for these argument types; exported: a name visible outside."""
        python = getattr(kernel, "py_func", kernel)
        kinds = tuple(WORKING[k.kind] if isinstance(k, Scalar) else k for k in kinds)
        key = (python, kinds)
        if key not in self._done:
            name = exported or f"{python.__name__}_{len(self._done)}"
            self._done[key] = (name, None)
            body = Function(self, python, kinds)
            returns = body.translate()
            self._done[key] = (name, returns)
            linkage = "" if exported else "static inline "
            head = f"{linkage}{returns.c if returns else 'void'} {name}({body.parameters()})"
            self._bodies.append(f"{head}\n{{\n{body.text}}}\n")
        return self._done[key]

    @property
    def source(self):
        return "\n".join([PRELUDE, *self._declarations, *self._bodies])
