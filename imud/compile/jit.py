"""How the kernels of the estimators are compiled: as those of the drivers are; and access to numba's own functions."""

import functools
from collections.abc import Callable
from typing import Any

from imud.drivers.jit import inlined, interpreted, kernel, unrolled

__all__ = ["NumbaObject", "inlined", "interpreted", "kernel", "unrolled"]


class NumbaObject:
    """An object of numba's for kernels to call; it is made when the first of them is compiled."""

    def __init__(
        self,
        make: Callable[[Any], Any],
        intrinsic: str | None = None,
        external: tuple[str, ...] | None = None,
        python: Callable[..., Any] | None = None,
    ) -> None:
        """make(numba) -> an intrinsic, an external function, or one that numba has.

        intrinsic: what `compile.c` calls it; external: name, result and arguments of a function of the C library;
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
