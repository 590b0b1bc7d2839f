"""The one way a kernel is compiled: nopython, cached on disk, IEEE division, no fast-math; and not before it must be.

Importing and waking numba takes longer than all the rest of a start, and what Python calls while samples come needs
neither (see `entry`). So numba is imported when the first kernel is compiled, if one is.
Nothing is cached unless the program has named a directory that fits its sources: numba would take stale code for fresh.
"""

import functools
import os
from collections.abc import Callable
from typing import Any, TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., Any])


class Kernel:
    """A function that is compiled when it is called, or when a kernel that calls it is compiled."""

    def __init__(self, function: Callable[..., Any], **options: Any) -> None:
        """options: numba's, beside our own."""
        functools.update_wrapper(self, function)
        self.py_func = function
        self.targetoptions = {"error_model": "numpy", **options}  # numba asks for these three by name

    @property
    def name(self) -> str:
        """Where it is defined, with dots."""
        return f"{self.py_func.__module__}.{self.py_func.__qualname__}"

    @functools.cached_property
    def compiled(self) -> Any:
        """numba's dispatcher."""
        import numba

        return numba.njit(cache="NUMBA_CACHE_DIR" in os.environ, **self.targetoptions)(self.py_func)

    @property
    def _numba_type_(self) -> Any:
        """What numba takes a kernel for that another one calls."""
        return self.compiled._numba_type_

    def __call__(self, *arguments: Any) -> Any:
        return self.compiled(*arguments)


def kernel(function: Function) -> Function:
    """`function` in nopython mode; its own type is kept for the type checker."""
    return cast(Function, Kernel(function))


def inlined(function: Function) -> Function:
    """For a kernel with one caller that is compiled anyway: it becomes part of that, and is not compiled apart."""
    return cast(Function, Kernel(function, inline="always"))


def unrolled(function: Function) -> Function:
    """A kernel whose machine code is repeated wherever it is called: constant arguments make that short and fast."""
    return cast(Function, Kernel(function, forceinline=True))


def interpreted(function: Function) -> Function:
    """The same function as Python runs it: for what is done once, at the start, and is not worth waking numba."""
    return cast(Function, cast(Kernel, function).py_func)
