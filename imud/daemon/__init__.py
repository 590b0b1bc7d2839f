"""The running daemon: its loop, its ports, and what it says of itself."""

from ..late_imports import undocumented

with undocumented():
    import numpy as np  # noqa: F401
