"""Types of arrays, for the type checker."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Records = NDArray[np.void]  # a structured array, often of one element
