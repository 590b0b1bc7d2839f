"""Which file imports which, read from the import statements: those in functions and for types, too.

An `__init__.py` may hand names on to type checkers, as `imud` does: there, what is for types does not count.
"""

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path


def in_folders(module: str) -> str:
    """The name that a module has by its folder: `imud.drivers` and `imud.firmware_sim` are links."""
    return re.sub(r"^imud\.(?=(drivers|firmware_sim)(\.|$))", "", module)


def _module(path: Path, root: Path) -> str:
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@functools.cache
def import_statements(path: Path) -> list[ast.Import | ast.ImportFrom]:
    """Those of a file, wherever in it."""
    return [node for node in _within(ast.parse(path.read_text())) if isinstance(node, ast.Import | ast.ImportFrom)]


def _within(node: ast.AST) -> Iterator[ast.AST]:
    """The statements in this one, at any depth; `ast.walk` would look at every expression, too."""
    for field in ("body", "orelse", "finalbody", "handlers", "cases"):
        for inner in getattr(node, field, ()):
            yield inner
            yield from _within(inner)


def _of_run_time(path: Path) -> list[ast.Import | ast.ImportFrom]:
    if path.name != "__init__.py":
        return import_statements(path)
    for_types = [
        inner
        for node in ast.parse(path.read_text()).body
        if ast.unparse(node).partition("\n")[0] == "if TYPE_CHECKING:"
        for inner in _within(node)
    ]
    lines = {inner.lineno for inner in for_types if isinstance(inner, ast.stmt)}
    return [statement for statement in import_statements(path) if statement.lineno not in lines]


def _imported(path: Path, root: Path) -> Iterator[tuple[str, str]]:
    """(module, name in it or "") for each import, absolute."""
    package = path.relative_to(root).parts[:-1]
    for node in _of_run_time(path):
        if isinstance(node, ast.Import):
            yield from ((in_folders(alias.name), "") for alias in node.names)
        else:
            stem = package[: len(package) + 1 - node.level] if node.level else ()
            module = in_folders(".".join((*stem, *filter(None, [node.module]))))
            yield from ((module, alias.name) for alias in node.names)


def import_graph(root: Path, packages: tuple[str, ...]) -> dict[str, set[str]]:
    """For each file of the packages, the files of the packages that it imports; paths from the root."""
    paths = [path for package in packages for path in (root / package).rglob("*.py")]
    files = {_module(path, root): str(path.relative_to(root)) for path in paths}
    graph = {}
    for path in paths:
        names = {
            f"{module}.{name}" if f"{module}.{name}" in files else module for module, name in _imported(path, root)
        }
        own = str(path.relative_to(root))
        graph[own] = {files[name] for name in names if name in files} - {own}
    return graph
