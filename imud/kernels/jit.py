"""The one way a kernel of the estimators is compiled: nopython, cached on disk, IEEE division, no fast-math.

Nothing is cached unless the program has named a directory that fits its sources: numba would take stale code for fresh.
"""

import os
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])
CACHED = "NUMBA_CACHE_DIR" in os.environ


def kernel(function: Function) -> Function:
    """Compile `function` in nopython mode on first use; its own type is kept for the type checker."""
    return cast(Function, numba.njit(cache=CACHED, error_model="numpy")(function))


def inlined(function: Function) -> Function:
    """For a kernel with one caller that is compiled anyway: it becomes part of that, and is not compiled apart."""
    return cast(Function, numba.njit(inline="always", error_model="numpy")(function))


def unlocked(function: Function) -> Function:
    """A kernel that waits: other threads run meanwhile."""
    return cast(Function, numba.njit(cache=CACHED, error_model="numpy", nogil=True)(function))
