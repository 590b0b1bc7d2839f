"""Types of arrays, for the type checker: numpy's, and what kernels know of one (Reals, Integers, Tensor)."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Records = NDArray[np.void]  # a structured array, often of one element


class Reals(Protocol):
    """A one-dimensional array of numbers."""

    def __getitem__(self, i: int) -> float: ...
    def __setitem__(self, i: Any, value: float) -> None: ...
    def __len__(self) -> int: ...


class Integers(Protocol):
    """A one-dimensional array of integers."""

    def __getitem__(self, i: int) -> int: ...
    def __setitem__(self, i: Any, value: int) -> None: ...
    def __len__(self) -> int: ...


class Tensor(Protocol):
    """An array of numbers with several indices."""

    def __getitem__(self, i: Any) -> Any: ...
    def __setitem__(self, i: Any, value: float) -> None: ...
    def __imul__(self, factor: float) -> Any: ...
