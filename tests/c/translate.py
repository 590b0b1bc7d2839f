"""Kernels as C: the same functions, specialised by the types of their arguments as numba does it, for comparison.

Kernels are written in a small part of Python: numbers, fixed-size records and arrays, tuples of numbers, loops. Each
(function, argument types) becomes one static C function; records become structs of the same layout. The two then do
the same work by construction, whoever changes a kernel. What is not understood raises UnsupportedError with its place.
"""

import ast
import inspect
import math
import textwrap
from dataclasses import dataclass

import numpy as np

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
_STORAGE = {
    "i8": INT, "f8": FLOAT, "b1": BOOL, "u1": Scalar("i", "uint8_t"), "i4": Scalar("i", "int32_t"),
    "u2": Scalar("i", "uint16_t"), "u4": Scalar("i", "uint32_t"), "i2": Scalar("i", "int16_t"),
}  # fmt: skip
_WORKING = {"i": INT, "f": FLOAT, "b": BOOL}
_OPERATORS = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.BitAnd: "&", ast.BitOr: "|", ast.BitXor: "^", ast.LShift: "<<",
    ast.RShift: ">>", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
}  # fmt: skip
_CASTS = {"float": FLOAT, "int": INT, "bool": BOOL, "np.int64": INT, "np.uint64": INT}
_MATH = {
    "sqrt",
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
    "atan2",
    "exp",
    "log",
    "copysign",
    "hypot",
    "floor",
    "erf",
    "fabs",
}


def unify(a, b):
    """The type of a variable that holds both."""
    if a is None or a == b:
        return b
    if isinstance(a, Scalar) and isinstance(b, Scalar):
        return _WORKING["f" if "f" in (a.kind, b.kind) else "i"]
    if isinstance(a, Tuple) and isinstance(b, Tuple) and a.n == b.n:
        return Tuple(unify(a.item, b.item), a.n)
    raise UnsupportedError(f"a variable is {a} and {b}")


def real(value):
    """A number as C writes it, to the last bit."""
    if math.isnan(value):
        return "NAN"
    return ("-" if value < 0.0 else "") + "INFINITY" if math.isinf(value) else float(value).hex()


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
                c = self.record(base).c.rstrip(" *") if base.names else _STORAGE[base.str[1:]].c
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
        kind = self.record(base) if base.names else _STORAGE[base.str[1:]]
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
            item = unify(item, _WORKING[kind.kind] if isinstance(kind, Scalar) else kind)
        made = Tuple(item, len(kinds))
        if made.c not in self._tuples:
            self._tuples[made.c] = made
            self._declarations.append(f"typedef struct {{ {item.c} v[{made.n}]; }} {made.c};")
        return made

    def function(self, kernel, kinds, exported=None):
        """C name and return type of a kernel for these argument types; exported: a name visible outside."""
        python = getattr(kernel, "py_func", kernel)
        kinds = tuple(_WORKING[k.kind] if isinstance(k, Scalar) else k for k in kinds)
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


