"""One function of a kernel as C: its statements, and the kinds of its variables."""

import ast
import inspect
import textwrap

import numpy as np

from .expressions import Expressions
from .kinds import INT, STORAGE, WORKING, Array, Constant, Record, Scalar, Tuple, unify


class Function(Expressions):
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
        self.returns = unify(self.returns, WORKING[kind.kind] if isinstance(kind, Scalar) else kind)
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
            self.put(depth, f"{WORKING[kind.kind].c} {at} = {text};")
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
            kind = WORKING[kind.kind] if isinstance(kind, Scalar) else kind
            self.put(depth, f"{kind.c} {at} = {text};")
            pairs.append((target, at, kind))
        for target, at, kind in pairs:
            self.store(target, at, kind, depth)

    def temporary(self, kind):
        self.serial += 1
        return f"tmp_{self.serial}"

    def store(self, target, text, kind, depth):
        if isinstance(target, ast.Name):
            kind = WORKING[kind.kind] if isinstance(kind, Scalar) else kind
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
        self.locals[target.id] = Array(STORAGE[dtype.str[1:]], size)
        self.buffers = (*(n for n in self.buffers if n != target.id), target.id)
