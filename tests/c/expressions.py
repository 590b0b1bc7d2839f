"""Expressions of a kernel as C: each gives its text and its kind."""

import ast
import inspect

import numpy as np

from .kinds import BOOL, FLOAT, INT, WORKING, Array, Record, Tuple, UnsupportedError, real, unify

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


class Expressions:
    """Of one function, which has a `unit`, a source (`python`, `first_line`) and `locals`: name to kind."""

    def fail(self, node, what):
        where = f"{inspect.getsourcefile(self.python)}:{self.first_line + getattr(node, 'lineno', 1) - 1}"
        raise UnsupportedError(f"{where}: {what}: {ast.unparse(node)}")

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
        if isinstance(node.slice, ast.Slice):
            if not isinstance(kind, Array) or kind.n is not None or node.slice.upper or node.slice.step:
                self.fail(node, "slice")
            return f"({text} + {self.truth(node.slice.lower)})", kind
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
        kind = unify(WORKING[ka.kind], WORKING[kb.kind])
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
        for argument, (text, kind) in zip(node.args, args, strict=True):
            texts += self.with_length(argument, text) if isinstance(kind, Array) and kind.n is None else [text]
        return f"{c}({', '.join(texts)})", returns

    def with_length(self, node, text):
        """An array of unknown length, or what is left of it, as two arguments."""
        if not isinstance(node, ast.Subscript):
            return [text, f"{text}_n"]
        array, begin = self.truth(node.value), self.truth(node.slice.lower)
        return [text, f"({array}_n - {begin})"]

    def library(self, node, name):
        texts = [self.value(a)[0] for a in node.args]
        if name in ("isfinite", "isnan", "isinf"):
            return f"({name}({texts[0]}) != 0)", BOOL
        if name not in _MATH:
            self.fail(node, "library function")
        return f"{name}({', '.join(texts)})", FLOAT

    def extremum(self, node, name):
        text, kind = self.value(node.args[0])
        kind = WORKING[kind.kind]
        for argument in node.args[1:]:
            other, k = self.value(argument)
            kind = unify(kind, WORKING[k.kind])
            text = f"{name}_{kind.kind}({text}, {other})"
        return text, kind
