"""Calls in a kernel as C: of other kernels, of numbers' types, of the mathematical library, of `compile.system`."""

import ast
from typing import Any, NoReturn, Protocol

from .kinds import BOOL, FLOAT, INT, VOID, Array, Kind, Scalar, Tuple, Value, unify, working
from .unit import Unit

_CASTS = {"float": FLOAT, "int": INT, "bool": BOOL, "np.int64": INT, "np.uint64": INT}
_ROUNDED = {"math.floor": "floor", "math.ceil": "ceil"}  # to an int, as Python has it
_UNARY = ("len", "abs")
_TESTS = ("isfinite", "isnan", "isinf")
_LIBRARY = ("sqrt", "fabs", "floor", "ceil", "rint", "copysign", "fmod")  # the same bits in every C library
_INSTEAD = {  # of what numba has and C not
    "round": "int(np.rint(x))",
    "sum": "a loop",
    "divmod": "x // y and x % y",
    "np.abs": "abs(x)",
    "np.maximum": "max(x, y)",
    "np.minimum": "min(x, y)",
    "np.pow": "x ** n, with a constant n",
    "np.zeros": "np.empty(N), with a constant N, and a loop",
}
_OWN = ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "log", "hypot", "erf")


class Operands(Protocol):
    """Translates the arguments of a call: `expressions.Expressions`."""

    unit: Unit

    def value(self, node: ast.expr) -> Value: ...
    def text(self, node: ast.expr) -> str: ...
    def constant(self, node: ast.expr) -> Any: ...
    def fail(self, node: ast.AST, what: str) -> NoReturn: ...


def call(of: Operands, node: ast.Call) -> Value:
    """A call, in C. Raises UnsupportedError."""
    if node.keywords or any(isinstance(a, ast.Starred) for a in node.args):
        of.fail(node, "call with keywords or *")
    name, callee = ast.unparse(node.func), of.constant(node.func)
    if len(node.args) != 1 and (name in _CASTS or name in _ROUNDED or name in _UNARY):
        of.fail(node, f"call with {len(node.args)} arguments instead of one")
    if name in _CASTS:
        return f"(({_CASTS[name].c})({of.text(node.args[0])}))", _CASTS[name]
    if name in _ROUNDED:
        return f"((int64_t){_ROUNDED[name]}({of.text(node.args[0])}))", INT
    if name.startswith(("math.", "np.")):
        return _library(of, node, name.partition(".")[2])
    if name in _BUILT_IN:
        return _BUILT_IN[name](of, node)
    if (intrinsic := getattr(callee, "intrinsic", None)) is not None:
        return _INTRINSIC[intrinsic](of, node)
    if (external := getattr(callee, "external", None)) is not None:
        return f"{of.unit.system_call(external)}({', '.join(of.text(a) for a in node.args)})", INT
    if not hasattr(callee, "py_func"):
        of.fail(node, f"call{_advice(name)}")
    return _kernel(of, node, callee)


def _kernel(of: Operands, node: ast.Call, callee: Any) -> Value:
    takes = callee.py_func.__code__.co_argcount
    if len(node.args) != takes:
        of.fail(node, f"call with {len(node.args)} arguments of a kernel that takes {takes}")
    values = [of.value(a) for a in node.args]
    function = of.unit.function(callee, [kind for _, kind in values])
    texts = []
    for argument, (text, kind) in zip(node.args, values, strict=True):
        texts += [text, length(of, argument, text)] if is_open(kind) else [text]
    return f"{function.name}({', '.join(texts)})", function.returns


def is_open(kind: Kind) -> bool:
    """Whether this is an array whose length only a variable knows."""
    return isinstance(kind, Array) and kind.n is None


def length(of: Operands, node: ast.expr, text: str) -> str:
    """How many elements such an array has: a variable, what a slice leaves of one, or n of `records(address, n, …)`."""
    match node:
        case ast.Call():
            return of.text(node.args[1])
        case ast.Subscript(slice=ast.Slice(lower=ast.expr() as begin)):
            return f"({of.text(node.value)}_n - {of.text(begin)})"
    return f"{text}_n"


def _library(of: Operands, node: ast.Call, name: str) -> Value:
    texts = ", ".join(of.text(a) for a in node.args)
    if name in _TESTS:
        return f"({name}({texts}) != 0)", BOOL
    if name in _OWN:
        of.fail(node, f"function, which differs from machine to machine; use imud.drivers.elementary.{name} for this")
    if name not in _LIBRARY:
        of.fail(node, f"function of a library{_advice(f'np.{name}')}")
    return f"{name}({texts})", FLOAT


def _advice(name: str) -> str:
    return f"; write {_INSTEAD[name]}" if name in _INSTEAD else ""


def _length(of: Operands, node: ast.Call) -> Value:
    text, kind = of.value(node.args[0])
    if not isinstance(kind, Array | Tuple):
        of.fail(node, "length")
    return (f"{text}_n" if kind.n is None else str(kind.n)), INT


def _absolute(of: Operands, node: ast.Call) -> Value:
    text, kind = of.value(node.args[0])
    return (f"fabs({text})", FLOAT) if kind == FLOAT else (f"abs_i({text})", INT)


def _extremum(of: Operands, node: ast.Call) -> Value:
    name = ast.unparse(node.func)
    text, kind = of.value(node.args[0])
    for argument in node.args[1:]:
        other, k = of.value(argument)
        kind = unify(working(kind), working(k))
        if not isinstance(kind, Scalar):
            of.fail(node, "comparison")
        text = f"{name}_{'f' if kind == FLOAT else 'i'}({text}, {other})"
    return text, kind


def _records(of: Operands, node: ast.Call) -> Value:
    """n records that stand at an address."""
    address = node.args[0]
    if isinstance(address, ast.Call) and ast.unparse(address.func) == "pointer":  # what numba's `carray` wants
        address = address.args[0]
    kind = of.unit.array(of.constant(node.args[2]))
    return f"(({kind.c})({of.text(address)}))", kind


def _call(of: Operands, node: ast.Call) -> Value:
    """A function at an address, with integers only."""
    address, arguments = node.args
    if not isinstance(arguments, ast.Tuple):
        of.fail(node, "call by address")
    types = ", ".join(["int64_t"] * len(arguments.elts))
    return f"((int64_t (*)({types}))({of.text(address)}))({', '.join(of.text(a) for a in arguments.elts)})", INT


def _fence(of: Operands, node: ast.Call) -> Value:
    return "__atomic_thread_fence(__ATOMIC_SEQ_CST)", VOID


def _float_bits(of: Operands, node: ast.Call) -> Value:
    return f"float_bits({of.text(node.args[0])})", INT


def _float_of_bits(of: Operands, node: ast.Call) -> Value:
    return f"float_of_bits({of.text(node.args[0])})", FLOAT


_BUILT_IN = {"len": _length, "abs": _absolute, "max": _extremum, "min": _extremum}
_INTRINSIC = {
    "records": _records,
    "carray": _records,
    "call": _call,
    "fence": _fence,
    "float_bits": _float_bits,
    "float_of_bits": _float_of_bits,
}
