"""One function of a kernel as C: its statements, and the kinds of its variables."""

import ast
import functools
import inspect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .calls import is_open, length
from .expressions import Expressions
from .kinds import INT, STORAGE, VOID, Array, ConflictError, Kind, Record, Tuple, Value, stored, unify, working
from .unit import Unit

_PASSES = 5  # over a function, at most, until the kinds of its variables have settled


class Body:
    """One function for one choice of argument kinds. `returns` and `text` are filled by `translate`."""

    def __init__(self, unit: Unit, python: Callable[..., Any], kinds: Sequence[Kind]) -> None:
        lines, _ = inspect.findsource(python)
        self._tree = _functions("".join(lines))[python.__code__.co_firstlineno]
        self._arguments = dict(zip([a.arg for a in self._tree.args.args], kinds, strict=True))
        self._variables: dict[str, Kind] = dict(self._arguments)
        self._arrays: set[str] = set()  # that stand on the stack
        self._of = Expressions(unit, python, self._variables)
        self._file = inspect.getsourcefile(python) if unit.with_lines else None
        self.returns: Kind | None = None
        self.text = ""

    @property
    def parameters(self) -> str:
        """As C declares them."""
        return ", ".join(f"{c} {name}" for c, name in parameters(self._arguments)) or "void"

    def translate(self) -> None:
        """Raises UnsupportedError."""
        for _ in range(_PASSES):
            before = dict(self._variables), self.returns
            self._lines: list[str] = []
            self._serial, self._line = 0, self._tree.lineno
            self._block(self._tree.body, 1)
            if before == (self._variables, self.returns):
                break
        self.returns = self.returns or VOID
        own = []
        for name, kind in self._variables.items():
            if isinstance(kind, Array) and name in self._arrays:
                own.append(f"  {stored(kind.item)} {name}[{kind.n}];")
            elif name not in self._arguments:
                own.append(f"  {kind.c} {name};")
        self.text = "\n".join([*own, *self._lines]) + "\n"

    @property
    def line_directive(self) -> str:
        """The line of C that says to which line of Python what follows belongs; empty unless the unit has lines."""
        return "" if self._file is None else f'#line {self._tree.lineno} "{self._file}"\n'

    def _put(self, depth: int, text: str) -> None:
        if self._file is not None:
            self._lines.append(f'#line {self._line} "{self._file}"')
        self._lines.append("  " * depth + text)

    def _temporary(self) -> str:
        self._serial += 1
        return f"tmp_{self._serial}"

    def _block(self, body: list[ast.stmt], depth: int) -> None:
        outer = self._line
        for node in body:
            self._line = node.lineno
            try:
                self._statement(node, depth)
            except ConflictError as error:
                self._of.fail(node, str(error))
        self._line = outer

    def _statement(self, node: ast.stmt, depth: int) -> None:
        """One statement. Raises UnsupportedError."""
        if isinstance(node, ast.Pass) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            return
        if self._file is not None:  # no optimization removes it, or merges it with that of another line
            self._put(depth, '__asm__ volatile ("");')
        match node:
            case ast.Expr():
                self._put(depth, f"{self._of.text(node.value)};")
            case ast.Break():
                self._put(depth, "break;")
            case ast.Continue():
                self._put(depth, "continue;")
            case ast.Return():
                self._return(node, depth)
            case ast.Assign():
                self._assign(node.targets, node.value, depth)
            case ast.AnnAssign(value=ast.expr() as value):
                self._assign([node.target], value, depth)
            case ast.AugAssign():
                self._augment(node, depth)
            case ast.If():
                self._if(node, depth)
            case ast.While(orelse=[]):
                self._put(depth, f"while ({self._of.text(node.test)}) {{")
                self._block(node.body, depth + 1)
                self._put(depth, "}")
            case ast.For(orelse=[], target=ast.Name(id=name)):
                self._for(node, name, depth)
            case _:
                self._of.fail(node, "statement")

    def _return(self, node: ast.Return, depth: int) -> None:
        text, kind = ("", VOID) if node.value is None else self._of.value(node.value)
        self.returns = unify(self.returns, working(kind))
        self._put(depth, f"return {text};")

    def _if(self, node: ast.If, depth: int) -> None:
        self._put(depth, f"if ({self._of.text(node.test)}) {{")
        self._block(node.body, depth + 1)
        if node.orelse:
            self._put(depth, "} else {")
            self._block(node.orelse, depth + 1)
        self._put(depth, "}")

    def _for(self, node: ast.For, name: str, depth: int) -> None:
        """Over a range, or over the elements of a tuple."""
        index = self._temporary()
        pragma = ""
        if isinstance(node.iter, ast.Call) and (called := ast.unparse(node.iter.func)) in ("range", "written_out"):
            pragma = "#pragma GCC unroll 64" if called == "written_out" else ""
            first, last, step = self._range(node.iter)
            end, text, kind = self._temporary(), index, working(INT)
            compare = "<" if step > 0 else ">"
            head = f"int64_t {index} = {first}, {end} = {last}; {index} {compare} {end}; {index} += {step}"
        else:
            items, values = self._temporary(), self._of.value(node.iter)
            if not isinstance(values[1], Array | Tuple) or values[1].n is None:
                self._of.fail(node.iter, "loop")
            const = "const " if isinstance(values[1], Array) else ""
            self._put(depth, f"{const}{values[1].c} {items} = {values[0]};")
            text, kind = self._of.element(items, values[1], index)
            head = f"int64_t {index} = 0; {index} < {values[1].n}; {index}++"
        self._variables[name] = unify(self._variables.get(name), working(kind))
        if pragma:
            self._lines.append(pragma)
        self._put(depth, f"for ({head}) {{")
        self._put(depth + 1, f"{name} = {text};")
        self._block(node.body, depth + 1)
        self._put(depth, "}")

    def _range(self, node: ast.Call) -> tuple[str, str, int]:
        bounds = [self._of.text(a) for a in node.args]
        step = self._of.constant(node.args[2]) if len(bounds) == 3 else 1
        if not isinstance(step, int) or step == 0:
            self._of.fail(node, "step")
        return ("0", bounds[0], 1) if len(bounds) == 1 else (bounds[0], bounds[1], step)

    def _assign(self, targets: list[ast.expr], value: ast.expr, depth: int) -> None:
        if isinstance(value, ast.Tuple) and all(isinstance(t, ast.Tuple) for t in targets):
            for target in targets:
                assert isinstance(target, ast.Tuple)
                if len(target.elts) != len(value.elts):
                    self._of.fail(target, f"assignment of {len(value.elts)} values")
                self._assign_tuple(target.elts, value.elts, depth)
            return
        if isinstance(value, ast.Call) and ast.unparse(value.func) in ("np.empty", "np.zeros"):
            self._array(targets, value)
            return
        text, kind = self._of.value(value)
        if any(isinstance(t, ast.Tuple) for t in targets):
            self._unpack(targets, text, kind, depth)
            return
        self._remember_length(targets[0], kind, value, text, depth)
        kind = working(kind)
        if len(targets) > 1:
            at = self._temporary()
            self._put(depth, f"{kind.c} {at} = {text};")
            text = at
        for target in targets:
            self._store(target, text, kind, depth)

    def _unpack(self, targets: list[ast.expr], text: str, kind: Kind, depth: int) -> None:
        """The elements of a tuple, or of a row of a table, to several targets."""
        if not isinstance(kind, Array | Tuple):
            self._of.fail(targets[0], "assignment")
        for target in targets:
            at = self._temporary()
            self._put(depth, f"{'const ' if isinstance(kind, Array) else ''}{kind.c} {at} = {text};")
            if not isinstance(target, ast.Tuple) or len(target.elts) != kind.n:
                self._of.fail(target, "assignment")
            for i, item in enumerate(target.elts):
                self._store(item, *self._of.element(at, kind, str(i)), depth)

    def _assign_tuple(self, targets: list[ast.expr], values: list[ast.expr], depth: int) -> None:
        """Python evaluates the whole right side before it assigns."""
        pairs: list[tuple[ast.expr, Value]] = []
        for target, value in zip(targets, values, strict=True):
            text, kind = self._of.value(value)
            at = self._temporary()
            self._put(depth, f"{working(kind).c} {at} = {text};")
            pairs.append((target, (at, working(kind))))
            self._remember_length(target, kind, value, text, depth)
        for target, (at, kind) in pairs:
            self._store(target, at, kind, depth)

    def _remember_length(self, target: ast.expr, kind: Kind, value: ast.expr, text: str, depth: int) -> None:
        if is_open(kind):
            if not isinstance(target, ast.Name):
                self._of.fail(target, "target of an array")
            self._variables[f"{target.id}_n"] = INT
            self._put(depth, f"{target.id}_n = {length(self._of, value, text)};")

    def _store(self, target: ast.expr, text: str, kind: Kind, depth: int) -> None:
        if isinstance(target, ast.Name):
            self._variables[target.id] = unify(self._variables.get(target.id), working(kind))
            self._put(depth, f"{target.id} = {text};")
        elif isinstance(target, ast.Subscript) and isinstance(target.slice, ast.Slice):
            row, filled = self._of.value(target.value)
            if ast.unparse(target.slice) != ":" or not isinstance(filled, Array) or filled.n is None:
                self._of.fail(target, "slice")
            if isinstance(kind, Array):
                self._of.fail(target, "assignment of a whole array")
            self._fill(target, row, filled, "=", text, depth)
        elif isinstance(target, ast.Subscript | ast.Attribute):
            assigned, there = self._of.value(target)
            if isinstance(there, Array):
                self._of.fail(target, "assignment of a whole array")
            if isinstance(there, Record):
                self._put(depth, self._of.unit.record_copy(assigned, text, there))
            else:
                self._put(depth, f"{assigned} = {text};")
        else:
            self._of.fail(target, "target")

    def _fill(self, node: ast.expr, row: str, filled: Array, operator: str, text: str, depth: int) -> None:
        """The same with every element of an array."""
        n, item = 1, filled
        while isinstance(item, Array):
            if item.n is None:
                self._of.fail(node, "array of unknown length")
            n, item = n * item.n, item.item  # type: ignore[assignment]
        i = self._temporary()
        self._put(depth, f"for (int64_t {i} = 0; {i} < {n}; {i}++) (({stored(item)} *){row})[{i}] {operator} {text};")

    def _augment(self, node: ast.AugAssign, depth: int) -> None:
        target, there = self._of.value(node.target)
        if isinstance(there, Array) and isinstance(node.op, ast.Mult):
            self._fill(node.target, target, there, "*=", self._of.text(node.value), depth)
            return
        text, kind = self._of.binary(node, node.target, node.op, node.value)
        if isinstance(node.target, ast.Name):
            self._variables[node.target.id] = unify(self._variables.get(node.target.id), kind)
        self._put(depth, f"{target} = {text};")

    def _array(self, targets: list[ast.expr], node: ast.Call) -> None:
        """`np.empty(n)` or `np.empty(n, dtype)`, n known: an array on the stack."""
        size = self._of.constant(node.args[0])
        dtype = np.dtype(self._of.constant(node.args[1]) if len(node.args) > 1 else float)
        target = targets[0]
        if not isinstance(size, int) or ast.unparse(node.func) == "np.zeros" or not isinstance(target, ast.Name):
            self._of.fail(node, "array")
        self._variables[target.id] = Array(STORAGE[dtype.str[1:]], size)
        self._arrays.add(target.id)


@functools.cache
def _functions(text: str) -> dict[int, ast.FunctionDef]:
    """The functions of a file, by the line with which each begins."""
    return {_first_line(node): node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)}


def _first_line(function: ast.FunctionDef) -> int:
    """That of the first decorator."""
    return function.decorator_list[0].lineno if function.decorator_list else function.lineno


def parameters(arguments: dict[str, Kind]) -> list[tuple[str, str]]:
    """C type and name of each; of an array of unknown length two."""
    out = []
    for name, kind in arguments.items():
        out += [(kind.c, name), *([("int64_t", f"{name}_n")] if is_open(kind) else [])]
    return out
