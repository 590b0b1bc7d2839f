"""The one way a kernel of this package is compiled: nopython, cached on disk, IEEE division, no fast-math.

Nothing is cached unless the program has named a directory that fits its sources: numba would take stale code for fresh.
"""

import os
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])
_CACHE = "NUMBA_CACHE_DIR" in os.environ


def kernel(function: Function) -> Function:
    """Compile `function` in nopython mode on first use; its own type is kept for the type checker."""
    return cast(Function, numba.njit(cache=_CACHE, error_model="numpy")(function))
