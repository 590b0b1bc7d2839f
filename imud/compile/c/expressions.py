"""Expressions of a kernel as C. Each gives its text in C and its kind."""

import ast
import functools
import inspect
from collections.abc import Callable, Mapping
from types import CodeType
from typing import Any, NoReturn

import numpy as np

from .calls import call
from .kinds import BOOL, FLOAT, INT, Array, Kind, Record, Tuple, UnsupportedError, Value, literal, unify, working
from .unit import Unit

_OPERATORS: dict[type[ast.AST], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.BitAnd: "&",
    ast.BitOr: "|",
    ast.BitXor: "^",
    ast.LShift: "<<",
    ast.RShift: ">>",
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
    ast.USub: "-",
    ast.UAdd: "+",
    ast.Not: "!",
    ast.Invert: "~",
}


class Expressions:
    """Translates the expressions of one function."""

    def __init__(self, unit: Unit, python: Callable[..., Any], variables: Mapping[str, Kind]) -> None:
        """variables: the kinds of the function's arguments and local variables, as far as they are known."""
        self.unit, self._python, self._variables = unit, python, variables
        self._known: dict[ast.expr, Any] = {}  # constants
        cells = inspect.getclosurevars(python).nonlocals
        self._names = {**python.__globals__, **cells}

    def fail(self, node: ast.AST, what: str) -> NoReturn:
        """Raise UnsupportedError for this part of the function."""
        where = f"{inspect.getsourcefile(self._python)}:{getattr(node, 'lineno', 1)}"
        raise UnsupportedError(f"{where}: C has no translation of this {what}: {ast.unparse(node)}")

    def constant(self, node: ast.expr) -> Any:
        """The value of an expression that is known while translating, else None. What a kernel returns is not."""
        if not _names(node).isdisjoint(self._variables):
            return None
        if node not in self._known:
            self._known[node] = self._evaluate(node)
        return self._known[node]

    def _evaluate(self, node: ast.expr) -> Any:
        for part in ast.walk(node):
            if isinstance(part, ast.Call) and is_kernel(self.constant(part.func)):
                return None
        try:
            return eval(_code(node), self._names)
        except Exception:
            return None

    def text(self, node: ast.expr) -> str:
        """The expression in C."""
        return self.value(node)[0]

    def value(self, node: ast.expr) -> Value:
        """The expression in C, and its kind. Raises UnsupportedError."""
        known = None if isinstance(node, ast.Call | ast.Tuple) else self.constant(node)
        if isinstance(known, bool | int | float | np.number | np.bool_):
            return literal(known)
        if isinstance(known, np.ndarray | tuple):
            return self.unit.table(np.array(known))
        match node:
            case ast.Name(id=name):
                if name not in self._variables:
                    self.fail(node, "name, which has no value yet")
                return name, self._variables[name]
            case ast.Attribute():
                return self._attribute(node)
            case ast.Subscript():
                return self._subscript(node)
            case ast.Tuple():
                items = [self.value(item) for item in node.elts]
                made = self.unit.tuple_of([kind for _, kind in items])
                return f"(({made.c}){{{{{', '.join(text for text, _ in items)}}}}})", made
            case ast.IfExp():
                (yes, a), (no, b) = self.value(node.body), self.value(node.orelse)
                return f"({self.text(node.test)} ? {yes} : {no})", unify(working(a), working(b))
            case ast.BoolOp():
                sign = " && " if isinstance(node.op, ast.And) else " || "
                return f"({sign.join(self.text(v) for v in node.values)})", BOOL
            case ast.UnaryOp():
                text, kind = self.value(node.operand)
                result = BOOL if isinstance(node.op, ast.Not) else INT if working(kind) == BOOL else working(kind)
                return f"({_OPERATORS[type(node.op)]}{text})", result
            case ast.BinOp():
                return self.binary(node, node.left, node.op, node.right)
            case ast.Compare():
                return self._compare(node)
            case ast.Call():
                return call(self, node)
            case _:
                return self.fail(node, "expression")

    def element(self, text: str, kind: Array | Tuple, index: str) -> Value:
        """One element of an array or a tuple."""
        text = f"{text}.v[{index}]" if isinstance(kind, Tuple) else f"{text}[{index}]"
        return (f"(&{text})" if isinstance(kind.item, Record) else text), kind.item

    def _attribute(self, node: ast.Attribute) -> Value:
        text, kind = self.value(node.value)
        if not isinstance(kind, Record) or node.attr not in (kind.dtype.names or ()):
            self.fail(node, "attribute")
        field = self.unit.of_dtype(kind.dtype[node.attr])
        return (f"(&{text}->{node.attr})" if isinstance(field, Record) else f"{text}->{node.attr}"), field

    def _subscript(self, node: ast.Subscript) -> Value:
        text, kind = self.value(node.value)
        if isinstance(node.slice, ast.Slice):
            part = node.slice
            if not isinstance(kind, Array) or kind.n is not None or part.upper or part.step or part.lower is None:
                self.fail(node, "slice")
            return f"({text} + {self.text(part.lower)})", kind
        for index in node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]:
            if not isinstance(kind, Array | Tuple):
                self.fail(node, "index")
            known = self.constant(index)
            if isinstance(known, int) and known < 0:
                self.fail(node, "index from the end")
            text, kind = self.element(text, kind, self.text(index))
        return text, kind

    def binary(self, node: ast.AST, left: ast.expr, op: ast.operator, right: ast.expr) -> Value:
        """left op right, with numba's types and rounding."""
        (a, ka), (b, kb) = self.value(left), self.value(right)
        kind = unify(working(ka), working(kb))
        if kind not in (INT, FLOAT, BOOL):
            self.fail(node, "operation")
        kind = INT if kind == BOOL and not isinstance(op, ast.BitAnd | ast.BitOr | ast.BitXor) else kind
        if isinstance(op, ast.Div):
            return f"((double)({a}) / ({b}))", FLOAT
        if isinstance(op, ast.Pow):
            return self._power(node, a, kind, self.constant(right))
        if isinstance(op, ast.FloorDiv | ast.Mod):
            if kind != INT:
                self.fail(node, "operation on floats")
            return f"{'floor_div' if isinstance(op, ast.FloorDiv) else 'floor_mod'}({a}, {b})", INT
        if type(op) not in _OPERATORS:
            self.fail(node, "operator")
        return f"({a} {_OPERATORS[type(op)]} {b})", kind

    def _power(self, node: ast.AST, a: str, kind: Kind, exponent: Any) -> Value:
        """numba multiplies for a constant integer exponent, and LLVM takes the root for 0.5."""
        if isinstance(exponent, int) and exponent > 0:
            return f"{self.unit.power(exponent, kind)}({a})", kind
        if exponent == 0.5:
            return f"root({a})", FLOAT
        return self.fail(node, "power, whose exponent is no positive integer constant")

    def _compare(self, node: ast.Compare) -> Value:
        parts, left = [], node.left
        for op, right in zip(node.ops, node.comparators, strict=True):
            if isinstance(op, ast.In | ast.NotIn) and isinstance(right, ast.Tuple):
                test = " || ".join(f"{self.text(left)} == {self.text(item)}" for item in right.elts)
                parts.append(f"(!({test}))" if isinstance(op, ast.NotIn) else f"({test})")
            elif type(op) in _OPERATORS:
                parts.append(f"({self.text(left)} {_OPERATORS[type(op)]} {self.text(right)})")
            else:
                self.fail(node, "comparison")
            left = right
        return f"({' && '.join(parts)})", BOOL


@functools.cache
def _names(node: ast.AST) -> frozenset[str]:
    if isinstance(node, ast.Name):
        return frozenset((node.id,))
    return frozenset().union(*map(_names, ast.iter_child_nodes(node)))


@functools.cache
def _code(node: ast.expr) -> CodeType:
    return compile(ast.Expression(node), "", "eval")


def is_kernel(value: Any) -> bool:
    """Whether this is a compiled function, of ours or of numba's."""
    return hasattr(value, "py_func")
