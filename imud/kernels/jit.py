"""The one way a kernel of the estimators is compiled: nopython, cached on disk, IEEE division, no fast-math."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile `function` in nopython mode on first use; its own type is kept for the type checker."""
    return cast(Function, numba.njit(cache=True, error_model="numpy")(function))