class Function:
    """One function for one choice of argument types."""

    def __init__(self, unit, python, kinds):
        self.unit, self.python = unit, python
        lines, self.first_line = inspect.getsourcelines(python)
        tree = ast.parse(textwrap.dedent("".join(lines)))
        self.tree = next(node for node in tree.body if isinstance(node, ast.FunctionDef))
        self.kinds = dict(zip([a.arg for a in self.tree.args.args], kinds, strict=True))
        self.locals, self.returns, self.text = dict(self.kinds), None, ""

    def parameters(self):
        out = []
        for name, kind in self.kinds.items():
            out.append(f"{kind.c} {name}")
            if isinstance(kind, Array) and kind.n is None:
                out.append(f"int64_t {name}_n")
        return ", ".join(out) or "void"

    def translate(self):
        for _ in range(5):  # until the types of variables have settled
            before = dict(self.locals), self.returns
            self.lines, self.serial = [], 0
            self.block(self.tree.body, 1)
            if before == (self.locals, self.returns):
                break
        declared = {n: k for n, k in self.locals.items() if n not in self.kinds}
        own = [f"  {k.c} {n};" for n, k in declared.items() if not (isinstance(k, Array) and n in self.buffers)]
        own += [f"  {self.locals[n].item.c} {n}[{self.locals[n].n}];" for n in self.buffers]
        self.text = "\n".join([*own, *self.lines]) + "\n"
        return self.returns

    buffers = ()

    def fail(self, node, what):
        where = f"{inspect.getsourcefile(self.python)}:{self.first_line + getattr(node, 'lineno', 1) - 1}"
        raise UnsupportedError(f"{where}: {what}: {ast.unparse(node)}")

    # statements

    def block(self, body, depth):
        for node in body:
            getattr(self, f"do_{type(node).__name__.lower()}", self.unknown)(node, depth)

    def unknown(self, node, depth):
        self.fail(node, "statement")

    def put(self, depth, text):
        self.lines.append("  " * depth + text)

    def do_expr(self, node, depth):
        if not isinstance(node.value, ast.Constant):
            self.put(depth, f"{self.value(node.value)[0]};")

    def do_pass(self, node, depth):
        pass

    def do_break(self, node, depth):
        self.put(depth, "break;")

    def do_continue(self, node, depth):
        self.put(depth, "continue;")

    def do_return(self, node, depth):
        if node.value is None:
            self.put(depth, "return;")
            return
        text, kind = self.value(node.value)
        self.returns = unify(self.returns, _WORKING[kind.kind] if isinstance(kind, Scalar) else kind)
        self.put(depth, f"return {text};")

    def do_annassign(self, node, depth):
        self.assign([node.target], node.value, depth)

    def do_assign(self, node, depth):
        self.assign(node.targets, node.value, depth)

    def assign(self, targets, value, depth):
        if all(isinstance(t, ast.Tuple) for t in targets) and isinstance(value, ast.Tuple):
            for target in targets:
                self.together(target.elts, value.elts, depth)
            return
        if self.is_buffer(value):
            self.buffer(targets[0], value)
            return
        text, kind = self.value(value)
        if any(isinstance(t, ast.Tuple) for t in targets):
            self.apart(targets, text, kind, depth)
            return
        if len(targets) > 1 and isinstance(kind, Scalar):
            at = self.temporary(kind)
            self.put(depth, f"{_WORKING[kind.kind].c} {at} = {text};")
            text = at
        for target in targets:
            self.store(target, text, kind, depth)

    def apart(self, targets, text, kind, depth):
        """Elements of a tuple, or of a row of a table, to several targets."""
        dot = ".v" if isinstance(kind, Tuple) else ""
        for target in targets:
            at = self.temporary(kind)
            self.put(depth, f"{'' if dot else 'const '}{kind.c} {at} = {text};")
            for i, item in enumerate(target.elts):
                self.store(item, f"{at}{dot}[{i}]", kind.item, depth)

    def together(self, targets, values, depth):
        """Python evaluates all of the right side before it assigns."""
        pairs = []
        for target, value in zip(targets, values, strict=True):
            if isinstance(target, ast.Tuple):
                self.fail(target, "nested targets")
            text, kind = self.value(value)
            at = self.temporary(kind)
            kind = _WORKING[kind.kind] if isinstance(kind, Scalar) else kind
            self.put(depth, f"{kind.c} {at} = {text};")
            pairs.append((target, at, kind))
        for target, at, kind in pairs:
            self.store(target, at, kind, depth)

    def temporary(self, kind):
        self.serial += 1
        return f"tmp_{self.serial}"

    def store(self, target, text, kind, depth):
        if isinstance(target, ast.Name):
            kind = _WORKING[kind.kind] if isinstance(kind, Scalar) else kind
            if isinstance(kind, Constant):
                self.fail(target, "a constant object in a variable")
            self.locals[target.id] = unify(self.locals.get(target.id), kind)
            self.put(depth, f"{target.id} = {text};")
        elif isinstance(target, ast.Subscript) and isinstance(target.slice, ast.Slice):
            row, filled = self.value(target.value)
            if ast.unparse(target.slice) != ":" or filled.n is None:
                self.fail(target, "slice")
            self.fill(row, filled, "=", text, depth)
        else:
            place, stored = self.value(target)
            star = "*" if isinstance(stored, Record) else ""  # a record is copied
            self.put(depth, f"{star}{place} = {star}{text};")

    def fill(self, row, filled, operator, text, depth):
        """The same with every element of an array."""
        n = 1
        while isinstance(filled, Array):
            n, filled = n * filled.n, filled.item
        i = self.temporary(INT)
        self.put(depth, f"for (int64_t {i} = 0; {i} < {n}; {i}++) (({filled.c} *){row})[{i}] {operator} {text};")

    def do_augassign(self, node, depth):
        target, stored = self.value(node.target)
        if isinstance(stored, Array) and isinstance(node.op, ast.Mult):
            self.fill(target, stored, "*=", self.value(node.value)[0], depth)
            return
        text, kind = self.binary(node, node.target, node.op, node.value)
        if isinstance(node.target, ast.Name):
            self.locals[node.target.id] = unify(self.locals.get(node.target.id), kind)
        self.put(depth, f"{target} = {text};")

    def do_if(self, node, depth):
        self.put(depth, f"if ({self.truth(node.test)}) {{")
        self.block(node.body, depth + 1)
        if node.orelse:
            self.put(depth, "} else {")
            self.block(node.orelse, depth + 1)
        self.put(depth, "}")

    def do_while(self, node, depth):
        self.put(depth, f"while ({self.truth(node.test)}) {{")
        self.block(node.body, depth + 1)
        self.put(depth, "}")

    def do_for(self, node, depth):
        if isinstance(node.iter, ast.Tuple):
            self.each(node, depth)
            return
        if not (isinstance(node.iter, ast.Call) and getattr(node.iter.func, "id", "") == "range"):
            self.fail(node.iter, "loop")
        bounds = [self.value(a)[0] for a in node.iter.args]
        first, last = ("0", bounds[0]) if len(bounds) == 1 else bounds[:2]
        step = ast.literal_eval(node.iter.args[2]) if len(bounds) == 3 else 1
        name, end = node.target.id, self.temporary(INT)
        self.locals[name] = unify(self.locals.get(name), INT)
        self.serial += 1
        index = f"at_{self.serial}"
        compare = "<" if step > 0 else ">"
        self.put(
            depth, f"for (int64_t {index} = {first}, {end} = {last}; {index} {compare} {end}; {index} += {step}) {{"
        )
        self.put(depth + 1, f"{name} = {index};")
        self.block(node.body, depth + 1)
        self.put(depth, "}")

    def each(self, node, depth):
        """A loop over the elements of a tuple."""
        text, kind = self.value(node.iter)
        items, index = self.temporary(kind), self.temporary(INT)
        name = node.target.id
        self.locals[name] = unify(self.locals.get(name), kind.item)
        self.put(depth, f"{kind.c} {items} = {text};")
        self.put(depth, f"for (int64_t {index} = 0; {index} < {kind.n}; {index}++) {{")
        self.put(depth + 1, f"{name} = {items}.v[{index}];")
        self.block(node.body, depth + 1)
        self.put(depth, "}")

    def is_buffer(self, node):
        return isinstance(node, ast.Call) and ast.unparse(node.func) in ("np.empty", "np.zeros")

    def buffer(self, target, node):
        size = self.constant(node.args[0])
        dtype = np.dtype(self.constant(node.args[1])) if len(node.args) > 1 else np.dtype(float)
        if size is None or ast.unparse(node.func) == "np.zeros":
            self.fail(node, "array")
        self.locals[target.id] = Array(_STORAGE[dtype.str[1:]], size)
        self.buffers = (*(n for n in self.buffers if n != target.id), target.id)

    # expressions: C text and type

    def constant(self, node):
        """The value of an expression that is known now, else None."""
        names = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
        if names & set(self.locals):
            return None
        try:
            return eval(compile(ast.Expression(node), "", "eval"), self.python.__globals__)
        except Exception:
            return None

    def literal(self, value):
        if isinstance(value, bool | np.bool_):
            return str(bool(value)).lower(), BOOL
        if isinstance(value, int | np.integer):
            return f"INT64_C({int(value)})" if value >= 0 else f"(-INT64_C({-int(value)}))", INT
        return f"({real(value)})", FLOAT

    def value(self, node):
        known = None if isinstance(node, ast.Call | ast.Tuple) else self.constant(node)
        if isinstance(known, bool | int | float | np.number):
            return self.literal(known)
        if isinstance(known, np.ndarray | tuple):
            return self.unit.table(np.array(known))
        return getattr(self, f"see_{type(node).__name__.lower()}", self.unseen)(node)

    def unseen(self, node):
        self.fail(node, "expression")

    def truth(self, node):
        return self.value(node)[0]

    def see_name(self, node):
        if node.id not in self.locals:
            self.fail(node, "name")
        return node.id, self.locals[node.id]

    def see_attribute(self, node):
        text, kind = self.value(node.value)
        if not isinstance(kind, Record):
            self.fail(node, "attribute")
        field = self.unit.of_dtype(kind.dtype.fields[node.attr][0])
        text = f"{text}->{node.attr}"
        return (f"(&{text})" if isinstance(field, Record) else text), field

    def see_subscript(self, node):
        text, kind = self.value(node.value)
        indices = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        for index in indices:
            if isinstance(kind, Tuple):
                text, kind = f"{text}.v[{self.value(index)[0]}]", kind.item
            elif isinstance(kind, Array):
                text, kind = f"{text}[{self.value(index)[0]}]", kind.item
                text = f"(&{text})" if isinstance(kind, Record) else text
            else:
                self.fail(node, "index")
        return text, kind

    def see_tuple(self, node):
        items = [self.value(item) for item in node.elts]
        made = self.unit.tuple_of([kind for _, kind in items])
        return f"(({made.c}){{{{{', '.join(text for text, _ in items)}}}}})", made

    def see_ifexp(self, node):
        (yes, a), (no, b) = self.value(node.body), self.value(node.orelse)
        return f"({self.truth(node.test)} ? {yes} : {no})", unify(a, b)

    def see_boolop(self, node):
        sign = " && " if isinstance(node.op, ast.And) else " || "
        return f"({sign.join(self.truth(v) for v in node.values)})", BOOL

    def see_unaryop(self, node):
        text, kind = self.value(node.operand)
        sign = {ast.USub: "-", ast.Not: "!", ast.Invert: "~", ast.UAdd: "+"}[type(node.op)]
        return f"({sign}{text})", BOOL if sign == "!" else INT if kind.kind == "b" else kind

    def see_binop(self, node):
        return self.binary(node, node.left, node.op, node.right)

    def binary(self, node, left, op, right):
        (a, ka), (b, kb) = self.value(left), self.value(right)
        kind = unify(_WORKING[ka.kind], _WORKING[kb.kind])
        kind = INT if kind is BOOL and not isinstance(op, ast.BitAnd | ast.BitOr) else kind
        if isinstance(op, ast.Div):
            return f"((double)({a}) / ({b}))", FLOAT
        if isinstance(op, ast.Pow):
            if self.constant(right) == 2:
                return f"square_{kind.kind}({a})", kind
            return f"pow({a}, {b})", FLOAT
        if isinstance(op, ast.FloorDiv | ast.Mod):
            if kind is not INT:
                self.fail(node, "operator")
            return f"floor_{'div' if isinstance(op, ast.FloorDiv) else 'mod'}({a}, {b})", INT
        return f"({a} {_OPERATORS[type(op)]} {b})", kind

    def see_compare(self, node):
        parts, left = [], node.left
        for op, right in zip(node.ops, node.comparators, strict=True):
            if isinstance(op, ast.In | ast.NotIn):
                test = " || ".join(f"{self.value(left)[0]} == {self.value(item)[0]}" for item in right.elts)
                parts.append(f"(!({test}))" if isinstance(op, ast.NotIn) else f"({test})")
            else:
                parts.append(f"({self.value(left)[0]} {_OPERATORS[type(op)]} {self.value(right)[0]})")
            left = right
        return f"({' && '.join(parts)})", BOOL

    def see_call(self, node):
        name = ast.unparse(node.func)
        if node.keywords:
            self.fail(node, "keyword arguments")
        callee = self.constant(node.func)
        if name in _CASTS:
            kind = _CASTS[name]
            return f"(({kind.c})({self.value(node.args[0])[0]}))", kind
        if name in ("math.floor", "math.ceil"):
            return f"((int64_t){name.removeprefix('math.')}({self.value(node.args[0])[0]}))", INT
        if name.startswith(("math.", "np.")):
            return self.library(node, name.partition(".")[2])
        if name in ("max", "min"):
            return self.extremum(node, name)
        args = [self.value(a) for a in node.args]
        if name == "len":
            kind = args[0][1]
            return (f"{args[0][0]}_n" if kind.n is None else str(kind.n)), INT
        if name == "abs":
            return (f"fabs({args[0][0]})", FLOAT) if args[0][1].kind == "f" else (f"abs_i({args[0][0]})", INT)
        if callee is None or not hasattr(callee, "py_func"):
            self.fail(node, "call")
        c, returns = self.unit.function(callee, [kind for _, kind in args])
        texts = []
        for text, kind in args:
            texts += [text, f"{text}_n"] if isinstance(kind, Array) and kind.n is None else [text]
        return f"{c}({', '.join(texts)})", returns

    def library(self, node, name):
        texts = [self.value(a)[0] for a in node.args]
        if name in ("isfinite", "isnan", "isinf"):
            return f"({name}({texts[0]}) != 0)", BOOL
        if name not in _MATH:
            self.fail(node, "library function")
        return f"{name}({', '.join(texts)})", FLOAT

    def extremum(self, node, name):
        text, kind = self.value(node.args[0])
        kind = _WORKING[kind.kind]
        for argument in node.args[1:]:
            other, k = self.value(argument)
            kind = unify(kind, _WORKING[k.kind])
            text = f"{name}_{kind.kind}({text}, {other})"
        return text, kind
