"""The one way a kernel is compiled: nopython, cached on disk, IEEE division, no fast-math, and as late as possible.

Importing numba takes longer than all the rest of a start, and the kernels that Python calls while samples come do not
need it (see `entry`). So numba is imported when the first kernel is compiled, if any is. Nothing is cached unless the
program has named a cache directory for just these sources: numba itself does not detect stale machine code.

A kernel in the library is never run as Python. So the functions are not kept, 1 MB in a daemon: one that is asked for
is made again from its module's byte code.
"""

import functools
import os
import sys
import types
from collections.abc import Callable
from typing import Any, TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., Any])


_OPTIONS = {"error_model": "numpy"}  # IEEE division


class Kernel:
    """A function that is compiled when it is called, or when a kernel that calls it is compiled."""

    def __init__(self, function: Callable[..., Any], **options: Any) -> None:
        """options: numba's, beside our own."""
        self.__module__, self.__name__, self.__qualname__ = (
            function.__module__,
            function.__name__,
            function.__qualname__,
        )
        self._line = function.__code__.co_firstlineno
        self.targetoptions = {**_OPTIONS, **options} if options else _OPTIONS  # numba asks for it by name
        if not _is_restorable(function):
            self.py_func = function

    @property
    def name(self) -> str:
        """Where it is defined, with dots."""
        return f"{self.__module__}.{self.__qualname__}"

    @functools.cached_property
    def py_func(self) -> Any:
        """The function itself."""
        module = sys.modules[self.__module__]
        for constant in cast(Any, module.__spec__).loader.get_code(self.__module__).co_consts:
            if isinstance(constant, types.CodeType) and constant.co_firstlineno == self._line:
                return types.FunctionType(constant, vars(module), self.__name__)
        raise ImportError(f"{self.name} is no longer in line {self._line}: its file has changed", name=self.__module__)

    @property
    def __wrapped__(self) -> Any:
        return self.py_func

    @functools.cached_property
    def compiled(self) -> Any:
        """numba's dispatcher."""
        import numba

        return numba.njit(cache="NUMBA_CACHE_DIR" in os.environ, **self.targetoptions)(self.py_func)

    @property
    def _numba_type_(self) -> Any:
        """The type by which numba resolves a call of this kernel from another kernel."""
        return self.compiled._numba_type_

    def __call__(self, *arguments: Any) -> Any:
        return self.compiled(*arguments)


def _is_restorable(function: Callable[..., Any]) -> bool:
    """Whether its module's byte code has all of it: a module's function, of ours, not one made by another function."""
    spec = function.__globals__.get("__spec__")
    plain = function.__qualname__ == function.__name__ and not function.__defaults__ and not function.__kwdefaults__
    return plain and spec is not None and spec.name == function.__module__ and hasattr(spec.loader, "get_code")


def kernel(function: Function) -> Function:
    """`function` in nopython mode; its own type is kept for the type checker."""
    return cast(Function, Kernel(function))


def inlined(function: Function) -> Function:
    """For a kernel with a single caller: it is compiled as a part of that caller, never on its own."""
    return cast(Function, Kernel(function, inline="always"))


def unrolled(function: Function) -> Function:
    """A kernel that the compiler inlines at every call; for calls with constant arguments, which make it short."""
    return cast(Function, Kernel(function, forceinline=True))


# A `range` of known length, at most 64, whose passes the C compiler writes out one behind the other: for an outer loop,
# the lengths of whose inner loops are known then.
written_out = range


def interpreted(function: Function) -> Function:
    """A kernel as plain Python, with all that it calls: for what is done once and is not worth importing numba.

    As in Python, a division by zero raises ZeroDivisionError, and the root of a negative number ValueError.
    """
    python = cast(Any, function).py_func
    scope = dict(python.__globals__)
    names = python.__code__.co_names
    for name in names:
        value = scope.get(name)
        if isinstance(value, Kernel):
            scope[name] = interpreted(value)
        elif isinstance(value, types.ModuleType):
            inside = {n: interpreted(vars(value)[n]) for n in names if isinstance(vars(value).get(n), Kernel)}
            scope[name] = types.SimpleNamespace(**inside) if inside else value  # one of kernels, as `elementary`
    return cast(Function, types.FunctionType(python.__code__, scope, python.__name__, python.__defaults__))


class NumbaObject:
    """An object of numba's for kernels to call; it is made when the first of them is compiled."""

    def __init__(
        self,
        make: Callable[[Any], Any],
        intrinsic: str | None = None,
        external: str | None = None,
        python: Callable[..., Any] | None = None,
    ) -> None:
        """make(numba) -> an intrinsic, an external function, or one that numba has.

        intrinsic: what `compile.c` calls it; external: its name, if it is a function of the C library;
        python: the same for kernels that are interpreted, if there is such.
        """
        self._make, self.intrinsic, self.external, self._python = make, intrinsic, external, python

    @functools.cached_property
    def _numba_type_(self) -> Any:
        import numba
        from numba.core.registry import cpu_target

        self._made = self._make(numba)
        context: Any = cpu_target.typing_context
        context.refresh()
        return context.resolve_value_type(self._made)

    def __call__(self, *arguments: Any) -> Any:
        if self._python is None:
            raise TypeError("only kernels call this")
        return self._python(*arguments)
