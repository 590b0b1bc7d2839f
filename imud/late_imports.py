"""Modules that others import, but seldom or never use: a stand-in imports one at its first use, or it is hidden.

Python's own modules import each other: `urllib.parse` the whole of `ipaddress` for addresses in brackets. In a daemon
that stays for months such a module costs memory, and each command waits for it.
"""

import contextlib
import importlib
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any


class _StandIn(ModuleType):
    def __getattr__(self, name: str) -> Any:
        _remove(self)
        return getattr(importlib.import_module(self.__name__), name)


@contextlib.contextmanager
def undocumented() -> Iterator[None]:
    """Within the block numpy, if it is imported there, does not format the documentation of its functions.

    For that it would import `inspect`, which imports `ast` and `dis`: 1 MB.
    """
    before = sys.modules.get("inspect")
    if before is not None and not isinstance(before, _StandIn):
        yield
        return
    stand_in = _StandIn("inspect")
    vars(stand_in).update(cleandoc=lambda _: "", signature=lambda _: None)
    modules: dict[str, Any] = sys.modules
    modules["inspect"] = stand_in
    try:
        yield
    finally:
        if before is None:
            _remove(stand_in)
        elif modules["inspect"] is stand_in:
            modules["inspect"] = before


def _remove(stand_in: _StandIn) -> None:
    if sys.modules.get(stand_in.__name__) is stand_in:
        del sys.modules[stand_in.__name__]


@contextlib.contextmanager
def hidden(*names: str) -> Iterator[None]:
    """Within the block, these packages are not there, unless one was imported before: others do without them."""
    absent = [name for name in names if name not in sys.modules]
    modules: dict[str, Any] = sys.modules
    modules.update(dict.fromkeys(absent))  # None: as for a module that is not found
    try:
        yield
    finally:
        for name in absent:
            del modules[name]


@contextlib.contextmanager
def imported_late(*names: str) -> Iterator[None]:
    """Within the block, `import NAME` gives a stand-in unless the module was imported before. A module that imports it
    there keeps the stand-in, which works at any time later.
    """
    stand_ins = [_StandIn(name) for name in names if name not in sys.modules]
    sys.modules.update({each.__name__: each for each in stand_ins})
    try:
        yield
    finally:
        for each in stand_ins:
            _remove(each)
